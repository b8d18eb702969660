"""Nearest neighbours by a loop over all pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def nearest(queries: np.ndarray, references: np.ndarray, k: int, distance: str) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (n, min(k, m)) and distances; ties go to the smaller index."""
    indices, distances = [], []
    for query in np.asarray(queries, dtype=np.float64).tolist():
        pairs = sorted(
            (between(query, reference, distance), i)
            for i, reference in enumerate(np.asarray(references, dtype=np.float64).tolist())
        )
        indices.append([i for _, i in pairs[:k]])
        distances.append([d for d, _ in pairs[:k]])
    return np.array(indices), np.array(distances)


def between(a: Sequence[float], b: Sequence[float], distance: str) -> float:
    if distance in ("euclidean", "minkowski"):
        return math.sqrt(math.fsum((x - y) ** 2 for x, y in zip(a, b, strict=True)))
    if distance == "manhattan":
        return math.fsum(abs(x - y) for x, y in zip(a, b, strict=True))
    if distance == "correlation":
        a, b = _centred(a), _centred(b)
    na, nb = math.sqrt(math.fsum(x * x for x in a)), math.sqrt(math.fsum(y * y for y in b))
    if na == 0 or nb == 0:
        return 1.0
    # Half the squared chord between unit vectors is 1 - cos without cancellation.
    return math.fsum((x / na - y / nb) ** 2 for x, y in zip(a, b, strict=True)) / 2


def _centred(a: Sequence[float]) -> list[float]:
    mean = math.fsum(a) / len(a)
    centred = [x - mean for x in a]
    return [0.0] * len(a) if max(map(abs, centred)) <= 1e-12 * max(map(abs, a)) else centred
