"""Put the nearest map frames of a query in order anew, by comparing each of them with the query."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap

COMPARED = 8
"""Number of nearest map frames that are compared with a query."""
_ODDS = -10.0, 5.0  # log odds beyond these count no more: nearer frames differ in their descriptors
_ODDS_PER_DISTANCE = 25.0  # log odds that weigh as much as a distance of 1 between descriptors
_NEARNESS = 0.8  # distance between descriptors that weighs as much as 1 between positions
_NEAR = 1.0  # a certain match is preferred for being nearer than this, in the unit of the positions
_AT_ONCE = 256  # queries

Compares = Callable[
    [NDArray[np.float32], NDArray[np.float32]], tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
]
"""Compares orientation parts of queries (n, K, F) with those of as many map frames (n, K, F). Returns pose (n, 3):
the displacement ahead and to the left as seen from the map frame's robot, and how far the query's robot is turned left,
in rad; the inverse of the scale matrix of a t-distribution with 4 degrees of freedom (n, 3, 3), the information; and
the log odds (n,) that the images were taken near each other."""


def comparison_of(known: VisualMap) -> Compares | None:
    """Return the function by which a map's descriptor compares a query with a map frame; None if it cannot."""
    held = known.heading_by_network and known.distance == "euclidean"
    return getattr(known.describes, "compare", None) if held and getattr(known.describes, "compares", False) else None


def reranked(known: VisualMap, queries: Description, found: Retrieval, compares: Compares, compared: int) -> Retrieval:
    """Put the nearest map frames of each query in order anew.

    Distances between descriptors tell which places look alike; a comparison of two images tells whether both were taken
    near each other, which is more certain where map frames stand metres apart, and how far apart, which is more exact
    where they stand closely. With the log odds o of that, limited to -10 ... 5, and the length r of the displacement,
    limited to 1 and taken as 1 where o < 5, a map frame at distance d gets the distance d + (5 - o) / 25 + 0.8 r. Map
    frames after those compared get the distance d + 1.4, as if they showed another place.

    Args:
        known: a map of m frames, with the orientation parts that are compared.
        queries: n descriptions with orientation parts, by `known.describe`.
        found: the nearest map frames of each query.
        compares: compares orientation parts.
        compared: number of map frames to compare, from the first.
    """
    parts, rows = queries.orientation, found.indices[:, :compared]
    assert parts is not None
    starts = range(0, len(rows), _AT_ONCE)
    of_compared = [_doubts(known, parts[at : at + _AT_ONCE], rows[at : at + _AT_ONCE], compares) for at in starts]
    doubts = np.full(found.distances.shape, _doubt(np.array(_ODDS[0]), np.array(_NEAR)))
    doubts[:, : rows.shape[1]] = np.concatenate([rows[:0].astype(np.float64), *of_compared])
    distances = found.distances + doubts
    order = distances.argsort(axis=1, kind="stable")
    return Retrieval(np.take_along_axis(found.indices, order, 1), np.take_along_axis(distances, order, 1))


def _doubts(
    known: VisualMap, parts: NDArray[np.float32], rows: NDArray[np.int64], compares: Compares
) -> NDArray[np.float64]:
    """Return what to add to the distances (n, K) between queries with these parts and map frames (n, K)."""
    held = known.turning(rows.ravel()).orientation
    assert held is not None
    pose, _, odds = compares(np.repeat(scaled(parts), rows.shape[1], axis=0), scaled(held))
    return _doubt(odds, np.hypot(pose[:, 0], pose[:, 1])).reshape(rows.shape)


def _doubt(odds: NDArray[np.float64], apart: NDArray[np.float64]) -> NDArray[np.float64]:
    least, certain = _ODDS
    near = np.where(odds >= certain, np.minimum(apart, _NEAR), _NEAR)
    return (certain - odds.clip(least, certain)) / _ODDS_PER_DISTANCE + _NEARNESS * near


def scaled(parts: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return orientation parts scaled to a mean square of 1 each, as maps keep them only up to a scale."""
    size = np.sqrt(np.mean(np.square(parts, dtype=np.float64), axis=(1, 2), keepdims=True))
    return (parts / np.maximum(size, 1e-12)).astype(np.float32)
