"""Merging nodes that are too alike ([I] 4.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analytic.mapper.closure import Closure, Closures, node_levels
from analytic.mapper.decision import Reason
from analytic.mapper.node import Node
from analytic.mapper.state import State

_ROUNDING = 1e-6  # far above that of the distances


@dataclass(frozen=True)
class Known:
    """Distances from one point to nodes, which bound those from points near by.

    Attributes:
        point: (D,).
        closures: how it stands to nodes; those that are still part of the map must be as they were, but for the one
            that is held against the others.
    """

    point: NDArray[np.float64]
    closures: Closures

    def out_of_reach(self, point: NDArray[np.float64], state: State) -> set[int]:
        """Return nodes that cannot close by eq. 11 with another point (D,).

        The Mahalanobis distance is a norm, so that two points differ in it by no more than they are apart in it; and
        that is no more than their Euclidean distance over the root of the least variance. If the distance is beyond
        mean +- y std even so, the condition fails, and nothing need be computed.
        """
        found = self.closures
        nodes = [state.nodes.get(node) for node in found.nodes.tolist()]
        alone = np.array([node is not None and len(node.modes) == 1 for node in nodes])
        least = np.array([np.inf if node is None else node.modes[0].metric.least for node in nodes])
        apart = np.sqrt(np.square(point - self.point).sum()) / np.sqrt(least) * (1 + _ROUNDING)
        distances = np.sqrt(found.distances)
        nearest, furthest = distances * (1 - _ROUNDING) - apart, distances * (1 + _ROUNDING) + apart
        width = state.rules.y * found.stds
        beyond = np.square(np.maximum(nearest, 0.0)) > (found.means + width) * (1 + _ROUNDING)
        if state.rules.two_sided:
            beyond |= np.square(furthest) < (found.means - width) * (1 - _ROUNDING)
        return set(found.nodes[alone & beyond].tolist())


def merge_alike(state: State, node: int, known: Known | None = None) -> int:
    """Merge a node that has changed with nodes that eq. 10-11 call alike, and return the id that is left.

    The changed node's representative is held against every other node; the one with the smallest deviation for its
    spread comes first, of equals the older. The older id stays. What comes out is held against the rest again.

    Args:
        state: the map.
        node: id.
        known: distances that spare some comparisons; what is merged is the same without them.
    """
    while True:
        changed = state.nodes[node]
        alike = _alike(state, changed, known)
        if not alike:
            return node
        closure, own = min(alike, key=lambda found: (found[0].ratio, found[0].node, found[1]))
        node = _merge(state, changed, own, closure)


def _alike(state: State, changed: Node, known: Known | None) -> list[tuple[Closure, int]]:
    """Return the nodes that close with a mode of a node (eq. 10-11), with the index of that mode."""
    found = []
    for own, mode in enumerate(changed.modes):
        spared = {changed.id} if known is None else {changed.id} | known.out_of_reach(mode.centre, state)
        others = [node for node in state.ordered() if node.id not in spared]
        if others:
            closures = node_levels(mode.centre, others, state.rules.two_sided)
            found += [(closures.row(int(row)), own) for row in closures.closing(state.rules.y)]
    return found


def _merge(state: State, changed: Node, own: int, closure: Closure) -> int:
    other = state.nodes[closure.node]
    first, second = (other, changed) if other.id < changed.id else (changed, other)
    index, mode = (closure.mode, own) if first is other else (own, closure.mode)
    merged = first.modes[index].merge(second.modes[mode])
    others = second.modes[:mode] + second.modes[mode + 1 :]
    kept = first.with_mode(index, merged)
    state.nodes[first.id] = Node(first.id, (*kept.modes, *others))
    del state.nodes[second.id]
    state.labels[state.labels == second.id] = first.id
    limit = state.rules.y * closure.std
    state.note(
        Reason.NODES_MERGED,
        first.id,
        second.frames,
        gone=second.id,
        distance=closure.distance,
        mean=closure.mean,
        std=closure.std,
        deviation=closure.deviation,
        most_deviation=limit,
    )
    return first.id
