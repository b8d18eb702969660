"""Stores on disk: what they hold, and builds that are interrupted, that race, or that meet a full disk."""

from __future__ import annotations

import errno
import json
import logging
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import _bits_found
from siamloc.data.panorama import PolarRing
from siamloc.data.store import Store, open_store, store_key
from siamloc.errors import DataError, StorageError

IMAGES = 24
SIZE = (4, 8)

# A build that reports when it has reached the 20th image and goes on when it is told to.
BUILD = """
import sys
from pathlib import Path
from siamloc.data.decoding import Preprocessing
from siamloc.data.store import open_store

folder, pause = Path(sys.argv[1]), sys.argv[2] == "pause"
decode, count = Preprocessing.panorama, 0

def counted(self, path, tilt=None):
    global count
    count += 1
    if pause and Path(path).name == "20.png":
        print("half way", flush=True)
        sys.stdin.readline()
    return decode(self, path, tilt)

Preprocessing.panorama = counted
paths = sorted(str(path) for path in (folder / "images").iterdir())
store = open_store(paths, folder / "cache", Preprocessing.checked((4, 8)), workers=1)
print(store.folder.name, len(store.panoramas), count)
"""


@pytest.fixture
def paths(tmp_path) -> list[str]:
    """Images of a single grey level, which is their number."""
    (tmp_path / "images").mkdir()
    for i in range(IMAGES):
        cv2.imwrite(str(tmp_path / "images" / f"{i:02}.png"), np.full((*SIZE, 3), i, np.uint8))
    return sorted(str(path) for path in (tmp_path / "images").iterdir())


def build(paths: list[str], tmp_path: Path, *, image_size=SIZE, unwrap=None, **options) -> Store:
    preprocessing = Preprocessing.checked(image_size, unwrap)
    return open_store(paths, tmp_path / "cache", preprocessing, **{"workers": 2, **options})


def start(tmp_path: Path, mode: str) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", BUILD, str(tmp_path), mode], stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )


def names(folder: Path) -> list[str]:
    """Return the contents of a folder, without the lock files, which stay."""
    return sorted(path.name for path in folder.iterdir() if path.suffix != ".lock")


def assert_whole(store: Store) -> None:
    np.testing.assert_array_equal(store.panoramas[:, 0, 0, 0], np.arange(IMAGES))
    assert names(store.folder) == ["panoramas.npy", "store.json"]


@pytest.mark.parametrize("workers", [1, 5])
def test_a_store_holds_the_panoramas_of_the_images(paths, tmp_path, workers):
    store = build(paths, tmp_path, workers=workers)
    assert (store.panoramas.shape, store.panoramas.dtype) == ((IMAGES, 3, *SIZE), np.uint8)
    assert not store.panoramas.flags.writeable
    assert (store.kept.tolist(), store.rejected) == (list(range(IMAGES)), [])
    assert_whole(store)
    assert names(tmp_path / "cache") == [store.folder.name]
    np.testing.assert_array_equal(np.load(store.folder / "panoramas.npy"), store.panoramas)


def test_the_strict_stop_at_an_unreadable_image_and_everybody_where_none_is_readable(paths, tmp_path):
    Path(paths[3]).write_bytes(b"no image")
    for _ in range(2):
        with pytest.raises(DataError, match=r"03\.png cannot be read: .* not an image"):
            build(paths, tmp_path, on_error="raise")
        assert names(tmp_path / "cache") == []
    kept = build(paths, tmp_path).folder.name
    with pytest.raises(DataError, match=rf"1 of {IMAGES} images cannot be read.*03\.png"):
        build(paths, tmp_path, on_error="raise")
    for path in paths:
        Path(path).write_bytes(b"")
    with pytest.raises(DataError, match=rf"none of the {IMAGES} images can be read, the first: .*00\.png \(the"):
        build(paths, tmp_path)
    assert names(tmp_path / "cache") == [kept]


def test_the_key_is_made_of_files_and_preprocessing_only(paths, tmp_path):
    def key(some=paths, **options) -> str:
        return build(some, tmp_path, **options).folder.name

    keys = {
        "plain": key(),
        "fewer": key(paths[:2]),
        "order": key([paths[1], paths[0]]),
        "size": key(image_size=(8, 8)),
        "ring": key(unwrap=PolarRing(inner=1, outer=2)),
        "inner": key(unwrap=PolarRing(inner=0, outer=2)),
        "view": key(unwrap={"kind": "polar", "inner": 1, "outer": 2, "top": 10}),
    }
    os.utime(paths[0], ns=(1, 1))
    keys["time"] = key()
    with Path(paths[0]).open("ab") as file:
        file.write(b"\0")
    os.utime(paths[0], ns=(1, 1))
    keys["bytes"] = key()
    assert len(set(keys.values())) == len(keys)
    assert key(workers=1, on_error="raise") == keys["bytes"]


