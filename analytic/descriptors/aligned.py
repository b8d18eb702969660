"""Descriptors whose vectors turn with the robot, so that two of them are compared after turning one like the other.

The turn is the one of the largest circular correlation, which is the one of the smallest Euclidean distance, because
turning leaves lengths. That correlation is also all that the Euclidean, cosine and Pearson distances need beside
lengths and means: no descriptor is turned to find them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import prod
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from analytic.descriptors import circular
from analytic.descriptors.base import Alignment, Description, Match
from analytic.descriptors.image import ImageDescriptor
from analytic.descriptors.threads import each
from analytic.distances import distance as distance_named

_CLOSE = 1e-2


class Turned(NamedTuple):
    """The best turn of each query against each reference.

    Attributes:
        step: (n, m) steps that the query's robot has turned left, in [0, steps).
        peak: (n, m) correlation at that turn.
    """

    step: NDArray[np.int64]
    peak: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class AlignedDescriptor(ImageDescriptor):
    """A descriptor that compares orientation parts (B, K, F) at their best turn ([T] 3.3.4-3.3.5).

    The position part of a description holds the values of the orientation part, in an order of its own; every
    distance of `analytic.DISTANCES` is taken between whole vectors, so that the order does not matter.

    A subclass that aligns by another correlation overrides `_correlation`; one that compares otherwise, `_compared`.
    """

    aligned: ClassVar[bool] = True

    def pairwise(
        self, queries: Description, references: Description, distance: str | None = None
    ) -> NDArray[np.float64]:
        """Return the distances (n, m) at the best turn of each pair; with `circular=False`, without any turn.

        Args:
            queries: n descriptions.
            references: m descriptions; their spectrum is computed once and kept.
            distance: a name in `analytic.DISTANCES`; the default distance if None. Whichever it is, the turn is that
                of the largest correlation.

        Raises:
            AnalyticError: descriptions that cannot be compared, an unknown distance.
        """
        name = self._distance(distance)
        if not self.circular:
            return super().pairwise(queries, references, name)
        self.check(queries, references)
        return self._compared(queries, references, self._turned(queries, references), name)

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading and the aligned Euclidean distance of every pair (n, m); see `Descriptor`."""
        self.check_turns()
        self.check(queries, references)
        steps = self._steps(queries, references)
        turned = self._turned(queries, references)
        heading = circular.heading(turned.step, steps)
        return Alignment(heading, self._compared(queries, references, turned, "euclidean"))

    def localize(self, queries: Description, references: Description, distance: str | None = None) -> Match:
        """Return the nearest reference at its best turn, and the heading that this turn is ([T] 3.3.4-3.3.5).

        Raises:
            AnalyticError: as `Descriptor.localize`.
        """
        if not len(references) or not self.circular:
            return super().localize(queries, references, distance)
        self.check(queries, references)
        steps = self._steps(queries, references)
        turned = self._turned(queries, references)
        apart = self._compared(queries, references, turned, self._distance(distance))
        index = apart.argmin(axis=1)
        rows = np.arange(len(queries))
        return Match(index, apart[rows, index], circular.heading(turned.step[rows, index], steps))

    def _distance(self, name: str | None) -> str:
        name = self.default_distance if name is None else name
        distance_named(name)  # an unknown name is an error before any work
        return name

    def _correlation(
        self, queries: NDArray[np.complex64], references: NDArray[np.complex64], steps: int
    ) -> NDArray[np.float32]:
        """Return what is largest at the best turn, (n, m, steps), of spectra (steps // 2 + 1, n or m, F)."""
        return circular.correlate(queries, references, steps)

    def _turned(self, queries: Description, references: Description) -> Turned:
        """Return the turn of the largest correlation of each pair, the smallest step of equal ones.

        Only a bounded part of the correlations is held at once.
        """
        steps = self._steps(queries, references)
        shape = (len(queries), len(references))
        found = Turned(np.zeros(shape, dtype=np.int64), np.zeros(shape))
        for part in circular.blocks(*shape, steps):
            correlation = self._correlation(queries.spectrum[:, part[0]], references.spectrum[:, part[1]], steps)
            best = correlation.argmax(axis=2)
            found.step[part] = best
            found.peak[part] = np.take_along_axis(correlation, best[..., None], axis=2)[..., 0]
        return found

    def _compared(
        self, queries: Description, references: Description, turned: Turned, name: str
    ) -> NDArray[np.float64]:
        """Return the named distance (n, m) of each pair at its turn."""
        shape = turned.step.shape
        if name == "manhattan":
            apart, close = np.zeros(shape), np.ones(shape, dtype=bool)
        else:
            apart, close = _from_peak(name, turned.peak, _Moments.of(queries), _Moments.of(references))
        assert references.orientation is not None
        values = references.orientation[0].size if len(references) else 0
        for row in np.flatnonzero(close.any(axis=1)).tolist():
            columns = np.flatnonzero(close[row])
            compare = partial(_directly, name, queries, row, references, turned.step[row])
            found = each(compare, np.array_split(columns, max(1, columns.size * values >> 24)))
            apart[row, columns] = np.concatenate(found)
        return apart


