"""Process a frame: place it ([I] algorithm 1; [T] 4.6), form a node if it is time, merge."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import (
    Closures,
    Similarity,
    image_level,
    node_levels,
    point_of,
    prominences,
    similarity_curve,
)
from analytic.mapper.decision import NONE, Decision, Reason
from analytic.mapper.growth import (
    Known,
    first_node,
    grow_version_1,
    grow_version_2,
    join,
    join_parked,
    merge_alike,
    reconsider,
)
from analytic.mapper.node import Mode, Node
from analytic.mapper.state import State


@dataclass
class Placement:
    """Where a frame belongs, and what was measured to find out.

    Attributes:
        reason: why it belongs to `node`, or to none.
        node: id of the node, or -1.
        mode: index of the mode in the node.
        match: the most similar frame, or -1.
        scores: what was measured.
        closures: node-level distances of the frame to every node.
    """

    reason: Reason
    node: int = NONE
    mode: int = 0
    match: int = NONE
    scores: dict[str, Any] = field(default_factory=dict)
    closures: Closures | None = None


def step(state: State, descriptor: Descriptor, description: Description, orientation: bool) -> Decision:
    """Add a frame to a state and decide where it belongs.

    Args:
        state: a copy of the map, which is changed.
        descriptor: descriptor of the map.
        description: description of the frame.
        orientation: whether orientation parts are compared.
    """
    placement = place(state, descriptor, description, orientation) if state.nodes else Placement(Reason.FIRST_FRAMES)
    frame = state.append(description, NONE, placement.match)
    if placement.node != NONE:
        join(state, frame, description, placement.node, placement.mode)
        state.pending = ()
    created = _grow(state, placement, frame, description)
    if created is not None and state.rules.version == 2 and len(state.nodes) > 1:
        reconsider(state, descriptor, created.id, orientation)
    changed = placement.node if created is None else created.id
    wanted = {"changed": changed != NONE, "created": created is not None}
    if wanted.get(state.rules.merge, False):
        # The distances of the frame are valid for nodes that have not changed since it was placed.
        known = Known(point_of(description), placement.closures) if created is None and placement.closures else None
        merge_alike(state, changed, known)
    label = int(state.labels[frame])
    return Decision(
        None if label == NONE else label,
        _reason(state, placement.reason, frame),
        placement.scores,
        frame,
        state.changes,
    )


def maintain(state: State, node: int, descriptions: list[Description]) -> Decision:
    """Give a node another mode: frames of another appearance of its place. Its other modes stay as they are."""
    start = len(state.labels)
    for description in descriptions:
        state.append(description, node, NONE)
    frames = range(start, len(state.labels))
    mode = Mode.of(state.rules, frames, descriptions)
    known = state.nodes[node]
    state.nodes[node] = Node(node, (*known.modes, mode))
    state.pending = ()
    state.note(Reason.MAINTAINED, node, frames)
    return Decision(node, Reason.MAINTAINED, {"modes": len(known.modes) + 1}, frames[-1], state.changes)


def _grow(state: State, placement: Placement, frame: int, description: Description) -> Node | None:
    """Form a node if it is time; the placement records whether the frame joined a parked candidate."""
    if placement.reason is Reason.FIRST_FRAMES:
        state.pending = (*state.pending, frame)
        return first_node(state)
    if state.rules.version == 2:
        return grow_version_2(state)
    if placement.node != NONE:
        return None
    joined = join_parked(state, frame, description)
    if joined is None:
        state.pending = (*state.pending, frame)
        return grow_version_1(state)
    state.pending = ()
    placement.reason = Reason.JOINED_PARKED
    placement.scores["parked"], created = joined
    return created


def _reason(state: State, placed: Reason, frame: int) -> Reason:
    """Return why a frame is where it is: its placement, or the last change that moved it.

    Merging moves only the frames of the node that disappears.
    """
    reason = placed
    for change in state.changes:
        if frame in change.frames and change.reason is not Reason.PARKED_FORGOTTEN:
            reason = change.reason
    return reason


def place(state: State, descriptor: Descriptor, description: Description, orientation: bool) -> Placement:
    """Find where a frame belongs, without changing anything.

    Args:
        state: the map, with at least one node.
        descriptor: descriptor of the map.
        description: description of the frame.
        orientation: whether orientation parts are compared.
    """
    rules = state.rules
    x = rules.x(len(state.nodes))
    closures = closures_of(state, description)
    scores: dict[str, Any] = {"x": x, "nodes": closures.scores()}
    closing = closures.nodes[closures.closing(x)].tolist()
    scores["candidates"] = closing
    if not closing:
        return Placement(Reason.NO_CANDIDATE_NODE, scores=scores)
    candidates = [state.nodes[node] for node in closing]
    similarity = image_level(descriptor, description, candidates, rules.distance, orientation)
    if rules.version == 1:
        row = similarity.best()
        node = int(similarity.nodes[row])
    else:
        means = similarity.means()
        node = min(means, key=lambda key: (-means[key], key))
        row = similarity.best(node)
        scores["mean_similarity"] = {str(key): value for key, value in means.items()}
    match = int(similarity.frames[row])
    scores |= {"node": node, "match": match, "similarity": float(similarity.values[row])}
    mode = closures.of(node).mode
    found = Placement(Reason.ASSIGNED, match=match, scores=scores, closures=closures)
    if rules.version == 1 and not _stands_out(similarity, row, state, found):
        found.reason = Reason.NOT_PROMINENT
    elif not _keeps_centroid(state.nodes[node].modes[mode], description, scores):
        found.reason = Reason.MOVES_CENTROID
    else:
        found.node, found.mode = node, mode
    return found


def closures_of(state: State, description: Description) -> Closures:
    """Return the node-level distances of a frame to every node, the oldest first."""
    return node_levels(point_of(description), state.ordered(), state.rules.two_sided)


def _stands_out(similarity: Similarity, row: int, state: State, found: Placement) -> bool:
    """Test eq. 8. The mean is over all candidate images; those that are not a peak have prominence 0."""
    curve, where = similarity_curve(similarity, state.labels, found.scores["candidates"])
    heights = prominences(curve)
    prominence = float(heights[where[row]])
    # In this order, so that a single peak among gamma frames exactly reaches its own limit.
    least = state.rules.gamma / len(where) * float(heights.sum())
    found.scores |= {"prominence": prominence, "least_prominence": least}
    return prominence >= least


def _keeps_centroid(mode: Mode, description: Description, scores: dict[str, Any]) -> bool:
    """Test eq. 9."""
    shift, reach = mode.shift(point_of(description)), mode.reach
    scores |= {"centroid_shift": shift, "most_centroid_shift": reach}
    return shift <= reach
