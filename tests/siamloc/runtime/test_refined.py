"""The robot's poses finer than the map: the same as in the evaluation, with covariances, from a complete bundle."""

from __future__ import annotations

import itertools
import json
import math
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from foundation.files import read_json, write_json
from siamloc.data.moves import chained, moves
from siamloc.errors import ConfigError, DataError, FormatError, SiamlocError
from siamloc.maps import (
    ErrorModel,
    MotionModel,
    PoseFilter,
    Refinement,
    SequenceFilter,
    VisualMap,
    frame_distances,
    match,
    temperature_of_map,
)
from siamloc.maps.motion import WrongUnitError
from siamloc.maps.sequence_filter import spacing_of
from siamloc.models import as_descriptor, build
from siamloc.runtime import Bundle, Localizer, export, locate_all, written
from siamloc.runtime.onnx_model import export_relative, relative_parity
from siamloc.runtime.stream import Located
from tests.siamloc.runtime.conftest import SIZE, altered, batch, drive, mapped, rewritten

PICTURES, FRAMES = drive(2)


@pytest.fixture(scope="module")
def network():
    """One whose answers are large enough to be distinguished from the map frames' own poses."""
    found = build("panoresnet", "magnitudes", SIZE, circular=True, relative=True).eval()
    assert found.relative is not None
    with torch.no_grad():
        found.relative.votes.weight[:3] *= 10
    return found


@pytest.fixture(scope="module")
def known(network) -> VisualMap:
    return mapped(as_descriptor(network))


def refinement(known: VisualMap, method: str, **options) -> Refinement:
    return Refinement(method, map_digest=known.digest, **options)


def bundled(folder, network, known, **options):
    export(network, known, folder, refinement=refinement(known, **options))
    return folder


@pytest.fixture(scope="module")
def bundle(network, known, tmp_path_factory):
    return bundled(tmp_path_factory.mktemp("robot") / "bundle", network, known, method="relative", widening=2.0)


@pytest.fixture(scope="module")
def between(network, known, tmp_path_factory):
    return bundled(tmp_path_factory.mktemp("robot") / "between", network, known, method="interpolate", widening=2.0)


@pytest.fixture(scope="module")
def plain(network, known, tmp_path_factory):
    return export(network, known, tmp_path_factory.mktemp("robot") / "plain").path


@pytest.fixture(scope="module")
def seen(known):
    """The descriptions of the pictures of a third drive."""
    return known.describe(batch(PICTURES))


@pytest.mark.slow
def test_the_robot_refines_by_an_ordinary_camera(tmp_path):
    network = build("panoresnet", "magnitudes", SIZE, relative=True).eval()
    known = mapped(as_descriptor(network))
    folder = bundled(tmp_path / "bundle", network, known, method="relative")
    seen = known.describe(batch(PICTURES[:3]))
    expected = refinement(known, "relative").poses(known, seen, match(known, seen, 3))
    localizer = Localizer(folder)
    found = [localizer.locate(picture) for picture in PICTURES[:3]]
    np.testing.assert_allclose([[one.x, one.y] for one in found], expected.xy, atol=1e-3)
    np.testing.assert_allclose([one.theta for one in found], expected.theta, atol=1e-3)
    assert localizer.bundle.about["heading"] is None
    plain = Localizer(export(network, known, tmp_path / "plain").path)
    assert math.isnan(plain.locate(PICTURES[0]).theta), "only the comparison knows it"


def test_a_map_that_is_not_put_in_order_by_comparison_is_refined_by_it(network, known, tmp_path):
    other = known.with_distance("cosine")
    localizer = Localizer(bundled(tmp_path / "bundle", network, other, method="relative"))
    seen = other.describe(batch(PICTURES[:1]))
    expected = refinement(other, "relative").poses(other, seen, match(other, seen, 3))
    found = localizer.locate(PICTURES[0])
    np.testing.assert_allclose([[found.x, found.y]], expected.xy, atol=1e-3)


def test_the_robot_says_how_exact_a_surveyed_map_is_wherever_it_is_tracked(network, known, tmp_path):
    surveyed = replace(known, frames=known.frames.with_columns(deviation=np.full(len(known), 0.5)))
    localizer = Localizer(bundled(tmp_path / "bundle", network, surveyed, method="relative", widening=1e-6))
    tracker = localizer.tracker(step=0.3)
    for picture in PICTURES[:3]:
        for found in (localizer.locate(picture), localizer.locate(picture, tracker)):
            np.testing.assert_allclose(found.covariance, 0.5**2 * np.eye(2), atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["relative", "interpolate"])
