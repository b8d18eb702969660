"""Where in a map of several buildings the frames of a drive were taken: their buildings and nearest map frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.maps.matching import learned_distances
from siamloc.maps.search import slices
from siamloc.maps.visual_map import VisualMap

_AROUND = 15  # frames of a drive before and after one that tell with it on which floor it was taken
_AT_ONCE = 64  # frames whose descriptors are compared with all map frames


def buildings_of(known: VisualMap, drive: VisualMap, reach: float) -> NDArray[np.str_]:
    """Return the building of each frame of a drive in a map (n,).

    It is the one that the frame states, if the map has frames of it, else that of the nearest map frame. Where
    buildings lie over each other, as the floors of a house do, it is the one whose nearest map frame looks most like
    the frame, summed over the frames before and after it in the drive.

    Args:
        known: a map with frames that have positions.
        drive: n frames with positions, described as the map was.
        reach: buildings lie over each other where their nearest map frames differ by at most this distance.
    """
    held, frames = known.frames, drive.frames
    names = np.unique(held.building[held.has_position])
    if len(names) == 1:
        return np.repeat(names, len(frames))
    own = [np.flatnonzero(held.has_position & (held.building == name)) for name in names]
    rows = np.stack([of[nearest(held.take(of), frames)] for of in own], axis=1)
    apart = np.hypot(*(held.xy[rows] - frames.xy[:, None]).transpose(2, 0, 1))
    unlike = np.empty(rows.shape)
    for part in slices(len(frames), _AT_ONCE):
        unlike[part] = np.take_along_axis(learned_distances(known, drive.turning(part)), rows[part], axis=1)
    for of in frames.rows_by("sequence").values():
        for column in unlike.T:
            column[of] = np.convolve(column[of], np.ones(2 * _AROUND + 1))[_AROUND : _AROUND + len(of)]
    unlike[apart > apart.min(axis=1, keepdims=True) + reach] = np.inf
    return np.where(np.isin(frames.building, names), frames.building, names[unlike.argmin(axis=1)])


def nearest(known: FrameTable, drive: FrameTable) -> NDArray[np.int64]:
    """Return the row of the nearest map frame that has a position, for each frame of a drive (n,).

    Of the frame's own building, where the map has frames of it.
    """
    found, placed, xy = np.zeros(len(drive), dtype=np.int64), known.has_position, known.xy
    for row, (here, building) in enumerate(zip(drive.xy, drive.building, strict=True)):
        own = placed & (known.building == building)
        apart = np.square(xy - here).sum(axis=1)
        found[row] = np.nanargmin(np.where(own, apart, np.nan) if own.any() else apart)
    return found
