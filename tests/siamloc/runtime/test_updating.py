"""The robot collects what it located well, and updates its bundle by that, without torch or scipy."""

from __future__ import annotations

import math
import pkgutil
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest

import analytic
from siamloc.data import PanoramaLibrary
from siamloc.errors import ConfigError, DataError, FormatError, SiamlocError, StorageError
from siamloc.jobs.robot import Localize
from siamloc.maps import ErrorModel, LayerSearch, group
from siamloc.runtime import Bundle, Candidate, Localizer, Location, export, locate_all, update
from siamloc.runtime.collecting import Collector, _pictures, collected
from siamloc.runtime.describing import coarse_map
from tests.installed import printed
from tests.siamloc.runtime.conftest import SIZE, altered, batch, drive, mapped

HOG = analytic.descriptor("hog", rows=4)
TOLD = ErrorModel("ratio", 1.0, 5, (0.0, 1.0), (0.05, 0.2), 24, lost_above=0.15)


def painted(pictures, seed=0):
    """The pictures of a flat whose right half was painted over."""
    paint = np.random.default_rng(seed).integers(0, 256, (4, 8, 3)).astype(np.uint8)
    changed = pictures.copy()
    changed[:, :, 64:] = cv2.resize(paint, (64, 32), interpolation=cv2.INTER_NEAREST)
    return changed


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    pictures, frames = drive(0)
    paths = [str(folder / f"{number}.png") for number in range(len(frames))]
    for path, picture in zip(paths, pictures, strict=True):
        cv2.imwrite(path, picture[..., ::-1])
    return PanoramaLibrary(frames.with_columns(path=paths), folder / "cache", image_size=SIZE)


@pytest.fixture
def bundle(images, tmp_path):
    known = replace(mapped(HOG), frames=images.frames)
    errors = ErrorModel(**{**vars(TOLD), "map_digest": known.digest})
    coarse = replace(mapped(analytic.descriptor("hog", rows=2)), frames=images.frames)
    layer = group(coarse, "rooms")
    search = LayerSearch(candidates=2)
    more = {"layer": layer.layer, "coarse_map": coarse, "search": search, "images": images, "thumbnails": True}
    return export(HOG, known, tmp_path / "bundle", errors=errors, **more).path


def located(x=0.0, y=0.0, theta=0.0, **more):
    values = {"room": "", "error_m": 0.1, "lost": False, "candidates": (), "ms": 1.0}
    return Location(x=x, y=y, theta=theta, **{**values, **more})


def kept_by(collector, pictures, frames):
    for picture, x, y, theta in zip(batch(pictures), frames.x, frames.y, frames.theta, strict=True):
        collector.take(picture, located(x, y, theta), tracked=False)
    return collected(collector.folder)[-1]


def _from(folder, paths):
    return [Path(path).relative_to(folder).as_posix() for path in paths]


def test_only_pictures_that_were_located_well_are_kept(tmp_path):
    collector, picture = Collector(tmp_path, most=3), np.zeros((3, 4, 8), np.uint8)

    def kept(tracked=False, map_variance=0.0, **more):
        return collector.take(picture, located(**more), tracked, map_variance) is not None

    sure, unsure = ((0.01, 0.0), (0.0, 0.01)), ((0.1, 0.0), (0.0, 0.1))
    assert not kept(error_m=math.nan)
    assert not kept(error_m=0.3)
    assert not kept(x=math.nan)
    assert not kept(theta=math.nan)
    assert not kept(lost=True)
    assert not kept(covariance=unsure)
    assert not kept(lost=None)
    assert kept()
    assert not kept(x=0.05), "almost the same place"
    assert kept(x=0.05, theta=0.5)
    assert kept(x=1, covariance=sure, agreement=0.9, tracked=True)
    assert kept(x=2, lost=None, covariance=unsure, map_variance=0.09, agreement=0.9), "sure of where it is in the map"
    (found,) = collected(tmp_path)
    np.testing.assert_allclose(found.x, [0.05, 1, 2], err_msg="the oldest picture is gone")
    np.testing.assert_allclose(found.theta, [0.5, 0, 0])
    assert (np.diff(found.time) > 0).all()
    assert len(Collector(tmp_path)._kept) == 3


