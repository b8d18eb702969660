"""Measures of place recognition and localization: pure functions on arrays.

Positions are in whatever unit the data set counts in (metres unless it says otherwise), angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import ConfigError, DataError


@dataclass(frozen=True)
class Recall:
    """Recall@K within a radius, with all that it is a share of.

    Attributes:
        recall: hits / queries; NaN without queries.
        hits: queries with at least one of the K retrieved frames within the radius.
        queries: all queries.
        answerable: queries that have any map frame within the radius.
        recall_answerable: hits / answerable; NaN where no query is answerable.
        k: how many retrieved frames count.
        radius: the largest distance that counts as the same place, inclusive.
    """

    recall: float
    hits: int
    queries: int
    answerable: int
    recall_answerable: float
    k: int
    radius: float


@dataclass(frozen=True)
class PairAccuracy:
    """Shares of pairs judged rightly; NaN for a part that has no pairs.

    Attributes:
        same: of the pairs from one room.
        different: of the pairs from two rooms.
        overall: of all pairs.
        n_same: pairs from one room.
        n_different: pairs from two rooms.
    """

    same: float
    different: float
    overall: float
    n_same: int
    n_different: int


@dataclass(frozen=True, eq=False)
class PairCurve:
    """Shares of pairs judged rightly at several thresholds; NaN for a part that has no pairs.

    Attributes:
        thresholds: of the dissimilarity (t,).
        same: of the pairs from one room (t,).
        different: of the pairs from two rooms (t,).
        overall: of all pairs (t,).
        auc: area under the curve of the pairs from one room found against those from two rooms mistaken for one: the
            share of such couples of pairs in which the one-room pair is less dissimilar, ties counting half.
    """

    thresholds: NDArray[np.float64]
    same: NDArray[np.float64]
    different: NDArray[np.float64]
    overall: NDArray[np.float64]
    auc: float


def localization_error(estimated_xy: ArrayLike, true_xy: ArrayLike) -> NDArray[np.float64]:
    """Return the Euclidean distance between estimated and true positions (n,).

    Args:
        estimated_xy: (n, 2).
        true_xy: (n, 2).

    Raises:
        DataError: other shapes, or a position that is not finite.
    """
    estimated, true = _positions(estimated_xy, "estimated"), _positions(true_xy, "true")
    if len(estimated) != len(true):
        raise DataError(f"as many estimated as true positions are needed, got {len(estimated)} and {len(true)}")
    difference = estimated - true
    return np.hypot(difference[:, 0], difference[:, 1])


def error_floor(map_xy: ArrayLike, query_xy: ArrayLike) -> NDArray[np.float64]:
    """Return the distance of each query to the nearest map frame (n,): no retrieval can do better.

    Args:
        map_xy: (m, 2), m at least 1.
        query_xy: (n, 2).

    Raises:
        DataError: an empty map, other shapes, or a position that is not finite.
    """
    known, queries = _map_positions(map_xy), _positions(query_xy, "query")
    if not len(queries):
        return np.empty(0)
    from scipy.spatial import cKDTree

    # The tree compares squares; the length itself comes from the function that measures errors.
    _, closest = cKDTree(known).query(queries)
    return localization_error(known[closest], queries)


def summarize(errors: ArrayLike) -> dict[str, Any]:
    """Return count, mean, median, p95 (linear interpolation), max and rmse of errors (n,); NaN where n is 0.

    Raises:
        DataError: another shape, or an error that is not finite.
    """
    values = _column(errors, "errors")
    if not len(values):
        return {"count": 0, **dict.fromkeys(("mean", "median", "p95", "max", "rmse"), math.nan)}
    median, p95 = np.percentile(values, (50, 95))
    return {
        "count": len(values),
        "mean": float(values.mean()),
        "median": float(median),
        "p95": float(p95),
        "max": float(values.max()),
        "rmse": float(np.sqrt(np.mean(values**2))),
    }


def first_rank_within(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: float) -> NDArray[np.int64]:
    """Return the rank (from 1) of the first retrieved frame within `radius` of its query; 0 where there is none (n,).

    Args:
        retrieved: rows of the map, nearest descriptor first (n, K).
        map_xy: (m, 2).
        query_xy: (n, 2).
        radius: not negative; a frame exactly at the radius counts.

    Raises:
        ConfigError: a negative radius.
        DataError: other shapes, rows outside the map, or a position that is not finite.
    """
    within = _distances_of_retrieved(retrieved, map_xy, query_xy) <= _radius(radius)
    return np.where(within.any(axis=1), within.argmax(axis=1) + 1, 0)


def recall_at_k(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: float, k: int) -> Recall:
    """Return the share of queries with at least one of the top k retrieved frames within `radius` of them.

    Args:
        retrieved: rows of the map, nearest descriptor first (n, K); K at least min(k, m).
        map_xy: (m, 2).
        query_xy: (n, 2).
        radius: not negative; a frame exactly at the radius counts.
        k: at least 1; a k beyond the size of the map means the whole map.

    Raises:
        ConfigError: a negative radius, or a k that is not positive or larger than what was retrieved.
        DataError: other shapes, rows outside the map, or a position that is not finite.
    """
    if int(k) != k or k < 1:
        raise ConfigError(f"recall@k needs a whole k >= 1, got {k}")
    known = _map_positions(map_xy)
    found = np.asarray(retrieved)
    if found.ndim == 2 and found.shape[1] < min(k, len(known)):
        raise ConfigError(f"recall@{k} needs {min(k, len(known))} retrieved frames a query, got {found.shape[1]}")
    rank = first_rank_within(found, known, query_xy, radius)
    return recall_from_ranks(rank, error_floor(known, query_xy), radius, k)


def recall_at_one_percent(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: float) -> Recall:
    """Return recall@K with K = one percent of the map, rounded up, at least 1. Arguments as `recall_at_k`."""
    return recall_at_k(retrieved, map_xy, query_xy, radius, one_percent(len(_map_positions(map_xy))))


def one_percent(map_size: int) -> int:
    """Return K = max(1, ceil(m / 100)) for a map of m frames."""
    return max(1, -(-int(map_size) // 100))


def recall_from_ranks(rank: ArrayLike, floor: ArrayLike, radius: float, k: int) -> Recall:
    """Return recall@k from what `first_rank_within` (for this radius) and `error_floor` gave (n,) and (n,)."""
    ranks, floors = np.asarray(rank), np.asarray(floor)
    hit = (ranks > 0) & (ranks <= k)
    # A hit is answerable by definition, whatever the last bit of its floor says.
    answerable = (floors <= radius) | (ranks > 0)
    hits, n, possible = int(hit.sum()), len(ranks), int(answerable.sum())
    return Recall(
        recall=hits / n if n else math.nan,
        hits=hits,
        queries=n,
        answerable=possible,
        recall_answerable=hits / possible if possible else math.nan,
        k=int(k),
        radius=float(radius),
    )


def pair_dissimilarity(distances: ArrayLike, margin: float = 2.0) -> NDArray[np.float64]:
    """Return min(distance / margin, 1) (n,): 0 for one place, 1 for two ([T] 5.3.3).

    Raises:
        ConfigError: a margin that is not positive.
        DataError: another shape, or distances that are negative or not finite.
    """
    if not margin > 0:
        raise ConfigError(f"the margin must be positive, got {margin}")
    values = _column(distances, "distances")
    if (values < 0).any():
        raise DataError(f"{int((values < 0).sum())} of {len(values)} pair distances are negative")
    return np.minimum(values / margin, 1.0)


def pair_accuracy(distances: ArrayLike, same: ArrayLike, margin: float = 2.0, threshold: float = 0.5) -> PairAccuracy:
    """Return the shares of pairs judged rightly, "same" meaning a dissimilarity below the threshold ([T] 5.3.3).

    Args:
        distances: between the two descriptors of each pair (n,).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        threshold: in (0, 1].

    Raises:
        ConfigError: a margin or threshold out of range.
        DataError: other shapes, or distances that are negative or not finite.
    """
    if not 0 < threshold <= 1:
        raise ConfigError(f"the threshold of a dissimilarity lies in (0, 1], got {threshold}")
    dissimilarity = pair_dissimilarity(distances, margin)
    truth = _verdicts(same, dissimilarity)
    correct = (dissimilarity < threshold) == truth
    return PairAccuracy(
        same=_share(correct[truth]),
        different=_share(correct[~truth]),
        overall=_share(correct),
        n_same=int(truth.sum()),
        n_different=int((~truth).sum()),
    )


def pair_threshold_curve(
    distances: ArrayLike, same: ArrayLike, margin: float = 2.0, thresholds: ArrayLike | None = None
) -> PairCurve:
    """Return what `pair_accuracy` gives at every threshold, and the area under the curve that needs none.

    Args:
        distances: between the two descriptors of each pair (n,).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        thresholds: (t,) in [0, 1], 0 calling every pair different; 0, 0.01 ... 1 if None.

    Raises:
        ConfigError: a margin or threshold out of range.
        DataError: other shapes, or distances that are negative or not finite.
    """
    steps = np.arange(101) / 100 if thresholds is None else _column(thresholds, "thresholds")
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


def heading_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Return the angle between estimated and true headings in rad (n,), in [0, pi], whatever turns are in them.

    Raises:
        DataError: shapes that differ, or a heading that is not finite.
    """
    a, b = _column(estimated, "estimated headings"), _column(true, "true headings")
    if a.shape != b.shape:
        raise DataError(f"as many estimated as true headings are needed, got {len(a)} and {len(b)}")
    return np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi)


