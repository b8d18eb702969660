"""Exact nearest neighbours: a float32 matrix product finds the candidates, float64 decides among them.

The rounding error of the product is bounded (Higham, *Accuracy and Stability of Numerical Algorithms*, section 3.1:
a sum of D products is off by at most about D u |q| |r|, in whatever order it is added up). Every reference whose
score lies within that bound of the k-th best is compared again in float64, so the answer is the one that a loop
over all pairs in float64 gives, whatever the sizes of the chunks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.distances import DISTANCES
from siamloc.errors import ConfigError, DataError, hint
from siamloc.maps.scores import DirectScores, ProductScores, Scores

_REFERENCES_PER_BLOCK = 4096
_QUERIES_PER_BLOCK = 2048  # the fewer products, the less their threads wait for each other
_GROUP = 256  # neighbouring scores of which the largest tells whether to look at the others
_MANY_GROUPS = 4  # a query's groups to look at, beyond which a better bound is worth its time
_BYTES_PER_SCORE = 16
_BYTES_PER_PAIR = 80  # of rows in which everything ties: score, mask, two indices, distance, and sorting them


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

    def take(self, rows: NDArray) -> Retrieval:
        """Return what was found for some of the queries: their numbers, or a mask."""
        return Retrieval(self.indices[rows], self.distances[rows])

    @staticmethod
    def concatenate(parts: Sequence[Retrieval]) -> Retrieval:
        """Return what was found for one batch of queries after the other."""
        return Retrieval(
            np.concatenate([part.indices for part in parts]), np.concatenate([part.distances for part in parts])
        )


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
        raise ConfigError(f"unknown distance {distance!r}: {hint(distance, DISTANCES)}")
    if int(k) != k or k < 1:
        raise ConfigError(f"a search needs a whole number of neighbours k >= 1, got {k}")
    if not memory > 0:
        raise ConfigError(f"the memory of a search must be a positive number of bytes, got {memory}")
    q, r = _checked(queries, references)
    k = min(int(k), len(r))
    best = Retrieval(np.full((len(q), k), len(r), dtype=np.int64), np.full((len(q), k), np.inf))
    scores: Scores = DirectScores(distance) if distance in ("manhattan", "minkowski") else ProductScores(distance, q, r)
    sizes = _Sizes.fitting(q.shape[1], len(r), int(memory), scores.bytes_per_query(q))
    for rows in _slices(0, len(q), sizes.batch):
        _search(best, q, r, rows, scores, sizes)
    return best


@dataclass(frozen=True)
class _Sizes:
    """What is held at once.

    Attributes:
        batch: queries that are prepared and kept while all references pass by.
        height: queries of a block of scores.
        width: references of a block of scores.
        rows: of a block, whose candidates are looked at.
    """

    batch: int
    height: int
    width: int
    rows: int

    @classmethod
    def fitting(cls, values: int, references: int, memory: int, query: int) -> _Sizes:
        """Return the sizes for vectors of so many values and queries of so many bytes once prepared."""
        vector = 8 * (values + 3)
        pairs = max(memory // 4 // _BYTES_PER_PAIR, 1)
        width = max(min(_REFERENCES_PER_BLOCK, references, memory // 8 // (3 * vector), pairs), 1)
        height = max(min(_QUERIES_PER_BLOCK, memory // 2 // (_BYTES_PER_SCORE * width), memory // 8 // (3 * vector)), 1)
        return cls(max(memory // 8 // query // height, 1) * height, height, width, max(pairs // width, 1))


def _search(
    best: Retrieval, queries: NDArray, references: NDArray, batch: slice, scores: Scores, sizes: _Sizes
) -> None:
    """Fill the rows of one batch; its queries are prepared once and kept while the references pass by."""
    blocks = [(rows, scores.queries(queries[rows])) for rows in _slices(batch.start, batch.stop, sizes.height)]
    buffer = np.empty(min(sizes.height, batch.stop - batch.start) * sizes.width, dtype=np.float32)
    for columns in _slices(0, len(references), sizes.width):
        prepared = scores.references(references[columns])
        for rows, block in blocks:
            score, slack = scores.block(block, prepared, buffer)
            indices, distances = best.indices[rows], best.distances[rows]
            needed = scores.at(block, distances[:, -1]) - slack
            for part in _slices(0, len(score), sizes.rows):
                row, column = _candidates(score[part], slack[part], needed[part], indices.shape[1])
                if len(row):
                    exact = scores.exact(block, prepared, part.start + row, column)
                    _merge(indices[part], distances[part], row, column + columns.start, exact)


def _candidates(score: NDArray, slack: NDArray, needed: NDArray, k: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column, in order, of what may be among the k nearest so far of queries (n,).

    Args:
        score: of a block of references (n, m).
        slack: by how much the scores may be wrong (n,).
        needed: score below which a reference is not wanted (n,).
        k: neighbours wanted.
    """
    groups, peaks = _groups(score)
    # The k nearest of all are among the k nearest of the block. Where references come nearer and nearer, as along a
    # drive, that is the better bound.
    if k == 1:
        needed = np.maximum(needed, peaks.max(axis=1) - 2 * slack)
        row, group = _reaching(peaks, needed)
    else:
        row, group = _reaching(peaks, needed)
        live = row[np.diff(row, prepend=-1) != 0]
        if len(row) > _MANY_GROUPS * len(live) or np.isinf(needed).any():
            needed[live] = np.maximum(needed[live], _kth_largest(score[live], k) - 2 * slack[live])
            row, group = _reaching(peaks, needed)
    if not len(row):
        return row, group
    place, offset = _reaching(groups[row, group], needed[row])
    return row[place], group[place] * groups.shape[2] + offset


def _groups(score: NDArray) -> tuple[NDArray, NDArray]:
    """Return scores in groups of neighbours (n, groups, size), filled up with -inf, and the groups' maxima."""
    n, width = score.shape
    size = min(_GROUP, width)
    if width % size:
        filled = np.full((n, -(-width // size) * size), -np.inf, dtype=score.dtype)
        filled[:, :width] = score
        score = filled
    peaks = np.maximum.reduceat(score, np.arange(0, score.shape[1], size), axis=1)
    return score.reshape(n, -1, size), peaks


def _reaching(values: NDArray, needed: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column, in order, of the values (n, m) that reach what their row needs (n,)."""
    place = np.flatnonzero(values >= needed.astype(values.dtype)[:, None])
    return place // values.shape[1], place % values.shape[1]


def _merge(indices: NDArray, distances: NDArray, row: NDArray, column: NDArray, exact: NDArray) -> None:
    """Keep the k nearest of those known (n, k) and of the candidates, in place; `row` never decreases."""
    k = indices.shape[1]
    fresh = np.diff(row, prepend=-1) != 0
    live, row = row[fresh], np.cumsum(fresh) - 1
    counts = np.bincount(row)
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
