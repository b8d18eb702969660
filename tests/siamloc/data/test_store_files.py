"""Builds that are interrupted, that race, or that meet a full disk."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from siamloc.data import PanoramaStore
from siamloc.data.frames import FrameTable
from siamloc.data.locking import exclusive, is_locked
from siamloc.data.store_files import _header
from siamloc.errors import DataError, StorageError

IMAGES = 24

# A build that says when it has come to the 20th image and goes on when it is told to.
BUILD = """
import sys
from pathlib import Path
from siamloc.data import FrameTable, PanoramaStore
from siamloc.data.decoding import Preprocessing

folder, pause = Path(sys.argv[1]), sys.argv[2] == "pause"
decode, count = Preprocessing.panorama, 0

def counted(self, path):
    global count
    count += 1
    if pause and Path(path).name == "20.png":
        print("half way", flush=True)
        sys.stdin.readline()
    return decode(self, path)

Preprocessing.panorama = counted
frames = FrameTable(path=sorted(str(path) for path in (folder / "images").iterdir()))
store = PanoramaStore.open_or_build(frames, folder / "cache", image_size=(4, 8), workers=1)
print(store.key, len(store), count)
"""


@pytest.fixture
def frames(tmp_path) -> FrameTable:
    (tmp_path / "images").mkdir()
    for i in range(IMAGES):
        cv2.imwrite(str(tmp_path / "images" / f"{i:02}.png"), np.full((4, 8, 3), i, np.uint8))
    return FrameTable(path=sorted(str(path) for path in (tmp_path / "images").iterdir()))


def build(frames: FrameTable, tmp_path: Path) -> PanoramaStore:
    return PanoramaStore.open_or_build(frames, tmp_path / "cache", image_size=(4, 8), workers=2)


def start(tmp_path: Path, mode: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", BUILD, str(tmp_path), mode], stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def assert_whole(store: PanoramaStore) -> None:
    np.testing.assert_array_equal(store.panoramas[:, 0, 0, 0], np.arange(IMAGES))
    assert names(store.folder) == ["panoramas.npy", "store.json"]


def test_a_killed_build_leaves_nothing_that_is_taken_for_a_store(frames, tmp_path):
    with start(tmp_path, "pause") as process:
        assert process.stdout.readline() == "half way\n"
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
    left = names(tmp_path / "cache")
    assert all(name.startswith(".") for name in left)
    assert any(name.endswith(".tmp") for name in left), "the build was killed before it began to write"
    store = build(frames, tmp_path)
    assert_whole(store)
    assert names(tmp_path / "cache") == [store.key]


def test_the_remains_of_a_killed_build_are_removed_by_the_build_of_another_store(frames, tmp_path):
    with start(tmp_path, "pause") as process:
        assert process.stdout.readline() == "half way\n"
        process.kill()
        process.wait(timeout=60)
    store = build(frames.take([0]), tmp_path)
    assert [name for name in names(tmp_path / "cache") if not name.endswith(".lock")] == [store.key]


def test_of_two_builds_at_once_the_second_waits_and_takes_the_first_ones_result(frames, tmp_path):
    with start(tmp_path, "pause") as first:
        try:
            assert first.stdout.readline() == "half way\n"
            with start(tmp_path, "wait") as second:
                try:
                    assert "another process is building the store" in second.stderr.readline()
                    # A build of other frames leaves the work of the first alone.
                    build(frames.take([0]), tmp_path)
                    first_result, first_errors = first.communicate("go\n", timeout=60)
                    second_result, second_errors = second.communicate(timeout=60)
                finally:
                    second.kill()
        finally:
            first.kill()
    key = build(frames, tmp_path).key
    assert first_result.split() == [key, str(IMAGES), str(IMAGES)], first_errors
    assert second_result.split() == [key, str(IMAGES), "0"], second_errors
    assert_whole(build(frames, tmp_path))
    assert not [name for name in names(tmp_path / "cache") if name.startswith(".")]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_refuses_before_anything_is_decoded(frames, tmp_path, monkeypatch, code):
    def full(*_):
        raise OSError(code, "full")

    def fail(*_):
        raise AssertionError("decoded all the same")

    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr("siamloc.data.decoding.Preprocessing.panorama", fail)
    with pytest.raises(StorageError, match=r"no space left on the disk while writing .*: free some space"):
        build(frames, tmp_path)
    assert names(tmp_path / "cache") == []


def test_a_disk_that_fills_up_half_way_leaves_no_remains(frames, tmp_path, monkeypatch):
    written = []

    def full(file, array):
        if len(written) == 5:
            raise OSError(errno.ENOSPC, "full")
        written.append(file.write(array.tobytes()))

    monkeypatch.setattr("siamloc.data.store_files._write_all", full)
    with pytest.raises(StorageError, match="no space left on the disk"):
        build(frames, tmp_path)
    assert len(written) == 5
    assert names(tmp_path / "cache") == []


def test_disks_that_cannot_reserve_space_are_used_all_the_same(frames, tmp_path, monkeypatch):
    def unsupported(*_):
        raise OSError(errno.EOPNOTSUPP, "not here")

    monkeypatch.setattr(os, "posix_fallocate", unsupported)
    assert_whole(build(frames, tmp_path))


def test_an_interrupted_build_leaves_no_remains(frames, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("siamloc.data.store_files._write_all", interrupt)
    with pytest.raises(KeyboardInterrupt):
        build(frames, tmp_path)
    assert names(tmp_path / "cache") == []


def test_a_cache_where_a_file_stands_is_an_error(frames, tmp_path):
    (tmp_path / "cache").write_text("")
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        build(frames, tmp_path)


def test_a_cache_inside_a_file_is_missing_and_not_damaged(frames, tmp_path, caplog):
    (tmp_path / "cache").write_text("")
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        PanoramaStore.open_or_build(frames, tmp_path / "cache" / "deeper", image_size=(4, 8))
    assert "damaged" not in caplog.text


@pytest.mark.parametrize("on_error", ["skip", "raise"])
def test_lists_that_come_without_images_are_told_from_damaged_images(tmp_path, on_error):
    paths = [str(tmp_path / f"seq{i % 2}" / f"{i}.jpeg") for i in range(4)]
    with pytest.raises(DataError) as raised:
        PanoramaStore.open_or_build(FrameTable(path=paths), tmp_path / "cache", image_size=(4, 8), on_error=on_error)
    assert str(raised.value) == (
        f"the images' folder {tmp_path / 'seq0'} does not exist (nor do 1 others): these lists come without images; "
        "add the images, or name the folder that holds them"
    )
    assert not (tmp_path / "cache").exists()


def test_without_locks_the_work_goes_on(frames, tmp_path, monkeypatch, caplog):
    def unsupported(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr("fcntl.flock", unsupported)
    old, fresh = (tmp_path / "cache" / f".0123.{word}.tmp" for word in ("old", "fresh"))
    old.mkdir(parents=True)
    fresh.mkdir()
    os.utime(old, (0, 0))
    assert_whole(build(frames, tmp_path))
    assert "no locks on the file system" in caplog.text
    assert fresh.exists(), "it may belong to a build that is going on"
    assert not old.exists()


def test_without_locks_the_faster_of_two_builds_wins(frames, tmp_path, monkeypatch):
    reference = build(frames, tmp_path)
    elsewhere = reference.folder.rename(tmp_path / "elsewhere")

    def unsupported(*_):
        raise OSError(errno.ENOLCK, "no locks")

    def faster(self, path):
        if path.endswith("00.png"):
            elsewhere.rename(reference.folder)
        return np.zeros((3, 4, 8), np.uint8)

    monkeypatch.setattr("fcntl.flock", unsupported)
    monkeypatch.setattr("siamloc.data.decoding.Preprocessing.panorama", faster)
    assert_whole(build(frames, tmp_path))
    assert [name for name in names(tmp_path / "cache") if name.endswith(".tmp")] == []


def test_a_lock_is_held_during_the_block_and_gone_afterwards(tmp_path):
    path = tmp_path / "lock"
    assert not is_locked(path)
    with exclusive(path, "waiting") as locked:
        assert locked
        assert is_locked(path)
    assert not path.exists()
    path.touch()
    assert not is_locked(path)


@pytest.mark.parametrize("shape", [(1, 3, 4, 8), (10**6, 3, 128, 512), (10**12, 3, 10**5, 10**5)])
def test_the_header_is_numpys_whatever_the_shape(tmp_path, shape):
    header = _header(shape)
    assert len(header) == len(_header((1, 3, 4, 8)))
    with (tmp_path / "header").open("wb+") as file:
        file.write(header)
        file.seek(0)
        assert np.lib.format.read_magic(file) == (1, 0)
        assert np.lib.format.read_array_header_1_0(file) == (shape, False, np.dtype("u1"))
        assert file.tell() == len(header)
