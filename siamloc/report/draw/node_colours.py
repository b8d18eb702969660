"""Colours for the nodes of a map: neighbours differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike

# From Okabe and Ito 2008, and from Paul Tol's "muted" and "bright" schemes, for colour-blind readers as well.
POOL = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#882255",
    "#F0E442", "#332288", "#AA4499", "#999933", "#117733", "#EE6677",
)  # fmt: skip
NO_NODE = "#CFCFCF"
_REACH = 1 / 25  # of the plan's longer side: nodes with frames this close are neighbours


def node_colours(
    neighbours: Iterable[tuple[int, int]], nodes: Sequence[int], fixed: Mapping[int, str] | None = None
) -> dict[int, str]:
    """Return a colour "#RRGGBB" from POOL for each node, the same for the same arguments.

    Nodes with many neighbours choose first. Each takes a colour that none of its neighbours has, or as few as possible;
    among these, the one used by the fewest nodes.

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
    used = Counter(chosen.values())
    for node in sorted((node for node in nodes if node not in chosen), key=lambda node: (-len(beside[node]), node)):
        others = Counter(chosen[other] for other in beside[node] if other in chosen)
        chosen[node] = min(POOL, key=lambda colour: (others[colour], used[colour]))
        used[chosen[node]] += 1
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


def ink(colour: str) -> str:
    """Return the more readable of "black" and "white" on a colour "#RRGGBB"."""
    return "black" if np.dot(to_rgb(colour), (0.299, 0.587, 0.114)) > 0.5 else "white"
