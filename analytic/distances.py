"""Distances between sets of descriptors: [T] 3.5.1, eq. 3.8-3.12, and [C] eq. 3-6."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.arrays import Floats, real
from analytic.errors import AnalyticError
from foundation.errors import known

Pairwise = Callable[[ArrayLike, ArrayLike], Floats]


def minkowski(a: ArrayLike, b: ArrayLike, p: float = 2.0, weights: ArrayLike | None = None) -> Floats:
    """Return the weighted Minkowski distances (n, m): (sum_i w_i |a_i - b_i|^p)^(1/p) ([T] eq. 3.8).

    Args:
        a: (n, D).
        b: (m, D).
        p: order, at least 1; 1 is Manhattan ([T]'s dist1), 2 Euclidean ([T]'s dist2).
        weights: (D,), not negative; ones if None.

    Raises:
        AnalyticError: p below 1, weights that are negative or of the wrong length, or sets of different D.

    Example:
        >>> minkowski([[0, 0]], [[3, 4], [0, 2]], weights=[1, 4])
        array([[8.54400375, 4.        ]])
    """
    a, b = _checked(a, b)
    if isinstance(p, bool) or not isinstance(p, int | float | np.integer | np.floating) or not 1 <= p < np.inf:
        raise AnalyticError(f"the Minkowski distance needs a number p >= 1, got {p!r}")
    if weights is not None:
        w = real(weights, "weights")
        if w.shape != (a.shape[1],) or not (w >= 0).all():
            raise AnalyticError(
                f"weights must be {a.shape[1]} numbers that are not negative, got {w.min(initial=np.inf):g} as the "
                f"smallest of shape {w.shape}"
            )
        a, b = a * w ** (1 / p), b * w ** (1 / p)
    try:
        from scipy.spatial.distance import cdist
    except ImportError:  # as on a robot
        return np.array([np.linalg.norm(b - row, p, axis=1) for row in a]).reshape(len(a), len(b))
    return cdist(a, b, "minkowski", p=p)


def cosine(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return 1 - cosine similarity (n, m), in [0, 2] ([T] eq. 3.11-3.12, dist4).

    A zero vector has distance 1 to everything.

    Example:
        >>> cosine([[1, 0]], [[2, 0], [0, 1], [-1, 0]])
        array([[0., 1., 2.]])
    """
    a, b = _checked(a, b)
    return between_units(unit_vectors(a), unit_vectors(b))


def correlation(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return 1 - Pearson correlation (n, m), in [0, 2] ([T] eq. 3.9-3.10, dist3).

    A constant vector has distance 1 to everything.

    Example:
        >>> correlation([[1, 2, 3]], [[5, 7, 9], [3, 2, 1], [4, 4, 4]]).round(6)
        array([[0., 2., 1.]])
    """
    a, b = _checked(a, b)
    return between_units(unit_vectors(a, centred=True), unit_vectors(b, centred=True))


DISTANCES: dict[str, Pairwise] = {
    "manhattan": partial(minkowski, p=1),
    "euclidean": minkowski,
    "minkowski": minkowski,
    "correlation": correlation,
    "cosine": cosine,
}


def distance(name: str) -> Pairwise:
    """Return the distance function of that name, which maps (n, D) and (m, D) to (n, m).

    Raises:
        AnalyticError: an unknown name.

    Example:
        >>> distance("manhattan")([[0, 0], [1, 1]], [[3, 4]])
        array([[7.],
               [5.]])
    """
    return DISTANCES[known(name, DISTANCES, "distance", AnalyticError)]


def _checked(a: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    a, b = real(a, "descriptors"), real(b, "descriptors")
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
        raise AnalyticError(f"distances need two sets of shape (n, D) and (m, D), got {a.shape} and {b.shape}")
    return a, b


def unit_vectors(a: NDArray[Any], centred: bool = False) -> Floats:
    """Return the vectors (n, D) scaled to length 1, after subtracting their means if `centred`; zero stays zero."""
    a = np.asarray(a, dtype=np.float64)
    if centred:
        rounding = 1e-12 * np.abs(a).max(axis=1, keepdims=True, initial=0)
        a = a - a.mean(axis=1, keepdims=True)
        a = np.where(np.abs(a).max(axis=1, keepdims=True, initial=0) <= rounding, 0.0, a)
    norm = np.linalg.norm(a, axis=1, keepdims=True)
    return np.divide(a, norm, out=np.zeros_like(a), where=norm != 0)


def between_units(a: Floats, b: Floats) -> Floats:
    """Return 1 - cosine similarity (n, m) of unit vectors (n, D) and (m, D)."""
    return np.clip(1 - a @ b.T, 0, 2)
