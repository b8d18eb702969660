"""A map between two frames, and how it grows.

New nodes: [I] 4.5 and [T] 4.6; frames evaluated again: [T] 4.6; merging: [I] 4.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from analytic.arrays import Floats, Integers
from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import NodeLevel, image_level, node_level, point_of
from analytic.mapper.decision import NONE, Change, Reason
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters


@dataclass
class State:
    """A map between two frames. A frame is added to a copy, which replaces the map if everything succeeds.

    Attributes:
        rules: the thresholds that decide how the map grows.
        nodes: nodes by id, in no particular order.
        parked: candidates of version 1, the oldest first.
        labels: (n,) node of each frame, -1 for none.
        matches: (n,) the frame most similar to each frame when that was added, -1 for none.
        recent: the last frames and their descriptions.
        pending: the consecutive frames without a node up to the last one.
        next_id: id that the next node will get; ids are never used twice.
        changes: changes made while a frame was added.
        calls: number of successful calls of `add`, `maintain` and `forget`.
    """

    rules: Parameters
    nodes: dict[int, Node] = field(default_factory=dict)
    parked: tuple[Node, ...] = ()
    labels: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    matches: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    recent: tuple[tuple[int, Description], ...] = ()
    pending: tuple[int, ...] = ()
    next_id: int = 0
    changes: tuple[Change, ...] = ()
    calls: int = 0

    def copy(self) -> State:
        """Return a working copy; nodes and descriptions are immutable and shared."""
        return replace(self, nodes=dict(self.nodes), labels=self.labels.copy(), changes=())

    def ordered(self) -> list[Node]:
        """Return the nodes by id, the smallest and oldest first."""
        return [self.nodes[key] for key in sorted(self.nodes)]

    def append(self, description: Description, label: int, match: int) -> int:
        """Add the next frame and return its number, counted from 0.

        Args:
            description: description of the frame.
            label: id of the frame's node, -1 for none.
            match: number of the earlier frame that is most similar to this frame, -1 for none.
        """
        frame = len(self.labels)
        self.labels = np.append(self.labels, label)
        self.matches = np.append(self.matches, match)
        self.recent = (*self.recent, (frame, description))[-self.rules.memory :]
        return frame

    def descriptions(self, frames: Sequence[int]) -> list[Description]:
        """Return the descriptions of some recent frames, by number."""
        known = dict(self.recent)
        return [known[frame] for frame in frames]

    def form(self, frames: Sequence[int]) -> Node:
        """Make a node of recent frames, with the next id, without adding the node to the map."""
        node = Node(self.next_id, (Mode.of(self.rules, frames, self.descriptions(frames)),))
        self.next_id += 1
        return node

    def leave(self, frames: Sequence[int]) -> list[int]:
        """Remove frames from their nodes and return the frames that were removed.

        A frame stays if its node would be left with too few frames or, where exemplars are bounded, with none to
        compare images with.
        """
        left = []
        for label in np.unique(self.labels[list(frames)]).tolist():
            leaving = [frame for frame in frames if self.labels[frame] == label]
            if label != NONE:
                kept = self.nodes[label].remove(leaving)
                if len(kept) < self.rules.smallest_node or not all(len(mode.gallery) for mode in kept.modes):
                    continue
                self.nodes[label] = kept
                self.labels[leaving] = NONE
            left += leaving
        return sorted(left)

    def note(self, reason: Reason, node: int | None, frames: Sequence[int], **scores: float | bool | str) -> None:
        """Record a change of the map for the decision and the log.

        Args:
            reason: why the map changes.
            node: id of the node that changes; None if the change concerns no node.
            frames: numbers of the frames concerned.
            scores: measured numbers and limits that led to the change, by name.
        """
        self.changes = (*self.changes, Change(reason, node, tuple(int(frame) for frame in frames), scores))


def grow_version_1(state: State) -> Node | None:
    """Form a node from enough consecutive frames without a node; park it if it is too similar to the map ([I] 4.5).

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
        forgotten, state.parked = state.parked[0], state.parked[1:]
        state.note(Reason.PARKED_FORGOTTEN, forgotten.id, forgotten.frames)
    return None


