"""Recall@K: whether one of the first K retrieved frames is near enough."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import NotNegative, Rule
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.metrics.arrays import map_positions, numbers_of, positions_of
from siamloc.evaluation.metrics.errors import error_floor

_Whole = Annotated[float, Rule("a whole number from 1 to 10 million", lambda k: 1 <= k <= 10_000_000 and k == int(k))]
"""A `Count` that may be a float, as `np.ceil` returns it."""


@dataclass(frozen=True)
class Recall:
    """Recall@K within a radius, with its denominators.

    Attributes:
        recall: hits / queries; NaN without queries.
        hits: queries with at least one of the K retrieved frames within the radius.
        queries: all queries.
        answerable: queries that have any map frame within the radius.
        recall_answerable: hits / answerable; NaN if no query is answerable.
        k: number of retrieved frames that count.
        radius: the largest distance that counts as the same place, inclusive.
    """

    recall: float
    hits: int
    queries: int
    answerable: int
    recall_answerable: float
    k: int
    radius: float


@typed
def recall_at_k(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: NotNegative, k: _Whole) -> Recall:
    """Return the share of queries with at least one of the top k retrieved frames within `radius` of them.

    Args:
        retrieved: rows of the map, nearest descriptor first (n, K); K at least min(k, m).
        map_xy: (m, 2).
        query_xy: (n, 2).
        radius: finite, not negative; a frame exactly at the radius counts.
        k: a whole number, at least 1; a k larger than the map means the whole map.

    Raises:
        ConfigError: a radius that is negative or not finite, or a k that is no whole number above 0 or exceeds the
            number of retrieved frames.
        DataError: other shapes, rows outside the map, or a position that is not finite.
    """
    known, k = map_positions(map_xy), int(k)
    found = np.asarray(retrieved)
    if found.ndim == 2 and found.shape[1] < min(k, len(known)):
        raise ConfigError(f"recall@{k} needs {min(k, len(known))} retrieved frames a query, got {found.shape[1]}")
    rank = first_rank_within(found, known, query_xy, radius)
    return recall_from_ranks(rank, error_floor(known, query_xy), radius, k)


def recall_at_one_percent(retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: float) -> Recall:
    """Return recall@K with K = one percent of the map, rounded up, at least 1. Arguments as for `recall_at_k`."""
    return recall_at_k(retrieved, map_xy, query_xy, radius, one_percent(len(map_positions(map_xy))))


def one_percent(map_size: int) -> int:
    """Return one percent of a map of m frames as a number of frames, max(1, ceil(m / 100))."""
    return max(1, -(-int(map_size) // 100))


@typed
def first_rank_within(
    retrieved: ArrayLike, map_xy: ArrayLike, query_xy: ArrayLike, radius: NotNegative
) -> NDArray[np.int64]:
    """Return the rank (from 1) of the first retrieved frame within `radius` of its query; 0 if there is none (n,).

    Args:
        retrieved: rows of the map, nearest descriptor first (n, K).
        map_xy: (m, 2).
        query_xy: (n, 2).
        radius: finite, not negative; a frame exactly at the radius counts.

    Raises:
        ConfigError: a radius that is negative or not finite.
        DataError: other shapes, rows outside the map, or a position that is not finite.
    """
    known, queries, found = map_positions(map_xy), positions_of(query_xy, "query"), np.asarray(retrieved)
    if found.ndim != 2 or found.shape[1] < 1 or found.dtype.kind not in "iu" or len(found) != len(queries):
        raise DataError(
            f"retrieved frames must be whole numbers of shape ({len(queries)}, K), got {found.dtype} of {found.shape}"
        )
    if found.size and (found.min() < 0 or found.max() >= len(known)):
        raise DataError(f"retrieved frames must be rows of the map, 0 to {len(known) - 1}")
    within = np.hypot(known[found, 0] - queries[:, :1], known[found, 1] - queries[:, 1:]) <= radius
    return np.where(within.any(axis=1), within.argmax(axis=1) + 1, 0)


@typed
def recall_from_ranks(rank: ArrayLike, floor: ArrayLike, radius: NotNegative, k: _Whole) -> Recall:
    """Return recall@k from the results of `first_rank_within` (for this radius) and `error_floor`, both (n,).

    Raises:
        ConfigError: a radius that is negative or not finite, or a k that is no whole number above 0.
        DataError: other shapes.
    """
    ranks, floors = numbers_of(rank, "ranks"), numbers_of(floor, "floors")
    if ranks.ndim != 1 or ranks.shape != floors.shape:
        raise DataError(f"ranks and floors must both have shape (n,), got {ranks.shape} and {floors.shape}")
    hit = (ranks > 0) & (ranks <= k)
    # A hit is answerable by definition, even if rounding lifts its floor above the radius.
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
