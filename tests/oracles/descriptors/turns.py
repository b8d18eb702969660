"""Comparing two orientation parts at every turn, one turn after the other."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import distance as scipy_distance


def angle(step: int, steps: int) -> float:
    """Return the angle of a number of steps to the left, rad in (-pi, pi]."""
    turned = 2 * math.pi * step / steps
    return turned if 2 * step <= steps else turned - 2 * math.pi


def scores(query: np.ndarray, reference: np.ndarray) -> list[float]:
    """Return the scalar products of the query (K, F) with the reference turned left by 0 ... K - 1 steps."""
    return [float((query * np.roll(reference, s, axis=0)).sum()) for s in range(len(query))]


def best(found) -> int:
    """Return the turn with the largest score, the first of equal ones."""
    return max(range(len(found)), key=lambda s: (found[s], -s))


def euclidean(query: np.ndarray, reference: np.ndarray, step: int) -> float:
    return math.sqrt(((query - np.roll(reference, step, axis=0)) ** 2).sum())


def between(a: np.ndarray, b: np.ndarray, name: str) -> float:
    """Return one named distance of two vectors, a constant or zero one being at 1 from everything."""
    if name in ("cosine", "correlation"):
        shift = (a.mean(), b.mean()) if name == "correlation" else (0, 0)
        if not (a - shift[0]).any() or not (b - shift[1]).any():
            return 1.0
        return float(getattr(scipy_distance, name)(a, b))
    return float({"manhattan": scipy_distance.cityblock}.get(name, scipy_distance.euclidean)(a, b))


def whitened(windows: np.ndarray, floor: float) -> np.ndarray:
    """Return windows (K, F) whose Fourier coefficients along K have magnitudes of 1, or of 0 below a share."""
    count = len(windows)
    waves = np.exp(-2j * np.pi * np.outer(np.arange(count), np.arange(count)) / count)
    spectrum = waves @ windows
    size = np.abs(spectrum)
    if not size.any():
        return np.zeros(windows.shape)
    phases = np.where(size >= floor * size.max(), spectrum / np.maximum(size, 1e-300), 0)
    return (waves.conj() @ phases).real / count