def test_the_robot_refines_as_the_evaluation_does(known, seen, bundle, between, method):
    relative = method == "relative"
    expected = refinement(known, method, widening=2.0).poses(known, seen, match(known, seen, 3))
    localizer = Localizer(bundle if relative else between, top=1)
    found = [localizer.locate(picture) for picture in PICTURES]
    np.testing.assert_allclose([[one.x, one.y] for one in found], expected.xy, atol=1e-3)
    np.testing.assert_allclose([math.cos(one.theta) for one in found], np.cos(expected.theta), atol=1e-3)
    np.testing.assert_allclose([one.agreement for one in found], expected.agreement, atol=1e-3)
    if not relative:
        assert {one.covariance for one in found} == {None}
    else:
        np.testing.assert_allclose([one.covariance for one in found], expected.covariance(), rtol=1e-2)
        alone = refinement(known, method).poses(known, seen, match(known, seen, 3))
        np.testing.assert_allclose(expected.covariance(), 2 * alone.covariance())
        assert np.abs(expected.xy - known.frames.xy[match(known, seen, 1).indices[:, 0]]).max() > 0.1


def test_the_robot_is_followed_as_the_filter_of_the_evaluation_does(known, seen, bundle):
    localizer = Localizer(bundle)
    alone = [localizer.locate(picture) for picture in PICTURES]
    tracker = localizer.tracker(step=0.3)
    found = [localizer.locate(picture, tracker) for picture in PICTURES]
    poses = refinement(known, "relative", widening=2.0).poses(known, seen, match(known, seen, 3))
    expected = PoseFilter(0.3).run(poses, np.full(len(poses), "drive"))
    np.testing.assert_allclose([[one.x, one.y] for one in found], expected.xy, atol=1e-2)
    assert [one.x for one in alone] != [one.x for one in found]
    np.testing.assert_array_equal([one.error_m for one in alone], [one.error_m for one in found])
    again = [localizer.locate(picture, localizer.tracker(step=0.3)) for picture in PICTURES]
    assert [one.x for one in again] == pytest.approx([one.x for one in alone]), "the first image of a drive is alone"
    assert localizer.tracker().length == pytest.approx(spacing_of(known.frames))


def motion_of(count: int) -> np.ndarray:
    """Moves of a robot that drives 0.3 m ahead and turns a little between two pictures."""
    return np.tile([0.3, 0.0, 0.1], (count, 1))


def test_the_robot_is_followed_by_its_wheels_as_in_the_evaluation(known, seen, bundle, plain):
    localizer, motion = Localizer(bundle), motion_of(len(PICTURES))
    tracker = localizer.tracker(step=0.3)
    found = [localizer.locate(picture, tracker, motion=move) for picture, move in zip(PICTURES, motion, strict=True)]
    poses = refinement(known, "relative", widening=2.0).poses(known, seen, match(known, seen, 3))
    expected = PoseFilter(0.3).run(poses, np.full(len(poses), "drive"), motion)
    np.testing.assert_allclose([[one.x, one.y] for one in found], expected.xy, atol=1e-2)
    np.testing.assert_allclose([math.cos(one.theta) for one in found], np.cos(expected.theta), atol=1e-2)
    np.testing.assert_allclose([one.covariance for one in found], expected.covariance(), rtol=0.05, atol=1e-4)
    without = PoseFilter(0.3).run(poses, np.full(len(poses), "drive"))
    assert np.abs(expected.xy - without.xy).max() > 0.05
    localizer = Localizer(plain)
    tracker = localizer.tracker(step=0.3)
    panoramas = batch(PICTURES)
    on_map = [localizer.locate_panorama(one, tracker, move) for one, move in zip(panoramas, motion, strict=True)]
    robot = SequenceFilter(MotionModel.learn(known.frames, step=0.3), temperature_of_map(known))
    rows = robot.run(frame_distances(known, seen), np.full(len(PICTURES), "drive"), motion=motion).frame
    np.testing.assert_allclose([[one.x, one.y] for one in on_map], known.frames.xy[rows])
    for locate in (localizer.locate, localizer.locate_panorama):
        with pytest.raises(ConfigError, match=r"give the tracker of its drive, localizer\.tracker"):
            locate(panoramas[0] if locate == localizer.locate_panorama else PICTURES[0], motion=motion[0])
    with pytest.raises(ConfigError, match="tracker must be a PoseFilter, or a SequenceFilter, got True"):
        localizer.locate(PICTURES[0], True)


