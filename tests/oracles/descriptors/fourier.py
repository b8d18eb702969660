"""The Fourier signature as sums over columns, and both of its ways to find a heading as loops over turns."""

from __future__ import annotations

import cmath
import math

import numpy as np


def coefficients(grey, rows, columns, circular=True):
    """Return F (rows, columns), complex."""
    height = len(grey)
    found = np.zeros((rows, columns), dtype=complex)
    for r in range(rows):
        line = grey[r * height // rows : (r + 1) * height // rows].mean(axis=0)
        if not circular:
            line = np.concatenate([line, line[::-1]])
        for u in range(columns):
            wave = np.exp(-2j * np.pi * u * np.arange(len(line)) / len(line))
            found[r, u] = (line * wave).sum() / len(line)
    return found


def describe(grey, rows, columns, orientation_rows, orientation_columns, circular=True, **_):
    """Return position (rows * columns,) and orientation (orientation_columns, orientation_rows)."""
    position = np.abs(coefficients(grey, rows, columns, circular)).ravel()
    return position, coefficients(grey, orientation_rows, orientation_columns, circular).T


def _white(values):
    size = np.abs(values)
    return np.where(size >= 1e-6 * size.max(), values / np.maximum(size, 1e-300), 0)


def correlation_scores(query, reference, turns, whitened):
    """Return c[t] of two orientation parts (U, R)."""
    q, r = (_white(query), _white(reference)) if whitened else (query, reference)
    weight = np.array([1.0] + [2.0] * (len(q) - 1))[:, None]
    u = np.arange(len(q))[:, None]
    return [float((weight * (q * r.conj() * np.exp(2j * np.pi * u * t / turns)).real).sum()) for t in range(turns)]


def correlation_distance(query, reference, turns, t):
    """Return the distance at a turn of the rows themselves, drawn from the frequencies kept, over sqrt(columns)."""
    many = 4 * len(query) * turns
    x = np.arange(many)
    total = 0.0
    for row in range(query.shape[1]):
        apart = np.zeros(many)
        for u in range(len(query)):
            turned = reference[u, row] * cmath.exp(-2j * math.pi * u * t / turns)
            wave = (query[u, row] - turned) * np.exp(2j * np.pi * u * x / many)
            apart += (1 if u == 0 else 2) * wave.real
        total += (apart**2).mean()
    return math.sqrt(total)


def _phases(values):
    return np.vectorize(cmath.phase)(values)


def phase_product_scores(query, reference, turns):
    u = np.arange(len(query))[:, None]
    of_map = _phases(reference)
    return [float((of_map * _phases(query * np.exp(2j * np.pi * u * t / turns))).sum()) for t in range(turns)]


def phase_product_distance(query, reference, turns, t):
    u = np.arange(len(query))[:, None]
    return math.sqrt(((_phases(reference) - _phases(query * np.exp(2j * np.pi * u * t / turns))) ** 2).sum())
