"""Clusterings and their measures by loops over frames, straight from the definitions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np


def between(a: Sequence[float], b: Sequence[float]) -> float:
    return math.sqrt(math.fsum((x - y) ** 2 for x, y in zip(a, b, strict=True)))


def chosen_sigma(x: np.ndarray) -> float:
    n = len(x)
    k = min(n - 1, math.ceil(math.log(n)) + 1)
    kth = [sorted(between(x[i], x[j]) for j in range(n) if j != i)[k - 1] for i in range(n)]
    return math.fsum(kth) / n / 3


def affinity(x: np.ndarray, sigma: float, neighbours: int | None = None) -> np.ndarray:
    n = len(x)
    kept = {(i, i) for i in range(n)}
    for i in range(n):
        order = sorted((between(x[i], x[j]), j) for j in range(n) if j != i)
        for _, j in order[:neighbours]:
            kept |= {(i, j), (j, i)}
    matrix = np.zeros((n, n))
    for i, j in kept:
        matrix[i, j] = math.exp(-(between(x[i], x[j]) ** 2) / (2 * sigma**2))
    return matrix


def som(x: np.ndarray, grid: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the place on the grid that each frame is won by."""
    width, height = grid
    mean = x.mean(axis=0)
    _, deviations, axes = np.linalg.svd((x - mean) / math.sqrt(len(x)))
    sides = {0: width, 1: height}
    component = {side: rank for rank, side in enumerate(sorted(sides, key=lambda side: -sides[side]))}
    units = {}
    for place in [(w, h) for w in range(width) for h in range(height)]:
        unit = mean.copy()
        for side, number in sides.items():
            rank = component[side]
            if number > 1 and rank < len(deviations):
                along = 2 * place[side] / (number - 1) - 1
                unit = unit + math.sqrt(3) * along * deviations[rank] * axes[rank]
        units[place] = unit
    won = [min(units, key=lambda place: between(row, units[place])) for row in x]
    first = max(width, height, 0.6) / 2
    for epoch in range(60 + 40):
        radius = first * (0.3 / first) ** (min(epoch, 59) / 59)
        if epoch >= 60:
            won = revived(x, units, won)
        moved = {}
        for place in units:
            weights = [math.exp(-(between(place, other) ** 2) / (2 * radius**2)) for other in won]
            moved[place] = sum(w * row for w, row in zip(weights, x, strict=True)) / sum(weights)
        units = moved
        before, won = won, [min(units, key=lambda place: between(row, units[place])) for row in x]
        if epoch >= 60 and before == won:
            break
    return won


def revived(x: np.ndarray, units: dict, won: list) -> list:
    """Move units without frames; return the winners after that."""
    for place in [place for place in units if place not in won]:
        errors = {}
        for other in units:
            members = [row.tolist() for row, winner in zip(x, won, strict=True) if winner == other]
            if len({tuple(row) for row in members}) >= 2:
                errors[other] = sum(between(row, units[other]) ** 2 for row in members)
        if not errors:
            break
        worst = max(errors, key=lambda other: errors[other])
        members = [row for row, winner in zip(x, won, strict=True) if winner == worst]
        units[place] = max(members, key=lambda row: between(row, units[worst])).copy()
        won = [min(units, key=lambda other: between(row, units[other])) for row in x]
    return won


def renumbered(labels: Sequence) -> list[int]:
    seen: dict = {}
    return [seen.setdefault(label, len(seen)) for label in labels]


def silhouettes(x: np.ndarray, labels: Sequence[int], mode: str) -> list[float]:
    """Return the silhouette of each frame; NaN for a negative label."""
    found = []
    frames = [i for i, label in enumerate(labels) if label >= 0]
    for i, label in enumerate(labels):
        own = [between(x[i], x[j]) for j in frames if labels[j] == label and j != i]
        if label < 0:
            found.append(math.nan)
            continue
        if not own:
            found.append(0.0)
            continue
        others = sorted({labels[j] for j in frames} - {label})
        apart = [[between(x[i], x[j]) for j in frames if labels[j] == other] for other in others]
        if mode == "nearest":
            b = min(sum(group) / len(group) for group in apart)
        else:
            b = sum(sum(group) for group in apart) / sum(len(group) for group in apart)
        a = sum(own) / len(own)
        found.append((b - a) / max(a, b) if max(a, b) > 0 else 0.0)
    return found


def average_silhouette(x: np.ndarray, labels: Sequence[int], mode: str) -> float:
    each = silhouettes(x, labels, mode)
    if mode == "nearest":
        kept = [s for s in each if not math.isnan(s)]
        return sum(kept) / len(kept)
    clusters = sorted({label for label in labels if label >= 0})
    means = []
    for cluster in clusters:
        own = [s for s, label in zip(each, labels, strict=True) if label == cluster]
        means.append(sum(own) / len(own))
    return sum(means) / len(means)


def moment_of_inertia(points: np.ndarray, labels: Sequence[int]) -> float:
    total = 0.0
    for cluster in sorted(set(labels)):
        own = [point for point, label in zip(points, labels, strict=True) if label == cluster]
        centre = [sum(p[d] for p in own) / len(own) for d in range(len(own[0]))]
        total += sum(between(centre, p) ** 2 for p in own) / len(own)
    return total


def purity(labels: Sequence[int], rooms: Sequence[str]) -> tuple[float, dict[str, float]]:
    """Return the overall purity, and that of each room."""
    pairs = [(label, room) for label, room in zip(labels, rooms, strict=True) if room and label >= 0]
    major = {}
    for label in {label for label, _ in pairs}:
        counts = Counter(room for other, room in pairs if other == label)
        major[label] = min(counts, key=lambda room: (-counts[room], room))
    right = [major[label] == room for label, room in pairs]
    per_room = {}
    for name in {room for _, room in pairs}:
        own = [ok for ok, (_, room) in zip(right, pairs, strict=True) if room == name]
        per_room[name] = sum(own) / len(own)
    return sum(right) / len(right), per_room


def closure_counts(closures, positions, radius: float, gap: int) -> dict[str, int]:
    different = {(min(pair), max(pair)) for pair in closures}
    counted = {(i, j) for i, j in different if j - i >= gap}
    right = {(i, j) for i, j in counted if between(positions[i], positions[j]) <= radius}
    revisits = {
        j for j in range(len(positions)) for i in range(j - gap + 1) if between(positions[i], positions[j]) <= radius
    }
    return {
        "right": len(right),
        "closures": len(counted),
        "closed": len({j for _, j in right}),
        "revisits": len(revisits),
        "trivial": len(different) - len(counted),
    }