class _Moments(NamedTuple):
    """Lengths of vectors, their means, and their lengths without these: (B,) each."""

    norm: NDArray[np.float64]
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]
    values: int

    @staticmethod
    def of(description: Description) -> _Moments:
        # A description never changes; like its spectrum, these are kept with it, since a map has a query after query.
        kept = vars(description)
        if "moments" not in kept:
            assert description.orientation is not None
            flat = description.orientation.reshape(len(description), prod(description.orientation.shape[1:]))
            norm = np.sqrt(np.einsum("bf,bf->b", flat, flat, dtype=np.float64))
            mean = flat.mean(axis=1, dtype=np.float64)
            squares = [np.square(row - middle).sum() for row, middle in zip(flat, mean, strict=True)]
            kept["moments"] = _Moments(norm, mean, np.sqrt(np.array(squares, dtype=np.float64)), flat.shape[1])
        return kept["moments"]


def _from_peak(
    name: str, peak: NDArray[np.float64], queries: _Moments, references: _Moments
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return distances (n, m) from correlation peaks, and which pairs are so close that the result lacks digits.

    Each distance is a difference of two numbers that nearly agree for two similar vectors; the peak has the rounding
    of float32, so that a difference below a hundredth of them is left to a comparison of the values themselves.
    """
    lengths = np.outer(queries.norm, references.norm)
    if name in ("euclidean", "minkowski"):
        both = queries.norm[:, None] ** 2 + references.norm[None, :] ** 2
        squared = both - 2 * peak
        return np.sqrt(np.maximum(squared, 0)), squared < _CLOSE * both
    if name == "cosine":
        scale, product = lengths, peak
    else:
        scale = np.outer(queries.spread, references.spread)
        product = peak - queries.values * np.outer(queries.mean, references.mean)
    similarity = np.divide(product, scale, out=np.zeros_like(peak), where=scale > 0)
    return np.clip(1 - similarity, 0, 2), scale - product < _CLOSE * lengths


def _directly(
    name: str,
    queries: Description,
    row: int,
    references: Description,
    steps: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the distances of one query, turned back by some steps (m,), to some of the references."""
    assert queries.orientation is not None
    assert references.orientation is not None
    query = queries.orientation[row]
    twice = np.concatenate([query, query])  # each turn of the query is a stretch of it: Q[k + s] against R[k]
    measure = distance_named(name)
    apart = np.zeros(len(columns))
    for place, (column, step) in enumerate(zip(columns, steps[columns], strict=True)):
        turned, reference = twice[step : step + len(query)], references.orientation[column]
        if name == "manhattan":
            apart[place] = cv2.norm(turned, reference, cv2.NORM_L1)  # one pass over both, summed in double precision
        else:
            apart[place] = measure(turned.reshape(1, -1), reference.reshape(1, -1))[0, 0]
    return apart
