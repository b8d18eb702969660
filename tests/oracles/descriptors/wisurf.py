"""WI-SURF: a mean over a box for each half of each wavelet, and each window of the image by itself."""

from __future__ import annotations

import math

import numpy as np


def wavelets(grey, a, circular):
    """Return dx and dy (H, W)."""
    height, width = grey.shape
    padded = np.pad(grey, ((a, a), (0, 0)), mode="edge")
    padded = np.pad(padded, ((0, 0), (a, a)), mode="wrap" if circular else "edge")

    def mean(top, bottom, left, right):
        """Return the mean over a box about every pixel, both ends included."""
        total, count = np.zeros(grey.shape), 0
        for i in range(top, bottom + 1):
            for j in range(left, right + 1):
                total += padded[a + i : a + i + height, a + j : a + j + width]
                count += 1
        return total / count

    dx = mean(-a, a, 1, a) - mean(-a, a, -a, -1)
    dy = mean(1, a, -a, a) - mean(-a, -1, -a, a)
    return dx, dy


def weights(h):
    sigma = 0.165 * h
    values = [math.exp(-((x - (h - 1) / 2) ** 2) / (2 * sigma**2)) for x in range(h)]
    return [value / sum(values) for value in values]


def overlaps(begin, end, count):
    """Return how much of each of `count` values, of width 1, lies between two places."""
    at = np.arange(count)
    return np.maximum(0, np.minimum(end, at + 1) - np.maximum(begin, at))


def sampled(grey, rows, windows, circular):
    """Return the orientation part by SURF's own sampling: every sample of every window by itself."""
    height, width = grey.shape
    h, step = height // rows, width // windows
    s = h / 20
    padded = np.pad(np.pad(grey, ((h, h), (0, 0)), mode="edge"), ((0, 0), (h, h)), mode="wrap" if circular else "edge")
    gauss = [math.exp(-((n - 9.5) ** 2) / (2 * 3.3**2)) for n in range(20)]
    orientation = np.zeros((windows, rows, 4, 4, 4))
    for r in range(rows):
        for j in range(windows):
            for n in range(20):
                for m in range(20):
                    y, x = h + r * h + (n + 0.5) * s, h + j * step + (m + 0.5) * s
                    above, below = (overlaps(y + a, y + a + s, len(padded)) for a in (-s, 0))
                    left, right = (overlaps(x + a, x + a + s, padded.shape[1]) for a in (-s, 0))
                    tall, wide = np.add(above, below), np.add(left, right)
                    dx = tall @ padded @ np.subtract(right, left) / (2 * s * s)
                    dy = np.subtract(below, above) @ padded @ wide / (2 * s * s)
                    responses = np.array([dx, dy, abs(dx), abs(dy)])
                    orientation[j, r, n // 5, m // 5] += gauss[n] * gauss[m] / sum(gauss) ** 2 * responses
    vectors = orientation.reshape(windows, rows, 64)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-6)


def describe(grey, rows, windows, circular=True, sampling="pixels"):
    """Return position (windows * rows * 64,) and orientation (windows, rows * 64)."""
    if sampling == "surf":
        orientation = sampled(grey, rows, windows, circular).reshape(windows, rows * 64)
        return orientation.ravel(), orientation
    height, width = grey.shape
    h, step = height // rows, width // windows
    dx, dy = wavelets(grey, max(1, math.floor(h / 20 + 0.5)), circular)
    if not circular:
        dx, dy = (np.pad(d, ((0, 0), (0, h))) for d in (dx, dy))
    weight = np.outer(weights(h), weights(h))
    orientation = np.zeros((windows, rows * 64))
    quarter = h // 4
    for r in range(rows):
        for j in range(windows):
            columns = [(j * step + x) % dx.shape[1] for x in range(h)]
            of_x, of_y = (weight * d[r * h : (r + 1) * h, columns] for d in (dx, dy))
            z = []
            for u in range(4):
                for v in range(4):
                    place = np.s_[u * quarter : (u + 1) * quarter, v * quarter : (v + 1) * quarter]
                    x, y = of_x[place], of_y[place]
                    z += [x.sum(), y.sum(), np.abs(x).sum(), np.abs(y).sum()]
            orientation[j, r * 64 : (r + 1) * 64] = np.array(z) / max(math.hypot(*z), 1e-6)
    return orientation.ravel(), orientation