def test_pictures_that_the_tracker_alone_locates_wait_until_a_recognized_one_confirms_it(tmp_path):
    collector, noise = Collector(tmp_path), np.random.default_rng(0)
    near, far = (Candidate("", x, 0.0, "", 0.0) for x in (0.5, 9.0))

    def take(x, lost, agreement, black=False, candidates=()):
        picture = np.zeros((3, 4, 8), np.uint8) if black else noise.integers(0, 256, (3, 4, 8)).astype(np.uint8)
        collector.take(picture, located(x, lost=lost, agreement=agreement, candidates=candidates), tracked=True)
        return [pose.x for _, pose in _pictures(tmp_path)]

    assert take(0, lost=True, agreement=0.9) == []
    assert take(0.2, lost=False, agreement=0.1) == []
    assert take(0.4, lost=True, agreement=0.1, black=True) == []
    assert take(0.6, lost=False, agreement=0.9) == [0, 0.2, 0.6]
    assert take(0.8, lost=True, agreement=0.1) == [0, 0.2, 0.6]
    assert take(7, lost=False, agreement=0.9) == [0, 0.2, 0.6, 7], "the tracker was wrong at 0.8"
    assert take(8.1, lost=False, agreement=math.nan, candidates=(near,)) == [0, 0.2, 0.6, 7]
    assert take(8.3, lost=None, agreement=math.nan, candidates=(far,)) == [0, 0.2, 0.6, 7, 8.1, 8.3]


def test_pictures_where_the_tracker_moves_otherwise_than_the_wheels_wait_until_the_robot_is_away_from_there(tmp_path):
    picture = np.arange(96, dtype=np.uint8).reshape(3, 4, 8)

    def kept(*steps):
        collector = Collector(tmp_path / str(len(list(tmp_path.iterdir()))))
        for x, ahead in steps:
            motion = None if ahead is None else (ahead, 0, 0)
            collector.take(picture, located(x, agreement=0.9), tracked=True, motion=motion)
        return [round(pose.x, 1) for _, pose in _pictures(collector.folder)]

    right = [(0, 2), (2, 2), (4, 2.5)]
    assert kept(*right) == [0, 2, 4], "a long way, but the wheels know it"
    there = [(13, 0.5), *((13 + 0.5 * (way % 2), 0) for way in range(20))]
    assert kept(*right, *there) == [0, 2, 4], "trembling is no way"
    back = [(5, 0.5), (6, 1), (7, np.nan)]
    assert kept(*right, *there, *back) == [0, 2, 4], "what lies between two leaps is dropped"
    assert kept(*right, *there, *back, (8, 1)) == [0, 2, 4, 5, 6, 7, 8]
    assert kept(*right, *there, *there) == [0, 2, 4]
    dead = [(0.5 * way, 0) for way in range(20)]
    assert kept(*dead) == [x for x, _ in dead]
    assert kept((0, 0), (1.5, 0), *((1.5 + x, 0) for x, _ in dead[1:]))[:3] == [0, 1.5, 2], "wheels that say nothing"
    assert len(kept(*((10.0 * row, 9) for row in range(20)))) == 20, "wheels that slip"
    room = [0.8 * (way % 3) for way in range(60)]
    steps = [0.0, *(abs(one - other) for one, other in zip(room[1:], room, strict=False))]
    assert len(kept((9, 0), *zip(room, steps, strict=True))) > 40, "a small room after a wrong first pose"
    assert kept(*((2 * x, None) for x, _ in dead)) == [2 * x for x, _ in dead], "without wheels"


