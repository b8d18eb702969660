"""Distinguish rooms: pairs of images judged by their distance ([T] 5.3.3), and the confusion of rooms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.metrics.arrays import column_of


@dataclass(frozen=True)
class PairAccuracy:
    """Shares of pairs judged correctly; NaN for a part without pairs.

    Attributes:
        same: share of the pairs from one room that are judged to be from one room.
        different: share of the pairs from two rooms that are judged to be from two rooms.
        overall: share of all pairs that are judged correctly.
        n_same: number of pairs from one room.
        n_different: number of pairs from two rooms.
    """

    same: float
    different: float
    overall: float
    n_same: int
    n_different: int


@dataclass(frozen=True, eq=False)
class PairCurve:
    """Shares of pairs judged correctly at several thresholds; NaN for a part without pairs.

    Attributes:
        thresholds: dissimilarities (t,) below which a pair is judged to be from one room.
        same: share of the pairs from one room that are judged correctly, at each threshold (t,).
        different: share of the pairs from two rooms that are judged correctly (t,).
        overall: share of all pairs that are judged correctly (t,).
        auc: area under the curve of one-room pairs judged right against two-room pairs mistaken for one room. This is
            the share of couples of a one-room and a two-room pair in which the one-room pair is less dissimilar; ties
            count half.
    """

    thresholds: NDArray[np.float64]
    same: NDArray[np.float64]
    different: NDArray[np.float64]
    overall: NDArray[np.float64]
    auc: float


def pair_dissimilarity(distances: ArrayLike, margin: float = 2.0) -> NDArray[np.float64]:
    """Return min(distance / margin, 1) (n,): 0 for one place, 1 for two ([T] 5.3.3).

    Raises:
        ConfigError: a margin that is not positive.
        DataError: another shape, or distances that are negative or not finite.
    """
    if not margin > 0:
        raise ConfigError(f"the margin must be positive, got {margin}")
    return np.minimum(_distances(distances) / margin, 1.0)


def pair_accuracy(distances: ArrayLike, same: ArrayLike, margin: float = 2.0, threshold: float = 0.5) -> PairAccuracy:
    """Return the shares of pairs judged correctly; "same" is a dissimilarity below the threshold ([T] 5.3.3).

    Args:
        distances: distances between the two descriptors of each pair (n,).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        threshold: dissimilarity below which a pair is judged to be from one room; in (0, 1].

    Raises:
        ConfigError: a margin or threshold out of range.
        DataError: other shapes, or distances that are negative or not finite.
    """
    if not 0 < threshold <= 1:
        raise ConfigError(f"the threshold of a dissimilarity lies in (0, 1], got {threshold}")
    curve = pair_threshold_curve(distances, same, margin, [threshold])
    truth = np.asarray(same)
    return PairAccuracy(
        same=float(curve.same[0]),
        different=float(curve.different[0]),
        overall=float(curve.overall[0]),
        n_same=int(truth.sum()),
        n_different=int((~truth).sum()),
    )


def pair_threshold_curve(
    distances: ArrayLike, same: ArrayLike, margin: float = 2.0, thresholds: ArrayLike | None = None
) -> PairCurve:
    """Return the shares of `pair_accuracy` at every threshold, and the area under the curve, which needs no threshold.

    Args:
        distances: distances between the two descriptors of each pair (n,).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        thresholds: (t,) in [0, 1], 0 calling every pair different; 0, 0.01 ... 1 if None.

    Raises:
        ConfigError: a margin or threshold out of range.
        DataError: other shapes, or distances that are negative or not finite.
    """
    steps = np.arange(101) / 100 if thresholds is None else column_of(thresholds, "thresholds")
    if ((steps < 0) | (steps > 1)).any():
        raise ConfigError(f"the thresholds of a dissimilarity lie in [0, 1], got {steps.min()} to {steps.max()}")
    dissimilarity = pair_dissimilarity(distances, margin)
    truth = _verdicts(same, dissimilarity)
    one, two = np.sort(dissimilarity[truth]), np.sort(dissimilarity[~truth])
    found, mistaken = np.searchsorted(one, steps), np.searchsorted(two, steps)
    below, up_to = np.searchsorted(one, two), np.searchsorted(one, two, side="right")
    couples = len(one) * len(two)
    return PairCurve(
        thresholds=steps,
        same=_shares(found, len(one)),
        different=_shares(len(two) - mistaken, len(two)),
        overall=_shares(found + len(two) - mistaken, len(truth)),
        auc=float(int((below + up_to).sum()) / (2 * couples)) if couples else math.nan,
    )


def fitted_margin(distances: ArrayLike, same: ArrayLike) -> float:
    """Return the margin whose half best separates pairs from one room and from two, for descriptors without a margin.

    Half the margin is a limit with which the fewest pairs are misjudged; if several gaps between distances are equally
    good, it is the middle of the widest one.

    Args:
        distances: distances between the two descriptors of each pair (n,).
        same: True for pairs from one room (n,).

    Raises:
        DataError: other shapes, distances that are negative or not finite, pairs of one kind only, or all distances
            equal.

    Example:
        >>> fitted_margin([0.1, 0.2, 0.8, 1.0], np.array([True, True, False, False]))
        1.0
    """
    values = _distances(distances)
    truth = _verdicts(same, values)
    levels, level = np.unique(values, return_inverse=True)
    if truth.all() or not truth.any() or len(levels) < 2:
        raise DataError(
            f"a margin is learned from pairs of both kinds at different distances, got {int(truth.sum())} from one "
            f"room, {int((~truth).sum())} from two, {len(levels)} different distances"
        )
    gained = np.bincount(level, np.where(truth, 1.0, -1.0)).cumsum()[:-1]  # with a limit above each level but the last
    gaps = np.where(gained == gained.max(), np.diff(levels), -1)
    at = int(gaps.argmax())
    return float(levels[at] + levels[at + 1])


def confusion_matrix(true: ArrayLike, predicted: ArrayLike, labels: Sequence[str]) -> NDArray[np.int64]:
    """Return counts (L, L): row = true label, column = predicted label, both in the order of `labels`.

    Raises:
        DataError: label arrays of different lengths, or a label that `labels` lacks or names twice.
    """
    names = [str(label) for label in labels]
    if len(set(names)) != len(names):
        raise DataError(f"the labels of a confusion matrix must differ, got {', '.join(names)}")
    rows, columns = np.asarray(true, dtype=np.str_), np.asarray(predicted, dtype=np.str_)
    if rows.ndim != 1 or rows.shape != columns.shape:
        raise DataError(f"as many true as predicted labels are needed, got shapes {rows.shape} and {columns.shape}")
    unknown = sorted((set(rows.tolist()) | set(columns.tolist())) - set(names))
    if unknown:
        raise DataError(f"labels {', '.join(map(repr, unknown))} are not among {', '.join(names)}")
    number = {name: i for i, name in enumerate(names)}
    matrix = np.zeros((len(names), len(names)), dtype=np.int64)
    pairs = ([number[label] for label in rows.tolist()], [number[label] for label in columns.tolist()])
    np.add.at(matrix, pairs, 1)
    return matrix


def _shares(counts: NDArray[np.int64], n: int) -> NDArray[np.float64]:
    return counts / n if n else np.full(len(counts), math.nan)


def _distances(distances: ArrayLike) -> NDArray[np.float64]:
    values = column_of(distances, "distances")
    if (values < 0).any():
        raise DataError(f"{int((values < 0).sum())} of {len(values)} pair distances are negative")
    return values


def _verdicts(same: ArrayLike, dissimilarity: NDArray[np.float64]) -> NDArray[np.bool_]:
    truth = np.asarray(same)
    if truth.dtype != np.bool_ or truth.shape != dissimilarity.shape:
        raise DataError(f"one True or False per pair is needed, got {truth.dtype} of shape {truth.shape}")
    return truth
