"""Error scores, isotonic regression and calibration measures as loops."""

from __future__ import annotations

import math


def ratio(neighbours, distances, xy, radius: float) -> float:
    best = neighbours[0]
    for frame, distance in zip(neighbours, distances, strict=True):
        if math.dist(xy[frame], xy[best]) > radius:
            return distances[0] / distance if distance else 1.0
    return distances[0] / distances[-1] if distances[-1] else 1.0


def isotonic(values, weights) -> list[float]:
    """Return the weighted least squares fit that does not fall, by pooling neighbours that do."""
    blocks: list[list[float]] = []  # mean, weight, count
    for value, weight in zip(values, weights, strict=True):
        blocks.append([value, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            mean, size, count = blocks.pop()
            last = blocks[-1]
            blocks[-1] = [(last[0] * last[1] + mean * size) / (last[1] + size), last[1] + size, last[2] + count]
    return [mean for mean, _, count in blocks for _ in range(int(count))]


def lost(predicted, error, threshold: float) -> tuple[int, int, int]:
    """Return how many were called lost, how many were lost, and how many both."""
    called = [value > threshold for value in predicted]
    truly = [value > threshold for value in error]
    return sum(called), sum(truly), sum(a and b for a, b in zip(called, truly, strict=True))
