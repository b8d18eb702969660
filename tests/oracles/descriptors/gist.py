"""Gist filter by filter, each a product in the frequency plane of the whole continued picture."""

from __future__ import annotations

import math
from functools import cache

import numpy as np


def continued(grey, circular):
    down = np.concatenate([grey, grey[::-1]], axis=0)
    return down if circular else np.concatenate([down, down[:, ::-1]], axis=1)


@cache
def transfer(shape, f, theta):
    values = np.zeros(shape)
    for v in range(shape[0]):
        down = v / shape[0] if 2 * v < shape[0] else v / shape[0] - 1
        for u in range(shape[1]):
            right = u / shape[1] if 2 * u < shape[1] else u / shape[1] - 1
            d = math.hypot(right - f * math.cos(theta), down - f * math.sin(theta))
            values[v, u] = 2 * max(0.0, (2 ** (-9 * (d / f) ** 2) - 2**-9) / (1 - 2**-9))
    return values


def magnitude(grey, f, theta, circular):
    picture = continued(grey, circular)
    answer = np.fft.ifft2(np.fft.fft2(picture) * transfer(picture.shape, f, theta))
    return np.abs(answer)[: grey.shape[0], : grey.shape[1]]


def describe(
    grey, blocks, orientations, window, step, orientation_filters, orientation_levels=1, normalized=True, circular=True
):
    """Return position (2 * blocks * orientations,) and orientation (W / step, levels * orientation_filters)."""
    height, width = grey.shape
    position = np.zeros((2, blocks, orientations))
    orientation = np.zeros((width // step, orientation_levels, orientation_filters))
    for level, f in enumerate([1 / 4, 1 / 8]):
        for k in range(orientations):
            answer = magnitude(grey, f, math.pi * k / orientations, circular)
            for b in range(blocks):
                position[level, b, k] = answer[b * height // blocks : (b + 1) * height // blocks].mean()
        if level == orientation_levels:
            break
        for k in range(orientation_filters):
            answer = magnitude(grey, f, math.pi * k / orientation_filters, circular)
            for n in range(width // step):
                held = [j % width for j in range(n * step, n * step + window) if circular or j < width]
                orientation[n, level, k] = answer[:, held].mean()
    orientation = orientation.reshape(width // step, -1)
    if normalized:
        for o in orientation:
            o -= o.mean()
            o /= math.sqrt((o**2).sum() + 0.001**2)
    return position.ravel(), orientation
