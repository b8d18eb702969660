"""The topology of a map: which places are connected, and where loops closed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.arrays import Integers
from foundation.files import write_json


@dataclass(frozen=True)
class NodeGraph:
    """Nodes, edges and loop closures of a map.

    Attributes:
        nodes: for each id, the number of its frames and modes and, if its frames have coordinates, their mean x and y.
        edges: how often the robot went between two nodes, by pair of ids, the smaller id first.
        loops: pairs (frame, matched frame) where the robot returned to a place from another place.

    Examples:
        >>> labels = np.array([0, 0, 1, -1, 0])
        >>> NodeGraph({0: {"frames": 3}, 1: {"frames": 1}}, edges(labels), loops(labels, np.array([-1, 0, -1, -1, 1])))
        NodeGraph(nodes={0: {'frames': 3}, 1: {'frames': 1}}, edges={(0, 1): 2}, loops=[(4, 1)])
    """

    nodes: dict[int, dict[str, float]]
    edges: dict[tuple[int, int], int]
    loops: list[tuple[int, int]]

    def to_json(self, path: str | Path) -> None:
        """Write a JSON object with lists `nodes`, `edges` and `loops`.

        Raises:
            StorageError: a path that cannot be written.
        """
        edges = [{"source": a, "target": b, "passages": n} for (a, b), n in sorted(self.edges.items())]
        nodes = [{"id": key, **values} for key, values in sorted(self.nodes.items())]
        write_json(path, {"nodes": nodes, "edges": edges, "loops": self.loops})


def edges(labels: Integers) -> dict[tuple[int, int], int]:
    """Count how often a frame of one node follows a frame of another node, by pair of ids.

    Args:
        labels: (n,) node of each frame in capture order, -1 for none; frames in no node are skipped.
    """
    assigned = labels[labels >= 0]
    pairs = zip(assigned[:-1].tolist(), assigned[1:].tolist(), strict=True)
    return dict(Counter((min(a, b), max(a, b)) for a, b in pairs if a != b))


def connections(labels: Integers, sequence: NDArray[Any]) -> Integers:
    """Return the pairs of nodes (e, 2) between which the robot moved, the smaller node first; each pair once.

    Args:
        labels: (n,) as in `edges`.
        sequence: (n,) name of each frame's sequence; moves between sequences do not count.
    """
    pairs = {pair for name in np.unique(sequence) for pair in edges(labels[sequence == name])}
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def loops(labels: Integers, matches: Integers) -> list[tuple[int, int]]:
    """Find loop closures, pairs (frame, matched frame) of one node with a frame of another node between them.

    Args:
        labels: (n,) as in `edges`.
        matches: (n,) most similar earlier frame of each frame, -1 for none.
    """
    assigned = labels >= 0
    last = np.maximum.accumulate(np.where(assigned, np.arange(len(labels)), -1))
    before = np.append(-1, last)[:-1]
    turns = np.cumsum(assigned & (before >= 0) & (labels != labels[before]))
    found = np.flatnonzero(assigned & (matches >= 0))
    found = found[(labels[matches[found]] == labels[found]) & (turns[matches[found]] < turns[found])]
    return [(int(frame), int(matches[frame])) for frame in found]


def coordinates(pose: Any) -> tuple[float, float] | None:
    """Read x and y of a pose: an object's "x" and "y", or the first two numbers of a list; None if there are none."""
    if isinstance(pose, dict):
        pair = [pose.get("x"), pose.get("y")]
    else:
        pair = pose[:2] if isinstance(pose, list) else []
    numbers = [float(v) for v in pair if isinstance(v, (int, float)) and not isinstance(v, bool) and isfinite(v)]
    return (numbers[0], numbers[1]) if len(numbers) == 2 else None
