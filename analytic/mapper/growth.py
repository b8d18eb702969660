"""How a map grows: new nodes ([I] 4.5; [T] 4.6), re-evaluated frames ([T] 4.6), merging ([I] 4.6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import NodeLevel, image_level, node_level, node_levels, point_of, within_reach
from analytic.mapper.decision import NONE, Reason
from analytic.mapper.node import Node
from analytic.mapper.state import State


def grow_version_1(state: State) -> Node | None:
    """Form a node from enough consecutive frames without one; park it if it is too similar to the map ([I] 4.5).

    The first node is formed as soon as there are enough frames ([I] 6).
    """
    rules = state.rules
    if len(state.pending) < (rules.new_node if state.nodes else rules.first_node):
        return None
    node = state.form(state.pending)
    if not state.nodes:
        return _create(state, node, trigger="first frames")
    state.pending = ()
    measured, distinct = distinctness(node.modes[0].centre, state.ordered())
    if distinct:
        return _create(state, node, trigger="consecutive", **measured)
    state.parked = (*state.parked, node)
    state.note(Reason.NODE_PARKED, node.id, node.frames, **measured)
    while len(state.parked) > rules.parked_nodes:
        forgotten, *kept = state.parked
        state.parked = tuple(kept)
        state.note(Reason.PARKED_FORGOTTEN, forgotten.id, forgotten.frames)
    return None


def join_parked(state: State, frame: int, description: Description) -> tuple[int, Node | None] | None:
    """Let a frame without a node join the parked candidate that it fits best by eq. 4.

    Returns:
        The candidate's id, and its node if the frame made it different enough from the map; None if none fits.
    """
    if not state.parked or not state.nodes:
        return None
    found = node_level(point_of(description), state.parked, state.rules.two_sided)
    fitting = found.closing(state.rules.x(len(state.nodes)))
    if not len(fitting):
        return None
    row = found.best(fitting)
    parked = state.parked[row]
    parked = parked.with_mode(0, parked.modes[0].add(frame, description))
    measured, distinct = distinctness(parked.modes[0].centre, state.ordered())
    state.parked = (*state.parked[:row], *(() if distinct else (parked,)), *state.parked[row + 1 :])
    return parked.id, _create(state, parked, trigger="parked", **measured) if distinct else None


def grow_version_2(state: State) -> Node | None:
    """Form a node if too many of the last frames have none, or if they changed node too often ([T] 4.6)."""
    rules, labels = state.rules, state.labels

    def unassigned(window: int) -> list[int]:
        start = max(0, len(labels) - window)
        return (start + np.flatnonzero(labels[start:] == NONE)).tolist()

    if len(frames := unassigned(rules.forced_window)) >= rules.forced_unassigned:
        return _create(state, state.form(frames), trigger="forced")
    if len(frames := unassigned(rules.checked_window)) >= rules.checked_unassigned:
        return _create_if_distinct(state, frames, "unassigned")
    start = max(0, len(labels) - rules.changes_window)
    assigned = labels[start:][labels[start:] != NONE]
    if (assigned[1:] != assigned[:-1]).sum() >= rules.node_changes:
        return _create_if_distinct(state, range(start, len(labels)), "changes")
    return None


def _create_if_distinct(state: State, frames: Sequence[int], trigger: str) -> Node | None:
    """Form a node from recent frames, which leave their nodes, if it is different enough from the map.

    Frames whose node would become too small stay there; if too few frames are left, nothing changes.
    """
    draft = state.copy()
    taken = draft.leave(frames)
    if len(taken) < state.rules.smallest_node:
        return None
    points = [point_of(description) for description in state.descriptions(taken)]
    measured, distinct = distinctness(np.mean(points, axis=0), draft.ordered())
    if not distinct:
        return None
    state.nodes, state.labels = draft.nodes, draft.labels
    return _create(state, state.form(taken), trigger=trigger, **measured)


def _create(state: State, node: Node, **scores: Any) -> Node:
    state.nodes[node.id] = node
    state.labels[node.frames] = node.id
    state.pending = ()
    state.note(Reason.NEW_NODE, node.id, node.frames, **scores)
    return node


def distinctness(centre: NDArray[np.float64], nodes: Sequence[Node]) -> tuple[dict[str, float], bool]:
    """Compare the mean distance of a representative (D,) to those of nodes with the mean among these ([I] 4.5).

    Two nodes are as far apart as the nearest of the representatives of their modes; a single node has mean 0.

    Returns:
        Both means, and whether the representative is at least as far away as the nodes are from each other.
    """
    from scipy.spatial.distance import cdist, pdist, squareform

    centres = np.array([mode.centre for node in nodes for mode in node.modes])
    away, pairs = cdist(centre[None], centres)[0], pdist(centres)
    if len(centres) > len(nodes):
        starts = np.cumsum([0, *(len(node.modes) for node in nodes[:-1])])
        away, apart = np.minimum.reduceat(away, starts), np.minimum.reduceat(squareform(pairs), starts)
        pairs = np.minimum.reduceat(apart, starts, axis=1)[np.triu_indices(len(nodes), 1)]
    distance, least = float(away.mean()), float(pairs.mean()) if len(pairs) else 0.0
    return {"distance": distance, "least_distance": least}, distance >= least


def reconsider(state: State, descriptor: Descriptor, created: int) -> None:
    """Evaluate the frames of a new node and the window before it again, and move those more similar to another node.

    The mean similarity decides, and in a tie a frame stays where it is. A frame of the new node may go to any node
    whose node-level and centroid conditions it passes. A frame of the window stays in its node or moves to the new one;
    without a node, it goes to the most similar of all, so that no gaps are left before a new node. All frames are
    evaluated before any moves.
    """
    rules = state.rules
    first = min(state.nodes[created].frames)
    known = {frame: one for frame, one in state.recent if frame >= first - rules.window}
    inside = [frame for frame in known if state.labels[frame] == created]
    open_to = dict(zip(inside, _open_to(state, [known[frame] for frame in inside]), strict=True))
    moves: dict[tuple[int, int], list[int]] = {}
    for frame, description in known.items():
        own = int(state.labels[frame])
        options = sorted(set(state.nodes) if own == NONE else {own, created} | open_to.get(frame, set()))
        goal = options[0]
        if len(options) > 1:
            nodes = [state.nodes[option] for option in options]
            means = image_level(descriptor, description, nodes, rules.distance, leave_out=frame).means()
            goal = min(means, key=lambda node: (-means[node], node != own, node))
        if goal != own:
            moves.setdefault((own, goal), []).append(frame)
    left = set(state.leave(sorted(frame for (own, _), frames in moves.items() if own != NONE for frame in frames)))
    for (own, goal), frames in sorted(moves.items()):
        moved = [frame for frame in frames if own == NONE or frame in left]
        for frame in moved:
            join(state, frame, known[frame], goal)
        if moved:
            state.note(Reason.REASSIGNED, goal, moved, came_from=own)


def _open_to(state: State, descriptions: Sequence[Description]) -> list[set[int]]:
    """Return, for each frame, the nodes whose node-level and centroid conditions (eq. 4 and 9) it passes."""
    points = np.array([point_of(description) for description in descriptions])
    open_to = []
    for point, found in zip(points, node_levels(points, state.ordered(), state.rules.two_sided), strict=True):
        rows = found.closing(state.rules.x(len(state.nodes)))
        places = zip(found.nodes[rows].tolist(), found.modes[rows].tolist(), strict=True)
        modes = {node: state.nodes[node].modes[mode] for node, mode in places}
        open_to.append({node for node, mode in modes.items() if mode.shift(point) <= mode.reach})
    return open_to


def join(state: State, frame: int, description: Description, goal: int, mode: int | None = None) -> None:
    """Put a frame into a node: into the mode given, or the one that it fits best."""
    node = state.nodes[goal]
    if mode is None:
        mode = int(node_level(point_of(description), [node], state.rules.two_sided).modes[0])
    state.nodes[goal] = node.with_mode(mode, node.modes[mode].add(frame, description))
    state.labels[frame] = goal


def merge_alike(state: State, node: int, known: tuple[NDArray[np.float64], NodeLevel] | None = None) -> None:
    """Merge a node that has changed with the nodes that are similar to it (eq. 10-11).

    The changed node's representative is compared with every other node; the one with the smallest deviation for its
    spread comes first; ties go to the older. The older id is kept. The merged node is compared with the rest again.

    Args:
        state: the map.
        node: id of the node that has changed.
        known: the frame that joined the node and its comparison with all nodes, which saves most others.
    """
    changed, alike = state.nodes[node], []
    for own, mode in enumerate(changed.modes):
        nodes = state.ordered()
        if known is not None:
            nodes = within_reach(nodes, known[0], known[1], mode.centre, state.rules.y)
        others = [other for other in nodes if other is not changed]
        if others:
            found = node_level(mode.centre, others, state.rules.two_sided)
            rows = found.closing(state.rules.y)
            if len(rows):
                row = found.best(rows)
                alike.append((float(found.ratios[row]), int(found.nodes[row]), own, row, found))
    if alike:
        *_, own, row, found = min(alike, key=lambda one: one[:3])
        merge_alike(state, merge(state, changed, own, found, row))


def merge(state: State, changed: Node, own: int, found: NodeLevel, row: int) -> int:
    """Merge the mode `own` of a node with the node and mode of a row of its comparison; return the id that is kept."""
    other, mode = state.nodes[int(found.nodes[row])], int(found.modes[row])
    (first, index), (second, gone) = sorted([(other, mode), (changed, own)], key=lambda place: place[0].id)
    kept = first.with_mode(index, first.modes[index].merge(second.modes[gone]))
    state.nodes[first.id] = Node(first.id, (*kept.modes, *second.modes[:gone], *second.modes[gone + 1 :]))
    del state.nodes[second.id]
    state.labels[state.labels == second.id] = first.id
    measured = {name: float(getattr(found, f"{name}s")[row]) for name in ("distance", "mean", "std", "deviation")}
    limit = state.rules.y * measured["std"]
    state.note(Reason.NODES_MERGED, first.id, second.frames, gone=second.id, **measured, most_deviation=limit)
    return first.id
