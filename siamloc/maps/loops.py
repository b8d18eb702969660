"""Loops: pairs of frames that show one place, though the robot drove a long way between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.moves import composed, relative, wrapped
from siamloc.errors import DataError
from siamloc.maps.comparing import ODDS, agree
from siamloc.maps.joining import FREEDOM
from siamloc.maps.pose_graph import Array, Edges
from siamloc.maps.search import slices

_NEIGHBOURHOOD = 3  # frames on either side within which loops must agree
_AGREE = 2  # number of other loops that must agree with a loop
_CONTRADICTED = 0.15  # weight below which a loop is refused
_CONFIRMED = 0.5  # weight from which on a refused loop is accepted
_CLOSER = 0.75  # a solution follows from many measurements, so it agrees more closely than two loops: times this
_PAIRS = 1 << 20  # compared at once
_VALUES = 1 << 22  # distances between descriptors, computed at once

Pairs = Callable[[NDArray[np.int64], NDArray[np.int64]], tuple[Edges, Array]]
"""Compares frames, given by their rows: (p,) first ones and (p,) second ones. Returns the poses of the second frames as
seen from the first, and the log odds (p,) that both images were taken near each other."""


class Reason(Enum):
    """Why a loop is used, or not."""

    ACCEPTED = "accepted"
    UNLIKE = "the comparison does not find that the two images were taken near each other"
    ALONE = "the loops of neighbouring frames do not agree with it"
    CONTRADICTED = "it contradicts all other measurements together"


@dataclass(frozen=True, eq=False)
class Loops(Edges):
    """Candidates for loops between frames (p pairs), of which `first` is the earlier one.

    Attributes:
        odds: (p,) log odds that the two images were taken near each other.
        reason: (p,) of `Reason`.
        weight: (p,) weight in the last solution, from 0 to 1; 0 for loops that are not accepted.
    """

    odds: Array
    reason: NDArray[np.object_]
    weight: Array

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Which loops are used (p,)."""
        return np.asarray(self.reason == Reason.ACCEPTED)

    def counts(self) -> dict[str, int]:
        """Return the number of loops of each reason, by its name in small letters."""
        return {reason.name.lower(): int((self.reason == reason).sum()) for reason in Reason}


