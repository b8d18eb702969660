"""Exact nearest neighbours: a float32 matrix product finds the candidates, float64 decides among them.

The rounding error of the product is bounded (Higham, *Accuracy and Stability of Numerical Algorithms*, section 3.1:
a sum of D products is off by at most about D u |q| |r|, in any order of summation). Every reference whose score lies
within that bound of the k-th best is compared again in float64, so the result is that of a loop over all pairs in
float64, however many queries are searched at once.

The flat index of faiss answers a single query in an eighth to three quarters of the time (benchmarks/search.py), but
in float32: it guarantees neither the order of float64 nor the smaller row of equally near ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.distances import DISTANCES, unit_vectors
from foundation.calls import typed
from foundation.columns import Rows
from foundation.errors import known
from foundation.settings import Count
from siamloc.errors import DataError

MEMORY = 256 << 20  # bytes that a search uses on top of its input and output
_BYTES_PER_PAIR = 80  # if everything ties: score, mask, two indices, distance, and sorting them
_REFERENCES_PER_BLOCK = 4096  # compared at once
_VALUES_PER_BLOCK = 2**18  # 2 MiB of float64, prepared at once
_VALUES_PER_SLICE = 2**15  # 256 KiB of float64, which fits into a second-level cache
_ROUNDOFF = float(np.finfo(np.float32).eps)
_SMALLEST = float(np.finfo(np.float32).tiny)
_LARGEST = 1e15  # of a scaled query; beyond, float32 products overflow


@dataclass(frozen=True, eq=False)
class Retrieval(Rows):
    """Result of a search for n queries, the nearest reference first.

    Attributes:
        indices: rows of the references (n, k).
        distances: distances to them (n, k), non-decreasing along a row.
        alike: row (n,) of the reference that looks most like each query, wherever it is; None if that is the first.
        strangeness: how little of any reference each query shows (n,), by comparing images; None without a comparison.
    """

    indices: NDArray[np.int64]
    distances: NDArray[np.float64]
    alike: NDArray[np.int64] | None = None
    strangeness: NDArray[np.float64] | None = None

    @property
    def most_alike(self) -> NDArray[np.int64]:
        """Row (n,) of the reference that looks most like each query: the nearest may be in another room."""
        return self.indices[:, 0] if self.alike is None else self.alike


class VectorIndex:
    """Vectors prepared for exact search, which takes the memory of a float32 copy.

    Euclidean distances are ordered by the score q.r - |r|^2 / 2 of centred vectors; centring and scaling keep the
    rounding error small if all vectors lie close together. Cosine and correlation are Euclidean distances between unit
    vectors: 1 - cos = |u - v|^2 / 2. Manhattan distances have no such product and are computed for every pair.

    Args:
        references: (m, D), m and D at least 1; kept in their precision, not copied.
        distance: a name in `analytic.DISTANCES`; "minkowski" is that of order 2.

    Raises:
        ConfigError: an unknown distance.
        DataError: no references, another shape, or values that are not finite.

    Example:
        >>> index = VectorIndex([[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]])
        >>> index.search([[0.0, 0.2]], k=2).indices
        array([[0, 2]])
    """

    @typed
    def __init__(self, references: ArrayLike, distance: str = "euclidean") -> None:
        self.distance = known(distance, DISTANCES, "distance")
        self._references, self._largest = checked(references, "map")
        if 0 in self._references.shape:
            raise DataError("the map holds no descriptors: there is nothing to search in")
        if distance != "manhattan":
            self._prepare()

    def __len__(self) -> int:
        return len(self._references)

    @property
    def width(self) -> int:
        """Number of values in a vector, D."""
        return self._references.shape[1]

    @typed
    def search(
        self,
        queries: ArrayLike,
        k: Count = 1,
        *,
        excluded: ArrayLike | None = None,
        within: NDArray[np.int64] | None = None,
    ) -> Retrieval:
        """Return the exact k nearest references of each query; of equally near ones the smaller row comes first.

        If there are fewer than k references, all are returned: the result has min(k, m) columns. It does not
        depend on the other queries.

        Args:
            queries: (n, D); n may be 0.
            k: number of references to return, at least 1.
            excluded: (n, m) bool, True where a query must not find a reference.
            within: the only rows to search, increasing, not together with `excluded`; all if None.

        Raises:
            ConfigError: a number of neighbours that is not positive.
            DataError: queries of another shape, values that are not finite or far larger than the references', or a
                query with fewer than k references that are not excluded.
        """
        (q, largest), width = checked(queries, "query"), self.width
        if q.shape[1] != width:
            raise DataError(
                f"queries have {q.shape[1]} values each, the map's descriptors {width}: describe both with one model"
            )
        if self.distance in ("euclidean", "minkowski") and largest * self._scale > _LARGEST:
            raise DataError("the queries' values are out of all proportion to the map's: describe both with one model")
        if within is not None:
            rows_fit = within.ndim == 1 and within.dtype.kind in "iu" and ((within >= 0) & (within < len(self))).all()
            if excluded is not None or not rows_fit:
                raise DataError(f"within takes rows from 0 to {len(self) - 1}, and not together with excluded")
        m = len(self) if within is None else len(within)
        k = min(k, m)
        mask = None if excluded is None else check_excluded(excluded, (len(q), len(self)), k)
        found = Retrieval(np.zeros((len(q), k), dtype=np.int64), np.zeros((len(q), k)))
        for block in slices(len(q), MEMORY // 3 // (4 * m)):
            looked, scores, slack = self._look(q[block], within)
            if mask is not None:
                scores[mask[block]] = -np.inf
            for part in slices(len(scores), MEMORY // 2 // (_BYTES_PER_PAIR * m)):
                row, column = _candidates(scores[part], slack[part], k)
                rows = column if within is None else within[column]
                if self.distance == "manhattan":
                    apart = -scores[part][row, column].astype(np.float64)
                else:
                    apart = self._distances(looked[part], row, rows)
                place = slice(block.start + part.start, block.start + part.stop)
                found.indices[place], found.distances[place] = _nearest(row, rows, apart, k)
        return found

    def _look(self, queries: NDArray, within: NDArray[np.int64] | None) -> tuple[NDArray, NDArray, NDArray[np.float64]]:
        """Score queries against the references: the higher, the nearer.

        Returns:
            The queries in the form from which distances are computed (n, D'), the scores (n, m), and the largest
            possible error of each row's scores (n,).
        """
        if self.distance == "manhattan":
            references = self._references if within is None else self._references[within]
            scores = np.empty((len(queries), len(references)))
            for columns in slices(len(references), _REFERENCES_PER_BLOCK):
                scores[:, columns] = -DISTANCES["manhattan"](queries, references[columns])
            return queries, scores, np.zeros(len(queries))
        embedded = self._embed(queries, is_query=True)
        left = np.ones((len(queries), self._product.shape[1]), dtype=np.float32)
        left[:, :-1] = (embedded - self._centre) * self._scale
        right = self._product if within is None else self._product[within]
        norm = np.sqrt(np.einsum("ij,ij->i", left[:, :-1], left[:, :-1], dtype=np.float64))
        rounding = _ROUNDOFF * (norm * self._longest + self._longest**2) + _SMALLEST
        return embedded, left @ right.T, (left.shape[1] + 8) * rounding

    def _distances(
        self, queries: NDArray[np.float64], row: NDArray[np.int64], column: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the distances of pairs (p,), from float64 differences of the vectors."""
        squared = np.empty(len(row))
        for part in slices(len(row), _VALUES_PER_SLICE // queries.shape[1]):
            difference = self._embed(self._references[column[part]], is_query=False)
            difference -= queries[row[part]]
            # One dot product per pair: its bits do not depend on what else is in the slice.
            squared[part] = np.matmul(difference[:, None, :], difference[:, :, None])[:, 0, 0]
        if self.distance in ("cosine", "correlation"):
            squared[queries[row, -1] == 1] = 2  # of zero queries: rounding must not order what is equally far
            return np.minimum(squared / 2, 2.0)
        return np.sqrt(squared)

    def _prepare(self) -> None:
        """Centre and scale the references, and add a column with the constant term of the score."""
        m, angular = len(self), self.distance in ("cosine", "correlation")
        largest = 1.0 if angular else self._largest
        # A power of two, so that scaling is exact.
        self._scale = float(np.exp2(-np.ceil(np.log2(largest)))) if largest > 1e-290 else 1.0
        rows = max(1, _VALUES_PER_BLOCK // self._references.shape[1])
        # Any centre gives the right result, so a sample of a large map is enough.
        self._centre = self._embed(self._references[:: -(-m // rows)], is_query=False).mean(axis=0)
        self._product = np.empty((m, len(self._centre) + 1), dtype=np.float32)
        squares = np.empty(m)
        for part in slices(m, rows):
            product = self._product[part, :-1]
            product[:] = (self._embed(self._references[part], is_query=False) - self._centre) * self._scale
            squares[part] = np.einsum("ij,ij->i", product, product, dtype=np.float64)
        self._product[:, -1] = -squares / 2
        self._longest = float(np.sqrt(squares.max()))

    def _embed(self, vectors: NDArray, *, is_query: bool) -> NDArray[np.float64]:
        """Return float64 vectors (n, D) or (n, D + 2) whose Euclidean distance gives the distance of this index.

        A zero vector is at cosine distance 1 from everything. Two more coordinates, one for zero queries and one for
        zero references, ensure that.
        """
        values = vectors.astype(np.float64)
        if self.distance not in ("cosine", "correlation"):
            return values
        # Dividing by the largest value first keeps the squares inside the range of float64.
        largest = np.abs(values).max(axis=1, keepdims=True)
        unit = np.zeros((len(values), values.shape[1] + 2))
        unit[:, :-2] = unit_vectors(values / np.where(largest > 0, largest, 1), self.distance == "correlation")
        unit[~unit.any(axis=1), -1 if is_query else -2] = 1
        return unit


def _candidates(scores: NDArray, slack: NDArray, k: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, in order, row and column of all scores (n, m) that may be among the k highest of their rows."""
    m = scores.shape[1]
    best = scores.max(axis=1) if k == 1 else np.partition(scores, m - k, axis=1)[:, m - k]
    needed = (best.astype(np.float64) - 2 * slack).astype(scores.dtype)
    place = np.flatnonzero(scores >= needed[:, None])
    return place // m, place % m


def _nearest(
    row: NDArray[np.int64], column: NDArray[np.int64], apart: NDArray[np.float64], k: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return columns and distances (n, k) of the nearest candidates of each row, which has at least k."""
    # Columns increase within a row, so that a stable sort settles ties.
    order = np.lexsort((apart, row))
    first = np.flatnonzero(np.diff(row, prepend=-1))
    chosen = order[first[:, None] + np.arange(k)]
    return column[chosen], apart[chosen]


def slices(count: int, step: int) -> Iterator[slice]:
    """Yield consecutive slices of up to `step` rows (`step` at least 1) that cover `count` rows."""
    step = max(step, 1)
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def check_excluded(excluded: ArrayLike, shape: tuple[int, ...], k: int) -> NDArray[np.bool_]:
    """Return the mask (n, m) of references that queries must not find, after checking it.

    Raises:
        DataError: another shape or type, or a query with fewer than k references left.
    """
    mask = np.asarray(excluded)
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise DataError(f"excluded must be true or false of shape {shape}, got {mask.dtype} {mask.shape}")
    left = (~mask).sum(axis=1)
    if (left < k).any():
        raise DataError(
            f"{int((left < k).sum())} of {len(mask)} queries have fewer than {k} map frames that they may find, the "
            f"first has {left[left < k][0]}: exclude less, ask for fewer neighbours, or take more frames into the map"
        )
    return mask


def array_of(given: Any) -> NDArray:
    """Return an array, or a tensor on any device, as an array, in float32 if numpy lacks its type, as bfloat16."""
    if hasattr(given, "detach"):
        given = given.detach().cpu()
        try:
            given = given.numpy()
        except TypeError:
            given = given.float().numpy()
    return np.asarray(given)


def checked(array: ArrayLike, what: str) -> tuple[NDArray, float]:
    """Return descriptors (n, D) and their largest absolute value.

    Raises:
        DataError: descriptors of another shape or type, or values that are not finite.
    """
    values = array_of(array)
    if values.dtype.kind not in "biuf":
        raise DataError(f"a search needs {what} descriptors of real numbers, got {values.dtype}")
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    if values.ndim != 2:
        raise DataError(f"a search needs {what} descriptors of shape (n, D), got shape {values.shape}")
    largest = float(np.maximum(values.max(initial=0), -values.min(initial=0)))  # NaN if there is one
    if not np.isfinite(largest):
        bad = int((~np.isfinite(values)).any(axis=1).sum())
        raise DataError(
            f"{bad} of {len(values)} {what} descriptors hold values that are not finite: "
            "look at the model and at these images"
        )
    return values, largest
