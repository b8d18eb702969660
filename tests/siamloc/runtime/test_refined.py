"""The robot's poses finer than the map: the same as in the evaluation, with covariances, from a complete bundle."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from foundation.files import read_json, write_json
from siamloc.errors import ConfigError, FormatError, SiamlocError
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
from siamloc.maps.sequence_filter import spacing_of
from siamloc.models import as_descriptor, build
from siamloc.runtime import Bundle, Localizer, export, locate_all
from siamloc.runtime.onnx_model import export_relative, relative_parity
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


def test_a_picture_without_contrast_ends_no_drive(bundle):
    localizer = Localizer(bundle)
    session, black = localizer._describer._session, np.zeros_like(PICTURES[0])

    class OnThisMachine:  # whether it happens depends on how onnxruntime adds up
        def run(self, names, given):
            position, parts = session.run(names, given)
            return position, np.full_like(parts, np.nan) if not given["panorama"].any() else parts

    localizer._describer._session = OnThisMachine()
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
    np.testing.assert_allclose([one.covariance[0][0] for one in found], expected.spread**2 / 2, rtol=1e-3, atol=1e-6)
    tracker.reset()
    assert localizer.locate(PICTURES[0], tracker).x == found[0].x


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
    np.testing.assert_array_equal(errors.predict(nearest, known.frames.xy, untold), errors.errors[-1])


def test_what_does_not_fit_is_refused(network, known, bundle, tmp_path):
    with pytest.raises(ConfigError, match="learned on another map"):
        export(network, known, tmp_path / "bundle", refinement=Refinement("relative"))
    bare = replace(known, heading=None)
    with pytest.raises(ConfigError, match="the map does not hold what its network compares by"):
        export(network, bare, tmp_path / "bundle", refinement=refinement(bare, "relative"))
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
        ({"version": 3}, "has format version 3"),
        ({"neighbours": 0}, "neighbours must be a whole number from 1 to 10 million, got 0"),
        ({"method": "guess"}, "method must be interpolate or relative, got 'guess'"),
        ({"more": 1}, "is not a whole refinement of poses"),
    ):
        write_json(path, {**json.loads(path.read_text()), **changed})
        with pytest.raises((FormatError, ConfigError), match=says):
            Refinement.load(path)
        made.save(path)


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
