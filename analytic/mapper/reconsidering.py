"""After a new node: do its frames, and those before it, still belong where they are? ([T] 4.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import Closures, image_level, node_level, node_levels_of, point_of
from analytic.mapper.decision import Reason
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
    """Return the node with the highest mean similarity to a frame, of equals its own, or else the oldest."""
    own = int(state.labels[frame])
    if len(options) < 2:
        return options[0]
    nodes = [state.nodes[option] for option in options]
    means = image_level(descriptor, description, nodes, state.rules.distance, orientation, leave_out=frame).means()
    return min(means, key=lambda node: (-means[node], node != own, node))


def _open_to(state: State, descriptions: dict[int, Description]) -> dict[int, set[int]]:
    """Return, for each of some frames, the nodes whose node-level and centroid condition it passes."""
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
    if mode is None:
        mode = node_level(point_of(description), node, state.rules.two_sided).mode
    state.nodes[goal] = node.with_mode(mode, node.modes[mode].add(frame, description))
    state.labels[frame] = goal
