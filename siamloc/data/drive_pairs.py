"""Pairs of frames of one drive whose images are worth comparing, and how the robot drives between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.data.moves import way_along
from siamloc.data.trajectory import Array

_REACHES = (0.0, 0.4, 0.8, 1.6)  # moves to the first frame that is this far along the drive, in the unit of x and y
_GAPS = (1, 2, 4)  # moves to the frame that is this many later in the drive, without poses
_FARTHEST = 4.0  # longest move
_MOST = 400  # pairs of frames
_STILL = 0.05  # of the median step: a robot that moves less does not show where it is heading
_NONE = np.zeros((0, 2), dtype=np.int64)


def near_pairs(frames: FrameTable) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows of pairs of frames of one drive, near each other, in both orders.

    Both orders, because a network that always says the same, whatever it sees, must not pass for a constant yaw.
    """
    found = [_NONE]
    for rows in frames.rows_by("sequence").values():
        rows = rows[np.isfinite(frames.theta[rows]) & frames.has_position[rows]]
        along = way_along(frames.xy[rows])
        for reach in _REACHES:
            after = np.maximum(np.searchsorted(along, along + reach), np.arange(len(rows)) + 1)
            inside = after < len(rows)
            found.append(np.column_stack([rows[inside], rows[after[inside]]]))
    pairs = np.unique(np.concatenate(found), axis=0)
    near = np.hypot(*(frames.xy[pairs[:, 1]] - frames.xy[pairs[:, 0]]).T) < _FARTHEST
    return _both_orders(pairs[near])


def successive_pairs(frames: FrameTable) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows of pairs of frames that follow each other in a drive, in both orders, where poses are unknown."""
    drives = frames.rows_by("sequence").values()
    found = [np.column_stack([rows[:-n], rows[n:]]) for rows in drives for n in _GAPS]
    return _both_orders(np.concatenate([_NONE, *found]))


def _both_orders(pairs: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    chosen = np.random.default_rng(0).permutation(len(pairs))[: _MOST // 2]  # of all reaches alike
    pairs = pairs[np.sort(chosen)]
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    return first, second


def travel(frames: FrameTable) -> Array:
    """Return the direction of travel in rad at each frame (n,), NaN without a position or a move."""
    theta = np.full(len(frames), np.nan)
    for rows in frames.rows_by("sequence").values():
        rows = rows[frames.has_position[rows]]
        if len(rows) > 1:
            x, y = np.gradient(frames.x[rows]), np.gradient(frames.y[rows])
            moves = np.hypot(x, y) > _STILL * np.median(np.hypot(x, y))
            theta[rows] = np.where(moves, np.arctan2(y, x), np.nan)
    return theta


def ahead(seen: Array, onwards: NDArray[np.bool_]) -> Array:
    """Return the moves (p, 3) of a robot that drives ahead, or back where not `onwards`, along arcs.

    The arcs are as long and as curved as the moves in the images, `seen` (p, 3).
    """
    length, turned = np.hypot(seen[:, 0], seen[:, 1]) * np.where(onwards, 1, -1), seen[:, 2]
    return np.column_stack([length * np.cos(turned / 2), length * np.sin(turned / 2), turned])
