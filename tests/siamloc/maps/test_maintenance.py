"""A map is updated where a drive shows that it is out of date, and only there."""

import csv
from dataclasses import replace
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from analytic.errors import AnalyticError
from siamloc.cli import main
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import mapping
from siamloc.maps import Built, VisualMap, build, group, match, update
from tests.siamloc.cli.commands import done, refused

FRAMES, STEP, ROWS, COLUMNS = 120, 4, 16, 64
CHANGED = slice(40, 80)  # frames that show nothing but new paint
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


def test_a_drive_that_looks_as_before_changes_nothing(known, drives):
    found = update(known, drives[1], drives[2]["same"], progress=False)
    assert found.known is known
    assert found.known_place.all()
    assert not found.added.any()
    assert found.summary().endswith("the map is up to date")


def test_what_the_map_lacks_is_added_where_it_is_missing(known, drives):
    before = lost(known, drives, "later")
    found = update(known, drives[1], drives[2]["changed"], progress=False)
    rows = np.flatnonzero(found.added)
    assert len(found.known) == len(known) + len(rows)
    assert found.added[CHANGED].mean() > 0.8
    assert not found.added[: CHANGED.start - 25].any(), "a window is 20 frames, and a picture shows 16 steps"
    np.testing.assert_array_equal(found.known.frames.path[len(known) :], drives[2]["changed"].path[rows])
    assert before > 0.2
    assert lost(found.known, drives, "later") < before / 3
    assert lost(found.known, drives, "old") == 0
    again = update(found.known, drives[1], drives[2]["later"], progress=False)
    assert not again.added.any(), "the map knows both looks now"


def test_frames_beyond_the_map_are_not_its_matter(known, drives):
    part = known.take(np.arange(CHANGED.start - 20))
    found = update(part, drives[1], drives[2]["changed"], progress=False)
    assert not found.known_place[CHANGED].any()
    assert not found.added.any()
    assert not found.contradicted[~found.known_place].any()
    beyond = update(part, drives[1], drives[2]["changed"].take(np.arange(50, 70)), progress=False)
    assert beyond.summary().endswith("to judge the map, at least window=20 are needed")


def test_few_contradictions_are_no_evidence(known, drives):
    brief = drives[2]["changed"].take(np.r_[0:20, 55:69, 100:120])
    assert update(known, drives[1], brief, progress=False).contradicted.sum() <= 14
    assert not update(known, drives[1], brief, progress=False).added.any()
    assert update(known, drives[1], brief, contradicted=5, progress=False).added.any()


def test_nodes_of_an_incremental_map_learn_another_appearance(known, drives):
    built = group(known, "incremental", progress=False)
    modes = [len(node.modes) for node in built.mapper.nodes]
    found = update(known, drives[1], drives[2]["changed"], built=built, progress=False)
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
    found = update(known, drives[1], drives[2]["new"], built=group(known, "sample", nodes=10), progress=False)
    assert found.contradicted.sum() > 90
    assert found.added.sum() > 100
    assert (np.bincount(found.built.layer.labels) > 12).all(), "each node of 12 frames got more"


def test_too_few_frames_for_a_mode_are_reported(known, drives):
    built = group(known, "incremental", progress=False)
    second = int(np.argmax(built.layer.labels == 1))
    found = update(known, drives[1], drives[2]["new"].take(np.arange(second + 2)), built=built, progress=False)
    np.testing.assert_array_equal(np.flatnonzero(found.outdated & ~found.added), [second, second + 1])
    assert found.summary().endswith("; 2 left out, fewer in their node than smallest_node")


def test_rooms_keep_their_names(known, drives):
    found = update(known, drives[1], drives[2]["changed"], built=group(known, "rooms"), progress=False)
    assert found.built.layer.names.tolist() == ["far", "near"]
    added = found.known.frames.room[len(known) :]
    assert (found.built.layer.names[found.built.layer.labels[len(known) :]] == added).all()


def test_what_cannot_be_updated_is_refused(known, drives, tmp_path):
    _, images, drive = drives
    with pytest.raises(ConfigError, match="contradicted=21 frames cannot be among window=20"):
        update(known, images, drive["same"], contradicted=21)
    with pytest.raises(DataError, match="120 of the 240 frames of map and drive have no position"):
        update(known, images, drive["same"].with_columns(x=np.full(FRAMES, np.nan)))
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


def test_the_command_maintains_the_saved_map_and_its_nodes(drives, tmp_path, capsys):
    words = ["data=manifest", f"data.manifest={drives[0] / 'manifest.csv'}", f"data.image_size=[{ROWS},{COLUMNS}]"]
    common = ["descriptor=hog", f"run={tmp_path / 'run'}", "build=incremental"]
    saved, layer = tmp_path / "run/evaluation/hog/map.npz", tmp_path / "run/layers/hog-incremental/layer.npz"
    asked = refused(capsys, "map", *common, "update.sequences=[changed]")
    assert f"no map yet in {saved}: `siamloc map run={tmp_path / 'run'} descriptor=hog` makes one" in asked
    done("map", *words, *common, "protocol.map.sequences=[old]")
    before = len(VisualMap.load(saved))
    assert "no frame has sequence" in refused(capsys, "map", *common, "update.sequences=[nowhere]")
    assert "add update.sequences=[NAME]" in refused(capsys, "map", *common, "update.radius=2")
    assert "update is a group of keys" in refused(capsys, "map", *common, "update=[changed]")
    asked = refused(capsys, "map", *common[:2], "update.sequences=[changed]")
    assert "with `siamloc map build=incremental update.sequences=[...]`, or remove the folder" in asked
    capsys.readouterr()
    done("map", *common, "update.sequences=[same]")
    assert "the map is up to date" in capsys.readouterr().out
    done("map", *common, "update.sequences=[changed]", "update.radius=30")
    assert "the map is up to date" in capsys.readouterr().out, "the corridor is 24 m long"
    assert len(VisualMap.load(saved)) == before
    done("map", *common, "update.sequences=[changed]")
    assert "added, where the map is out of date" in capsys.readouterr().out
    known = VisualMap.load(saved)
    assert len(known) > before
    done("evaluate", *common, "task=hierarchical", "task.coarse.by=vote", "protocol.query.sequences=[later]")
    done("evaluate", *common, "task=mapping")
    assert len(VisualMap.load(saved)) == len(known)
    asked = ["evaluate", *common, "task=absolute", "protocol.query.sequences=[changed]"]
    assert "changed" in refused(capsys, *asked)
    with patch.object(Built, "save", side_effect=KeyboardInterrupt):
        assert main(["map", *common, "update.sequences=[new]"]) == 130
    assert len(VisualMap.load(saved)) > len(known)
    assert not layer.exists(), "nodes of the map before the interruption"
    asked = refused(capsys, "map", *common, "update.sequences=[new]")
    assert "descriptor=hog build=incremental` makes map and nodes" in asked
