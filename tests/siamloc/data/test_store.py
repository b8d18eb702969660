from __future__ import annotations

import json
import logging
import os
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from siamloc.data import PanoramaStore
from siamloc.data.frames import FrameTable
from siamloc.data.panorama import PanoramaView, PolarRing
from siamloc.errors import ConfigError, DataError, FormatError

SIZE = (8, 16)


@pytest.fixture
def frames(tmp_path) -> FrameTable:
    """Seven frames; the image of frame i is i * 30 in red, 255 - i * 30 in green, grey noise in blue."""
    (tmp_path / "images").mkdir()
    paths = [tmp_path / "images" / f"{i}.png" for i in range(7)]
    for i, path in enumerate(paths):
        cv2.imwrite(str(path), picture(i))
    return FrameTable(path=[str(path) for path in paths], room=list("aabbccc"), x=np.arange(7.0))


def picture(i: int) -> np.ndarray:
    image = np.zeros((*SIZE, 3), np.uint8)
    image[..., 0] = np.random.default_rng(i).integers(0, 256, SIZE)
    image[..., 1], image[..., 2] = 255 - i * 30, i * 30
    return image


def expected(*numbers: int) -> np.ndarray:
    return np.stack([picture(i)[..., ::-1].transpose(2, 0, 1) for i in numbers])


def open_store(frames: FrameTable, tmp_path: Path, **options) -> PanoramaStore:
    return PanoramaStore.open_or_build(frames, tmp_path / "cache", **{"image_size": SIZE, **options})


def test_the_store_holds_the_panoramas_of_the_frames(frames, tmp_path):
    store = open_store(frames, tmp_path)
    assert len(store) == 7
    assert store.frames == frames
    assert store.rejected == []
    assert isinstance(store.panoramas, np.memmap)
    assert store.panoramas.shape == (7, 3, *SIZE)
    np.testing.assert_array_equal(store.panoramas, expected(*range(7)))
    assert {path.name for path in (tmp_path / "cache").iterdir()} == {store.key}
    assert {path.name for path in (tmp_path / "cache" / store.key).iterdir()} == {"panoramas.npy", "store.json"}
    np.testing.assert_array_equal(np.load(tmp_path / "cache" / store.key / "panoramas.npy"), store.panoramas)
    assert repr(store) == f"PanoramaStore(7 panoramas of 8 x 16, {tmp_path / 'cache' / store.key})"


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_the_number_of_workers_does_not_matter(frames, tmp_path, workers):
    np.testing.assert_array_equal(open_store(frames, tmp_path, workers=workers).panoramas, expected(*range(7)))


def test_a_second_time_nothing_is_decoded(frames, tmp_path, monkeypatch):
    first = open_store(frames, tmp_path)

    def fail(*_):
        raise AssertionError("decoded again")

    monkeypatch.setattr("siamloc.data.decoding.Preprocessing.panorama", fail)
    again = open_store(frames.with_columns(room=["other"] * 7, x=np.zeros(7)), tmp_path)
    assert again.key == first.key
    assert set(again.frames.room.tolist()) == {"other"}
    np.testing.assert_array_equal(again.panoramas, first.panoramas)


def test_the_store_is_read_only(frames, tmp_path):
    store = open_store(frames, tmp_path)
    with pytest.raises(ValueError, match="read-only"):
        store.panoramas[0] = 0


@pytest.mark.parametrize("rows", [[3], [6, 0, 0, 6], [], list(range(7)), np.array([5, 2], np.int32)])
def test_batches_agree_with_picking_one_by_one(frames, tmp_path, rows):
    batch = open_store(frames, tmp_path).batch(rows)
    assert batch.shape == (len(rows), 3, *SIZE)
    assert batch.dtype == np.uint8
    assert batch.flags.writeable
    assert batch.flags.c_contiguous
    for row, panorama in zip(rows, batch, strict=True):
        np.testing.assert_array_equal(panorama, expected(int(row))[0])


def test_large_batches_agree_too(frames, tmp_path):
    rows = np.random.default_rng(0).integers(0, 7, 500)
    np.testing.assert_array_equal(open_store(frames, tmp_path).batch(rows), expected(*range(7))[rows])


