"""Exact nearest neighbours: a float32 matrix product finds the candidates, float64 decides among them.

The rounding error of the product is bounded (Higham, *Accuracy and Stability of Numerical Algorithms*, section 3.1:
a sum of D products is off by at most about D u |q| |r|, in whatever order it is added up). Every reference whose
score lies within that bound of the k-th best is compared again in float64, so the answer is the one that a loop
over all pairs in float64 gives, whatever the sizes of the chunks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.distances import DISTANCES
from siamloc.errors import ConfigError, DataError
from siamloc.errors import nearest as nearest_name
from siamloc.maps.scores import DirectScores, ProductScores, Scores

_REFERENCES_PER_BLOCK = 4096
_PAIRS_PER_BLOCK = 1 << 19  # 2 MiB of scores, which stay in the processor's cache
_QUERIES_PER_BLOCK = 256  # but not fewer than make a matrix product worth it
_BYTES_PER_PAIR = 80  # of a block in which everything ties: score, mask, two indices, distance, and sorting them


@dataclass(frozen=True)
class Retrieval:
    """What a search found, the nearest reference first.

    Attributes:
        indices: rows of the references (n, k).
        distances: distances to them (n, k), not decreasing along a row.
    """

    indices: NDArray[np.int64]
    distances: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.indices)


def nearest(
    queries: ArrayLike, references: ArrayLike, k: int = 1, distance: str = "euclidean", memory: int = 256 << 20
) -> Retrieval:
    """Return the k nearest references of each query, exactly; of equally near ones the smaller index comes first.

    A map of fewer than k references gives all of them: the answer has min(k, m) columns. It depends neither on
    how many queries are asked at once nor on `memory`.

    Args:
        queries: (n, D); n may be 0.
        references: (m, D).
        k: how many to return, at least 1.
        distance: a name in `analytic.DISTANCES`; "minkowski" is that of order 2.
        memory: bytes that the search may use on top of its input and its answer; about 8 MiB are the least.

    Raises:
        ConfigError: an unknown distance, or a number of neighbours or bytes that is not positive.
        DataError: no references, arrays of another shape, or values that are not finite.
    """
    if distance not in DISTANCES:
        raise ConfigError(f"unknown distance {distance!r}: {nearest_name(distance, DISTANCES)}")
    if int(k) != k or k < 1:
        raise ConfigError(f"a search needs a whole number of neighbours k >= 1, got {k}")
    if not memory > 0:
        raise ConfigError(f"the memory of a search must be a positive number of bytes, got {memory}")
    q, r = _checked(queries, references)
    k = min(int(k), len(r))
    best = Retrieval(np.full((len(q), k), len(r), dtype=np.int64), np.full((len(q), k), np.inf))
    scores: Scores = DirectScores(distance) if distance in ("manhattan", "minkowski") else ProductScores(distance, q, r)
    batch, height, width = _block_sizes(q.shape[1], len(r), int(memory), scores.bytes_per_query(q))
    for rows in _slices(0, len(q), batch):
        _search(best, q, r, rows, scores, height, width)
    return best


def _search(
    best: Retrieval, queries: NDArray, references: NDArray, batch: slice, scores: Scores, height: int, width: int
) -> None:
    """Fill the rows of one batch; its queries are prepared once and kept while the references pass by."""
    blocks = [(rows, scores.queries(queries[rows])) for rows in _slices(batch.start, batch.stop, height)]
    for columns in _slices(0, len(references), width):
        prepared = scores.references(references[columns])
        for rows, block in blocks:
            _improve(
                best.indices[rows],
                best.distances[rows],
                scores,
                block,
                prepared,
                columns.start,
            )


def _improve(indices: NDArray, distances: NDArray, scores: Scores, queries: Any, references: Any, first: int) -> None:
    """Merge one block of references, whose first row has the number `first`, into the best so far, in place."""
    k = indices.shape[1]
    score, slack = scores.block(queries, references)
    worst = distances[:, -1]
    if np.isinf(worst).any():
        needed = _kth_largest(score, k) - 2 * slack
        live = np.arange(len(score))
    else:
        needed = scores.at(queries, worst) - slack
        live = np.flatnonzero(score.max(axis=1) >= needed)
    if not len(live):
        return
    part = score if len(live) == len(score) else score[live]
    threshold = needed[live].astype(score.dtype)
    hits = part >= threshold[:, None]
    if np.count_nonzero(hits) > 4 * k * len(live):
        # The references come nearer and nearer, as along a drive: the block's own best are the better threshold.
        threshold = np.maximum(threshold, (_kth_largest(part, k) - 2 * slack[live]).astype(score.dtype))
        hits = part >= threshold[:, None]
    row, column = np.nonzero(hits)
    exact = scores.exact(queries, references, live[row], column)
    _merge(indices, distances, live, row, column + first, exact)


def _merge(indices: NDArray, distances: NDArray, live: NDArray, row: NDArray, column: NDArray, exact: NDArray) -> None:
    """Keep the k nearest of those known and of the candidates; `row` counts inside `live` and never decreases."""
    k = indices.shape[1]
    counts = np.bincount(row, minlength=len(live))
    place = k + np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    near = np.full((len(live), k + int(counts.max())), np.inf)
    found = np.zeros(near.shape, dtype=np.int64)
    near[:, :k], found[:, :k] = distances[live], indices[live]
    near[row, place], found[row, place] = exact, column
    # Known references have the smaller numbers and candidates come in order, so a stable sort settles ties.
    order = np.argsort(near, axis=1, kind="stable")[:, :k]
    distances[live] = np.take_along_axis(near, order, axis=1)
    indices[live] = np.take_along_axis(found, order, axis=1)


def _kth_largest(score: NDArray, k: int) -> NDArray[np.float64]:
    """Return the k-th largest score of each row; -inf where a row has fewer."""
    if k == 1:
        return score.max(axis=1).astype(np.float64)
    if k > score.shape[1]:
        return np.full(len(score), -np.inf)
    return np.partition(score, score.shape[1] - k, axis=1)[:, score.shape[1] - k].astype(np.float64)


def _block_sizes(width: int, references: int, memory: int, query: int) -> tuple[int, int, int]:
    """Return how many queries (of so many bytes) make a batch, how many of them a block, and references a block."""
    vector = 8 * (width + 3)
    pairs = max(memory // 2 // _BYTES_PER_PAIR, 1)
    columns = max(min(_REFERENCES_PER_BLOCK, references, memory // 8 // (3 * vector), pairs), 1)
    enough = max(_PAIRS_PER_BLOCK // columns, _QUERIES_PER_BLOCK)
    rows = max(min(enough, pairs // columns, memory // 8 // (3 * vector)), 1)
    batch = max(memory // 8 // query // rows, 1) * rows
    return batch, rows, columns


def _slices(start: int, stop: int, step: int) -> Iterator[slice]:
    return (slice(first, min(first + step, stop)) for first in range(start, stop, step))


def _checked(queries: ArrayLike, references: ArrayLike) -> tuple[NDArray, NDArray]:
    q, r = _as_float(queries), _as_float(references)
    if q.ndim != 2 or r.ndim != 2:
        raise DataError(f"a search needs queries (n, D) and references (m, D), got shapes {q.shape} and {r.shape}")
    if not len(r):
        raise DataError("the map holds no descriptors: there is nothing to search in")
    if q.shape[1] != r.shape[1] or not r.shape[1]:
        raise DataError(
            f"queries have {q.shape[1]} values each, the map's descriptors {r.shape[1]}: describe both with one model"
        )
    for what, array in (("query", q), ("map", r)):
        # The two extremes show NaN and infinity without a temporary array of the input's size.
        if array.size and not (np.isfinite(array.min()) and np.isfinite(array.max())):
            bad = int((~np.isfinite(array)).any(axis=1).sum())
            raise DataError(
                f"{bad} of {len(array)} {what} descriptors hold values that are not finite: "
                "look at the model and at these images"
            )
    return q, r


def _as_float(array: ArrayLike) -> NDArray:
    values = np.asarray(array)
    return values if values.dtype in (np.float32, np.float64) else values.astype(np.float64)
