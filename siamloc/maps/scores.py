"""Scores that find candidates quickly, and the exact distances that decide among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analytic.distances import distance as pairwise_distance

_ROUNDOFF = float(np.finfo(np.float32).eps)
_SMALLEST = float(np.finfo(np.float32).tiny)
_VALUES_PER_SLICE = 1 << 17  # 1 MiB of float64: a slice of candidates stays in the processor's cache
_SAMPLE = 4096


class Scores(Protocol):
    """What a search needs to know of a distance. A higher score is nearer."""

    def queries(self, queries: NDArray) -> Any:
        """Prepare a block of queries (n, D)."""

    def bytes_per_query(self, queries: NDArray) -> int:
        """Return what a prepared query (of these) takes."""

    def references(self, references: NDArray) -> Any:
        """Prepare a block of references (m, D)."""

    def block(
        self, queries: Any, references: Any, buffer: NDArray[np.float32] | None = None
    ) -> tuple[NDArray, NDArray[np.float64]]:
        """Return the scores (n, m), in the buffer (at least n m) if need be, and by how much a row's may be wrong (n,).

        A buffer saves asking the system for memory again and again.
        """

    def at(self, queries: Any, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the true scores of references at these distances (n,), one of each query."""

    def exact(self, queries: Any, references: Any, row: NDArray, column: NDArray) -> NDArray[np.float64]:
        """Return the distances of pairs (p,), the same bits in whatever block a pair stands; rows never decrease."""


@dataclass(frozen=True)
class _Block:
    vectors: NDArray  # that the exact distances are measured between (n, D'); float32 only where nothing is lost
    product: NDArray[np.float32]  # centred, scaled, and with one column for the constant term (n, D' + 1)
    norm: NDArray[np.float64]  # lengths of the centred, scaled vectors (n,)