def test_a_batch_can_be_put_where_one_wants(frames, tmp_path):
    store = open_store(frames, tmp_path)
    out = np.empty((2, 3, *SIZE), np.uint8)
    assert store.batch([4, 1], out=out) is out
    np.testing.assert_array_equal(out, expected(4, 1))
    for wrong in (np.empty((3, 3, *SIZE), np.uint8), np.empty((2, 3, *SIZE), np.int16), out[:, ::-1]):
        with pytest.raises(ValueError, match=r"out must be contiguous uint8 \(2, 3, 8, 16\)"):
            store.batch([4, 1], out=wrong)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([0, 7], r"row 7 is outside the store, whose rows are 0 \.\.\. 6"),
        ([-1], "row -1 is outside"),
        ([0.5], "whole numbers"),
        ([True] * 7, "whole numbers"),
        (3, r"whole numbers \(B,\), got shape \(\)"),
        ([[1]], r"got shape \(1, 1\)"),
    ],
)
def test_rows_outside_the_store(frames, tmp_path, rows, message):
    with pytest.raises(IndexError, match=message):
        open_store(frames, tmp_path).batch(rows)


def test_unreadable_images_are_left_out_and_reported_once(frames, tmp_path, caplog):
    Path(frames.path[0]).write_bytes(b"")
    Path(frames.path[3]).unlink()
    with caplog.at_level(logging.WARNING, "siamloc"):
        store = open_store(frames, tmp_path)
    assert len(caplog.records) == 1
    assert f"2 of 7 images cannot be read, the first: {frames.path[0]} (the file is empty)" in caplog.text
    assert store.rejected == [
        {"path": frames.path[0], "reason": "the file is empty"},
        {"path": frames.path[3], "reason": "the file does not exist"},
    ]
    assert store.frames.index.tolist() == [1, 2, 4, 5, 6]
    np.testing.assert_array_equal(store.panoramas, expected(1, 2, 4, 5, 6))
    assert store.rows_of(frames.take([6, 2])).tolist() == [4, 1]
    with pytest.raises(DataError, match=r"the first .*3\.png: the file does not exist; take the frames"):
        store.rows_of(frames.take([1, 3]))
    again = open_store(frames, tmp_path)
    assert again.key == store.key
    assert again.rejected == store.rejected


def test_the_strict_stop_at_an_unreadable_image(frames, tmp_path):
    Path(frames.path[3]).write_bytes(b"no image")
    for _ in range(2):
        with pytest.raises(DataError, match=r"3\.png cannot be read: .* no image"):
            open_store(frames, tmp_path, on_error="raise")
        assert list((tmp_path / "cache").iterdir()) == []
    open_store(frames, tmp_path)
    with pytest.raises(DataError, match=r"1 of 7 images cannot be read.*3\.png"):
        open_store(frames, tmp_path, on_error="raise")


def test_no_readable_image_is_an_error(frames, tmp_path):
    for path in frames.path.tolist():
        Path(path).write_bytes(b"")
    with pytest.raises(DataError, match=r"none of the 7 images can be read, the first: .*0\.png \(the file is empty\)"):
        open_store(frames, tmp_path)
    assert list((tmp_path / "cache").iterdir()) == []


