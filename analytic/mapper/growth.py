"""How a map grows: new nodes ([I] 4.5; [T] 4.6), re-evaluated frames ([T] 4.6), merging ([I] 4.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import (
    Closure,
    Closures,
    image_level,
    node_level,
    node_levels,
    node_levels_of,
    point_of,
)
from analytic.mapper.decision import NONE, Reason
from analytic.mapper.node import Node
from analytic.mapper.state import State, mean_distance

_ROUNDING = 1e-6  # far above the rounding of the distances


def first_node(state: State) -> Node | None:
    """Form the first node of the map, as soon as there are enough frames ([I] 6)."""
    if len(state.pending) < state.rules.first_node:
        return None
    return _create(state, state.form(state.pending), trigger="first frames")


def grow_version_1(state: State) -> Node | None:
    """Form a node from enough consecutive frames without one; park it if it is too similar to the map."""
    if len(state.pending) < state.rules.new_node:
        return None
    node = state.form(state.pending)
    state.pending = ()
    away, among = _distinctness(state, node.modes[0].centre)
    if away >= among:
        return _create(state, node, trigger="consecutive", distance=away, least_distance=among)
    state.parked = (*state.parked, node)
    state.note(Reason.NODE_PARKED, node.id, node.frames, distance=away, least_distance=among)
    while len(state.parked) > state.rules.parked_nodes:
        forgotten, *kept = state.parked
        state.parked = tuple(kept)
        state.note(Reason.PARKED_FORGOTTEN, forgotten.id, forgotten.frames)
    return None


def join_parked(state: State, frame: int, description: Description) -> tuple[int, Node | None] | None:
    """Let a frame without a node join the parked candidate that it fits best by eq. 4.

    Returns:
        The candidate's id, and its node if the frame made it different enough from the map; None if none fits.
    """
    x = state.rules.x(len(state.nodes))
    point = point_of(description)
    closures = [node_level(point, node, state.rules.two_sided) for node in state.parked]
    fitting = [closure for closure in closures if closure.closes(x)]
    if not fitting:
        return None
    joined = min(fitting, key=lambda closure: (closure.ratio, closure.node)).node
    index = [node.id for node in state.parked].index(joined)
    parked = state.parked[index]
    parked = parked.with_mode(0, parked.modes[0].add(frame, description))
    away, among = _distinctness(state, parked.modes[0].centre)
    if away < among:
        state.parked = (*state.parked[:index], parked, *state.parked[index + 1 :])
        return joined, None
    state.parked = state.parked[:index] + state.parked[index + 1 :]
    return joined, _create(state, parked, trigger="parked", distance=away, least_distance=among)


def grow_version_2(state: State) -> Node | None:
    """Form a node if too many of the last frames have none, or if they changed node too often."""
    rules = state.rules
    unassigned = _unassigned(state, rules.forced_window)
    if len(unassigned) >= rules.forced_unassigned:
        return _create(state, state.form(unassigned), trigger="forced")
    unassigned = _unassigned(state, rules.checked_window)
    if len(unassigned) >= rules.checked_unassigned:
        return _create_if_distinct(state, unassigned, "unassigned")
    if changes_of_node(state.labels[-rules.changes_window :]) >= rules.node_changes:
        start = max(0, len(state.labels) - rules.changes_window)
        return _create_if_distinct(state, range(start, len(state.labels)), "changes")
    return None


def changes_of_node(labels: NDArray[np.int64]) -> int:
    """Count how often the node changes along labels (n,), skipping frames without one."""
    assigned = labels[labels != NONE]
    return int((assigned[1:] != assigned[:-1]).sum())


def _unassigned(state: State, window: int) -> list[int]:
    start = max(0, len(state.labels) - window)
    return [start + int(index) for index in np.flatnonzero(state.labels[start:] == NONE)]


def _create_if_distinct(state: State, frames: Sequence[int], trigger: str) -> Node | None:
    """Form a node from recent frames, which leave their nodes, if it is different enough from the map.

    Frames whose node would become too small stay there; if too few frames are left, nothing changes.
    """
    draft = state.copy()
    taken = draft.leave(frames)
    if len(taken) < state.rules.smallest_node:
        return None
    points = [point_of(description) for description in state.descriptions(taken)]
    away, among = _distinctness(draft, np.mean(points, axis=0))
    if away < among:
        return None
    state.nodes, state.labels = draft.nodes, draft.labels
    return _create(state, state.form(taken), trigger=trigger, distance=away, least_distance=among)


def _create(state: State, node: Node, **scores: float | str) -> Node:
    state.adopt(node)
    state.pending = ()
    state.note(Reason.NEW_NODE, node.id, node.frames, **scores)
    return node


def _distinctness(state: State, centre: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean distance of a representative to those of the nodes, and the mean among these ([I] 4.5)."""
    representatives = state.representatives()
    return mean_distance(centre, representatives), state.spacing.among(representatives)


