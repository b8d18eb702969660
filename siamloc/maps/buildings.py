"""Where in a map of several buildings the frames of a drive were taken: their buildings and nearest map frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.maps.matching import learned_distances
from siamloc.maps.search import slices
from siamloc.maps.visual_map import VisualMap

_REACH = 3.0  # times the radius: buildings lie over each other where their map frames differ by at most this distance
_CHANGE = 3.0  # what a change of floors costs, in units of how unlike map frames of the right floor usually look
_AT_ONCE = 64  # frames that are compared with the map frames around them


def buildings_of(known: VisualMap, drive: VisualMap, radius: float = 1.0) -> NDArray[np.str_]:
    """Return the building of each frame of a drive in a map (n,).

    It is the one that the frame states, or all frames of its drive that state any, if the map has frames of it; else
    that of the nearest map frame. Where buildings lie over each other, as the floors of a house do, the frames around
    there that look most like those of the drive tell the floor, for all of the drive at once: it changes floors only
    where enough frames say so.

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
    unlike, least = np.zeros((len(drive), len(names))), list[NDArray[np.float64]]()
    for part in (asked[part] for part in slices(len(asked), _AT_ONCE)):
        xy = drive.frames.xy[part]
        apart = np.hypot(xy[:, :1] - known.frames.x, xy[:, 1:] - known.frames.y)
        around = apart <= apart.min(axis=1, keepdims=True) + _REACH * radius
        of = np.stack([around & (number == one) for one in range(len(names))])
        unlike[part] = np.where(of.any(axis=2).T, 0.0, np.inf)
        some = np.isfinite(unlike[part]).sum(axis=1) > 1
        if some.any():
            rows = np.flatnonzero(around[some].any(axis=0))
            distances = learned_distances(known.take(rows), drive.turning(part[some]))
            unlike[part[some]] = np.where(of[:, some][:, :, rows], distances, np.inf).min(axis=2).T
            least.append(unlike[part[some]].min(axis=1))
    usual = float(np.median(np.concatenate(least))) if least else 0.0
    for of in drives:
        of = of[building[of] == ""]
        building[of] = names[_cheapest(unlike[of], _CHANGE * usual)]
    return building.astype(np.str_)


def _cheapest(costs: NDArray[np.float64], change: float) -> NDArray[np.int64]:
    """Return which of b columns to be in at each of n rows (n,), where each costs (n, b), and so does each change."""
    best, came = np.zeros(costs.shape[1]), list[NDArray[np.int64]]()
    for cost in costs:
        first = best.argmin()
        came.append(np.where(best > best[first] + change, first, np.arange(len(best))))
        best = np.minimum(best, best[first] + change) + cost
    path = [int(best.argmin())]
    for before in came[:0:-1]:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1])


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
