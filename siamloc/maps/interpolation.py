"""Poses between map frames: the mean of the nearest ones by descriptor, weighted by inverse distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.columns import Rows
from foundation.settings import Count, NotNegative, Positive
from siamloc.data.frames import FrameTable
from siamloc.errors import DataError
from siamloc.maps.search import Retrieval


@dataclass(frozen=True, eq=False)
class Poses(Rows):
    """Estimated poses.

    Attributes:
        xy: (n, 2) positions.
        theta: (n,) headings in rad, in (-pi, pi]; None if no headings were given, NaN where the headings of the map
            frames used are unknown.
        used: (n,) number of map frames averaged into each pose.
    """

    xy: NDArray[np.float64]
    theta: NDArray[np.float64] | None
    used: NDArray[np.int64]


def path_positions(frames: FrameTable) -> NDArray[np.float64]:
    """Return how far along the path of its sequence each frame lies (m,), 0 for the first of each sequence.

    Raises:
        DataError: a frame without a position.
    """
    if not frames.has_position.all():
        raise DataError(
            f"{int((~frames.has_position).sum())} of {len(frames)} map frames have no position: there is no path "
            "along which to interpolate"
        )
    along = np.zeros(len(frames))
    for rows in frames.rows_by("sequence").values():
        along[rows[1:]] = np.cumsum(np.hypot(np.diff(frames.x[rows]), np.diff(frames.y[rows])))
    return along


@typed
def interpolate_poses(
    found: Retrieval,
    frames: FrameTable,
    k: Count = 3,
    radius: NotNegative = 1.0,
    headings: ArrayLike | None = None,
    epsilon: Positive = 1e-6,
) -> Poses:
    """Return poses between the k nearest map frames of each query.

    A frame at descriptor distance d has the weight 1 / (d + epsilon). Only frames within a radius of the nearest one,
    measured along the map's own path, count: a frame behind a wall, or one elsewhere that looks alike, would pull the
    mean to a place where the robot cannot be. Headings are averaged as directions.

    Args:
        found: result of the search, at least min(k, m) neighbours of n queries.
        frames: the map's frames (m), in capture order within each sequence, all with positions.
        k: largest number of neighbours used; 1 gives the nearest frame's position exactly.
        radius: along the path, in units of x and y, not negative; 0 leaves only frames at the nearest one's position.
        headings: (n, k or more) heading of the query according to each neighbour, rad; NaN where there is none.
        epsilon: keeps the weight of an identical descriptor finite, positive.

    Raises:
        ConfigError: k, radius or epsilon out of range.
        DataError: too few neighbours, rows outside the map, headings of another shape, or a frame without a position.
    """
    k = min(k, len(frames))
    rows = found.indices
    if rows.shape[1] < k or (rows.size and not 0 <= rows.min() <= rows.max() < len(frames)):
        raise DataError(
            f"interpolation needs {k} neighbours a query, rows 0 to {len(frames) - 1} of the map, got shape "
            f"{rows.shape}"
        )
    near, apart = rows[:, :k], found.distances[:, :k]
    along, best = path_positions(frames), near[:, :1]
    inside = (np.abs(along[near] - along[best]) <= radius) & (frames.sequence[near] == frames.sequence[best])
    weight = np.where(inside, 1 / (apart + epsilon), 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    # Offsets from the nearest frame: for a single frame they are zero, so its position is reproduced to the last bit.
    xy = frames.xy[best[:, 0]] + np.einsum("nk,nkc->nc", weight, frames.xy[near] - frames.xy[best])
    theta = None if headings is None else _mean_heading(weight, headings, k)
    return Poses(xy, theta, (weight > 0).sum(axis=1))


def _mean_heading(weight: NDArray[np.float64], headings: ArrayLike, k: int) -> NDArray[np.float64]:
    angle = np.asarray(headings, dtype=np.float64)
    if angle.ndim != 2 or len(angle) != len(weight) or angle.shape[1] < k:
        raise DataError(f"{len(weight)} queries need headings by {k} neighbours, got shape {angle.shape}")
    angle = angle[:, :k]
    known = np.isfinite(angle) & (weight > 0)
    weight, angle = np.where(known, weight, 0.0), np.where(known, angle, 0.0)
    # Relative to the first known heading, so that a single one is reproduced to the last bit.
    first = np.take_along_axis(angle, known.argmax(axis=1)[:, None], axis=1)
    turned = angle - first
    mean = np.arctan2((weight * np.sin(turned)).sum(axis=1), (weight * np.cos(turned)).sum(axis=1))
    return np.where(known.any(axis=1), _wrapped(first[:, 0] + mean), np.nan)


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles in (-pi, pi]; those already in this range are unchanged."""
    inside = (angle > -np.pi) & (angle <= np.pi)
    return np.where(inside, angle, np.pi - np.remainder(np.pi - angle, 2 * np.pi))
