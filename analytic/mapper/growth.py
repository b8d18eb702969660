"""How a map grows: new nodes ([I] 4.5; [T] 4.6), re-evaluated frames ([T] 4.6), merging ([I] 4.6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import NodeLevel, image_level, node_level, node_levels, point_of, within_reach
from analytic.mapper.decision import NONE, Reason
from analytic.mapper.node import Node
from analytic.mapper.state import State


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
    away, among = distinctness(node.modes[0].centre, state.ordered())
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
    if not state.parked:
        return None
    found = node_level(point_of(description), state.parked, state.rules.two_sided)
    fitting = found.closing(state.rules.x(len(state.nodes)))
    if not len(fitting):
        return None
    row = found.best(fitting)
    parked = state.parked[row]
    parked = parked.with_mode(0, parked.modes[0].add(frame, description))
    away, among = distinctness(parked.modes[0].centre, state.ordered())
    if away < among:
        state.parked = (*state.parked[:row], parked, *state.parked[row + 1 :])
        return parked.id, None
    state.parked = state.parked[:row] + state.parked[row + 1 :]
    return parked.id, _create(state, parked, trigger="parked", distance=away, least_distance=among)


def grow_version_2(state: State) -> Node | None:
    """Form a node if too many of the last frames have none, or if they changed node too often."""
    rules = state.rules
    unassigned = _unassigned(state, rules.forced_window)
    if len(unassigned) >= rules.forced_unassigned:
        return _create(state, state.form(unassigned), trigger="forced")
    unassigned = _unassigned(state, rules.checked_window)
    if len(unassigned) >= rules.checked_unassigned:
        return _create_if_distinct(state, unassigned, "unassigned")
    last = state.labels[-rules.changes_window :]
    assigned = last[last != NONE]
    if (assigned[1:] != assigned[:-1]).sum() >= rules.node_changes:
        return _create_if_distinct(state, range(len(state.labels) - len(last), len(state.labels)), "changes")
    return None


def _unassigned(state: State, window: int) -> list[int]:
    start = max(0, len(state.labels) - window)
    return (start + np.flatnonzero(state.labels[start:] == NONE)).tolist()


def _create_if_distinct(state: State, frames: Sequence[int], trigger: str) -> Node | None:
    """Form a node from recent frames, which leave their nodes, if it is different enough from the map.

    Frames whose node would become too small stay there; if too few frames are left, nothing changes.
    """
    draft = state.copy()
    taken = draft.leave(frames)
    if len(taken) < state.rules.smallest_node:
        return None
    points = [point_of(description) for description in state.descriptions(taken)]
    away, among = distinctness(np.mean(points, axis=0), draft.ordered())
    if away < among:
        return None
    state.nodes, state.labels = draft.nodes, draft.labels
    return _create(state, state.form(taken), trigger=trigger, distance=away, least_distance=among)


def _create(state: State, node: Node, **scores: float | str) -> Node:
    state.nodes[node.id] = node
    state.labels[node.frames] = node.id
    state.pending = ()
    state.note(Reason.NEW_NODE, node.id, node.frames, **scores)
    return node


def distinctness(centre: NDArray[np.float64], nodes: Sequence[Node]) -> tuple[float, float]:
    """Return the mean distance of a representative (D,) to those of nodes, and the mean among these ([I] 4.5).

    Two nodes are as far apart as the nearest of the representatives of their modes; a single node has mean 0.
    """
    from scipy.spatial.distance import cdist, pdist, squareform

    centres = np.array([mode.centre for node in nodes for mode in node.modes])
    away, pairs = cdist(centre[None], centres)[0], pdist(centres)
    if len(centres) > len(nodes):
        starts = np.cumsum([0, *(len(node.modes) for node in nodes[:-1])])
        away, apart = np.minimum.reduceat(away, starts), np.minimum.reduceat(squareform(pairs), starts)
        pairs = np.minimum.reduceat(apart, starts, axis=1)[np.triu_indices(len(nodes), 1)]
    return float(away.mean()), float(pairs.mean()) if len(pairs) else 0.0


def reconsider(state: State, descriptor: Descriptor, created: int) -> None:
    """Evaluate the frames of a new node and the window before it again, and move those more similar to another node.

    The mean similarity decides, and in a tie a frame stays where it is. A frame of the new node may go to any node
    whose node-level and centroid conditions it passes. A frame of the window stays in its node or moves to the new one;
    without a node, it goes to the most similar of all, so that no gaps are left before a new node. All frames are
    evaluated before any moves.
    """
    first = min(state.nodes[created].frames)
    known = {frame: one for frame, one in state.recent if frame >= first - state.rules.window}
    open_to = _open_to(state, {frame: one for frame, one in known.items() if state.labels[frame] == created})
    moves: dict[tuple[int, int], list[int]] = {}
    for frame, description in known.items():
        own = int(state.labels[frame])
        options = set(state.nodes) if own == NONE else {own, created} | open_to.get(frame, set())
        goal = _best(state, descriptor, frame, description, sorted(options))
        if goal != own:
            moves.setdefault((own, goal), []).append(frame)
    _move(state, moves)


def _open_to(state: State, known: dict[int, Description]) -> dict[int, set[int]]:
    """Return, for each frame, the nodes whose node-level and centroid conditions (eq. 4 and 9) it passes."""
    if not known:
        return {}
    x = state.rules.x(len(state.nodes))
    points = np.array([point_of(description) for description in known.values()])
    open_to = {}
    for frame, point, found in zip(
        known, points, node_levels(points, state.ordered(), state.rules.two_sided), strict=True
    ):
        rows = found.closing(x)
        modes = [
            (node, state.nodes[node].modes[mode])
            for node, mode in zip(found.nodes[rows].tolist(), found.modes[rows].tolist(), strict=True)
        ]
        open_to[frame] = {node for node, mode in modes if mode.shift(point) <= mode.reach}
    return open_to


def _best(state: State, descriptor: Descriptor, frame: int, description: Description, options: list[int]) -> int:
    """Return the node with the highest mean similarity to a frame; ties go to its own, or else to the oldest."""
    own = int(state.labels[frame])
    if len(options) < 2:
        return options[0]
    nodes = [state.nodes[option] for option in options]
    means = image_level(descriptor, description, nodes, state.rules.distance, leave_out=frame).means()
    return min(means, key=lambda node: (-means[node], node != own, node))


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
        mode = int(node_level(point_of(description), [node], state.rules.two_sided).modes[0])
    state.nodes[goal] = node.with_mode(mode, node.modes[mode].add(frame, description))
    state.labels[frame] = goal


def merge_alike(state: State, node: int, known: tuple[NDArray[np.float64], NodeLevel] | None = None) -> int:
    """Merge a node that has changed with the nodes that are similar by eq. 10-11, and return the id that remains.

    The changed node's representative is compared with every other node; the one with the smallest deviation for its
    spread comes first; ties go to the older. The older id is kept. The merged node is compared with the rest again.

    Args:
        state: the map.
        node: id of the node that has changed.
        known: the frame that joined the node and its comparison with all nodes, which saves most others.
    """
    while True:
        changed = state.nodes[node]
        alike = []
        for own, mode in enumerate(changed.modes):
            nodes = state.ordered()
            if known is not None:
                nodes = within_reach(nodes, known[0], known[1], mode.centre, state.rules.y)
            others = [other for other in nodes if other is not changed]
            if not others:
                continue
            found = node_level(mode.centre, others, state.rules.two_sided)
            rows = found.closing(state.rules.y)
            if len(rows):
                row = found.best(rows)
                alike.append((float(found.ratios[row]), int(found.nodes[row]), own, row, found))
        if not alike:
            return node
        *_, own, row, found = min(alike, key=lambda one: one[:3])
        node, known = _merge(state, changed, own, found, row), None


def _merge(state: State, changed: Node, own: int, found: NodeLevel, row: int) -> int:
    """Merge the mode `own` of a node with the node and mode of a row of the comparison."""
    other, mode = state.nodes[int(found.nodes[row])], int(found.modes[row])
    (first, index), (second, gone) = sorted([(other, mode), (changed, own)], key=lambda place: place[0].id)
    kept = first.with_mode(index, first.modes[index].merge(second.modes[gone]))
    state.nodes[first.id] = Node(first.id, (*kept.modes, *second.modes[:gone], *second.modes[gone + 1 :]))
    del state.nodes[second.id]
    state.labels[state.labels == second.id] = first.id
    state.note(
        Reason.NODES_MERGED,
        first.id,
        second.frames,
        gone=second.id,
        distance=float(found.distances[row]),
        mean=float(found.means[row]),
        std=float(found.stds[row]),
        deviation=float(found.deviations[row]),
        most_deviation=state.rules.y * float(found.stds[row]),
    )
    return first.id