def test_the_key_of_a_list_of_files_stays_what_it_was(monkeypatch):
    """Otherwise every cache would be built again."""
    monkeypatch.chdir("/")
    ring = PolarRing(centre=(3.0, 4.0))
    assert store_key(["/nowhere/a.png"], Preprocessing.checked((128, 512))) == "5d2f937c80544ed2"
    assert store_key(["nowhere/a.png"], Preprocessing.checked((128, 512), ring)) == "d6f97a0a4d7dee41"


def test_images_of_sixteen_bits_are_decoded_again_where_others_show_that_they_use_more(tmp_path):
    def mean(some: list[str]) -> float:
        _bits_found.cache_clear()  # as in another process
        return float(open_store(some, tmp_path / "cache", Preprocessing.checked((4, 8))).panoramas[0].mean())

    paths = [str(tmp_path / f"{name}.png") for name in ("dark", "light")]
    cv2.imwrite(paths[0], np.full((*SIZE, 3), 1000, np.uint16))
    assert mean(paths[:1]) == 1000 >> 2
    cv2.imwrite(paths[1], np.full((*SIZE, 3), 4000, np.uint16))
    assert mean(paths[:1]) == 1000 >> 4


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
        lambda folder: (folder / "store.json").unlink(),
        lambda folder: (folder / "panoramas.npy").unlink(),
        cut,
        change(version=2),
        change(images=6),
        change(image_size=[8, 16]),
        change(rejected=[{"row": 99, "path": "", "reason": ""}]),
        lambda folder: (folder / "store.json").write_text("{"),
        lambda folder: (folder / "store.json").write_text("[]"),
        lambda folder: (folder / "panoramas.npy").write_bytes(b"no array"),
        lambda folder: np.save(folder / "panoramas.npy", np.zeros((IMAGES, 3, *SIZE), np.float32)),
    ],
)
def test_a_damaged_store_is_built_again(paths, tmp_path, caplog, damage):
    key = build(paths, tmp_path).folder.name
    damage(tmp_path / "cache" / key)
    missing = len(names(tmp_path / "cache" / key)) < 2
    with caplog.at_level(logging.WARNING, "siamloc"):
        store = build(paths, tmp_path)
    assert ("damaged or cut short; it is built again" in caplog.text) != missing
    assert_whole(store)
    assert names(tmp_path / "cache") == [key]


def test_a_store_that_vanished_cannot_be_unpickled(paths, tmp_path):
    store = build(paths, tmp_path)
    data = pickle.dumps(store)
    (store.folder / "store.json").unlink()
    with pytest.raises(DataError, match="gone or cut short"):
        pickle.loads(data)


def test_a_killed_build_leaves_nothing_that_is_taken_for_a_store(paths, tmp_path):
    with start(tmp_path, "pause") as process:
        assert process.stdout.readline() == "half way\n"
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
    left = names(tmp_path / "cache")
    assert all(name.startswith(".") for name in left)
    assert any(name.endswith(".tmp") for name in left), "the build was killed before it began to write"
    with start(tmp_path, "go") as process:
        assert process.communicate(timeout=60)[0].split()[1:] == [str(IMAGES), str(IMAGES)]
    assert_whole(store := build(paths, tmp_path))
    assert names(tmp_path / "cache") == [store.folder.name]


def test_of_two_builds_at_once_the_second_waits_and_takes_the_first_ones_result(paths, tmp_path):
    with start(tmp_path, "pause") as first:
        try:
            assert first.stdout.readline() == "half way\n"
            with start(tmp_path, "wait") as second:
                try:
                    assert "another process is building the store" in second.stderr.readline()
                    # A build of other paths leaves the work of the first alone.
                    build(paths[:1], tmp_path)
                    first_result, first_errors = first.communicate("go\n", timeout=60)
                    second_result, second_errors = second.communicate(timeout=60)
                finally:
                    second.kill()
        finally:
            first.kill()
    key = build(paths, tmp_path).folder.name
    assert first_result.split() == [key, str(IMAGES), str(IMAGES)], first_errors
    assert second_result.split() == [key, str(IMAGES), "0"], second_errors
    assert_whole(build(paths, tmp_path))
    assert not [name for name in names(tmp_path / "cache") if name.startswith(".")]


@pytest.mark.parametrize(
    ("error", "seen"),
    [
        (OSError(errno.ENOSPC, "full"), pytest.raises(StorageError, match=r"no space left .*: free some space")),
        (KeyboardInterrupt(), pytest.raises(KeyboardInterrupt)),
    ],
)
def test_a_build_that_stops_half_way_leaves_no_remains(paths, tmp_path, monkeypatch, error, seen):
    def some(work, items, threads):
        yield from map(work, items[:5])
        raise error

    monkeypatch.setattr("siamloc.data.store.in_order", some)
    with seen:
        build(paths, tmp_path)
    assert names(tmp_path / "cache") == []


@pytest.mark.parametrize("inside", [".", "cache"])
def test_a_cache_where_a_file_stands_is_an_error(paths, tmp_path, caplog, inside):
    (tmp_path / "cache").write_text("")
    with pytest.raises(StorageError, match=r"SIAMLOC_CACHE=FOLDER.* a file stands where a folder is needed"):
        build(paths, tmp_path / inside)
    assert "damaged" not in caplog.text