def test_the_robot_drives_on_where_only_map_frames_without_positions_look_alike(known, bundle, tmp_path):
    localizer = Localizer(bundle)
    tracker = localizer.tracker(step=0.3)
    before = localizer.locate(PICTURES[0], tracker)
    bare = known.frames.x.copy()
    bare[localizer.locate(PICTURES[1]).candidates[0].row] = np.nan
    folder = rewritten(bundle, tmp_path / "bundle", map=replace(known, frames=known.frames.with_columns(x=bare)))
    other = Localizer(folder)
    assert math.isnan(other.locate(PICTURES[1]).x)
    after = other.locate(PICTURES[1], tracker, motion=[0.3, 0.0, 0.0])
    ahead = [before.x + 0.3 * math.cos(before.theta), before.y + 0.3 * math.sin(before.theta)]
    np.testing.assert_allclose([after.x, after.y], ahead)


def test_images_are_followed_by_a_table_of_odometry(bundle, tmp_path, monkeypatch):
    localizer, at = Localizer(bundle), chained(motion_of(6))
    folder = tmp_path / "drive"
    folder.mkdir()
    files = [folder / f"{number}.png" for number in range(6)]
    for file, picture in zip(files, PICTURES, strict=False):
        cv2.imwrite(str(file), picture[..., ::-1])
    files[2].write_bytes(b"no image")
    rows = [f"drive/{file.name},{x},{y},{theta}" for file, (x, y, theta) in zip(files, at.tolist(), strict=True)]
    wheels = tmp_path / "robot.csv"
    wheels.write_text("\n".join(["image,odom_x,odom_y,odom_theta", *rows]))
    found = [one.location for one in locate_all(localizer, folder, track=True, odometry=wheels)]
    tracker = localizer.tracker()
    moved = [None, motion_of(1)[0], moves(at[[1, 3]])[1], *motion_of(2)]  # over the image that cannot be read
    files.pop(2)
    expected = [localizer.locate(file, tracker, motion=move) for file, move in zip(files, moved, strict=True)]
    assert found.pop(2) is None
    np.testing.assert_allclose([(one.x, one.y) for one in found], [(one.x, one.y) for one in expected], atol=1e-9)
    without = [one.location for one in locate_all(localizer, files, track=True)]
    assert np.abs(np.subtract([one.x for one in found], [one.x for one in without])).max() > 0.05

    def another_unit(*_):
        raise WrongUnitError("another unit")

    with monkeypatch.context() as changed:
        changed.setattr(PoseFilter, "step", another_unit)
        located = locate_all(localizer, folder, track=True, odometry=wheels)
        passing = written(tmp_path / "found.csv", itertools.chain([Located("0.png", None)], located))
        with pytest.raises(WrongUnitError):  # not an image that is left out
            list(passing)
    assert not (tmp_path / "found.csv").exists()
    with pytest.raises(ConfigError, match=r"odometry=.* says how the robot is followed: set track=true"):
        next(locate_all(localizer, folder, odometry=wheels))
    wheels.write_text("image,odom_x,odom_y,odom_theta\nother.png,0,0,0\n")
    with pytest.raises(DataError, match=r"robot\.csv names none of the images, such as .*0\.png: paths are relative"):
        next(locate_all(localizer, folder, track=True, odometry=wheels))
    (tmp_path / "film.avi").touch()
    with pytest.raises(
        DataError, match=r"robot\.csv names none of the images, such as .*film\.avi: paths are relative"
    ):
        next(locate_all(localizer, tmp_path / "film.avi", track=True, odometry=wheels))
    wheels.write_text("image,odom_x,odom_y,odom_theta\nfilm.avi#1,0,0,0\n")
    with pytest.raises(DataError, match="cannot be read as a video"):
        next(locate_all(localizer, tmp_path / "film.avi", track=True, odometry=wheels))
    wheels.write_text("image,odom_x\ndrive/0.png,0\n")
    with pytest.raises(DataError, match=r"has no row with all of odom_x, odom_y and odom_theta"):
        next(locate_all(localizer, folder, track=True, odometry=wheels))
    turns = [f"drive/{number}.png,{number},0,{20 * number}" for number in range(40)]
    wheels.write_text("\n".join(["image,odom_x,odom_y,odom_theta", *turns]))
    with pytest.raises(DataError, match=r"robot\.csv: odom_theta looks like degrees"):
        next(locate_all(localizer, folder, track=True, odometry=wheels))


