"""Mahalanobis distances to a shrunk covariance ([I] eq. 3 and 10).

A node has fewer frames than its descriptor has dimensions, so that its covariance has no inverse. It is shrunk towards
a multiple of the identity: (1 - a) S + a (trace S / D) I, with the intensity of Ledoit and Wolf by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analytic.errors import AnalyticError
from analytic.mapper.moments import Moments, Vector

_LEAST_SHRINKAGE = 1e-6  # two frames, or frames on one line, have intensity 0 and a covariance without inverse
_LEAST_VARIANCE = 1e-12  # of frames that are all equal, relative to their mean square
_NO_VARIANCE = 1e-30  # of frames that are all zero


@dataclass(frozen=True)
class Model:
    """The frames that model a node: their moments, and the factor of the covariance once it is asked for.

    Attributes:
        moments: of those frames.
        shrinkage: "ledoit_wolf" or a fixed intensity.
    """

    moments: Moments
    shrinkage: str | float

    def add(self, x: Vector) -> Model:
        """Return the model with one frame (D,) more."""
        return Model(self.moments.add(x), self.shrinkage)

    def remove(self, x: Vector) -> Model:
        """Return the model without one of its frames (D,)."""
        return Model(self.moments.remove(x), self.shrinkage)

    def merge(self, other: Model) -> Model:
        """Return the model of the frames of both."""
        return Model(self.moments.merge(other.moments), self.shrinkage)

    @property
    def intensity(self) -> float:
        """Return the share of the identity in the covariance."""
        if isinstance(self.shrinkage, str):
            return max(self.moments.ledoit_wolf(), _LEAST_SHRINKAGE)
        return float(self.shrinkage)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Return the shrunk covariance (D, D)."""
        moments, a = self.moments, self.intensity
        variance = float(np.trace(moments.scatter)) / (moments.count * len(moments.mean))
        least = _LEAST_VARIANCE * float(np.mean(np.square(moments.mean)))
        variance = max(variance, least, _NO_VARIANCE)
        covariance = moments.scatter * ((1 - a) / moments.count)
        covariance[np.diag_indices(len(covariance))] += a * variance
        return covariance

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the squared Mahalanobis distances (n,) of points (n, D): (d - mean)^T covariance^-1 (d - mean)."""
        from scipy.linalg import blas

        away = np.asfortranarray((points - self.moments.mean).T)
        if len(points) == 1:
            one = blas.dtrsv(self._factor, away[:, 0], lower=1)
            return np.array([one @ one])
        solved = blas.dtrsm(1.0, self._factor, away, lower=1)
        return np.einsum("dn,dn->n", solved, solved)

    @cached_property
    def _factor(self) -> NDArray[np.float64]:
        from scipy.linalg import lapack

        factor, failed = lapack.dpotrf(np.asfortranarray(self.covariance), lower=1, clean=0, overwrite_a=1)
        if failed:
            raise AnalyticError(
                "the covariance of a node cannot be inverted: its descriptors differ by too little against their "
                "size, so that a larger fixed shrinkage is needed"
            )
        return factor
