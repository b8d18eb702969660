"""Colours for the nodes of a map: neighbours differ clearly, also for colour-blind readers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

# From Okabe and Ito 2008, and from Paul Tol's "muted" and "bright" schemes.
POOL = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#882255",
    "#F0E442", "#332288", "#AA4499", "#999933", "#117733", "#EE6677",
)  # fmt: skip
NO_NODE = "#CFCFCF"
_ENOUGH = 30.0  # distance in CIELAB from which two colours count as clearly different
_REACH = 1 / 25  # of the plan's longer side: nodes with frames this close are neighbours

# Linear RGB as the colour-blind see it (Machado, Oliveira and Fernandes 2009, severity 1).
_SIGHTS = (
    np.eye(3),
    np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]),
    np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]),
)


def node_colours(
    neighbours: Iterable[tuple[int, int]], nodes: Sequence[int], fixed: Mapping[int, str] | None = None
) -> dict[int, str]:
    """Return a colour "#RRGGBB" from POOL for each node, the same for the same arguments.

    Nodes with many neighbours choose first. Each takes a colour that differs clearly from those of its neighbours, or
    as clearly as possible; among these, the one used by the fewest nodes.

    Args:
        neighbours: pairs of nodes, in either order.
        nodes: nodes to colour.
        fixed: colours that some nodes already have.
    """
    beside: dict[int, set[int]] = {node: set() for node in nodes}
    for a, b in neighbours:
        if a != b:
            beside.setdefault(a, set()).add(b)
            beside.setdefault(b, set()).add(a)
    chosen = dict(fixed or {})
    used = [sum(colour == other for other in chosen.values()) for colour in POOL]
    for node in sorted((node for node in nodes if node not in chosen), key=lambda node: (-len(beside[node]), node)):
        others = [chosen[other] for other in beside[node] if other in chosen]
        apart = [min((contrast(colour, other) for other in others), default=np.inf) for colour in POOL]
        best = max(range(len(POOL)), key=lambda i: (min(apart[i], _ENOUGH), -used[i], -i))
        chosen[node] = POOL[best]
        used[best] += 1
    return {node: chosen[node] for node in nodes}


def neighbouring(xy: ArrayLike, labels: ArrayLike, edges: Iterable[Sequence[int]] = ()) -> set[tuple[int, int]]:
    """Return the pairs of nodes that appear next to each other on the plan, the smaller one first.

    Such nodes are connected by an edge, or some of their frames are close to each other on the plan.

    Args:
        xy: positions of frames (n, 2).
        labels: (n,) node of each frame, negative for none.
        edges: pairs of nodes.
    """
    from scipy.spatial import cKDTree

    points, node = np.asarray(xy, dtype=np.float64), np.asarray(labels)
    pairs = {(min(int(a), int(b)), max(int(a), int(b))) for a, b in edges}
    points, node = points[node >= 0], node[node >= 0]
    if not len(points):
        return pairs
    reach = _REACH * max(float(np.ptp(points, axis=0).max()), 1e-9)
    # One point per node and cell, so that the frames of a standing robot do not multiply.
    cells = np.round(points / (reach / 4)).astype(np.int64)
    cells, first = np.unique(np.column_stack([cells, node]), axis=0, return_index=True)
    points, node = points[first], node[first]
    near = node[cKDTree(points).query_pairs(reach, output_type="ndarray")].reshape(-1, 2)
    near = np.unique(np.sort(near[near[:, 0] != near[:, 1]], axis=1), axis=0)
    return pairs | {(int(a), int(b)) for a, b in near}


@cache
def contrast(one: str, other: str) -> float:
    """Return the CIELAB distance of two colours "#RRGGBB", as the least sensitive of three kinds of sight sees it:
    normal, protanopic and deuteranopic."""
    return min(float(np.linalg.norm(_lab(one, sight) - _lab(other, sight))) for sight in range(len(_SIGHTS)))


def ink(colour: str) -> str:
    """Return the more readable of "black" and "white" on a colour "#RRGGBB"."""
    return "black" if _lab(colour, 0)[0] > 58 else "white"


@cache
def _lab(colour: str, sight: int) -> NDArray[np.float64]:
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.array([[np.clip(_SIGHTS[sight] @ linear, 0, 1)]], dtype=np.float32)
    return np.asarray(cv2.cvtColor(seen, cv2.COLOR_LRGB2Lab)[0, 0], dtype=np.float64)