class ProductScores:
    """Euclidean, cosine and correlation distance through the score q.r - |r|^2 / 2 of centred vectors.

    Cosine and correlation are Euclidean distances between unit vectors: 1 - cos = |u - v|^2 / 2. A zero vector is at
    distance 1 from everything; two more coordinates, one for zero queries and one for zero references, make
    that so. Centring on the map's mean and scaling keep the rounding small where all descriptors lie close together.

    Args:
        distance: "euclidean", "cosine" or "correlation".
        queries: all queries (n, D), for the scale.
        references: all references (m, D), for the centre and the scale.
    """

    def __init__(self, distance: str, queries: NDArray, references: NDArray) -> None:
        self._distance = distance
        largest = 1.0
        if distance == "euclidean":
            largest = max(abs(float(f(a))) for a in (queries, references) if a.size for f in (np.min, np.max))
        # A power of two, so that scaling rounds nothing.
        self._scale = float(np.exp2(-np.ceil(np.log2(largest)))) if largest > 1e-290 else 1.0
        # float32 descriptors are centred in float32: with a centre in float32 that rounds once, as any way would.
        self._single = distance == "euclidean" and 1e-30 < largest < 1e30
        # Any centre gives the right answer, so a sample of a large map will do.
        centre = self._embed(references[:: -(-len(references) // _SAMPLE)], is_query=False).mean(axis=0)
        self._centre = centre.astype(np.float32).astype(np.float64) if self._single else centre

    def queries(self, queries: NDArray) -> _Block:
        """Prepare a block of queries."""
        block = self._prepare(queries, is_query=True)
        block.product[:, -1] = 1
        return block

    def bytes_per_query(self, queries: NDArray) -> int:
        """Return what a prepared query takes; float32 values are not kept a second time."""
        width = queries.shape[1] + 3
        return 4 * width if self._single and queries.dtype == np.float32 else 16 * width

    def references(self, references: NDArray) -> _Block:
        """Prepare a block of references."""
        block = self._prepare(references, is_query=False)
        block.product[:, -1] = -(block.norm**2) / 2
        return block

    def block(
        self, queries: _Block, references: _Block, buffer: NDArray[np.float32] | None = None
    ) -> tuple[NDArray, NDArray[np.float64]]:
        """Return the scores and the bound of their rounding error."""
        longest = references.norm.max()
        terms = queries.product.shape[1] + 8
        slack = terms * (_ROUNDOFF * (queries.norm * longest + longest**2) + _SMALLEST)
        n, m = len(queries.product), len(references.product)
        out = None if buffer is None else buffer[: n * m].reshape(n, m)
        return np.matmul(queries.product, references.product.T, out=out), slack

    def at(self, queries: _Block, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the scores that belong to distances, a little lower than exact."""
        if self._distance == "euclidean":
            squared = (distances * self._scale) ** 2
        else:
            squared = 2 * distances * self._scale**2
        # The norm is that of the rounded vector, and the difference cancels where both are large.
        return (queries.norm**2 - squared) / 2 - 4 * _ROUNDOFF * (queries.norm**2 + squared)

    def exact(self, queries: _Block, references: _Block, row: NDArray, column: NDArray) -> NDArray[np.float64]:
        """Return the distances of pairs from the differences of the vectors in float64."""
        squared = _squared_distances(queries.vectors, references.vectors, row, column)
        return np.sqrt(squared) if self._distance == "euclidean" else np.minimum(squared / 2, 2.0)

    def _prepare(self, raw: NDArray, *, is_query: bool) -> _Block:
        """Return a block whose last column, the constant term, is still free."""
        if self._single and raw.dtype == np.float32:
            vectors = raw if is_query else raw.astype(np.float64)
            product = np.empty((len(raw), raw.shape[1] + 1), dtype=np.float32)
            np.subtract(raw, self._centre.astype(np.float32), out=product[:, :-1])
            product[:, :-1] *= np.float32(self._scale)
        else:
            vectors = self._embed(raw, is_query=is_query)
            product = np.empty((len(raw), vectors.shape[1] + 1), dtype=np.float32)
            product[:, :-1] = (vectors - self._centre) * self._scale
        squared = np.einsum("ij,ij->i", product[:, :-1], product[:, :-1], dtype=np.float64)
        return _Block(vectors, product, np.sqrt(squared))

    def _embed(self, vectors: NDArray, *, is_query: bool) -> NDArray[np.float64]:
        """Return vectors whose Euclidean distance is, or tells, the wanted one: (n, D) or (n, D + 2) float64."""
        values = vectors.astype(np.float64, copy=False)
        if self._distance == "euclidean":
            return values
        if self._distance == "correlation":
            mean = values.mean(axis=1, keepdims=True)
            rounding = 1e-12 * np.abs(values).max(axis=1, keepdims=True)
            values = values - mean
            values[np.abs(values).max(axis=1) <= rounding[:, 0]] = 0
        # Dividing by the largest value first keeps the squares inside the range of float64.
        largest = np.abs(values).max(axis=1, keepdims=True)
        values = np.divide(values, largest, out=np.zeros_like(values), where=largest > 0)
        norm = np.linalg.norm(values, axis=1, keepdims=True)
        unit = np.zeros((len(values), values.shape[1] + 2))
        np.divide(values, norm, out=unit[:, :-2], where=norm > 0)
        unit[norm[:, 0] == 0, -1 if is_query else -2] = 1
        return unit


def _squared_distances(
    queries: NDArray, references: NDArray[np.float64], row: NDArray, column: NDArray
) -> NDArray[np.float64]:
    """Return the squared distances of pairs from their differences in float64; rows never decrease."""
    squared = np.empty(len(row))
    width = references.shape[1]
    step = max(_VALUES_PER_SLICE // width, 1)
    left, right = np.empty((step, width)), np.empty((step, width))
    fresh = np.diff(row, prepend=-1) != 0
    rows, number = row[fresh], np.cumsum(fresh) - 1
    for start in range(0, len(row), step):
        part = slice(start, min(start + step, len(row)))
        n = part.stop - start
        # The few queries of a slice are widened to float64 once, and then copied from the processor's cache.
        first, last = number[start], number[part.stop - 1]
        few = queries.take(rows[first : last + 1], axis=0).astype(np.float64, copy=False)
        # mode="clip" lets numpy write straight into the buffers; the indices are in range anyway.
        difference = np.take(few, number[part] - first, axis=0, out=left[:n], mode="clip")
        difference -= np.take(references, column[part], axis=0, out=right[:n], mode="clip")
        # One dot product per pair: its bits do not depend on what else is in the slice.
        squared[part] = np.matmul(difference[:, None, :], difference[:, :, None])[:, 0, 0]
    return squared


class DirectScores:
    """Distances that no matrix product gives, computed in float64 for every pair."""

    def __init__(self, distance: str) -> None:
        self._distance = pairwise_distance(distance)
        self._last: NDArray[np.float64] = np.empty((0, 0))

    def queries(self, queries: NDArray) -> NDArray[np.float64]:
        """Return a block of queries in float64."""
        return queries.astype(np.float64, copy=False)

    def bytes_per_query(self, queries: NDArray) -> int:
        """Return what a query takes in float64."""
        return 8 * queries.shape[1]

    def references(self, references: NDArray) -> NDArray[np.float64]:
        """Return a block of references in float64."""
        return references.astype(np.float64, copy=False)

    def block(
        self, queries: NDArray, references: NDArray, buffer: NDArray[np.float32] | None = None
    ) -> tuple[NDArray, NDArray[np.float64]]:
        """Return the negative distances; they are exact."""
        self._last = self._distance(queries, references)
        return -self._last, np.zeros(len(queries))

    def at(self, queries: NDArray, distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the negative distances."""
        return -distances

    def exact(self, queries: NDArray, references: NDArray, row: NDArray, column: NDArray) -> NDArray[np.float64]:
        """Return the distances of pairs of the block that was scored last."""
        return self._last[row, column]