def reconsider(state: State, descriptor: Descriptor, created: int, orientation: bool) -> None:
    """Evaluate the frames of a new node and the window before it again, and move those more similar to another node.

    The mean similarity decides, and in a tie a frame stays where it is. A frame of the new node may go to any node
    whose node-level and centroid conditions it passes. A frame of the window stays in its node or moves to the new one;
    without a node, it goes to the most similar of all, so that no gaps are left before a new node. All frames are
    evaluated before any moves.
    """
    known = dict(state.recent)
    first = min(state.nodes[created].frames)
    again = [frame for frame in sorted(known) if frame >= first - state.rules.window]
    open_to = _open_to(state, {frame: known[frame] for frame in again if state.labels[frame] == created})
    moves: dict[tuple[int, int], list[int]] = {}
    for frame in again:
        own = int(state.labels[frame])
        options = set(state.nodes) if own == NONE else {own, created} | open_to.get(frame, set())
        goal = _best(state, descriptor, frame, known[frame], sorted(options), orientation)
        if goal != own:
            moves.setdefault((own, goal), []).append(frame)
    _move(state, moves)


def _best(
    state: State, descriptor: Descriptor, frame: int, description: Description, options: list[int], orientation: bool
) -> int:
    """Return the node with the highest mean similarity to a frame; ties go to its own, or else to the oldest."""
    own = int(state.labels[frame])
    if len(options) < 2:
        return options[0]
    nodes = [state.nodes[option] for option in options]
    means = image_level(descriptor, description, nodes, state.rules.distance, orientation, leave_out=frame).means()
    return min(means, key=lambda node: (-means[node], node != own, node))


def _open_to(state: State, descriptions: dict[int, Description]) -> dict[int, set[int]]:
    """Return, for each frame, the nodes whose node-level and centroid conditions it passes."""
    if not descriptions:
        return {}
    x = state.rules.x(len(state.nodes))
    points = np.concatenate([description.position for description in descriptions.values()]).astype(np.float64)
    closures = node_levels_of(points, state.ordered(), state.rules.two_sided)
    return {
        frame: _keeping_centroid(state, point, found, x)
        for frame, point, found in zip(descriptions, points, closures, strict=True)
    }


def _keeping_centroid(state: State, point: NDArray[np.float64], closures: Closures, x: float) -> set[int]:
    closing = closures.closing(x)
    pairs = zip(closures.nodes[closing].tolist(), closures.modes[closing].tolist(), strict=True)
    modes = [(node, state.nodes[node].modes[mode]) for node, mode in pairs]
    return {node for node, mode in modes if mode.shift(point) <= mode.reach}


def _move(state: State, moves: dict[tuple[int, int], list[int]]) -> None:
    """Move frames from node to node, in capture order; none leaves a node that would become too small."""
    leaving = sorted(frame for (own, _), frames in moves.items() if own != NONE for frame in frames)
    left = set(state.leave(leaving)) if leaving else set()
    for (own, goal), frames in sorted(moves.items()):
        moved = [frame for frame in frames if own == NONE or frame in left]
        for frame, description in zip(moved, state.descriptions(moved), strict=True):
            join(state, frame, description, goal)
        if moved:
            state.note(Reason.REASSIGNED, goal, moved, came_from=own)


def join(state: State, frame: int, description: Description, goal: int, mode: int | None = None) -> None:
    """Put a frame into a node: into the mode given, or the one that it fits best."""
    node = state.nodes[goal]
    if mode is None:
        mode = node_level(point_of(description), node, state.rules.two_sided).mode
    state.nodes[goal] = node.with_mode(mode, node.modes[mode].add(frame, description))
    state.labels[frame] = goal


@dataclass(frozen=True)
class Known:
    """Distances from one point to nodes, which bound the distances from points nearby.

    Attributes:
        point: (D,).
        closures: its distances to nodes; the nodes that are still part of the map must be unchanged, except for the
            one that is compared with the others.
    """

    point: NDArray[np.float64]
    closures: Closures

    def out_of_reach(self, point: NDArray[np.float64], state: State) -> set[int]:
        """Return nodes that cannot close by eq. 11 with another point (D,).

        The Mahalanobis distance is a norm, so the distances of two points differ by at most the distance between them,
        which is at most their Euclidean distance over the root of the least variance. If the distance is still
        outside mean +- y std, the condition fails and nothing needs to be computed.
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
    """Merge a node that has changed with the nodes that are similar by eq. 10-11, and return the id that remains.

    The changed node's representative is compared with every other node; the one with the smallest deviation for its
    spread comes first; ties go to the older. The older id is kept. The merged node is compared with the rest again.

    Args:
        state: the map.
        node: id of the node that has changed.
        known: distances that save some comparisons; the same nodes are merged without them.
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
