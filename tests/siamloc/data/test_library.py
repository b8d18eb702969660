from __future__ import annotations

import json
import logging
import os
import pickle
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import analytic
import siamloc
from siamloc.data import FrameTable, PanoramaLibrary, PolarRing
from siamloc.errors import ConfigError, DataError, FormatError

SIZE = (8, 16)


@pytest.fixture
def frames(tmp_path) -> FrameTable:
    """Eight frames of two interleaved drives; the image of frame i is i * 30 in red, 255 - i * 30 in green."""
    (tmp_path / "images").mkdir()
    paths = [tmp_path / "images" / f"{i}.png" for i in range(8)]
    for i, path in enumerate(paths):
        cv2.imwrite(str(path), picture(i))
    return FrameTable(
        path=[str(path) for path in paths], room=list("aabbcccc"), x=np.arange(8.0), sequence=["monday", "tuesday"] * 4
    )


def picture(i: int) -> np.ndarray:
    image = np.zeros((*SIZE, 3), np.uint8)
    image[..., 0] = np.random.default_rng(i).integers(0, 256, SIZE)
    image[..., 1], image[..., 2] = 255 - i * 30, i * 30
    return image


def expected(*numbers: int) -> np.ndarray:
    return np.array([picture(i)[..., ::-1].transpose(2, 0, 1) for i in numbers]).reshape(-1, 3, *SIZE)


def open_library(frames: FrameTable, tmp_path: Path, **options) -> PanoramaLibrary:
    return PanoramaLibrary(frames, tmp_path / "cache", **{"image_size": SIZE, **options})


def test_pictures_of_all_drives_are_scaled_to_the_size_of_most_in_whose_pixels_the_ring_counts(tmp_path, caplog):
    small = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (96, 144, 3), np.uint8), (0, 0), 4)
    pictures = [small, cv2.resize(small, (288, 192)), cv2.resize(small, (96, 144)), small]
    paths = [tmp_path / f"{number}.bmp" for number in range(4)]
    for path, one in zip(paths, pictures, strict=True):
        cv2.imwrite(str(path), one)
    drives = FrameTable(path=paths, sequence=["monday"] * 3 + ["tuesday"])
    library = open_library(drives, tmp_path, unwrap=PolarRing(centre=(71.5, 47.5), inner=10, outer=40))
    first, *others = library.batch([0, 1, 2]).astype(int)
    assert max(np.abs(first - other).mean() for other in others) < 2
    assert library.sizes == {"monday": (96, 144), "tuesday": (96, 144)}
    assert "have 288 x 192 px, and the camera's parameters count in those of 144 x 96: they are scaled" in caplog.text
    (rejected,) = library.rejected
    assert rejected["reason"].startswith("the picture has 96 x 144 px, and the camera's parameters count in those of")
    known = siamloc.maps.build(analytic.descriptor("thumbnail", columns=16), library, library.frames, progress=False)
    alone = open_library(drives.take([1]), tmp_path, unwrap=PolarRing(centre=(71.5, 47.5), inner=10, outer=40))
    with pytest.raises(ConfigError, match="in the map's pictures of 144 x 96 px, and these have 288 x 192 px"):
        known.check_images(alone.preprocessing.parameters(), alone.preprocessing.size)


def test_interleaved_drives_give_their_own_images(frames, tmp_path, monkeypatch):
    """The rows of a table whose drives alternate are not those of a table sorted by drive."""
    library = open_library(frames, tmp_path)
    assert library.frames == frames
    assert library.rejected == []
    assert len(list((tmp_path / "cache").glob("*/panoramas.npy"))) == 2
    assert repr(library).startswith(f"PanoramaLibrary(8 panoramas of 8 x 16 px in {tmp_path / 'cache'}; 8 frames; ")
    assert "\n" not in repr(library)
    monkeypatch.chdir(tmp_path)
    relative = frames.with_columns(path=[os.path.relpath(path) for path in frames.path.tolist()])
    for part, numbers in [
        (frames, range(8)),
        (relative.take(np.arange(8)[::-1]), [7, 6, 5, 4, 3, 2, 1, 0]),
        (frames.select(sequence="monday"), [0, 2, 4, 6]),
        (frames.select(sequence="tuesday").every(2), [1, 5]),
        (library.frames.take([7, 0, 7]), [7, 0, 7]),
        (frames.select(sequence="monday").select(room="c").with_columns(x=[9, 9]), [4, 6]),
    ]:
        assert library.rows(part).tolist() == list(numbers)
        np.testing.assert_array_equal(np.concatenate(list(library.batches(part, size=3))), expected(*numbers))
    assert not list(library.batches(frames.take([])))


def test_one_image_in_two_drives_is_two_frames(frames, tmp_path):
    both = frames.with_columns(path=[frames.path[0]] * 8)
    library = open_library(both.take([0, 1]), tmp_path)
    assert library.rows(both.take([1, 0, 1])).tolist() == [1, 0, 1]
    with pytest.raises(DataError, match=r"1 of 1 frames are not among those .*0\.png of sequence 'friday'"):
        library.rows(both.take([0]).with_columns(sequence=["friday"]))
    with pytest.raises(DataError, match="not among those that the library was made from"):
        library.readable(frames.take([2]))


