"""Squared Mahalanobis distances to a shrunk covariance, in the form that costs least ([I] eq. 3 and 10).

The covariance of n frames with D numbers each is c I + s Y^T Y: Y (n, D) holds the frames about their mean, s is
(1 - a) / n for the intensity a, and c the variance that shrinking adds to every direction. `Factored` solves with its
Cholesky factor, which costs D^2 / 2 products for a distance. `LowRank` needs n D of them and as much memory, without
ever forming the covariance. It gives the same distances, because of Woodbury's identity

    (c I + s Y^T Y)^-1 = (I - Y^T (c/s I + Y Y^T)^-1 Y) / c = (I - W^T W) / c,    W = L^-1 Y,    L L^T = c/s I + Y Y^T,

so that the squared distance of z = d - mean is (|z|^2 - |W z|^2) / c. The difference loses no more digits than solving
does: it has an error of eps |z|^2 / c, and |z|^2 over the largest eigenvalue is the least that the distance can be, so
that relative to the distance the error is eps times the condition number of the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analytic.errors import AnalyticError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Factored:
    """Distances by the Cholesky factor of the covariance.

    Attributes:
        mean: (D,).
        least: a variance that no direction falls below.
        factor: (D, D) lower triangle; what stands above it has no meaning.
    """

    mean: Array
    least: float
    factor: Array

    @staticmethod
    def of(mean: Array, covariance: Array, least: float) -> Factored:
        """Return the distances of a covariance (D, D).

        Raises:
            AnalyticError: one that has no inverse.
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
    """Distances by the frames that model the covariance, which are fewer than half its dimensions.

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
        """Return the distances of the covariance least * I + weight * sum y y^T.

        Args:
            mean: (D,).
            rows: (n, D) frames; y is a frame less the mean.
            weight: s; 0 leaves the identity alone.
            least: c.

        Raises:
            AnalyticError: a covariance that has no inverse.
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
            "the covariance of a node cannot be inverted: its descriptors differ by too little against their "
            "size, so that a larger fixed shrinkage is needed"
        )
    return factor
