"""Interpolated poses by a loop over queries."""

from __future__ import annotations

import itertools
import math


def pose(neighbours, distances, xy, sequence, headings, k: int, radius: float, epsilon: float):
    """Return x, y and heading of one query; `xy` and `sequence` are those of the map in capture order."""
    best = neighbours[0]
    x = y = east = north = total = 0.0
    for frame, distance, heading in list(zip(neighbours, distances, headings, strict=True))[:k]:
        if sequence[frame] != sequence[best]:
            continue
        low, high = sorted((frame, best))
        stretch = [i for i in range(low, high + 1) if sequence[i] == sequence[best]]
        if sum(math.dist(xy[a], xy[b]) for a, b in itertools.pairwise(stretch)) > radius:
            continue
        weight = 1 / (distance + epsilon)
        total += weight
        x += weight * xy[frame][0]
        y += weight * xy[frame][1]
        east += weight * math.cos(heading)
        north += weight * math.sin(heading)
    return x / total, y / total, math.atan2(north, east)