def _share(correct: NDArray[np.bool_]) -> float:
    return float(correct.mean()) if len(correct) else math.nan


def _shares(counts: NDArray[np.int64], n: int) -> NDArray[np.float64]:
    return counts / n if n else np.full(len(counts), math.nan)


def _verdicts(same: ArrayLike, dissimilarity: NDArray[np.float64]) -> NDArray[np.bool_]:
    truth = np.asarray(same)
    if truth.dtype != np.bool_ or truth.shape != dissimilarity.shape:
        raise DataError(f"one True or False per pair is needed, got {truth.dtype} of shape {truth.shape}")
    return truth


def _column(values: ArrayLike, what: str) -> NDArray[np.float64]:
    column = np.asarray(values, dtype=np.float64)
    if column.ndim != 1:
        raise DataError(f"{what} must have shape (n,), got {column.shape}")
    if not np.isfinite(column).all():
        raise DataError(f"{int((~np.isfinite(column)).sum())} of {len(column)} {what} are not finite")
    return column


def _positions(xy: ArrayLike, what: str) -> NDArray[np.float64]:
    positions = np.asarray(xy, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise DataError(f"{what} positions must have shape (n, 2), got {positions.shape}")
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        raise DataError(
            f"{int((~finite).sum())} of {len(positions)} {what} positions are unknown or not finite: "
            "leave those frames out"
        )
    return positions


def _map_positions(xy: ArrayLike) -> NDArray[np.float64]:
    positions = _positions(xy, "map")
    if not len(positions):
        raise DataError("the map is empty: there is nothing to retrieve")
    return positions


def _radius(radius: float) -> float:
    if not radius >= 0:
        raise ConfigError(f"the radius must not be negative, got {radius}")
    return float(radius)


def _distances_of_retrieved(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike) -> NDArray[np.float64]:
    """Return the distances of retrieved map frames to their queries (n, K)."""
    known, queries, found = _map_positions(map_xy), _positions(query_xy, "query"), np.asarray(retrieved)
    if found.ndim != 2 or found.shape[1] < 1 or found.dtype.kind not in "iu" or len(found) != len(queries):
        raise DataError(
            f"retrieved frames must be whole numbers of shape ({len(queries)}, K), got {found.dtype} of {found.shape}"
        )
    if found.size and (found.min() < 0 or found.max() >= len(known)):
        raise DataError(f"retrieved frames must be rows of the map, 0 to {len(known) - 1}")
    return np.hypot(known[found, 0] - queries[:, :1], known[found, 1] - queries[:, 1:])