def test_times_rise_within_a_drive_though_the_clock_is_set_back(bundle, tmp_path):
    collector = Collector(tmp_path / "seen")
    pictures, frames = drive(1)
    early, late = (slice(None, 12), slice(12, None))
    kept_by(collector, painted(pictures[early]), frames.take(early))
    assert len(update(bundle, collector.folder)) == 1
    with patch("time.time", return_value=0.0):
        whole = kept_by(collector, painted(pictures[late]), frames.take(late))
    np.testing.assert_allclose(whole.x, frames.x, atol=1e-6)
    (second,) = update(bundle, collector.folder)
    assert len(second.drive) == len(frames) - 12


def test_a_disk_that_refuses_pictures_ends_no_drive(bundle, tmp_path, caplog):
    localizer = Localizer(bundle, collect=tmp_path / "seen")
    with patch("siamloc.runtime.collecting.write_picture", side_effect=StorageError("full")):
        for picture in drive(0)[0][:6]:
            assert localizer.locate(picture).lost is False
    assert caplog.text.count("takes no more images") == 1
    (tmp_path / "taken").touch()
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        Localizer(bundle, collect=tmp_path / "taken")


def test_headings_that_a_map_does_not_give_are_0(tmp_path):
    collector = Collector(tmp_path / "seen", headings=False)
    assert collector.take(np.zeros((3, 4, 8), np.uint8), located(theta=math.nan), tracked=False) is not None
    assert collected(tmp_path / "seen")[0].theta.tolist() == [0.0]


def test_a_localizer_collects_panoramas_as_it_describes_them(bundle, tmp_path):
    pictures, frames = drive(0)
    localizer = Localizer(bundle, collect=tmp_path / "seen")
    locations = [localizer.locate(picture) for picture in pictures]
    assert not any(location.lost for location in locations)
    (found,) = collected(tmp_path / "seen")
    assert 10 < len(found) <= len(frames)
    assert np.array_equal(cv2.imread(str(found.path[0]))[..., ::-1], pictures[0])


