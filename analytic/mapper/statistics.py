"""The Gaussian of a node's frames: moments that grow, a shrunk covariance, and distances to it ([I] eq. 3 and 10).

A node has fewer frames than its descriptor has dimensions, so its covariance has no inverse. It is shrunk towards a
multiple of the identity: (1 - a) S + a (trace S / D) I, with the intensity a of Ledoit and Wolf by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analytic.errors import AnalyticError

Array = NDArray[np.float64]

_LEAST_SHRINKAGE = 1e-6  # two frames, or frames on one line, have intensity 0 and a covariance without inverse
_LEAST_VARIANCE = 1e-12  # of equal frames, relative to their mean square
_NO_VARIANCE = 1e-30  # of frames that are all zero


@dataclass(frozen=True)
class Moments:
    """Mean and scatter of a growing set of vectors, updated without revisiting the vectors.

    In addition to the mean m and the scatter M = sum y y^T (y = x - m), two sums are kept for the shrinkage intensity:
    b = sum |y|^2 y and f = sum |y|^4. About m + d instead of m, with t = trace M and n vectors, they are

        M + n d d^T,    b - 2 M d - t d - n |d|^2 d,    f + 4 d^T M d + n |d|^4 - 4 b d + 2 t |d|^2,

    because sum y = 0. Adding, removing and merging are this change of origin plus a sum.

    Attributes:
        count: n.
        mean: (D,).
        scatter: (D, D) sum of y y^T; n times the covariance.
        third: (D,) sum of |y|^2 y.
        fourth: sum of |y|^4.
    """

    count: int
    mean: Array
    scatter: Array
    third: Array
    fourth: float

    @property
    def trace(self) -> float:
        """Return trace M, the sum of |y|^2."""
        return float(np.trace(self.scatter))

    @staticmethod
    def none(size: int) -> Moments:
        """Return the moments of an empty set of vectors of that size."""
        return Moments(0, np.zeros(size), np.zeros((size, size)), np.zeros(size), 0.0)

    def add(self, x: Array) -> Moments:
        """Return the moments with one more vector (D,)."""
        count = self.count + 1
        away = x - self.mean
        shift = away / count
        third, fourth = self._higher_about(shift)
        y = away - shift
        square = float(y @ y)
        scatter = _plus_outer(self.scatter, away, self.count / count)
        return Moments(count, self.mean + shift, scatter, third + square * y, fourth + square**2)

    def remove(self, x: Array) -> Moments:
        """Return the moments without one of the vectors (D,), which must be among them."""
        count = self.count - 1
        if count == 0:
            return Moments.none(len(self.mean))
        away = self.mean - x
        shift = away / count
        third, fourth = self._higher_about(shift)
        y = -(away + shift)
        square = float(y @ y)
        scatter = _plus_outer(self.scatter, away, -self.count / count)
        return Moments(count, self.mean + shift, scatter, third - square * y, fourth - square**2)

    def merge(self, other: Moments) -> Moments:
        """Return the moments of both sets together."""
        count = self.count + other.count
        if not self.count or not other.count:
            return self if self.count else other
        apart = other.mean - self.mean
        here, there = apart * (other.count / count), -apart * (self.count / count)
        own, others = self._higher_about(here), other._higher_about(there)
        scatter = _plus_outer(self.scatter + other.scatter, apart, self.count * other.count / count)
        return Moments(count, self.mean + here, scatter, own[0] + others[0], own[1] + others[1])

    def ledoit_wolf(self) -> float:
        """Compute the shrinkage intensity of Ledoit and Wolf (2004), in [0, 1].

        With S = M / n and p = D: b2 = (f / n - |S|^2) / n against d2 = |S|^2 - trace(S)^2 / p, and min(b2, d2) / d2.
        """
        size = len(self.mean)
        spread = float(np.einsum("ij,ij->", self.scatter, self.scatter)) / self.count**2
        trace = self.trace / self.count
        excess = spread - trace**2 / size
        error = min((self.fourth / self.count - spread) / self.count, excess)
        return error / excess if error > 0 and excess > 0 else 0.0

    def _higher_about(self, shift: Array) -> tuple[Array, float]:
        square = float(shift @ shift)
        along = self.scatter @ shift
        third = self.third - 2 * along - (self.trace + self.count * square) * shift
        fourth = self.fourth + 4 * float(shift @ along) + self.count * square**2
        return third, fourth - 4 * float(self.third @ shift) + 2 * self.trace * square


@dataclass(frozen=True)
class Model:
    """The frames that model a node: their moments, their shrunk covariance, and distances to them.

    Attributes:
        moments: moments of those frames.
        shrinkage: "ledoit_wolf" or a fixed intensity.
    """

    moments: Moments
    shrinkage: str | float

    def add(self, x: Array) -> Model:
        """Return the model with one more frame (D,)."""
        return Model(self.moments.add(x), self.shrinkage)

    def remove(self, x: Array) -> Model:
        """Return the model without one of its frames (D,)."""
        return Model(self.moments.remove(x), self.shrinkage)

    def merge(self, other: Model) -> Model:
        """Return the model of the frames of both."""
        return Model(self.moments.merge(other.moments), self.shrinkage)

    @cached_property
    def intensity(self) -> float:
        """The share of the identity in the covariance."""
        if isinstance(self.shrinkage, str):
            return max(self.moments.ledoit_wolf(), _LEAST_SHRINKAGE)
        return float(self.shrinkage)

    @property
    def least(self) -> float:
        """The variance that shrinking adds to every direction: intensity times mean variance."""
        moments = self.moments
        variance = moments.trace / (moments.count * len(moments.mean))
        least = _LEAST_VARIANCE * float(np.mean(np.square(moments.mean)))
        return self.intensity * max(variance, least, _NO_VARIANCE)

    @property
    def weight(self) -> float:
        """The factor of the scatter in the covariance."""
        return (1 - self.intensity) / self.moments.count

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Return the shrunk covariance (D, D)."""
        covariance = self.moments.scatter * self.weight
        covariance[np.diag_indices(len(covariance))] += self.least
        return covariance

    @cached_property
    def factored(self) -> Factored:
        """The squared Mahalanobis distances (d - mean)^T covariance^-1 (d - mean), computed as defined."""
        return Factored.of(self.moments.mean, self.covariance, self.least)

    @property
    def few(self) -> bool:
        """Whether there are so few frames that distances cost less without the covariance."""
        return 2 * self.moments.count <= len(self.moments.mean)

    def metric(self, rows: NDArray[np.float64] | None) -> Metric:
        """Return the same distances in the cheaper form.

        Args:
            rows: (n, D) the frames that model the node; needed only if there are few.
        """
        if rows is None or not self.few:
            return self.factored
        return LowRank.of(self.moments.mean, rows, self.weight, self.least)


