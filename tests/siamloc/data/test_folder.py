from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest

import siamloc.data
from siamloc.errors import DataError


def put(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"image")


def test_split_room_and_pose(tmp_path):
    put(
        tmp_path,
        "train_Cloudy/KT-A/t3_x3_y0_a-1e-05.jpeg",
        "train_Cloudy/CR-A/t2_x2_y-0.000000_a0.5.jpeg",
        "train_Cloudy/KT-A/t1_x1_y0_a0.jpg",
        "TestNight/CR-A/t9_x9_y1_a1.png",
        "TestNight/CR-A/notes.txt",
        ".cache/CR-A/t1_x1_y1_a1.jpeg",
    )
    table = siamloc.data.read("folder", root=tmp_path)
    assert table.sequence.tolist() == ["TestNight"] + ["train_Cloudy"] * 3
    assert table.lighting.tolist() == ["night"] + ["cloudy"] * 3
    assert table.room.tolist() == ["CR-A", "KT-A", "CR-A", "KT-A"]
    np.testing.assert_array_equal(table.time, [9, 1, 2, 3])
    np.testing.assert_array_equal(table.x, [9, 1, 2, 3])
    np.testing.assert_array_equal(table.theta, [1, 0, 0.5, -1e-5])
    assert table.path[1] == str(tmp_path / "train_Cloudy/KT-A/t1_x1_y0_a0.jpg")


def test_images_without_a_pose_have_none_and_keep_the_order_of_their_names(tmp_path):
    put(tmp_path, "train/b/2.jpg", "train/b/1.jpg", "train/a/t5_x1_y1_a1.jpeg")
    table = siamloc.data.read("folder", root=tmp_path)
    assert [Path(path).name for path in table.path.tolist()] == ["t5_x1_y1_a1.jpeg", "1.jpg", "2.jpg"]
    assert np.isnan([table.x, table.time]).tolist() == [[False, True, True]] * 2


def test_images_beside_the_rooms_are_left_out_and_reported(tmp_path, caplog):
    put(tmp_path, "train/a/1.jpg", "train/stray.jpg")
    with caplog.at_level(logging.WARNING, "siamloc"):
        assert len(siamloc.data.read("folder", root=tmp_path)) == 1
    assert re.search(r"1 of 2 images lie next to the rooms' folders.*stray\.jpg", caplog.text)
    with pytest.raises(DataError, match=r"stray\.jpg"):
        siamloc.data.read("folder", root=tmp_path, on_error="raise")
    (tmp_path / "train/stray.jpg").rename(tmp_path / "train/a/2.jpg")
    put(tmp_path, "train/a/best/3.jpg")
    with pytest.raises(DataError, match=r"1 of 3 images lie .*, or in folders inside, the first: .*best/3\.jpg"):
        siamloc.data.read("folder", root=tmp_path, on_error="raise")


def test_pictures_in_formats_that_are_not_read_are_reported(tmp_path, caplog):
    put(tmp_path, "train/a/1.jpg", "train/a/1.HEIC", "train/a/2.HEIC", "train/b/3.gif", "train/b/._3.gif")
    with caplog.at_level(logging.WARNING, "siamloc"):
        assert len(siamloc.data.read("folder", root=tmp_path)) == 1
    said = r"2 of 3 files are in formats that are not read; \.heic: convert .*; \.gif: convert .* first: .*a/2\.HEIC"
    assert re.search(said, caplog.text), "1.jpg shows what 1.HEIC does"
    with pytest.raises(DataError, match=said):
        siamloc.data.read("folder", root=tmp_path, on_error="raise")
    (tmp_path / "train/a/1.jpg").unlink()
    with pytest.raises(DataError, match=r"holds no images .*; it holds: train; \.heic: convert them to JPEG"):
        siamloc.data.read("folder", root=tmp_path)
    put(tmp_path, "train/b/4.jpg")
    assert len(siamloc.data.read("trajectory", images=tmp_path / "train/b")) == 1
    said = f"{tmp_path / 'train/b'}: files in formats that are not read are left out: 1, the first 3.gif; .gif: convert"
    assert said in caplog.text


def test_another_layout_is_an_error_that_says_what_is_there(tmp_path):
    with pytest.raises(DataError, match=r"laid out as <split>/<room>/<image>.*it holds: nothing"):
        siamloc.data.read("folder", root=tmp_path)
    put(tmp_path, "room/1.jpg")
    with pytest.raises(DataError, match=r"it holds: room; images not directly in a room.*: 1, the first .*1\.jpg"):
        siamloc.data.read("folder", root=tmp_path)
    with pytest.raises(DataError, match="is not a folder: expected one with <split>"):
        siamloc.data.read("folder", root=tmp_path / "room/1.jpg")