def test_a_picture_without_contrast_ends_no_drive(bundle):
    localizer = Localizer(bundle)
    session, black = localizer._network.session, np.zeros_like(PICTURES[0])

    class OnThisMachine:  # whether it happens depends on how onnxruntime adds up
        def run(self, names, given):
            position, parts = session.run(names, given)
            return position, np.full_like(parts, np.nan) if not given["panorama"].any() else parts

    localizer._network.session = OnThisMachine()
    tracker = localizer.tracker(step=0.3)
    found = [localizer.locate(one, tracker) for one in (*PICTURES[:3], black, *PICTURES[3:])]
    assert np.isfinite([[one.x, one.y, one.theta] for one in found]).all()
    seen = [localizer.locate(one, tracker) for tracker in [localizer.tracker(step=0.3)] for one in PICTURES]
    np.testing.assert_allclose([one.x for one in found[4:]], [one.x for one in seen[3:]], atol=0.5)


def test_each_folder_is_a_drive(known, bundle, between, tmp_path):
    localizer = Localizer(bundle)
    for name, some in (("a", PICTURES[:3]), ("b", PICTURES[3:6])):
        (tmp_path / name).mkdir()
        for number, picture in enumerate(some):
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), picture[..., ::-1])
    both = [one.location.x for one in locate_all(localizer, [tmp_path / "a", tmp_path / "b"], track=True)]
    single = [one.location.x for name in "ab" for one in locate_all(localizer, tmp_path / name, track=True)]
    assert both == single
    followed = [one.location for one in locate_all(Localizer(between), tmp_path / "a", track=True)]
    assert {(one.x, one.y) for one in followed} <= set(map(tuple, known.frames.xy.tolist()))


def test_poses_that_are_map_frames_are_followed_as_by_the_sequence_filter(known, seen, plain):
    localizer = Localizer(plain)
    tracker = localizer.tracker(step=0.3)
    found = [localizer.locate(picture, tracker) for picture in PICTURES]
    robot = SequenceFilter(MotionModel.learn(known.frames, step=0.3), temperature_of_map(known))
    expected = robot.run(frame_distances(known, seen), np.full(len(PICTURES), "drive"))
    np.testing.assert_allclose([[one.x, one.y] for one in found], known.frames.xy[expected.frame])
    variance = expected.spread**2 / 2 + spacing_of(known.frames) ** 2 / 12
    np.testing.assert_allclose([one.covariance[0][0] for one in found], variance, rtol=1e-3, atol=1e-6)
    tracker.reset()
    assert localizer.locate(PICTURES[0], tracker).x == found[0].x


@pytest.mark.parametrize("frames", [1, 3])
def test_a_map_of_a_single_place_does_not_say_how_certain_it_is(network, known, tmp_path, frames):
    there = known.take(np.arange(frames))
    there = replace(there, frames=there.frames.with_columns(x=np.ones(frames), y=np.ones(frames)))
    localizer = Localizer(export(network, there, tmp_path / "there").path)
    found = localizer.locate(PICTURES[0], localizer.tracker())
    assert (found.x, found.y, found.covariance) == (1, 1, None)


def test_a_map_without_positions_follows_nobody(known, plain, tmp_path):
    unknown = np.full(len(known), np.nan)
    bare = replace(known, frames=known.frames.with_columns(x=unknown, y=unknown))
    folder = rewritten(plain, tmp_path / "bundle", map=bare)
    with pytest.raises(ConfigError, match="cannot follow a robot: none of its map frames has a position"):
        Localizer(folder).tracker()


def test_the_summary_says_that_poses_are_finer(bundle, between):
    assert "position (by comparison with 3 map frames)" in Bundle.open(bundle).summary()
    assert "position (between 3 map frames)" in Bundle.open(between).summary()
    assert (between / "relative.onnx").exists()  # by which the robot puts map frames in order
    assert read_json(bundle / "bundle.json")["refinement"]["parity"]["max_relative_difference"] < 1e-3


@pytest.mark.slow
def test_a_map_without_some_positions_is_refined_by_the_others(network, known, seen, tmp_path):
    x = known.frames.x.copy()
    x[::3] = np.nan
    partly = replace(known, frames=known.frames.with_columns(x=x))
    placed = partly.placed()
    folder = tmp_path / "bundle"
    export(network, partly, folder, refinement=refinement(placed, "relative"))
    nearest = match(partly, seen, 1).indices[:, 0]
    expected = refinement(placed, "relative").poses(placed, seen, match(placed, seen, 3))
    found = [Localizer(folder).locate(picture) for picture in PICTURES]
    for one, row, xy in zip(found, nearest, expected.xy, strict=True):
        if partly.frames.has_position[row]:
            np.testing.assert_allclose([one.x, one.y], xy, atol=1e-3)
        else:
            assert math.isnan(one.x)


