"""Notes on the frames of a run, for recognizing them wherever their files are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from foundation.files import content_key
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary

_PICTURES = 8  # examined, spread over the frames
_CELLS = (8, 4)  # columns and rows of their thumbnails
_TOLERANCE = 6  # grey levels in a thumbnail, by which decoders and copies of different quality differ
# The parts of a note in the order of comparison, with their messages.
_WORDS = {
    "names": "the {role} frames differ (sequences and file names)",
    "positions": "the positions of the {role} frames differ",
    "labels": "the labels of the {role} frames differ (room, building or lighting)",
}


def note_frames(images: PanoramaLibrary, frames: FrameTable) -> dict[str, Any]:
    """Describe frames for the record: their number, keys of their columns, and thumbnails of some panoramas.

    Args:
        images: decoded panoramas of all frames.
        frames: some of them.

    Returns:
        Plain values; `pictures` holds the thumbnails as hexadecimal digits.
    """
    names = [frames.sequence, [Path(path).name for path in frames.path.tolist()]]
    rows = np.unique(np.linspace(0, len(frames) - 1, _PICTURES).round().astype(np.int64))
    panoramas = images.batch(images.rows(frames.take(rows)))
    thumbnails = [cv2.resize(np.moveaxis(one, 0, -1), _CELLS, interpolation=cv2.INTER_AREA) for one in panoramas]
    return {
        "count": len(frames),
        "names": content_key(names),
        "positions": content_key([frames.xy]),
        "labels": content_key([frames.room, frames.building, frames.lighting]),
        "pictures": np.stack(thumbnails).tobytes().hex(),
    }


def differing_frames(before: Mapping[str, Any] | None, now: Mapping[str, Any] | None, role: str) -> str | None:
    """Describe how frames differ from those of an earlier note; None if they are the same.

    Parts that one of the notes lacks are not compared.

    Args:
        before: earlier result of `note_frames`; None if there were no frames of this role.
        now: current result of it.
        role: "training" or "validation".

    Example:
        >>> differing_frames({"count": 12}, {"count": 6}, "training")
        'there were 12 training frames, and now there are 6'
    """
    counts = [0 if note is None else note["count"] for note in (before, now)]
    if counts[0] != counts[1]:
        return f"there were {counts[0]} {role} frames, and now there are {counts[1]}"
    if before is None or now is None:
        return None
    for part, words in _WORDS.items():
        if before[part] != now[part]:
            return words.format(role=role)
    if not _alike(before["pictures"], now["pictures"]):
        return f"the images of the {role} frames differ (their file names and labels are the same)"
    return None


def _alike(before: str, now: str) -> bool:
    """Compare thumbnails, which may differ slightly between decoders."""
    if len(before) != len(now):
        return False
    values = [np.frombuffer(bytes.fromhex(text), np.uint8).astype(np.int64) for text in (before, now)]
    return bool((np.abs(values[0] - values[1]) <= _TOLERANCE).all())