def most_alike(
    descriptors: NDArray[np.float32], path: Array, drive: NDArray[np.int64], apart: float, k: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of similar frames, each pair once, as first rows (p,) and second rows (p,), which are larger.

    Args:
        descriptors: (n, D), of any length; similar ones have a small Euclidean distance.
        path: (n,) way that the robot drove from the start of its drive.
        drive: (n,) number of the drive.
        apart: way between two frames of a drive that may be a loop, at least.
        k: number of candidates of each frame, divided evenly among the drives, but at least two in each.
    """
    square = np.square(descriptors).sum(axis=1)
    found: set[tuple[int, int]] = set()
    drives = int(drive.max()) + 1
    k = max(-(-k // drives), min(k, 2))
    for part in slices(len(path), _VALUES // len(path)):
        rows = np.arange(len(path))[part]
        unlike = square - 2 * descriptors[rows] @ descriptors.T
        same = drive[rows, None] == drive
        unlike[same & (np.abs(path[rows, None] - path) < apart)] = np.inf
        for other in range(drives):
            columns = np.flatnonzero(drive == other)
            some = min(k, len(columns))
            best = np.argpartition(unlike[:, columns], some - 1, axis=1)[:, :some]
            of_row = np.repeat(rows, some)
            of_column = columns[best].ravel()
            usable = np.isfinite(unlike[of_row - part.start, of_column])
            pairs = np.sort(np.column_stack([of_row, of_column])[usable], axis=1)
            found.update(map(tuple, pairs.tolist()))
    pairs = np.array(sorted(found), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def checked_pairs(pairs: ArrayLike, count: int) -> NDArray[np.int64]:
    """Return pairs of rows of so many frames (p, 2).

    Raises:
        DataError: something else.
    """
    rows = np.asarray(pairs)
    rows = rows.astype(np.int64).reshape(0, 2) if rows.size == 0 else rows
    if rows.ndim != 2 or rows.shape[1] != 2 or rows.dtype.kind not in "iu" or not ((rows >= 0) & (rows < count)).all():
        raise DataError(
            f"candidates are pairs of rows of the {count} frames: (p, 2) whole numbers from 0 to {count - 1}"
        )
    return rows.astype(np.int64)


def far_apart(
    pairs: NDArray[np.int64], path: Array, drive: NDArray[np.int64], apart: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the given pairs (p, 2) that may be loops, as first rows (q,) and second rows (q,), which are larger.

    Args:
        pairs: rows of frames; -1 for a frame that is left out.
        path: (n,) as for `most_alike`.
        drive: (n,) likewise.
        apart: likewise.
    """
    first, second = np.unique(np.sort(pairs, axis=1), axis=0).T
    usable = (first >= 0) & ((drive[first] != drive[second]) | (np.abs(path[first] - path[second]) >= apart))
    return first[usable], second[usable]


def agreeing(loops: Loops, poses: Array, drive: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count for each loop the loops between neighbouring frames that agree with it (p,).

    Two loops agree if one predicts the other: from one first frame to the other as the robot drove, along the loop,
    and from one second frame to the other.

    Args:
        loops: the loops to compare, all of which count.
        poses: (n, 3) poses that are right over a few frames of a drive, however much they drift.
        drive: (n,) number of the drive of each frame.
    """
    from scipy.spatial import cKDTree

    places = np.column_stack([loops.first, loops.second]) + 10 * _NEIGHBOURHOOD * np.column_stack(
        [drive[loops.first], drive[loops.second]]
    )
    counts = np.zeros(len(loops), dtype=np.int64)
    if not len(loops):
        return counts
    pairs = cKDTree(places).query_pairs(_NEIGHBOURHOOD, p=np.inf, output_type="ndarray")
    for part in slices(len(pairs), _PAIRS):
        one, other = pairs[part].T
        there = relative(poses, loops.first[other], loops.first[one])
        back = relative(poses, loops.second[one], loops.second[other])
        agrees = agree(composed(composed(there, loops.pose[one]), back), loops.pose[other])
        for rows in (one, other):
            counts += np.bincount(rows[agrees], minlength=len(loops))
    return counts


def loops_of(edges: Edges, odds: Array) -> Loops:
    """Return compared frames as loops that no other loop agrees with so far."""
    reason = np.full(len(odds), Reason.UNLIKE, dtype=object)
    reason[odds >= ODDS] = Reason.ALONE
    return Loops(**vars(edges), odds=odds, reason=reason, weight=np.zeros(len(odds)))


def agreed(loops: Loops, poses: Array, drive: NDArray[np.int64], last: int | None = None) -> Loops:
    """Accept the loops (p) with which enough other loops agree.

    Args:
        loops: loops with their reasons so far.
        poses: (n, 3), as for `agreeing`.
        drive: (n,) number of the drive of each frame.
        last: only loops to this frame and its neighbours are judged; all if None.
    """
    alike = (loops.reason != Reason.UNLIKE) & (last is None or loops.second >= last - _NEIGHBOURHOOD)
    rows, reason = np.flatnonzero(alike), loops.reason.copy()
    enough = rows[agreeing(loops.take(rows), poses, drive) >= _AGREE]
    reason[enough[reason[enough] == Reason.ALONE]] = Reason.ACCEPTED
    return replace(loops, reason=reason)


def judged_again(loops: Loops, found: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which accepted loops a solution contradicts (p,), and which refused ones it confirms (p,).

    An accepted loop is contradicted if it weighs next to nothing, and also if it is far off: a loop that is wrong, but
    says itself how uncertain it is, would keep some weight.

    Args:
        loops: loops with the reasons so far; images that are not alike stay refused.
        found: what the solution says about the poses of the second frames, as seen from the first (p, 3).
    """
    error = found - loops.pose
    error[:, 2] = wrapped(error[:, 2])
    weight = 1 / (1 + np.einsum("pi,pij,pj->p", error, loops.information, error) / FREEDOM)
    alike = agree(found, loops.pose, _CLOSER)
    refused = (loops.reason == Reason.ALONE) | (loops.reason == Reason.CONTRADICTED)
    return loops.accepted & ((weight < _CONTRADICTED) | ~alike), refused & alike & (weight > _CONFIRMED)
