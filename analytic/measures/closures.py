"""Precision and recall of loop closures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.arrays import Floats, Integers
from analytic.clustering import checks
from analytic.errors import AnalyticError
from foundation.settings import Count, NotNegative, checked


@dataclass(frozen=True)
class ClosureScores:
    """How many loop closures are right, and how many revisits they close.

    Attributes:
        precision: right closures / counted closures; NaN if there are none.
        recall: revisits that a right closure joins to an earlier frame / revisits; NaN if there are none.
        f1: harmonic mean of both; 0 if revisits exist and none was closed, NaN if there are none.
        right: closures within the radius.
        closures: closures counted: distinct pairs of frames, at least `gap` apart.
        closed: revisits that were closed.
        revisits: frames with an earlier frame, at least `gap` before, within the radius.
        trivial: distinct pairs of frames less than `gap` apart, left out of everything.
        radius: radius used, inclusive, in the positions' unit.
        gap: gap used, in frames.
    """

    precision: float
    recall: float
    f1: float
    right: int
    closures: int
    closed: int
    revisits: int
    trivial: int
    radius: float
    gap: int


def closure_scores(closures: ArrayLike, positions: ArrayLike, radius: float, gap: int = 30) -> ClosureScores:
    """Measure precision, recall and F1 of loop closures.

    A closure joins two frames, in either order, and counts once however often it is listed. It is right when their
    positions are within the radius. Frames less than `gap` frames apart are close to each other anyway: a closure
    between them is trivial and does not count. A frame is a revisit if a frame at least `gap` frames earlier lies
    within the radius; it is closed if it is the later frame of a right closure, so recall is at most 1.

    Args:
        closures: rows of `positions`, in pairs (m, 2); m may be 0.
        positions: positions of the frames in the order of capture (n, 2).
        radius: largest distance of a right closure, in the positions' unit, not negative.
        gap: frames that a closure must span, at least 1.

    Raises:
        AnalyticError: wrong shapes, positions that are not finite, frames that do not exist, a closure of a frame with
            itself, a radius or gap out of range.

    Examples:
        >>> found = closure_scores([(0, 3), (0, 2)], [[0, 0], [5, 0], [9, 0], [0.2, 0]], radius=0.5, gap=2)
        >>> found.precision, found.recall
        (0.5, 1.0)
    """
    xy = checks.vectors(positions, "positions")
    gap = int(checked(gap, Count, "the gap", AnalyticError))
    checked(radius, NotNegative, "the radius", AnalyticError)
    ends = _checked(closures, len(xy))
    nontrivial = ends[ends[:, 1] - ends[:, 0] >= gap]
    # Both use the same comparison, so that a frame exactly at the radius is judged the same way.
    near = _within(xy[nontrivial[:, 0]] - xy[nontrivial[:, 1]], radius)
    revisits = _revisits(xy, radius, gap)
    right, revisited, closed = int(near.sum()), int(revisits.sum()), len(np.unique(nontrivial[near, 1]))
    precision = right / len(nontrivial) if len(nontrivial) else math.nan
    recall = closed / revisited if revisited else math.nan
    return ClosureScores(
        precision=precision,
        recall=recall,
        f1=2 * precision * recall / (precision + recall) if recall else 0.0,
        right=right,
        closures=len(nontrivial),
        closed=closed,
        revisits=revisited,
        trivial=len(ends) - len(nontrivial),
        radius=float(radius),
        gap=gap,
    )


def _revisits(xy: Floats, radius: float, gap: int) -> NDArray[np.bool_]:
    found = np.zeros(len(xy), dtype=bool)
    for rows in checks.row_slices(len(xy), len(xy) * xy.shape[1]):
        if rows.stop <= gap:
            continue
        earlier = xy[: rows.stop - gap]
        near = _within(earlier[None] - xy[rows, None], radius)
        old_enough = np.arange(len(earlier)) <= np.arange(rows.start, rows.stop)[:, None] - gap
        found[rows] = (near & old_enough).any(axis=1)
    return found


def _within(difference: Floats, radius: float) -> NDArray[np.bool_]:
    return np.sqrt((difference**2).sum(axis=-1)) <= radius


def _checked(closures: ArrayLike, frames: int) -> Integers:
    """Return the distinct closures, the earlier frame first (m, 2)."""
    ends = np.asarray(closures)
    if not ends.size:
        return np.zeros((0, 2), dtype=np.int64)
    if ends.ndim != 2 or ends.shape[1] != 2 or ends.dtype.kind not in "iu":
        raise AnalyticError(f"closures must be whole numbers of shape (m, 2), got {ends.dtype} of shape {ends.shape}")
    if ends.min() < 0 or ends.max() >= frames:
        raise AnalyticError(f"closures must be of frames from 0 to {frames - 1}, got {ends.min()} to {ends.max()}")
    ends = np.sort(ends.astype(np.int64), axis=1)
    if (ends[:, 0] == ends[:, 1]).any():
        raise AnalyticError("a closure joins two different frames, but one has the same frame twice")
    return np.unique(ends, axis=0)
