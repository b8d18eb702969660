"""The measures, written as loops."""

from __future__ import annotations

import math

import numpy as np


def localization_error(estimated, true) -> list[float]:
    return [math.dist(a, b) for a, b in zip(estimated, true, strict=True)]


def error_floor(map_xy, query_xy) -> list[float]:
    return [min(math.dist(query, known) for known in map_xy) for query in query_xy]


def percentile(values, share: float) -> float:
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def summarize(errors) -> dict:
    return {
        "count": len(errors),
        "mean": math.fsum(errors) / len(errors),
        "median": percentile(errors, 0.5),
        "p95": percentile(errors, 0.95),
        "max": max(errors),
        "rmse": math.sqrt(math.fsum(error**2 for error in errors) / len(errors)),
    }


def recall_at_k(retrieved, map_xy, query_xy, radius: float, k: int) -> tuple[int, int]:
    """Return hits and answerable queries."""
    hits = answerable = 0
    for ranking, query in zip(retrieved, query_xy, strict=True):
        found = False
        for place in ranking[:k]:
            if math.dist(map_xy[place], query) <= radius:
                found = True
        hits += found
        answerable += any(math.dist(known, query) <= radius for known in map_xy)
    return hits, answerable


def pair_accuracy(distances, same, margin: float, threshold: float) -> tuple[int, int, int, int]:
    """Return right and all of the same-room pairs, then of the others."""
    right = {True: 0, False: 0}
    count = {True: 0, False: 0}
    for distance, truth in zip(distances, same, strict=True):
        judged_same = min(distance / margin, 1) < threshold
        count[bool(truth)] += 1
        right[bool(truth)] += judged_same == bool(truth)
    return right[True], count[True], right[False], count[False]


def pair_auc(distances, same, margin: float) -> tuple[float, int]:
    """Return how many couples of a one-room and a two-room pair are in order, ties counting half, and all couples."""
    apart = [min(distance / margin, 1) for distance in distances]
    one = [value for value, truth in zip(apart, same, strict=True) if truth]
    two = [value for value, truth in zip(apart, same, strict=True) if not truth]
    return sum(1.0 if a < b else 0.5 if a == b else 0.0 for a in one for b in two), len(one) * len(two)


def confusion(true, predicted, labels) -> list[list[int]]:
    return [
        [sum(1 for t, p in zip(true, predicted, strict=True) if (t, p) == (row, column)) for column in labels]
        for row in labels
    ]


def heading_error(estimated, true) -> list[float]:
    return [abs(math.atan2(math.sin(a - b), math.cos(a - b))) for a, b in zip(estimated, true, strict=True)]


def absolute_trajectory_error(estimated, true, scale):
    """Distances after Umeyama's alignment, by a singular value decomposition of 2 x 2 matrices."""
    x, y = estimated[:, :2].T, true[:, :2].T
    mx, my = x.mean(axis=1, keepdims=True), y.mean(axis=1, keepdims=True)
    u, d, vt = np.linalg.svd((y - my) @ (x - mx).T / x.shape[1])
    sign = np.diag([1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u @ sign @ vt
    size = np.trace(np.diag(d) @ sign) / (x - mx).var(axis=1).sum() if scale else 1.0
    moved = size * rotation @ x + my - size * rotation @ mx
    return np.linalg.norm(moved - y, axis=0)


def relative_trajectory_error(estimated, true, delta):
    """Distances and angles of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), with homogeneous matrices."""

    def matrix(pose):
        x, y, theta = pose
        return np.array([[np.cos(theta), -np.sin(theta), x], [np.sin(theta), np.cos(theta), y], [0, 0, 1]])

    apart, angles = [], []
    for i in range(len(true) - delta):
        p, q = (np.linalg.inv(matrix(one[i])) @ matrix(one[i + delta]) for one in (estimated, true))
        error = np.linalg.inv(q) @ p
        apart.append(np.hypot(error[0, 2], error[1, 2]))
        angles.append(abs(np.arctan2(error[1, 0], error[0, 0])))
    return np.array(apart), np.array(angles)