def test_no_frames_is_an_error(frames, tmp_path):
    with pytest.raises(DataError, match="the table is empty"):
        open_store(frames.take([]), tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "at least one worker, got 0"),
        ({"on_error": "ignore"}, "'ignore' is not a policy"),
        ({"image_size": (0, 16)}, "at least 1 x 2 pixels"),
    ],
)
def test_impossible_options(frames, tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        open_store(frames, tmp_path, **options)


def test_a_selection_of_the_frames_finds_its_rows(frames, tmp_path):
    store = open_store(frames.take([6, 4, 2, 0]), tmp_path)
    assert store.rows_of(frames.take([0, 6, 0])).tolist() == [3, 0, 3]
    assert store.rows_of(frames.take([])).tolist() == []
    np.testing.assert_array_equal(store.batch(store.rows_of(frames.select(room="b").take([0]))), expected(2))
    with pytest.raises(DataError, match=r"1 of 2 frames are not in the store .*1\.png; take the frames from"):
        store.rows_of(frames.take([0, 1]))


def test_frames_of_another_table_are_not_mistaken(frames, tmp_path):
    store = open_store(frames, tmp_path)
    other = frames.with_columns(path=[f"/elsewhere{path}" for path in frames.path.tolist()])
    with pytest.raises(DataError, match="7 of 7 frames are not in the store"):
        store.rows_of(other)


def test_the_key_is_made_of_files_and_preprocessing_only(frames, tmp_path):
    keys = {
        "plain": open_store(frames, tmp_path).key,
        "fewer": open_store(frames.take([0, 1]), tmp_path).key,
        "order": open_store(frames.take([1, 0]), tmp_path).key,
        "size": open_store(frames, tmp_path, image_size=(8, 8)).key,
        "ring": open_store(frames, tmp_path, unwrap=PolarRing(inner=1)).key,
        "inner": open_store(frames, tmp_path, unwrap=PolarRing(inner=2)).key,
        "view": open_store(frames, tmp_path, unwrap=PolarRing(inner=2), view=PanoramaView(*SIZE, top=10)).key,
    }
    os.utime(frames.path[0], ns=(1, 1))
    keys["time"] = open_store(frames, tmp_path).key
    with Path(frames.path[0]).open("ab") as file:
        file.write(b"\0")
    os.utime(frames.path[0], ns=(1, 1))
    keys["bytes"] = open_store(frames, tmp_path).key
    assert len(set(keys.values())) == len(keys)
    assert open_store(frames.with_columns(theta=np.ones(7), sequence=["s"] * 7), tmp_path).key == keys["bytes"]
    assert open_store(frames, tmp_path, workers=1, on_error="raise").key == keys["bytes"]


def test_relative_and_absolute_names_of_a_file_are_one(frames, tmp_path, monkeypatch):
    store = open_store(frames, tmp_path)
    monkeypatch.chdir(tmp_path)
    relative = frames.with_columns(path=[os.path.relpath(path) for path in frames.path.tolist()])
    assert PanoramaStore.open_or_build(relative, "cache", image_size=SIZE).key == store.key


def test_the_store_survives_pickling_without_its_bytes(frames, tmp_path):
    Path(frames.path[3]).unlink()
    store = open_store(frames, tmp_path, image_size=(128, 512))
    data = pickle.dumps(store)
    assert len(data) < store.panoramas.nbytes / 100
    again = pickle.loads(data)
    np.testing.assert_array_equal(again.batch([5, 0]), store.batch([5, 0]))
    assert again.frames == store.frames
    assert again.rejected == store.rejected


def cut(folder: Path) -> None:
    os.truncate(folder / "panoramas.npy", (folder / "panoramas.npy").stat().st_size - 1)


def change(**values):
    def apply(folder: Path) -> None:
        record = json.loads((folder / "store.json").read_text())
        (folder / "store.json").write_text(json.dumps({**record, **values}))

    return apply


@pytest.mark.parametrize(
    "damage",
    [
        cut,
        change(version=0),
        change(images=6),
        change(image_size=[4, 16]),
        change(rejected=[{"row": 99, "path": "", "reason": ""}]),
        change(rejected=None),
        lambda folder: (folder / "store.json").write_text("{"),
        lambda folder: (folder / "store.json").write_text("[]"),
        lambda folder: (folder / "panoramas.npy").write_bytes(b""),
        lambda folder: (folder / "panoramas.npy").write_bytes(b"no array"),
        lambda folder: np.save(folder / "panoramas.npy", np.zeros((7, 3, *SIZE), np.float32)),
    ],
)
def test_a_damaged_store_is_built_anew(frames, tmp_path, caplog, damage):
    key = open_store(frames, tmp_path).key
    damage(tmp_path / "cache" / key)
    with caplog.at_level(logging.WARNING, "siamloc"):
        store = open_store(frames, tmp_path)
    assert "damaged or cut short; it is built anew" in caplog.text
    np.testing.assert_array_equal(store.panoramas, expected(*range(7)))
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [key]


@pytest.mark.parametrize("name", ["store.json", "panoramas.npy"])
def test_a_store_with_a_file_missing_is_built_anew(frames, tmp_path, name):
    key = open_store(frames, tmp_path).key
    (tmp_path / "cache" / key / name).unlink()
    np.testing.assert_array_equal(open_store(frames, tmp_path).panoramas, expected(*range(7)))


def test_a_store_of_a_newer_version_is_refused(frames, tmp_path):
    key = open_store(frames, tmp_path).key
    change(version=2)(tmp_path / "cache" / key)
    with pytest.raises(FormatError, match="has format version 2, this siamloc reads up to 1: update siamloc"):
        open_store(frames, tmp_path)
    assert (tmp_path / "cache" / key / "panoramas.npy").exists()


def test_a_store_that_vanished_cannot_be_unpickled(frames, tmp_path):
    store = open_store(frames, tmp_path)
    data = pickle.dumps(store)
    (store.folder / "store.json").unlink()
    with pytest.raises(DataError, match="gone or cut short"):
        pickle.loads(data)
