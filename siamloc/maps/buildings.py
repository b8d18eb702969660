"""Where in a map of several buildings the frames of a drive were taken: their buildings and nearest map frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.maps.matching import learned_distances
from siamloc.maps.search import slices
from siamloc.maps.visual_map import VisualMap

_REACH = 3.0  # times the radius: buildings lie over each other where their map frames differ by at most this distance
_AROUND = 15  # frames of a drive before and after one that are judged together with it
_AT_ONCE = 64  # frames that are compared with the map frames around them


def buildings_of(known: VisualMap, drive: VisualMap, radius: float = 1.0) -> NDArray[np.str_]:
    """Return the building of each frame of a drive in a map (n,).

    It is the one that the frame states, or all frames of its drive that state any, if the map has frames of it; else
    that of the nearest map frame. Where buildings lie over each other, as the floors of a house do, it is the one whose
    frames around there look most like the drive, summed over 15 frames before and after: where a drive changes floors
    is known no better than that.

    Args:
        known: a map with frames that have positions.
        drive: n frames with positions, described as the map was.
        radius: distance within which frames show the same place, in the unit of the positions.
    """
    known = known.take(known.frames.has_position)
    names, number = np.unique(known.frames.building, return_inverse=True)
    building = np.where(np.isin(drive.frames.building, names), drive.frames.building, "").astype(object)
    drives = drive.frames.rows_by("sequence").values()
    for of in drives:
        if len(stated := set(building[of]) - {""}) == 1:
            building[of] = stated.pop()
    asked = np.flatnonzero(building == "")
    if len(names) == 1 or not len(asked):
        building[asked] = names[0]
        return building.astype(np.str_)
    there, unlike = np.zeros((len(drive), len(names)), dtype=bool), np.zeros((len(drive), len(names)))
    for part in (asked[part] for part in slices(len(asked), _AT_ONCE)):
        xy = drive.frames.xy[part]
        apart = np.hypot(xy[:, :1] - known.frames.x, xy[:, 1:] - known.frames.y)
        around = apart <= apart.min(axis=1, keepdims=True) + _REACH * radius
        of = np.stack([around & (number == one) for one in range(len(names))])
        there[part] = of.any(axis=2).T
        if (there[part].sum(axis=1) > 1).any():
            rows = np.flatnonzero(around.any(axis=0))
            distances = learned_distances(known.take(rows), drive.turning(part))
            least = np.where(of[:, :, rows], distances, np.inf).min(axis=2).T
            unlike[part] = np.where(there[part], least, np.where(there[part], least, 0).max(axis=1, keepdims=True))
    for of in drives:
        for column in unlike.T:
            column[of] = np.convolve(column[of], np.ones(2 * _AROUND + 1))[_AROUND : _AROUND + len(of)]
    unlike[~there] = np.inf
    building[asked] = names[unlike[asked].argmin(axis=1)]
    return building.astype(np.str_)


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
