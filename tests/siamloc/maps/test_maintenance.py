"""A map follows its building: frames join it where a drive shows that it is out of date, and stale ones leave it."""

import csv
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest

import siamloc
from analytic.errors import AnalyticError
from siamloc.cli import main
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import mapping
from siamloc.maps import (
    Built,
    History,
    Reason,
    Refinement,
    VisualMap,
    build,
    group,
    maintenance,
    map_file,
    match,
    update,
)
from siamloc.maps.axes import warn_of_axes
from siamloc.maps.maintenance import updated
from tests.siamloc.cli.commands import done, refused

FRAMES, STEP, ROWS, COLUMNS = 120, 4, 16, 64
CHANGED = slice(40, 80)  # frames that show nothing but new paint
COUNTS = {"contradicted": 15, "window": 20, "usual": None}  # of [T] 4.6
DRIVES = {"old": 0, "same": 0, "changed": 1, "later": 1, "new": 2}


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Drives along one corridor, a third of which has other paint in two of them, and all of it in the last."""
    folder, rng = tmp_path_factory.mktemp("corridor"), np.random.default_rng(3)
    paint = rng.uniform(40, 215, (2, ROWS, COLUMNS + FRAMES * STEP, 3)).astype(np.float32)
    outside = np.ones(paint.shape[2], dtype=bool)
    outside[CHANGED.start * STEP : (CHANGED.stop - 1) * STEP + COLUMNS] = False
    paint[1][:, outside] = paint[0][:, outside]
    paint = np.concatenate([paint, paint[:1, ::-1, ::-1]])
    table = []
    for name, which in DRIVES.items():
        walls = cv2.GaussianBlur(paint[which], (0, 0), 2)
        for i in range(FRAMES):
            picture = walls[:, i * STEP : i * STEP + COLUMNS] + rng.normal(0, 2, (ROWS, COLUMNS, 3))
            cv2.imwrite(str(folder / f"{name}-{i:03d}.png"), picture.clip(0, 255).astype(np.uint8))
            pose = {"x": 0.2 * i, "y": 0.0, "theta": 0.0, "time": i}
            room = "near" if i < FRAMES // 2 else "far"
            table.append({"path": str(folder / f"{name}-{i:03d}.png"), **pose, "room": room, "sequence": name})
    with (folder / "manifest.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["image", *list(table[0])[1:]])
        writer.writerows(list(row.values()) for row in table)
    frames = FrameTable.from_rows(table)
    return (
        folder,
        PanoramaLibrary(frames, folder / "cache", image_size=(ROWS, COLUMNS)),
        {n: frames.select(sequence=n) for n in DRIVES},
    )


@pytest.fixture(scope="module")
def known(drives):
    _, images, drive = drives
    return build("hog", images, drive["old"], progress=False)


def lost(known, drives, name):
    """Return the share of frames of a drive that are located more than 1 m away."""
    _, images, drive = drives
    asked = build("hog", images, drive[name], progress=False)
    found = match(known, asked.description).indices[:, 0]
    return (np.abs(known.frames.x[found] - asked.frames.x) > 1).mean()


def named(reasons):
    return np.array([reason.name for reason in reasons])


def test_a_drive_that_looks_as_before_changes_little(known, drives):
    found = update(known, drives[1], drives[2]["same"], progress=False, **COUNTS)
    assert found.known.frames == known.frames
    assert found.known_place.all()
    assert (named(found.reason) == "EXPLAINED").mean() > 0.95
    assert (named(found.map_reason) == "CONFIRMED").mean() > 0.95
    np.testing.assert_array_equal(found.known.history.confirmed, named(found.map_reason) == "CONFIRMED")
    assert found.summary().endswith("the map is up to date")
    assert repr(found) == f"Update({found.summary().removeprefix('update: ')})"
    assert update(known, drives[1], drives[2]["same"], progress=False).added.sum() <= 0.05 * FRAMES


def test_a_drive_is_counted_once(known, drives, caplog):
    found = update(known, drives[1], drives[2]["same"], progress=False, **COUNTS)
    assert not caplog.messages
    again = update(found.known, drives[1], drives[2]["same"], progress=False, **COUNTS)
    assert again.known.history.confirmed.max() == 1
    assert "the map counted drive same before" in caplog.text
    annex = drives[2]["same"].with_columns(building=["annex"] * FRAMES)
    moved = known.frames.with_columns(building=["annex"] * FRAMES)
    caplog.clear()
    other = update(replace(found.known, frames=moved), drives[1], annex, progress=False, **COUNTS).known
    assert not caplog.messages
    assert other.history.confirmed.max() == 2
    update(other, drives[1], annex, progress=False, **COUNTS)
    assert "the map counted drive annex/same before" in caplog.text


def test_a_drive_that_states_no_building_is_in_that_of_the_map(known, drives, caplog):
    stated = drives[2]["changed"].with_columns(building=["annex"] * FRAMES)
    annex = replace(known, frames=known.frames.with_columns(building=["annex"] * FRAMES))
    wanted, found = (update(annex, drives[1], one, progress=False) for one in (stated, drives[2]["changed"]))
    assert named(found.reason).tolist() == named(wanted.reason).tolist()
    assert set(found.drive.building) == set(found.known.frames.building) == {"annex"}
    assert found.known.made["upkeep"]["drives"] == ["annex/changed"]
    elsewhere = update(annex, drives[1], stated.with_columns(building=["barn"] * FRAMES), progress=False)
    assert set(named(elsewhere.reason)) <= {"NEW_PLACE", "REPEATED"}, "a building of its own"
    assert not caplog.messages
    update(known, drives[1], stated, progress=False)
    assert "drive changed states the building annex, and frames of the map state none" in caplog.text


def test_pictures_of_a_drive_that_cannot_be_read_are_left_out(tmp_path):
    example = siamloc.data.example(frames=40)
    for path in example.frames.path:
        shutil.copy(path, tmp_path)
    paths = [str(tmp_path / Path(path).name) for path in example.frames.path]
    frames = example.frames.with_columns(path=paths)
    monday, tuesday = (frames.select(sequence=day) for day in ("monday", "tuesday"))
    Path(tuesday.path[5]).write_bytes(b"cut short")
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(16, 64), on_error="skip")
    for building in ("", "annex"):
        known = build("hog", images, monday.with_columns(building=[building] * len(monday)), progress=False)
        found = update(known, images, tuesday, progress=False)
        assert len(found.drive) == len(found.reason) == len(tuesday) - 1
        assert set(found.drive.building) == {building}


def test_drives_are_counted_one_by_one(known, drives):
    both, same = drives[1].frames.select(sequence=["same", "later"]), drives[2]["same"]
    for frames, asked in (
        (both, "takes the frames of one drive, and these are of 2"),
        (both.take([]), "the drive has no frames: look at how they were selected"),
        (
            same.take([0, 1, 2, 1, 0]),
            r"2 of 5 frames of the drive are repeated, such as .*same-00.\.png: give each frame once",
        ),
    ):
        with pytest.raises(DataError, match=asked):
            update(known, drives[1], frames)


@pytest.mark.parametrize("settings", [{}, COUNTS])
def test_what_the_map_lacks_is_added_where_it_is_missing(known, drives, settings):
    before = lost(known, drives, "later")
    found = update(known, drives[1], drives[2]["changed"], progress=False, growth=None, **settings)
    rows = np.flatnonzero(found.added)
    assert len(found.known) == len(known) + len(rows)
    assert found.added[CHANGED].mean() > 0.4
    assert found.added[: CHANGED.start - 25].sum() <= 1, "a window is 20 frames, and a picture shows 16 steps"
    np.testing.assert_array_equal(found.known.frames.path[len(known) :], drives[2]["changed"].path[rows])
    assert before > 0.2
    assert lost(found.known, drives, "later") < before / 3
    assert lost(found.known, drives, "old") == 0
    again = update(found.known, drives[1], drives[2]["later"], progress=False, **settings)
    assert again.added.sum() < 0.25 * len(rows), "the map knows both looks by then"


def test_what_several_drives_contradict_is_forgotten(known, drives):
    now, gone = known, list[int]()
    for name in ("changed", "later"):
        found = update(now, drives[1], drives[2][name], progress=False, forget=2, growth=None)
        now = found.known
        gone.append(int(found.forgotten.sum()))
    stale = known.frames.path[CHANGED]
    assert gone[0] == 0
    assert gone[1] > 10
    left = np.isin(found.before.frames.path[found.forgotten], stale)
    assert left.mean() > 0.6, "the others show some of what has changed"
    assert set(named(found.map_reason[found.forgotten])) == {"FORGOTTEN"}
    assert (found.before.history.contradicted[found.forgotten] == 2).all()
    change = found.before.history.change
    assert np.median(change[CHANGED]) > 1 > np.median(change)


def test_a_light_of_which_nothing_is_recognized_says_nothing_about_the_map(known, drives):
    found = update(known, drives[1], drives[2]["new"], progress=False, growth=None)
    assert set(named(found.map_reason)) <= {"CONFIRMED", "OTHER_LIGHT"}
    assert (named(found.map_reason) == "OTHER_LIGHT").sum() > 60
    assert not found.known.history.contradicted.any()
    lit = replace(known, frames=known.frames.with_columns(lighting=["day"] * FRAMES))
    night = drives[2]["changed"].with_columns(lighting=["night"] * FRAMES)
    assert "CONTRADICTED" not in named(update(lit, drives[1], night, progress=False).map_reason)
    assert "CONTRADICTED" in named(update(known, drives[1], night, progress=False).map_reason)


def test_a_drive_that_contradicts_a_map_that_cannot_compare_is_a_warning(known, drives, caplog):
    update(known, drives[1], drives[2]["changed"], progress=False)
    assert not caplog.messages
    update(known, drives[1], drives[2]["new"], progress=False)
    assert "frames of drive new taken in known places contradict the map: the light may be another one" in caplog.text


def test_pictures_that_show_nothing_never_join(known, drives, tmp_path):
    drive = drives[2]["changed"]
    cv2.imwrite(str(tmp_path / "covered.png"), np.full((ROWS, COLUMNS, 3), (10, 90, 200), np.uint8))
    path = drive.path.tolist()
    for row in range(30, 60):
        path[row] = str(tmp_path / f"{row}.png")
        (tmp_path / f"{row}.png").write_bytes((tmp_path / "covered.png").read_bytes())
    drive = drive.with_columns(path=path)
    images = PanoramaLibrary(drive, image_size=(ROWS, COLUMNS))
    found = update(known, images, drive, progress=False, growth=None)
    assert np.flatnonzero(found.reason == Reason.BLANK).tolist() == list(range(30, 60))
    assert found.added[60:80].any()
    assert len(found.drive) == FRAMES
    with pytest.raises(DataError, match="none of the 30 pictures shows anything: look whether the camera is covered"):
        update(known, images, drive.take(np.arange(30, 60)), progress=False)


def test_a_map_stays_within_its_growth(known, drives):
    found = update(known, drives[1], drives[2]["new"], progress=False, growth=1.2)
    assert len(found.known) == int(1.2 * FRAMES)
    assert "REDUNDANT" in named([*found.reason, *found.map_reason])
    again = update(found.known, drives[1], drives[2]["changed"], progress=False, growth=1.2)
    assert len(again.known) == int(1.2 * FRAMES), "of the frames before the first update"
    history = History(np.zeros(FRAMES, int), np.arange(FRAMES) // 118, np.full(FRAMES, np.nan))
    found = update(replace(known, history=history), drives[1], drives[2]["same"], progress=False, frames=118)
    assert found.forgotten.sum() == 2 + found.added.sum()
    assert not found.before.history.contradicted[118:].any(), "the drive recognized the last two"


def test_a_merged_map_keeps_what_both_maps_need_for_their_updates(known, drives):
    annex = drives[2]["new"].with_columns(building=["annex"] * FRAMES)
    annex = build("hog", drives[1], annex, progress=False)
    after = update(known, drives[1], drives[2]["same"], progress=False).known
    kept = {"before": 240, "frames": 240, "drives": ["same"], "usual": None, "learned": None}
    for whole in (after.merge(annex), annex.merge(after), after.add(annex.frames, annex.description)):
        assert whole.made["upkeep"] == kept
    found = update(after.merge(annex), drives[1], drives[2]["changed"], progress=False)
    assert found.added.any()
    assert not found.forgotten.any(), "both maps together have room"
    assert found.known.made["upkeep"]["usual"] > 0
    alike = {"before": 9, "frames": 10, "drives": ["same", "later"], "usual": 1.05 * after.made["upkeep"]["usual"]}
    other = replace(annex, made={**annex.made, "upkeep": {**after.made["upkeep"], **alike}})
    both = after.merge(other).made["upkeep"]
    assert both == after.made["upkeep"] | {"before": 129, "frames": 130, "drives": ["same", "later"]}
    assert "upkeep" not in known.merge(annex).made


def test_new_places_join_the_map_unless_it_is_not_extended(known, drives):
    part = known.take(np.arange(CHANGED.start - 20))
    found = update(part, drives[1], drives[2]["changed"], progress=False, **COUNTS, extend=False)
    assert not found.known_place[CHANGED].any()
    assert not found.added.any()
    assert not found.contradicted[~found.known_place].any()
    beyond = drives[2]["changed"].take(np.arange(50, 70))
    short = update(part, drives[1], beyond, progress=False, extend=False)
    assert short.summary().endswith("to judge the map, at least window=5 are needed")
    found = update(part, drives[1], beyond, progress=False)
    assert {"NEW_PLACE"} <= set(named(found.reason)) <= {"NEW_PLACE", "REPEATED"}
    assert "0 of 0 frames in known places" in found.summary()
    assert f"{found.added.sum()} show new places; {found.added.sum()} joined the map" in found.summary()
    assert lost(found.known, drives, "changed") < lost(part, drives, "changed")


def test_frames_of_the_map_and_uncertain_ones_are_not_judged(known, drives):
    drive = drives[2]["changed"]
    joined = known.merge(build("hog", drives[1], drive.take(np.arange(60)), progress=False))
    deviation = np.where(np.arange(FRAMES) < 100, 0.1, np.nan)
    found = update(joined, drives[1], drive, deviation=deviation, progress=False)
    assert (found.reason[:60] == Reason.HELD).all()
    assert (found.reason[100:] == Reason.UNSURE).all()
    assert found.added[60:80].any()
    assert found.contradicted.shape == (FRAMES,)
    assert not found.contradicted[:60].any()
    for deviation in (0.1, np.nan):
        with pytest.raises(DataError, match=r"none of the 120 frames .* has a deviation of at most certain=0\.05"):
            update(known, drives[1], drive, deviation=np.full(FRAMES, deviation), certain=0.05)
    with pytest.raises(DataError, match="a deviation is 0 or more, or NaN where it is unknown, got -1"):
        update(known, drives[1], drive, deviation=-np.ones(FRAMES))
    with pytest.raises(DataError, match=r"120 frames of the drive need a deviation each, got shape \(3,\)"):
        update(known, drives[1], drive, deviation=[0, 0, 0])


def test_positions_with_other_axes_than_the_map_are_refused(known, drives):
    drive = drives[2]["same"]
    for moved in ({"x": drive.x + 3.0}, {"x": -drive.y + 40.0, "y": drive.x}):
        with pytest.raises(DataError, match=r"other axes than the map's: .* of 120 frames .* in the column building"):
            update(known, drives[1], drive.with_columns(**moved), progress=False)
    away = drive.with_columns(x=drive.x + 40.0, building=["annex"] * FRAMES)
    assert update(known, drives[1], away, progress=False).added.any()


def test_drives_of_a_map_in_different_frames_are_warned_of(known, drives, caplog):
    """Frames without positions, and drives of other buildings, are not compared."""
    drive = drives[2]["same"]
    for moved, wrong in ((drive, False), (drive.with_columns(x=drive.x + 3.0), True)):
        both = known.merge(build("hog", drives[1], moved, progress=False))
        caplog.clear()
        warn_of_axes(both, 1.0)
        assert wrong == (
            "drive same of this map and the drives before it seem to be in different frames: the" in caplog.text
        )
    for columns in ({"x": np.full(FRAMES, np.nan)}, {"building": ["annex"] * FRAMES}):
        caplog.clear()
        warn_of_axes(known.merge(build("hog", drives[1], moved.with_columns(**columns), progress=False)), 1.0)
        assert not caplog.text


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda x, y: (y, x), "one motion, with x and y exchanged or one of them reversed, brings 40 of 40"),
        (lambda x, y: (x, -y), "one motion, with x and y exchanged or one of them reversed, brings 40 of 40"),
        (lambda x, y: (3 - y, 7 + x), r"one motion by \d\.\d\d m and 90 degrees brings 40 of 40"),
        (lambda x, y: (1000 * x, 1000 * y), r"one motion and a factor of 0\.001, as between units, brings 40 of 40"),
        (lambda x, y: (3.28 * y, 3.28 * x), r"reversed, and a factor of 0\.3, as between units, brings 40 of 40"),
        (lambda x, y: (x / 1000 + 9, y / 1000), r"a factor of 1000, as between units, brings 40 of 40"),
    ],
)
def test_positions_that_are_turned_exchanged_reversed_or_in_another_unit_are_refused(made, says):
    angle, out = 0.15 * np.arange(40), 1 + 0.1 * np.arange(40)  # a spiral, which no motion brings into its mirror image
    x, y = out * np.cos(angle), out * np.sin(angle)
    descriptors = np.column_stack([x, y]).astype(np.float32)
    known = VisualMap(descriptors, FrameTable(path=[f"{n}.png" for n in range(40)], x=x, y=y)).take(slice(0, 40, 3))
    moved = dict(zip("xy", made(x, y), strict=True))
    with pytest.raises(DataError, match=says):
        updated(known, VisualMap(descriptors, FrameTable(path=[f"drive/{n}.png" for n in range(40)], **moved)))


@pytest.mark.parametrize("every", [1, 8, 25])
def test_short_drives_in_another_unit_are_refused_and_true_ones_never(every):
    x = 0.3 * np.arange(60)
    y = np.sin(x)
    rng, descriptors = np.random.default_rng(0), np.column_stack([x, y]).astype(np.float32)
    known = VisualMap(descriptors, FrameTable(path=[f"{n}.png" for n in range(60)], x=x, y=y)).take(slice(0, 60, every))
    for first in range(0, 60, 3):
        for count, noise in ((5, 0.0), (9, 0.3), (30, 1.0), (30, 30.0)):  # at last, frames are located anywhere
            rows = np.arange(first, min(first + count, 60))
            frames = FrameTable(path=[f"drive/{n}.png" for n in rows], x=x[rows], y=y[rows])
            seen = descriptors[rows] + rng.normal(0, noise, (len(rows), 2)).astype(np.float32)
            updated(known, VisualMap(seen, frames))
    short = FrameTable(path=[f"drive/{n}.png" for n in range(9)], x=100 * x[:9], y=100 * y[:9])
    if every == 1:
        with pytest.raises(DataError, match=r"a factor of 0\.01, as between units, brings 9 of 9 frames"):
            updated(known, VisualMap(descriptors[:9], short))


def test_headings_in_degrees_are_refused_where_they_would_be_compared(known, drives, monkeypatch):
    _, images, drive = drives
    x, y = np.cos(0.1 * np.arange(FRAMES)), np.sin(0.1 * np.arange(FRAMES))
    turned = drive["same"].with_columns(x=x, y=y, theta=90 + np.degrees(0.1 * np.arange(FRAMES)))
    monkeypatch.setattr(maintenance, "comparison_of", lambda _: object())
    with pytest.raises(DataError, match="headings of the drive cannot be compared: theta looks like degrees"):
        update(known, images, turned)


def test_few_contradictions_are_no_evidence(known, drives):
    brief = drives[2]["changed"].take(np.r_[0:20, 55:69, 100:120])
    assert update(known, drives[1], brief, progress=False, **COUNTS).contradicted.sum() <= 14
    assert not update(known, drives[1], brief, progress=False, **COUNTS).added.any()
    assert update(known, drives[1], brief, contradicted=5, window=20, usual=None, progress=False).added.any()
    one = drives[2]["changed"].take(np.r_[0:20, 60:61, 100:120])
    found = update(known, drives[1], one, progress=False)
    assert found.contradicted[20]
    assert found.reason[20] == Reason.ALONE


def test_nodes_of_an_incremental_map_learn_another_appearance(known, drives):
    built = group(known, "incremental", progress=False)
    modes = [len(node.modes) for node in built.mapper.nodes]
    found = update(known, drives[1], drives[2]["changed"], built=built, progress=False, growth=None, **COUNTS)
    assert found.added.any()
    found.built.check_map(found.known)
    assert [len(node.modes) for node in built.mapper.nodes] == modes, "the given mapper stays as it was"
    mapper, layer = found.built.mapper, found.built.layer
    assert sum(len(node.modes) for node in mapper.nodes) > sum(modes)
    assert len(mapper) == len(found.known) == len(found.built.seconds) == len(found.built.reasons)
    before = mapping(known, built).measures["ms_per_frame"]
    assert mapping(found.known, found.built).measures["ms_per_frame"] == before, "of the frames placed one by one"
    ids = np.array([*layer.made["ids"], -1])
    np.testing.assert_array_equal(mapper.labels(), ids[layer.labels])
    np.testing.assert_array_equal([pose[0] for pose in mapper.poses], found.known.frames.x)


def test_short_nodes_are_out_of_date_as_well(known, drives):
    built = group(known, "sample", nodes=10)
    found = update(known, drives[1], drives[2]["new"], built=built, progress=False, growth=None, **COUNTS)
    assert found.contradicted.sum() > 90
    assert found.added.sum() > 100
    assert (np.bincount(found.built.layer.labels) > 12).all(), "each node of 12 frames got more"


def test_too_few_frames_for_a_mode_are_reported(known, drives):
    built = group(known, "incremental", progress=False)
    second = int(np.argmax(built.layer.labels == 1))
    part = drives[2]["new"].take(np.arange(second + 2))
    found = update(known, drives[1], part, built=built, progress=False, **COUNTS)
    np.testing.assert_array_equal(np.flatnonzero(found.reason == Reason.FEW), [second, second + 1])
    assert found.summary().endswith("; 2 left out, fewer in their node than smallest_node")


def test_nodes_of_an_incremental_map_forget_as_their_map_does(known, drives, tmp_path):
    built = group(known, "incremental", progress=False)
    now, nodes = known, built
    for name in ("changed", "later"):
        found = update(now, drives[1], drives[2][name], built=nodes, progress=False, forget=2)
        now, nodes = found.known, found.built
    assert found.forgotten.any()
    nodes.check_map(now)
    numbers, ids = np.array(nodes.layer.made["frames"]), np.array([*nodes.layer.made["ids"], -1])
    np.testing.assert_array_equal(nodes.mapper.labels()[numbers], ids[nodes.layer.labels])
    np.testing.assert_array_equal([nodes.mapper.poses[number][0] for number in numbers], now.frames.x)
    sizes = np.bincount(nodes.layer.labels[nodes.layer.labels >= 0])
    assert (sizes >= nodes.mapper.parameters.smallest_node).all()
    nodes.save(tmp_path / "layer")
    assert not (tmp_path / "layer" / "events.jsonl").exists(), "frames in the log are not those of the map"
    assert len(nodes.layer.edges) == len(np.unique(nodes.layer.edges, axis=0))


def test_nodes_without_frames_vanish(known, drives):
    built = group(known, "sample", nodes=60)
    now, nodes = known, built
    for name in ("changed", "later"):
        found = update(now, drives[1], drives[2][name], built=nodes, progress=False, forget=2, growth=None)
        now, nodes = found.known, found.built
    nodes.check_map(now)
    assert set(nodes.layer.names.tolist()) <= set(built.layer.names.tolist())
    kept = ~found.forgotten
    old = found.before.frames.path[kept]
    np.testing.assert_array_equal(now.frames.path[: kept.sum()], old)


def test_rooms_keep_their_names(known, drives):
    found = update(known, drives[1], drives[2]["changed"], built=group(known, "rooms"), progress=False)
    assert found.built.layer.names.tolist() == ["far", "near"]
    added = found.known.frames.room[len(known) :]
    assert (found.built.layer.names[found.built.layer.labels[len(known) :]] == added).all()


def test_what_cannot_be_updated_is_refused(known, drives, tmp_path):
    _, images, drive = drives
    with pytest.raises(ConfigError, match="contradicted=6 frames cannot be among window=5"):
        update(known, images, drive["same"], contradicted=6)
    with pytest.raises(ConfigError, match=r"growth=0\.5 would shrink a map"):
        update(known, images, drive["same"], growth=0.5)
    with pytest.raises(DataError, match="none of the 120 frames"):
        update(known, images, drive["same"].with_columns(x=np.full(FRAMES, np.nan)))
    lacking = replace(known, frames=known.frames.with_columns(x=np.full(FRAMES, np.nan)))
    with pytest.raises(DataError, match="120 of the 120 map frames have no position"):
        update(lacking, images, drive["same"], progress=False)
    with pytest.raises(DataError, match="positions count in m and px"):
        update(known, images, replace(drive["same"], unit="px"))
    built = group(known, "incremental", folder=tmp_path / "layer", progress=False)
    with pytest.raises(DataError, match="an incremental map is updated with its mapper"):
        update(known, images, drive["same"], built=Built.load(tmp_path / "layer"))
    built.mapper.extendable = False
    with pytest.raises(AnalyticError, match="is read-only"):
        update(known, images, drive["changed"], built=built, progress=False)
    with pytest.raises(ConfigError, match="described differently"):
        known.merge(build("thumbnail", images, drive["same"], progress=False))


def test_data_that_say_nothing_of_the_frames_that_joined_agree_with_the_map(known, drives):
    after = update(known, drives[1], drives[2]["changed"], progress=False).known
    table, joined = drives[1].frames, after.frames.select(sequence="changed")
    unplaced = np.where(table.sequence == "changed", np.nan, table.x)
    assert not len(after.check_frames(table.with_columns(x=unplaced, room=[""] * len(table))))
    assert after.check_frames(drives[2]["old"]) == joined
    assert after.check_frames(drives[2]["changed"], whole=False) == after.frames.select(sequence="old")
    with pytest.raises(ConfigError, match=f"of the map's {len(after)} frames are not in the data"):
        after.check_frames(drives[2]["changed"])
    for column in ({"y": np.full(len(table), 0.1)}, {"room": ["attic"] * len(table)}):
        with pytest.raises(ConfigError, match="another position or room in the data now"):
            after.check_frames(table.with_columns(**column), whole=False)


@pytest.mark.parametrize("name", ["", "old"])
def test_frames_that_joined_are_told_from_the_maps_own_by_themselves_and_not_by_a_name(known, drives, tmp_path, name):
    library, frames = drives[1], drives[2]["changed"].with_columns(sequence=[name] * FRAMES)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(ROWS, COLUMNS))
    after = update(known, images, frames, progress=False).known
    after.save(tmp_path / "map.npz")
    read = VisualMap.load(tmp_path / "map.npz")
    held = set(drives[2]["old"].identities())
    assert read.history.joined.tolist() == [frame not in held for frame in read.frames.identities()]
    assert 0 < read.history.joined.sum() < len(read)
    assert read.check_frames(library.frames) == read.frames.take(read.history.joined)


def test_frames_that_joined_a_map_before_it_kept_them_are_those_of_the_drives_that_updated_it(
    known, drives, tmp_path, monkeypatch
):
    after = update(known, drives[1], drives[2]["changed"], progress=False).known
    write = map_file.write_arrays
    monkeypatch.setattr(
        map_file,
        "write_arrays",
        lambda path, header, arrays: write(path, header, {k: v for k, v in arrays.items() if k != "history_joined"}),
    )
    after.save(tmp_path / "map.npz")
    assert VisualMap.load(tmp_path / "map.npz").history.joined.tolist() == after.history.joined.tolist()


@pytest.mark.slow
def test_the_command_takes_drives_together_and_in_tables_of_their_own(drives, tmp_path, capsys):
    header, *rows = (drives[0] / "manifest.csv").read_text().splitlines()

    def table(*names):
        path = tmp_path / f"{'-'.join(names)}.csv"
        path.write_text("\n".join([header, *(row for row in rows if row.rpartition(",")[2] in names)]))
        return f"data.manifest={path}"

    common = ["descriptor=hog", f"run={tmp_path / 'run'}", f"data.image_size=[{ROWS},{COLUMNS}]"]
    done("map", *common, table("old"), "protocol.map.sequences=['*']")
    done("map", *common, table("changed"), "update.sequences=[changed]")
    assert capsys.readouterr().out.splitlines()[-1] == f"next: siamloc export run={tmp_path / 'run'} descriptor=hog"
    Refinement("interpolate").save(tmp_path / "run/evaluation/hog/refinement.json")
    done("export", f"run={tmp_path / 'run'}", "descriptor=hog", "thumbnails=true")
    done("map", *common, table(*DRIVES), "update.sequences=[later,same]", "update.forget=2")
    said, (saved,) = capsys.readouterr().out, tmp_path.glob("run/evaluation/hog/map.npz")
    assert f"picture: {saved.with_name('staleness.png')}" in said
    again = refused(capsys, "map", *common, table("old"), "protocol.map.sequences=['*']")
    assert "holds what updates added and counted, which a new map would lose: move the file away first" in again
    refined = "task.refine=interpolate thumbnails=true"  # as the bundle has
    assert said.splitlines()[-1] == f"next: siamloc export run={tmp_path / 'run'} descriptor=hog {refined}"
    known = VisualMap.load(saved)
    assert known.history.joined.any()
    assert 0 < (~known.history.joined).sum() < FRAMES, "of those that it was made of, some were forgotten"
    asked = ["evaluate", *common, "task=absolute", "protocol.query.sequences=[new]", "task.plots=false"]
    done(*asked, table(*DRIVES), "protocol.map.sequences=[old]", "task.baselines=[]")
    without = [table("old", "new"), "protocol.map.sequences=[old]", f"out={tmp_path / 'out'}"]
    done(*asked, *without, "task.baselines=[thumbnail]")  # of all map frames
    for role in ("sequences=[old,later]", "every=2"):
        more = [table(*DRIVES), "protocol.map.sequences=[old]", f"protocol.map.{role}", "overwrite=true"]
        assert "was made of other frames than protocol.map asks for" in refused(capsys, *asked, *more)


def test_the_command_maintains_the_saved_map_and_its_nodes(drives, tmp_path, capsys):
    words = ["data=manifest", f"data.manifest={drives[0] / 'manifest.csv'}", f"data.image_size=[{ROWS},{COLUMNS}]"]
    common = ["descriptor=hog", f"run={tmp_path / 'run'}", "build=incremental"]
    counts = ["update.contradicted=15", "update.window=20", "update.usual=null", "update.growth=null"]
    saved, layer = tmp_path / "run/evaluation/hog/map.npz", tmp_path / "run/layers/hog-incremental/layer.npz"
    asked = refused(capsys, "map", *common, "update.sequences=[changed]")
    assert f"no map yet in {saved}: `siamloc map run={tmp_path / 'run'} descriptor=hog` makes one" in asked
    done("map", *words, *common, "protocol.map.sequences=[old]")
    before = len(VisualMap.load(saved))
    assert "update.sequences: no frame has sequence 'nowhere'" in refused(
        capsys, "map", *common, "update.sequences=[nowhere]"
    )
    assert "add update.sequences=[NAME]" in refused(capsys, "map", *common, "update.radius=2")
    assert "update is a group of keys" in refused(capsys, "map", *common, "update=[changed]")
    asked = refused(capsys, "map", *common[:2], "update.sequences=[changed]")
    assert "with `siamloc map build=incremental update.sequences=[...]`, or remove the folder" in asked
    capsys.readouterr()
    done("map", *common, *counts, "update.sequences=[same]")
    assert (saved.parent / "staleness.png").stat().st_size > 10_000
    assert VisualMap.load(saved).history.confirmed.mean() > 0.95
    assert "the map is up to date" in capsys.readouterr().out
    done("map", *common, *counts, "update.sequences=[changed]", "update.radius=30")
    assert "the map is up to date" in capsys.readouterr().out, "the corridor is 24 m long"
    assert len(VisualMap.load(saved)) == before
    with patch("siamloc.report.draw.staleness.staleness_picture", side_effect=KeyboardInterrupt):
        assert main(["map", *common, *counts, "update.sequences=[changed]"]) == 130
    assert layer.exists(), "map and nodes are saved before the picture is drawn"
    assert " joined the map, " in capsys.readouterr().out
    known = VisualMap.load(saved)
    assert len(known) > before
    done("evaluate", *common, "task=hierarchical", "task.coarse.by=vote", "protocol.query.sequences=[later]")
    done("evaluate", *common, "task=mapping")
    assert len(VisualMap.load(saved)) == len(known)
    asked = ["evaluate", *common, "task=absolute", "protocol.query.sequences=[changed]"]
    assert "changed" in refused(capsys, *asked)
    with patch.object(Built, "save", side_effect=KeyboardInterrupt):
        assert main(["map", *common, *counts, "update.sequences=[new]"]) == 130
    assert len(VisualMap.load(saved)) > len(known)
    assert not layer.exists(), "nodes of the map before the interruption"
    asked = refused(capsys, "map", *common, "update.sequences=[new]")
    assert "descriptor=hog build=incremental task=mapping` makes them" in asked
    done("evaluate", *common, "task=mapping", "overwrite=true")
    assert layer.exists()
