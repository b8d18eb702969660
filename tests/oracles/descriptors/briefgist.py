"""BRIEF-gist window by window."""

from __future__ import annotations

from fractions import Fraction

import numpy as np


def describe(grey, rows, columns, circular=True):
    """Return position (rows * columns,) and orientation (columns, rows)."""
    height, width = grey.shape
    h, w = height // rows, width // columns
    bits = np.zeros((rows, columns))
    for r in range(rows):
        means = []
        for c in range(columns):
            cell = grey[r * h : (r + 1) * h, c * w : (c + 1) * w]
            means.append(sum(Fraction(float(value)) for value in cell.ravel()) / (h * w))
        for c in range(columns):
            if c == 0 and not circular:
                continue
            bits[r, c] = 1 if means[c] - means[c - 1] > 0 else 0
    return bits.ravel(), bits.T
