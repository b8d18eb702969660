"""Thumbnails of the map frames, for people who watch the robot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.arrays import DAMAGE, read_arrays, write_arrays
from siamloc.errors import FormatError

if TYPE_CHECKING:
    from siamloc.data.frames import FrameTable
    from siamloc.data.library import PanoramaLibrary

_COLUMNS, _QUALITY = 256, 75


def read_thumbnails(path: Path) -> list[bytes | None]:
    """Read the thumbnails that `save_thumbnails` wrote: a JPEG for each map frame, None if its image was unreadable.

    Raises:
        FormatError: the file is damaged.
    """
    try:
        arrays = read_arrays(path)
        content, ends = arrays["jpeg"], arrays["ends"]
        lengths = np.diff(ends, prepend=0)
        fits = (content.dtype, ends.dtype, content.ndim, ends.ndim) == (np.uint8, np.int64, 1, 1)
        if not fits or (lengths < 0).any() or lengths.sum() != len(content):
            raise ValueError("arrays that do not fit together")
    except DAMAGE as error:
        raise FormatError(f"{path} holds no pictures, or not all of them: export again") from error
    return [content[end - length : end].tobytes() or None for length, end in zip(lengths, ends, strict=True)]


def save_thumbnails(path: str | Path, images: PanoramaLibrary, frames: FrameTable) -> None:
    """Write the thumbnails of frames to one npz file, atomically.

    Args:
        path: path of the file.
        images: panoramas of the frames.
        frames: n frames; unreadable ones get no thumbnail.

    Raises:
        DataError: a frame is not among the images.
        StorageError: the disk is full or cannot be written to.
    """
    rows = np.flatnonzero(frames.rows_in(images.readable(frames)) >= 0).tolist()
    pictures: list[bytes | None] = [None] * len(frames)
    panoramas = (panorama for batch in images.batches(frames.take(rows)) for panorama in batch)
    for row, panorama in zip(rows, panoramas, strict=True):
        pictures[row] = jpeg(panorama)
    write_thumbnails(path, pictures)


def write_thumbnails(path: str | Path, pictures: Sequence[bytes | None]) -> None:
    """Write thumbnails in the form in which `read_thumbnails` returns them to one npz file, atomically."""
    whole = [picture or b"" for picture in pictures]
    ends = np.cumsum([len(picture) for picture in whole], dtype=np.int64)
    write_arrays(path, {}, {"jpeg": np.frombuffer(b"".join(whole), dtype=np.uint8), "ends": ends})


def jpeg(panorama: NDArray[np.uint8], columns: int = _COLUMNS) -> bytes:
    """Return a panorama (3, H, W), uint8, RGB, as a JPEG of at most `columns` columns."""
    picture = np.ascontiguousarray(panorama[::-1].transpose(1, 2, 0))
    height, width = picture.shape[:2]
    if width > columns:
        size = (columns, max(1, round(height * columns / width)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
