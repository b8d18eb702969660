"""Thumbnails of the map frames, for people who watch the robot."""

from __future__ import annotations

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


class Thumbnails:
    """JPEG thumbnails by row of the map.

    Args:
        path: of the file that `save_thumbnails` wrote.

    Raises:
        FormatError: the file is damaged.
    """

    def __init__(self, path: Path) -> None:
        try:
            arrays = read_arrays(path)
            self._bytes, self._ends = arrays["jpeg"], arrays["ends"]
            right = self._bytes.dtype == np.uint8 and self._ends.dtype == np.int64 and self._bytes.ndim == 1
            steps = np.diff(self._ends, prepend=0)
            if not right or self._ends.ndim != 1 or (steps < 0).any() or steps.sum() != len(self._bytes):
                raise ValueError("arrays that do not fit together")
        except DAMAGE as error:
            raise FormatError(f"{path} holds no pictures, or not all of them: export again") from error

    def __len__(self) -> int:
        return len(self._ends)

    def __getitem__(self, row: int) -> bytes | None:
        """Return the thumbnail of a map frame; None if its image could not be read."""
        begin = int(self._ends[row - 1]) if row else 0
        return self._bytes[begin : int(self._ends[row])].tobytes() or None


def save_thumbnails(path: str | Path, images: PanoramaLibrary, frames: FrameTable) -> None:
    """Write the thumbnails of frames to one npz file, atomically.

    Args:
        path: of the file.
        images: panoramas of the frames.
        frames: n frames; those that cannot be read get none.

    Raises:
        DataError: a frame is not among the images.
        StorageError: the disk is full or cannot be written to.
    """
    readable = set(images.readable(frames).identities())
    rows = [row for row, key in enumerate(frames.identities()) if key in readable]
    pictures = [b""] * len(frames)
    at = iter(rows)
    for batch in images.batches(frames.take(rows)):
        for panorama in batch:
            pictures[next(at)] = jpeg(panorama)
    ends = np.cumsum([len(picture) for picture in pictures], dtype=np.int64)
    write_arrays(path, {}, {"jpeg": np.frombuffer(b"".join(pictures), dtype=np.uint8), "ends": ends})


def jpeg(panorama: NDArray[np.uint8], columns: int = _COLUMNS) -> bytes:
    """Return a panorama (3, H, W), uint8, RGB, as a JPEG of at most `columns` columns."""
    picture = np.ascontiguousarray(panorama[::-1].transpose(1, 2, 0))
    height, width = picture.shape[:2]
    if width > columns:
        size = (columns, max(1, round(height * columns / width)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