@dataclass(frozen=True)
class Factored:
    """Squared Mahalanobis distances from the Cholesky factor of the covariance, D^2 / 2 products each.

    Attributes:
        mean: (D,).
        least: a variance that no direction falls below.
        factor: (D, D) lower triangle; the values above it have no meaning.
    """

    mean: Array
    least: float
    factor: Array

    @staticmethod
    def of(mean: Array, covariance: Array, least: float) -> Factored:
        """Prepare the distances of a covariance (D, D).

        Raises:
            AnalyticError: the covariance has no inverse.
        """
        return Factored(mean, least, _cholesky(covariance))

    def distance(self, point: Array) -> float:
        """Return the squared distance of a point (D,)."""
        from scipy.linalg import blas

        solved = blas.dtrsv(self.factor, point - self.mean, lower=1)
        return float(solved @ solved)

    def distances(self, points: Array) -> Array:
        """Return the squared distances (n,) of points (n, D)."""
        from scipy.linalg import blas

        solved = blas.dtrsm(1.0, self.factor, np.asfortranarray((points - self.mean).T), lower=1)
        return np.einsum("dn,dn->n", solved, solved)


@dataclass(frozen=True)
class LowRank:
    """The same distances from the frames that model the covariance, for at most half as many frames as dimensions.

    The covariance of n frames with D numbers each is c I + s Y^T Y: Y (n, D) holds the frames about their mean, s is
    (1 - a) / n for the intensity a, and c the variance that shrinking adds to every direction. By Woodbury's identity

        (c I + s Y^T Y)^-1 = (I - Y^T (c/s I + Y Y^T)^-1 Y) / c = (I - W^T W) / c,  W = L^-1 Y,  L L^T = c/s I + Y Y^T,

    the squared distance of z = d - mean is (|z|^2 - |W z|^2) / c: n D products and as much memory, without ever
    forming the covariance. The difference loses no more precision than solving does: its error is eps |z|^2 / c, and
    |z|^2 over the largest eigenvalue is the least that the distance can be, so relative to the distance the error is
    eps times the condition number of the covariance.

    Attributes:
        mean: (D,).
        least: c, the least variance of any direction.
        whitened: W (n, D).
    """

    mean: Array
    least: float
    whitened: Array

    @staticmethod
    def of(mean: Array, rows: Array, weight: float, least: float) -> LowRank:
        """Prepare the distances of the covariance least * I + weight * sum y y^T.

        Args:
            mean: (D,).
            rows: (n, D) frames; y is a frame less the mean.
            weight: s; 0 leaves the identity alone.
            least: c.

        Raises:
            AnalyticError: the covariance has no inverse.
        """
        from scipy.linalg import blas

        if weight == 0:
            return LowRank(mean, least, np.empty((0, len(mean))))
        away = rows - mean
        inner = away @ away.T
        inner[np.diag_indices(len(inner))] += least / weight
        whitened = blas.dtrsm(1.0, _cholesky(inner), np.asfortranarray(away), lower=1)
        return LowRank(mean, least, np.ascontiguousarray(whitened))

    def distance(self, point: Array) -> float:
        """Return the squared distance of a point (D,)."""
        away = point - self.mean
        inside = self.whitened.dot(away)
        return max(float(away.dot(away) - inside.dot(inside)), 0.0) / self.least

    def distances(self, points: Array) -> Array:
        """Return the squared distances (n,) of points (n, D)."""
        away = points - self.mean
        inside = away @ self.whitened.T
        squares = np.einsum("nd,nd->n", away, away) - np.einsum("nk,nk->n", inside, inside)
        return np.maximum(squares, 0.0) / self.least


Metric = Factored | LowRank


def _cholesky(matrix: Array) -> Array:
    """Return the lower factor of a symmetric matrix (n, n)."""
    from scipy.linalg import lapack

    factor, failed = lapack.dpotrf(np.asfortranarray(matrix), lower=1, clean=0, overwrite_a=1)
    if failed:
        raise AnalyticError(
            "the covariance of a node cannot be inverted: its descriptors differ too little for their size; choose a "
            "larger fixed shrinkage"
        )
    return factor


def _plus_outer(matrix: Array, vector: Array, weight: float) -> Array:
    total = np.multiply.outer(vector, vector * weight)
    total += matrix
    return total
