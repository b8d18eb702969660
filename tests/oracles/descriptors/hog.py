"""HOG pixel by pixel."""

from __future__ import annotations

import math

import numpy as np


def gradient(grey, i, j, circular):
    height, width = grey.shape
    above, below = max(i - 1, 0), min(i + 1, height - 1)
    if circular:
        left, right = (j - 1) % width, (j + 1) % width
    else:
        left, right = max(j - 1, 0), min(j + 1, width - 1)
    return (grey[i, right] - grey[i, left]) / 2, (grey[below, j] - grey[above, j]) / 2


def bin_of(dx, dy, bins):
    return math.floor(math.atan2(dy, dx) * bins / (2 * math.pi) + 0.5) % bins


def undecided(grey, bins, circular=True):
    """Return the sum of the magnitudes whose direction is so near a bin's edge that float32 may decide otherwise."""
    total = 0.0
    for i in range(grey.shape[0]):
        for j in range(grey.shape[1]):
            dx, dy = gradient(grey, i, j, circular)
            place = math.atan2(dy, dx) * bins / (2 * math.pi) + 0.5
            if abs(place - round(place)) < 1e-4:
                total += math.hypot(dx, dy)
    return total


def describe(grey, rows, bins, window, step, orientation_bins, circular=True, **_):
    """Return position (rows * bins,) and orientation (W / step, orientation_bins)."""
    height, width = grey.shape
    position = np.zeros(rows * bins)
    columns = np.zeros((width, orientation_bins))
    for i in range(height):
        for j in range(width):
            dx, dy = gradient(grey, i, j, circular)
            if dx == 0 and dy == 0:
                continue
            magnitude = math.sqrt(dx * dx + dy * dy)
            position[i // (height // rows) * bins + bin_of(dx, dy, bins)] += magnitude
            columns[j, bin_of(dx, dy, orientation_bins)] += magnitude
    orientation = np.zeros((width // step, orientation_bins))
    for k in range(width // step):
        for j in range(k * step, k * step + window):
            if circular or j < width:
                orientation[k] += columns[j % width]
    return position, orientation