def join_parked(state: State, frame: int, description: Description) -> tuple[int, Node | None] | None:
    """Let a frame without a node join the parked candidate that it fits best by eq. 4.

    Returns:
        The candidate's id, and its node if the frame made it different enough from the map; None if none fits.
    """
    if not state.parked or not state.nodes:
        return None
    x = state.rules.x(len(state.nodes))
    found = node_level(point_of(description), state.parked, state.rules.two_sided, x)
    fitting = found.closing(x)
    if not len(fitting):
        return None
    row = [node.id for node in state.parked].index(found.nodes[found.best(fitting)])
    parked = state.parked[row]
    parked = parked.with_mode(0, parked.modes[0].add(frame, description))
    measured, distinct = distinctness(parked.modes[0].centre, state.ordered())
    state.parked = (*state.parked[:row], *(() if distinct else (parked,)), *state.parked[row + 1 :])
    return parked.id, _create(state, parked, trigger="parked", **measured) if distinct else None


def grow_version_2(state: State) -> Node | None:
    """Form a node if too many of the last frames have no node, or changed their node too often ([T] 4.6)."""
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


def distinctness(centre: Floats, nodes: Sequence[Node]) -> tuple[dict[str, float], bool]:
    """Compare how far a representative (D,) is from the nodes with how far the nodes are from each other ([I] 4.5).

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
    """Evaluate a new node's frames and the window before it again; move frames that are more similar to another node.

    The mean similarity to the frames of a node decides, and in a tie a frame stays where it is. A frame of the new node
    may go to any node whose node-level and centroid conditions it passes. A frame of the window stays in its node or
    moves to the new node; a frame in no node goes to the most similar node of all, so that no gaps are left before a
    new node. All frames are evaluated before any moves.
    """
    rules, x = state.rules, state.rules.x(len(state.nodes))
    first = min(state.nodes[created].frames)
    known = {frame: description for frame, description in state.recent if frame >= first - rules.window}
    moves: dict[tuple[int, int], list[int]] = {}
    for frame, description in known.items():
        own = int(state.labels[frame])
        options = set(state.nodes) if own == NONE else {own, created}
        if own == created:
            point = point_of(description)
            found = node_level(point, state.ordered(), rules.two_sided, x)
            for row in found.closing(x):
                mode = state.nodes[int(found.nodes[row])].modes[found.modes[row]]
                if mode.shift(point) <= mode.reach:
                    options.add(int(found.nodes[row]))
        goal = created
        if len(options) > 1:
            nodes = [state.nodes[option] for option in sorted(options)]
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


def join(state: State, frame: int, description: Description, goal: int, mode: int | None = None) -> None:
    """Add a frame to the node with id `goal`: to a given mode, or to the mode that the frame fits best."""
    node = state.nodes[goal]
    if mode is None:
        mode = int(node_level(point_of(description), [node], state.rules.two_sided).modes[0])
    state.nodes[goal] = node.with_mode(mode, node.modes[mode].add(frame, description))
    state.labels[frame] = goal


def merge_alike(state: State, node: int) -> None:
    """Merge a node that has changed with the nodes that are similar to it (eq. 10-11).

    The changed node's representative is compared with every other node; the one with the smallest deviation for its
    spread comes first; ties go to the older. The older id is kept. The merged node is compared with the rest again.
    """
    changed, alike = state.nodes[node], []
    others = [other for other in state.ordered() if other is not changed]
    for own, mode in enumerate(changed.modes if others else ()):
        found = node_level(mode.centre, others, state.rules.two_sided, state.rules.y)
        rows = found.closing(state.rules.y)
        if len(rows):
            row = found.best(rows)
            alike.append((float(found.ratios[row]), int(found.nodes[row]), own, row, found))
    if alike:
        *_, own, row, found = min(alike, key=lambda one: one[:3])
        merge_alike(state, merge(state, changed, own, found, row))


def merge(state: State, changed: Node, own: int, found: NodeLevel, row: int) -> int:
    """Merge a node, by its mode `own`, with the node and mode in a row of `found`; return the id that is kept."""
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
