"""When frames without a node become one ([I] 4.5; [T] 4.6 for version 2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.mapper.closure import node_level, point_of
from analytic.mapper.decision import Reason
from analytic.mapper.node import Node
from analytic.mapper.spacing import mean_distance
from analytic.mapper.state import NONE, State


def first_node(state: State) -> Node | None:
    """Form the node that the map starts with, as soon as there are enough frames ([I] 6)."""
    if len(state.pending) < state.rules.first_node:
        return None
    return _create(state, state.form(state.pending), trigger="first frames")


def grow_version_1(state: State) -> Node | None:
    """Form a node of the frames without one, if there are enough in a row; park it if it is too like the map."""
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
        The candidate's id, with its node if the frame made it different enough from the map; None if none fits.
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
    """Form a node if the last frames ask for one: too many have none, or they changed node too often."""
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
    """Return how often the node changes along labels (n,), frames without one left out."""
    assigned = labels[labels != NONE]
    return int((assigned[1:] != assigned[:-1]).sum())


def _unassigned(state: State, window: int) -> list[int]:
    start = max(0, len(state.labels) - window)
    return [start + int(index) for index in np.flatnonzero(state.labels[start:] == NONE)]


def _create_if_distinct(state: State, frames: Sequence[int], trigger: str) -> Node | None:
    """Form a node of recent frames, taken from their nodes, if it is different enough from the map.

    Frames of a node that would be left too small stay there; if too few come together, nothing changes.
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