@pytest.mark.slow
def test_expected_errors_are_those_of_the_refined_poses(network, known, seen, tmp_path):
    poses = refinement(known, "relative").poses(known, seen, match(known, seen, 3))
    errors = replace(
        ErrorModel.fit_poses(poses, np.hypot(*(poses.xy - FRAMES.xy).T)), lost_above=1.0, map_digest=known.digest
    )
    with pytest.raises(ConfigError, match="give errors and refinement of the same evaluation"):
        export(network, known, tmp_path / "bundle", errors=errors)
    nearest = replace(errors, score="ratio", refine="none")
    with pytest.raises(ConfigError, match="refine=none, but the robot makes them with refine=relative"):
        export(network, known, tmp_path / "bundle", errors=nearest, refinement=refinement(known, "relative"))
    with pytest.raises(ConfigError, match="give it those"):
        errors.predict(match(known, seen, 3), known.frames.xy)
    export(network, known, tmp_path / "bundle", errors=errors, refinement=refinement(known, "relative", widening=3.0))
    localizer = Localizer(tmp_path / "bundle")
    found = [localizer.locate(picture) for picture in PICTURES]
    nearest = match(known, seen, 3)
    expected = errors.predict(nearest, known.frames.xy, poses)
    np.testing.assert_allclose([one.error_m for one in found], expected, rtol=1e-2)
    assert [one.lost for one in found] == [one.error_m > errors.lost_above for one in found]
    untold = replace(poses, information=np.zeros_like(poses.information))
    np.testing.assert_array_equal(errors.predict(nearest, known.frames.xy, untold), errors.errors[-1])  # of one knot


def test_what_does_not_fit_is_refused(network, known, bundle, tmp_path):
    with pytest.raises(ConfigError, match="learned on another map"):
        export(network, known, tmp_path / "bundle", refinement=Refinement("relative"))
    bare = replace(known, heading=None)
    with pytest.raises(ConfigError, match="the map does not hold what its network compares by"):
        export(network, bare, tmp_path / "bundle", refinement=refinement(bare, "relative"))
    feet = replace(known, frames=replace(known.frames, unit="ft"))
    with pytest.raises(ConfigError, match="in metres, and the map is in 'ft'"):
        export(network, feet, tmp_path / "bundle", refinement=refinement(feet, "relative"))
    other = build("panoresnet", "magnitudes", SIZE, circular=True)
    with pytest.raises(ConfigError, match="does not tell where images were taken relative to others"):
        export_relative(other, tmp_path / "relative.onnx")
    assert not list(tmp_path.iterdir())
    different = build("panoresnet", "magnitudes", SIZE, circular=True, relative=True, seed=1)
    with pytest.raises(SiamlocError, match=r"differ by .* do not use the file"):
        relative_parity(different, bundle / "relative.onnx")


def test_how_poses_are_refined_is_saved(tmp_path):
    path = tmp_path / "refinement.json"
    made = Refinement("interpolate", 5, 2.0, 1.5, "abc")
    made.save(path)
    assert Refinement.load(path) == made
    for changed, says in (
        ({"format": "other"}, "is not a siamloc refinement of poses"),
        ({"version": 2}, "has format version 2"),
        ({"neighbours": 0}, "neighbours must be a whole number from 1 to 10 million, got 0"),
        ({"method": "guess"}, "method must be interpolate or relative, got 'guess'"),
        ({"more": 1}, "is not a whole refinement of poses"),
    ):
        write_json(path, {**json.loads(path.read_text()), **changed})
        with pytest.raises((FormatError, ConfigError), match=says):
            Refinement.load(path)
        made.save(path)


def test_a_bundle_that_compares_in_another_unit_is_refused(known, bundle, tmp_path):
    frames = known.frames.with_columns(x=known.frames.x / 0.3048, y=known.frames.y / 0.3048, unit="ft")
    feet = replace(known, frames=frames)
    with pytest.raises(ConfigError, match="answers in metres, and its map is in 'ft'"):
        Localizer(rewritten(bundle, tmp_path / "feet", map=feet))


def test_missing_and_altered_files_are_found(bundle, tmp_path):
    folder = shutil.copytree(bundle, tmp_path / "bundle")
    (folder / "refinement.json").write_text("{}")
    with pytest.raises(FormatError, match="not the file the bundle was written with"):
        Localizer(folder)
    with pytest.raises(FormatError, match="is not a siamloc refinement of poses"):
        Localizer(altered(folder, "refinement.json"))
    shutil.copy(bundle / "refinement.json", folder)
    hashes = read_json(bundle / "bundle.json")["sha256"]
    del hashes["relative.onnx"]
    with pytest.raises(FormatError, match="holds no network for it: export again"):
        Localizer(altered(folder, sha256=hashes))