def test_unreadable_images_are_left_out_and_named(frames, tmp_path, caplog):
    Path(frames.path[0]).write_bytes(b"")
    Path(frames.path[3]).unlink()
    with caplog.at_level(logging.WARNING, "siamloc"):
        library = open_library(frames, tmp_path)
    assert "1 of 4 images cannot be read, the first: " in caplog.text
    assert library.rejected == [
        {"path": frames.path[0], "reason": "the file is empty"},
        {"path": frames.path[3], "reason": "the file does not exist"},
    ]
    assert library.frames == frames.take([1, 2, 4, 5, 6, 7])
    assert open_library(frames, tmp_path).rejected == library.rejected
    assert library.readable(frames.take([7, 3, 2])) == frames.take([7, 2])
    np.testing.assert_array_equal(library.batch(library.rows(frames.take([7, 2]))), expected(7, 2))
    with pytest.raises(DataError, match=r"1 of 2 frames have no panorama, .*3\.png \(the file does not exist\): leave"):
        library.rows(frames.take([1, 3]))


@pytest.mark.parametrize("rows", [[0, 8], [-1], [0.5], 3])
def test_rows_outside_the_library(frames, tmp_path, rows):
    says = f"rows must be whole numbers (B,), of the library's 0 ... 7, got {rows}"
    with pytest.raises(IndexError, match=re.escape(says)):
        open_library(frames, tmp_path).batch(rows)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"on_error": "ignore"}, "on_error must be skip or raise, got 'ignore'"),
        ({"image_size": (0, 16)}, "image_size must be"),
        ({"unwrap": {"kind": "polar", "iner": 3}}, "unknown key unwrap.iner: did you mean 'inner'"),
    ],
)
def test_impossible_options(frames, tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        open_library(frames, tmp_path, **options)
    with pytest.raises(DataError, match="the table is empty"):
        open_library(frames.take([]), tmp_path)


@pytest.mark.parametrize(
    "unwrap",
    [
        None,
        {"kind": "none"},
        PolarRing(inner=1, outer=3),
        {"kind": "polar", "inner": 1, "outer": 3, "centre": [8, 4]},
        {"kind": "hyperbolic", "top": 20.0, "cx": 8.0, "fx": 8.0, "fy": 8.0, "cy": 3.5},
    ],
)
def test_the_settings_make_the_same_library_again(frames, tmp_path, unwrap):
    library = open_library(frames, tmp_path, unwrap=unwrap, circular=False, on_error="raise")
    settings = library.settings()
    again = PanoramaLibrary(frames, **json.loads(json.dumps(settings)))
    assert (again.settings(), again.preprocessing) == (settings, library.preprocessing)
    assert (again.circular, again.image_size) == (False, SIZE)
    np.testing.assert_array_equal(again.batch([7]), library.batch([7]))


def test_where_panoramas_are_kept_unless_told(frames, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SIAMLOC_CACHE", raising=False)
    PanoramaLibrary(frames.take([0]), image_size=SIZE)
    assert list((tmp_path / ".siamloc" / "panoramas").glob("*/store.json"))
    monkeypatch.setenv("SIAMLOC_CACHE", "elsewhere")
    library = PanoramaLibrary(frames.take([0]), image_size=SIZE)
    assert library.settings()["cache"] == str(tmp_path / "elsewhere")
    assert list((tmp_path / "elsewhere").glob("*/store.json"))


def test_the_library_survives_pickling_without_its_bytes(frames, tmp_path):
    Path(frames.path[3]).unlink()
    library = open_library(frames, tmp_path, image_size=(128, 512))
    data = pickle.dumps(library)
    assert len(data) < len(library) * 3 * 128 * 512 / 50
    again = pickle.loads(data)
    np.testing.assert_array_equal(again.batch([5, 0]), library.batch([5, 0]))
    assert (again.frames, again.rejected) == (library.frames, library.rejected)


@pytest.mark.parametrize(
    ("images", "unwrap", "advice"),
    [("panorama", {"kind": "polar"}, "use unwrap=none"), ("omnidirectional", None, "use unwrap=hyperbolic, or sim")],
)
def test_simulated_images_are_not_unwrapped_by_mistake(frames, tmp_path, images, unwrap, advice):
    (tmp_path / "camera.json").write_text(json.dumps({"images": images}))
    with pytest.raises(ConfigError, match=f"simulated images of kind {images}, which .* does not fit: {advice}"):
        open_library(frames, tmp_path, unwrap=unwrap)
    for other in ([], 5, None, "panorama", {"images": [images]}):
        (tmp_path / "camera.json").write_text(json.dumps(other))
        with pytest.raises(FormatError, match=r"camera.json must be a mapping .*: simulate again, or rename the file"):
            open_library(frames, tmp_path, unwrap=unwrap)