def test_the_map_and_all_that_has_its_frames_follow(bundle, tmp_path):
    pictures, frames = drive(1)
    before, old = Localizer(bundle), {name: (bundle / name).read_bytes() for name in ("map.npz", "bundle.json")}
    assert kept_by(Collector(tmp_path / "seen"), painted(pictures), frames) is not None
    with (
        patch("siamloc.runtime.updating.write_thumbnails", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        update(bundle, tmp_path / "seen", growth=None)
    assert {name: (bundle / name).read_bytes() for name in old} == old, "the old bundle is whole"
    assert [path.name for path in bundle.parent.iterdir() if "tmp" in path.name] == []
    (found,) = update(bundle, tmp_path / "seen", growth=None)
    after, opened = Localizer(bundle), Bundle.open(bundle)
    assert found.added.sum() > 10
    assert len(after.map) == len(before.map) + found.added.sum()
    assert after.map.history.confirmed.any()
    assert set(after.map.frames.room) == set(before.map.frames.room)
    joined = after.map.frames.take(slice(len(before.map), None))
    nearest = np.argmin(
        np.hypot(joined.x[:, None] - before.map.frames.x, joined.y[:, None] - before.map.frames.y), axis=1
    )
    np.testing.assert_array_equal(joined.room, before.map.frames.room[nearest])
    layer, coarse = opened.load("layer.npz"), opened.load("coarse_map.npz")
    assert len(layer.labels) == len(coarse) == len(after.map)
    np.testing.assert_array_equal(layer.names[layer.labels], after.map.frames.room)
    np.testing.assert_allclose(layer.representatives[0], coarse.descriptors[layer.labels == 0].mean(axis=0), rtol=1e-5)
    np.testing.assert_array_equal(coarse.frames.xy, after.map.frames.xy)
    thumbnails = opened.load("thumbnails.npz")
    with pytest.raises(IndexError):
        before.bundle.thumbnail(len(before.map))
    assert len(thumbnails) == len(after.map)
    shown = cv2.imdecode(np.frombuffer(thumbnails[-1], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    last = painted(pictures)[np.flatnonzero(found.added)[-1]]
    assert np.abs(shown.astype(float) - last).mean() < 20
    assert opened.load("error_model.json").learned_on(after.map)
    asked = painted(pictures)[found.added][0]
    assert after.locate(asked).candidates[0].distance < before.locate(asked).candidates[0].distance
    assert update(bundle, tmp_path / "seen") == [], "each drive counts once"


def test_pictures_join_the_building_that_they_look_like(images, tmp_path):
    pictures, frames = drive(1)
    building = np.where(np.arange(len(images.frames)) % 2, "up", "down")
    known = replace(mapped(HOG), frames=images.frames.with_columns(building=building))
    bundle = export(HOG, known, tmp_path / "bundle").path
    kept_by(Collector(tmp_path / "seen"), painted(pictures), frames)
    with patch("siamloc.runtime.updating.buildings_of", lambda known, drive, radius: ["down"] * len(drive)):
        (found,) = update(bundle, tmp_path / "seen", growth=None)
    assert set(found.drive.building) == {"down"}
    after = Localizer(bundle).map.frames
    assert found.added.any()
    assert set(after.building[len(known) :]) == {"down"}
    location = Localizer(bundle).locate(pictures[0])
    assert location.room == location.candidates[0].room
    assert location.room in Localizer(bundle).map.frames.place, "which floor"
    assert location.room.startswith(("up/", "down/"))


@pytest.mark.parametrize(
    ("called", "given"), [("siamloc.runtime.updating.collected", "seen"), ("foundation.files._flush", "bundle.json")]
)
def test_a_bundle_that_was_replaced_meanwhile_stays(bundle, tmp_path, called, given):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    as_before = pkgutil.resolve_name(called)

    def replacing(path):
        if path.name == given:
            altered(bundle, figures={"mean": 0.1})
        return as_before(path)

    with patch(called, replacing), pytest.raises(SiamlocError, match="was replaced while its map was updated"):
        update(bundle, tmp_path / "seen")
    assert Bundle.open(bundle).about["figures"] == {"mean": 0.1}
    assert [path.name for path in bundle.parent.iterdir() if path.suffix in (".old", ".tmp")] == []


@pytest.mark.parametrize("during", ["siamloc.runtime.bundle.file_hash", "siamloc.runtime.localizer.coarse_map"])
def test_a_localizer_that_is_opened_during_an_update_is_of_one_bundle(bundle, tmp_path, during):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    newer = shutil.copytree(bundle, tmp_path / "newer")
    (found,) = update(newer, tmp_path / "seen", growth=None)
    as_before = pkgutil.resolve_name(during)

    def replacing(given):
        if newer.exists():
            bundle.rename(tmp_path / "older")
            newer.rename(bundle)
        return as_before(given)

    with patch(during, replacing):
        opened = Localizer(bundle)
    assert len(opened.map) == len(found.known) > len(found.before)
    assert opened.bundle.thumbnail(len(opened.map) - 1) is not None
    assert opened.bundle.about == Bundle.open(bundle).about


def test_a_bundle_that_is_replaced_again_and_again_is_not_opened(bundle):
    def replacing(given):
        altered(bundle, figures={"mean": 0.1})
        return coarse_map(given)

    with patch("siamloc.runtime.localizer.coarse_map", replacing), pytest.raises(FormatError, match="replaced 5 times"):
        Localizer(bundle)


def test_the_bundle_that_a_killed_update_left_is_named(bundle):
    bundle.rename(bundle.with_name(".bundle.0123abcd-7-0.old"))
    with pytest.raises(FormatError, match=r"there is no folder .*bundle: rename .*\.bundle\.0123abcd-7-0\.old, "):
        Bundle.open(bundle)


def test_pictures_that_cannot_be_read_are_left_out(bundle, tmp_path, caplog):
    whole = kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    Path(whole.path[3]).write_bytes(Path(whole.path[3]).read_bytes()[:100])
    cv2.imwrite(whole.path[6], np.zeros_like(cv2.imread(whole.path[6])))
    (tmp_path / "seen" / "none").mkdir()
    (tmp_path / "seen" / "none" / Path(whole.path[4]).name).touch()
    (found,) = update(bundle, tmp_path / "seen")
    assert found.drive.path.tolist() == _from(tmp_path / "seen", np.delete(whole.path, [3, 6]))
    assert f"2 of {len(whole)} pictures cannot be used, the first: {whole.path[3]}" in caplog.text
    assert "1 of 1 pictures cannot be used" in caplog.text


def test_pictures_taken_after_an_update_count_too(bundle, tmp_path, caplog):
    collector = Collector(tmp_path / "seen")
    pictures, frames = drive(1)
    early, late = (slice(None, 12), slice(12, None))
    kept_by(collector, painted(pictures[early]), frames.take(early))
    (first,) = update(bundle, collector.folder, growth=None)
    whole = kept_by(collector, painted(pictures[late]), frames.take(late))
    (second,) = update(bundle, collector.folder, growth=None)
    assert [*first.drive.path, *second.drive.path] == _from(collector.folder, whole.path)
    assert len(Localizer(bundle).map) > len(first.known)
    assert update(bundle, collector.folder) == []
    assert "budget" not in caplog.text
    assert update(bundle, collector.folder, frames=5) == []
    assert f"keeps {len(second.known)} frames, more than its budget: the next drive thins it" in caplog.text


def test_a_drive_that_cannot_update_the_map_keeps_no_other_from_it(bundle, tmp_path, caplog):
    seen, small = tmp_path / "seen", np.zeros((3, 4, 8), np.uint8)
    good, others = Collector(seen), [Collector(seen), Collector(seen)]
    kept_by(others[0], drive(1)[0], drive(1)[1].with_columns(x=drive(1)[1].x + 100))
    others[1].take(small, located(), tracked=False)
    kept_by(good, painted(drive(1)[0]), drive(1)[1])
    (found,) = update(bundle, seen)
    assert str(found.drive.sequence[0]).startswith(good.drive.name)
    assert caplog.text.count(f"Move it out of {seen}; left out") == 2
    assert f"{others[0].drive} cannot update the map: the drive's positions have other axes" in caplog.text
    assert "odom_x" not in caplog.text, "its poses are in the names of its files"
    assert f"{others[1].drive} cannot update the map: " in caplog.text
    before = (bundle / "map.npz").read_bytes()
    assert update(bundle, seen) == [], "a drive that fits was counted before"
    good.drive.rename(tmp_path / "elsewhere")
    with pytest.raises(DataError, match=r"drive-.* cannot update the map: .*; .*drive-.* cannot update the map: "):
        update(bundle, seen)
    assert (bundle / "map.npz").read_bytes() == before


def test_frames_that_joined_name_no_folder_of_the_robot(bundle, tmp_path):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    update(bundle, tmp_path / "seen")
    known = Localizer(bundle).map
    assert all(path.startswith("drive-") for path in known.frames.path[known.history.joined])
    (tmp_path / "seen").rename(tmp_path / "moved")
    assert update(bundle, tmp_path / "moved") == []


def test_an_export_keeps_what_drives_taught_a_bundle(bundle, images, tmp_path):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    (found,) = update(bundle, tmp_path / "seen")
    known = replace(mapped(HOG), frames=images.frames)
    with pytest.raises(ConfigError, match=r"robots updated .*, 1 of them, .* drive-\d+.*: .* overwrite=true"):
        export(HOG, known, bundle)
    assert len(Localizer(bundle).map) == len(found.known)
    export(HOG, replace(found.known, describes=None), bundle)
    left = bundle.rename(bundle.with_name(".bundle.0123abcd-7-0.old"))  # by a killed update
    with pytest.raises(ConfigError, match=r"robots updated the map in .*-7-0\.old .*: rename that folder to bundle, "):
        export(HOG, known, bundle)
    left.rename(bundle)
    export(HOG, known, bundle, overwrite=True)
    assert len(Localizer(bundle).map) == len(known)


def test_each_drive_has_a_folder(bundle, tmp_path):
    folders = [tmp_path / "drives" / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir(parents=True)
        for number, picture in enumerate(drive(0)[0][:3]):
            cv2.imwrite(str(folder / f"{number}.png"), picture[..., ::-1])
    for _ in range(2):
        list(locate_all(Localizer(bundle, collect=tmp_path / "seen"), folders, track=True))
    assert len(collected(tmp_path / "seen")) == 4


def test_an_update_needs_numpy_opencv_and_onnxruntime_alone(bundle, tmp_path):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    shown = printed(
        f"""
from siamloc.runtime import update
(found,) = update({str(bundle)!r}, {str(tmp_path / "seen")!r}, growth=1.25)
print(len(found.known), found.added.sum())
""",
        "robot",
    )
    frames, added = map(int, shown.split())
    assert frames == len(Localizer(bundle).map) == 30
    assert added > 0


def test_the_command_updates_what_was_collected(bundle, tmp_path):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    lines = list[str]()
    job = {"bundle": str(bundle), "collect": str(tmp_path / "seen"), "update": True}
    Localize.of(job).run(lines.append)
    assert len(lines) == 1
    assert "joined the map" in lines[0]
    Localize.of(job).run(lines.append)
    assert lines[1].endswith("were counted before")
    with pytest.raises(ConfigError, match="give collect=FOLDER"):
        Localize.of({"bundle": str(bundle), "update": True}).run()


def test_an_update_keeps_the_users_files_in_the_folder_of_the_bundle(bundle, tmp_path):
    kept_by(Collector(tmp_path / "seen"), painted(drive(1)[0]), drive(1)[1])
    with pytest.raises(ConfigError, match="seen is in the bundle, which an update replaces"):
        Localizer(bundle, collect=bundle / "seen")
    job = {"bundle": str(bundle), "collect": str(tmp_path / "seen"), "update": True, "images": str(tmp_path)}
    with pytest.raises(ConfigError, match=r"locations\.csv is in the bundle, which the update replaces"):
        Localize.of({**job, "out": str(bundle / "locations.csv")}).run()
    (bundle / "NOTES.txt").write_text("hi")
    with pytest.raises(ConfigError, match=r"holds other files, such as NOTES\.txt, and .*: move them elsewhere"):
        update(bundle, tmp_path / "seen")
    assert (bundle / "NOTES.txt").read_text() == "hi"


def test_a_mount_point_is_refused_before_any_picture_is_read(bundle, tmp_path):
    with (
        patch("os.path.ismount", lambda path: path == bundle.resolve()),
        pytest.raises(ConfigError, match=r"bundle is a mount point, .*: mount the folder above it"),
    ):
        update(bundle, tmp_path / "nowhere")


def test_what_cannot_be_collected_or_updated_is_refused(bundle, tmp_path):
    with pytest.raises(DataError, match="nowhere is not a folder"):
        update(bundle, tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="holds no picture that was located well"):
        update(bundle, tmp_path / "empty")
    Collector(tmp_path / "other").take(np.zeros((3, 4, 8), np.uint8), located(), tracked=False)
    with pytest.raises(DataError, match="is 4 x 8 px, and the bundle's panoramas 32 x 128"):
        update(bundle, tmp_path / "other")
    plain = export(HOG, mapped(HOG), tmp_path / "plain").path
    with pytest.raises(ConfigError, match="cannot say which images were located well"):
        Localizer(plain, collect=tmp_path / "seen")
