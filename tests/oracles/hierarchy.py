"""Hierarchical search as loops over frames and nodes."""

from __future__ import annotations

import math

from tests.oracles.search import between


def by_representatives(query, representatives, candidates: int, distance: str) -> list[int]:
    ranked = sorted((between(query, mean, distance), node) for node, mean in enumerate(representatives))
    return [node for _, node in ranked[:candidates]]


def by_vote(nearest_frames, labels, candidates: int) -> list[int]:
    votes: dict[int, list[int]] = {}
    for place, frame in enumerate(nearest_frames):
        if labels[frame] >= 0:
            votes.setdefault(labels[frame], []).append(place)
    ranked = sorted(votes, key=lambda node: (-len(votes[node]), votes[node][0]))
    return ranked[:candidates]


def by_position(query_xy, map_xy, labels) -> list[int]:
    apart = [math.dist(xy, query_xy) for xy in map_xy]
    return sorted({label for label, distance in zip(labels, apart, strict=True) if distance <= min(apart) + 1e-9})


def search(query, descriptors, labels, nodes, k: int, distance: str) -> tuple[list[int], list[float], int]:
    """Return frames, distances and how many frames were compared, for one query."""
    inside = [frame for frame, node in enumerate(labels) if node == -1 or node in nodes]
    ranked = sorted((between(query, descriptors[frame], distance), frame) for frame in inside)
    return [frame for _, frame in ranked[:k]], [apart for apart, _ in ranked[:k]], len(inside)


def search_along(query, descriptors, labels, nodes, k, distance, drives, along) -> tuple[list[int], list[float], int]:
    """Like `search`, and then next to the nearest frame, where other nodes hold the frames."""
    inside = {frame for frame, node in enumerate(labels) if node == -1 or node in nodes}
    nearest = search(query, descriptors, labels, nodes, 1, distance)[0][0]
    for frame in range(nearest - along, nearest + along + 1):
        if 0 <= frame < len(labels) and drives[frame] == drives[nearest]:
            inside.add(frame)
    ranked = sorted((between(query, descriptors[frame], distance), frame) for frame in inside)
    return [frame for _, frame in ranked[:k]], [apart for apart, _ in ranked[:k]], len(inside)
