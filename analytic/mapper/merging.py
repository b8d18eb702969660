"""Merging nodes that are too alike ([I] 4.6)."""

from __future__ import annotations

from analytic.mapper.closure import Closure, node_level
from analytic.mapper.decision import Reason
from analytic.mapper.node import Node
from analytic.mapper.state import State


def merge_alike(state: State, node: int) -> int:
    """Merge a node that has changed with nodes that eq. 10-11 call alike, and return the id that is left.

    The changed node's representative is held against every other node; the one with the smallest deviation for its
    spread comes first, of equals the older. The older id stays. What comes out is held against the rest again.
    """
    while True:
        changed = state.nodes[node]
        alike = [found for found in _alike(state, changed) if found[0].closes(state.rules.y)]
        if not alike:
            return node
        closure, own = min(alike, key=lambda found: (found[0].ratio, found[0].node, found[1]))
        node = _merge(state, changed, own, closure)


def _alike(state: State, changed: Node) -> list[tuple[Closure, int]]:
    """Return how each mode of a node stands to every other node (eq. 10), with the index of that mode."""
    return [
        (node_level(mode.centre, other, state.rules.two_sided), own)
        for other in state.ordered()
        if other.id != changed.id
        for own, mode in enumerate(changed.modes)
    ]


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
