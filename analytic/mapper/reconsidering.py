"""After a new node: do its frames, and those before it, still belong where they are? ([T] 4.6)."""

from __future__ import annotations

import numpy as np

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import image_level
from analytic.mapper.decision import Reason
from analytic.mapper.placing import closures_of
from analytic.mapper.state import NONE, State


def reconsider(state: State, descriptor: Descriptor, created: int, orientation: bool) -> None:
    """Evaluate the frames of a new node and the window before it again, and move those more similar elsewhere.

    The mean similarity decides, and at equality a frame stays where it is. A frame of the new node may go to any node
    whose node-level and centroid condition it passes. A frame of the window stays in its node or is more similar to the
    new one; without a node, it goes to the most similar of all, so that no gaps are left before a new node. All frames
    are evaluated before any moves.
    """
    known = dict(state.recent)
    first = min(state.nodes[created].frames)
    moves: dict[tuple[int, int], list[int]] = {}
    for frame in sorted(known):
        if frame >= first - state.rules.window:
            own = int(state.labels[frame])
            goal = _best(state, descriptor, frame, known[frame], created, orientation)
            if goal != own:
                moves.setdefault((own, goal), []).append(frame)
    _move(state, moves)


def _best(
    state: State, descriptor: Descriptor, frame: int, description: Description, created: int, orientation: bool
) -> int:
    own = int(state.labels[frame])
    options = set(state.nodes) if own == NONE else {own, created}
    if own == created:
        options |= _open_to(state, description)
    if len(options) < 2:
        return next(iter(options))
    nodes = [state.nodes[option] for option in sorted(options)]
    means = image_level(descriptor, description, nodes, state.rules.distance, orientation, leave_out=frame).means()
    return min(means, key=lambda node: (-means[node], node != own, node))


def _open_to(state: State, description: Description) -> set[int]:
    """Return the nodes whose node-level and centroid condition a frame passes."""
    point = description.position[0].astype(np.float64)
    x = state.rules.x(len(state.nodes))
    closures = [closure for closure in closures_of(state, description).values() if closure.closes(x)]
    modes = [(closure.node, state.nodes[closure.node].modes[closure.mode]) for closure in closures]
    return {node for node, mode in modes if mode.shift(point) <= mode.reach}


def _move(state: State, moves: dict[tuple[int, int], list[int]]) -> None:
    """Move frames from node to node, in capture order; none leaves a node that would be left too small."""
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
    index = closures_of(state, description)[goal].mode if mode is None else mode
    state.nodes[goal] = node.with_mode(index, node.modes[index].add(frame, description))
    state.labels[frame] = goal
