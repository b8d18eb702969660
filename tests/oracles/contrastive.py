"""The contrastive loss and the pair statistics, written as loops over pairs and dimensions."""

from __future__ import annotations

import math
from collections.abc import Sequence

Vectors = Sequence[Sequence[float]]


def contrastive_loss(d0: Vectors, d1: Vectors, labels: Sequence[float], margin: float) -> float:
    total = 0.0
    for a, b, y in zip(d0, d1, labels, strict=True):
        d = math.dist(a, b)
        gap = margin - d if d < margin else 0.0
        total += (1 - y) * d * d + y * gap * gap
    return total / len(labels)


def pair_statistics(
    d0: Vectors, d1: Vectors, labels: Sequence[float], same: Sequence[bool], margin: float
) -> dict[str, float]:
    groups: dict[str, list[tuple[float, bool]]] = {"same": [], "different": []}
    for a, b, is_same in zip(d0, d1, same, strict=True):
        d = math.dist(a, b)
        told_same = min(d / margin, 1) < 0.5
        groups["same" if is_same else "different"].append((d, told_same == is_same))
    result = {"loss": contrastive_loss(d0, d1, labels, margin)}
    apart = [contrastive_loss([a], [b], [y], margin) for a, b, y in zip(d0, d1, labels, strict=True) if y == 1]
    if apart:
        result["active"] = sum(cost > 0 for cost in apart) / len(apart)
    everything = groups["same"] + groups["different"]
    if groups["same"] and groups["different"]:
        result["accuracy"] = sum(right for _, right in everything) / len(everything)
    for name, pairs in groups.items():
        if pairs:
            result[f"distance_{name}"] = sum(d for d, _ in pairs) / len(pairs)
            result[f"accuracy_{name}"] = sum(right for _, right in pairs) / len(pairs)
    vectors = [*d0, *d1]
    deviations = []
    for column in zip(*vectors, strict=True):
        mean = sum(column) / len(column)
        deviations.append(math.sqrt(sum((x - mean) ** 2 for x in column) / len(column)))
    result["spread"] = sum(deviations) / len(deviations)
    return result
