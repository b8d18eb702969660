"""Mean and covariance of a growing set of vectors, kept without looking at the vectors again.

Besides the mean m and the scatter M = sum y y^T (y = x - m), two sums are kept for the sake of the shrinkage intensity:
b = sum |y|^2 y and f = sum |y|^4. Seen from m + d instead of m, with t = trace M and n vectors, they are

    M + n d d^T,    b - 2 M d - t d - n |d|^2 d,    f + 4 d^T M d + n |d|^4 - 4 b d + 2 t |d|^2,

because sum y = 0. Adding, removing and merging are this change of viewpoint and a sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """Sums over `count` vectors about their mean.

    Attributes:
        count: n.
        mean: (D,).
        scatter: (D, D) sum of y y^T; n times the covariance.
        third: (D,) sum of |y|^2 y.
        fourth: sum of |y|^4.
    """

    count: int
    mean: Vector
    scatter: Vector
    third: Vector
    fourth: float

    @property
    def trace(self) -> float:
        """Return trace M, the sum of |y|^2."""
        return float(np.trace(self.scatter))

    @staticmethod
    def none(size: int) -> Moments:
        """Return the moments of no vector of that size."""
        return Moments(0, np.zeros(size), np.zeros((size, size)), np.zeros(size), 0.0)

    def add(self, x: Vector) -> Moments:
        """Return the moments with one vector (D,) more."""
        count = self.count + 1
        away = x - self.mean
        shift = away / count
        third, fourth = self._higher_about(shift)
        y = away - shift
        square = float(y @ y)
        scatter = _plus_outer(self.scatter, away, self.count / count)
        return Moments(count, self.mean + shift, scatter, third + square * y, fourth + square**2)

    def remove(self, x: Vector) -> Moments:
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
        """Return the shrinkage intensity of Ledoit and Wolf (2004), in [0, 1].

        With S = M / n and p = D: b2 = (f / n - |S|^2) / n against d2 = |S|^2 - trace(S)^2 / p, and min(b2, d2) / d2.
        """
        size = len(self.mean)
        spread = float(np.einsum("ij,ij->", self.scatter, self.scatter)) / self.count**2
        trace = self.trace / self.count
        excess = spread - trace**2 / size
        error = min((self.fourth / self.count - spread) / self.count, excess)
        return error / excess if error > 0 and excess > 0 else 0.0

    def _higher_about(self, shift: Vector) -> tuple[Vector, float]:
        square = float(shift @ shift)
        along = self.scatter @ shift
        third = self.third - 2 * along - (self.trace + self.count * square) * shift
        fourth = self.fourth + 4 * float(shift @ along) + self.count * square**2
        return third, fourth - 4 * float(self.third @ shift) + 2 * self.trace * square


def _plus_outer(matrix: Vector, vector: Vector, weight: float) -> Vector:
    total = np.multiply.outer(vector, vector * weight)
    total += matrix
    return total
