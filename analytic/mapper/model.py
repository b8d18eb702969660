"""The covariance of the frames that model a node, shrunk so that it has an inverse ([I] eq. 3 and 10).

A node has fewer frames than its descriptor has dimensions, so that its covariance has no inverse. It is shrunk towards
a multiple of the identity: (1 - a) S + a (trace S / D) I, with the intensity of Ledoit and Wolf by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analytic.mapper.metric import Factored, LowRank, Metric
from analytic.mapper.moments import Moments, Vector

_LEAST_SHRINKAGE = 1e-6  # two frames, or frames on one line, have intensity 0 and a covariance without inverse
_LEAST_VARIANCE = 1e-12  # of frames that are all equal, relative to their mean square
_NO_VARIANCE = 1e-30  # of frames that are all zero


@dataclass(frozen=True)
class Model:
    """The frames that model a node: their moments, and how far points are from them once that is asked for.

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

    @cached_property
    def intensity(self) -> float:
        """Return the share of the identity in the covariance."""
        if isinstance(self.shrinkage, str):
            return max(self.moments.ledoit_wolf(), _LEAST_SHRINKAGE)
        return float(self.shrinkage)

    @property
    def least(self) -> float:
        """Return the variance that shrinking adds to every direction: intensity times mean variance."""
        moments = self.moments
        variance = moments.trace / (moments.count * len(moments.mean))
        least = _LEAST_VARIANCE * float(np.mean(np.square(moments.mean)))
        return self.intensity * max(variance, least, _NO_VARIANCE)

    @property
    def weight(self) -> float:
        """Return what the scatter is multiplied by in the covariance."""
        return (1 - self.intensity) / self.moments.count

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Return the shrunk covariance (D, D)."""
        covariance = self.moments.scatter * self.weight
        covariance[np.diag_indices(len(covariance))] += self.least
        return covariance

    @cached_property
    def factored(self) -> Factored:
        """Return the squared Mahalanobis distances (d - mean)^T covariance^-1 (d - mean) as they are defined."""
        return Factored.of(self.moments.mean, self.covariance, self.least)

    @property
    def few(self) -> bool:
        """Return whether there are so few frames that distances cost less without the covariance."""
        return 2 * self.moments.count <= len(self.moments.mean)

    def metric(self, rows: NDArray[np.float64] | None) -> Metric:
        """Return the same distances in the form that costs less.

        Args:
            rows: (n, D) the frames that model the node; asked for only if they are few.
        """
        if rows is None or not self.few:
            return self.factored
        return LowRank.of(self.moments.mean, rows, self.weight, self.least)
