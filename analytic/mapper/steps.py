"""Process a frame: place it ([I] algorithm 1; [T] 4.6), form a node if it is time, merge."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import NodeLevel, Similarity, image_level, node_level, point_of, prominences_of
from analytic.mapper.decision import NONE, Decision, Location, Reason
from analytic.mapper.growth import (
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
        found: the comparison of the frame with every node.
    """

    reason: Reason
    node: int = NONE
    mode: int = 0
    match: int = NONE
    scores: dict[str, Any] = field(default_factory=dict)
    found: NodeLevel | None = None


def step(state: State, descriptor: Descriptor, description: Description) -> Decision:
    """Add a frame to a state, which is changed, and decide where it belongs.

    Args:
        state: a copy of the map.
        descriptor: descriptor of the map.
        description: description of the frame.
    """
    placement = place(state, descriptor, description) if state.nodes else Placement(Reason.FIRST_FRAMES)
    frame = state.append(description, NONE, placement.match)
    if placement.node != NONE:
        join(state, frame, description, placement.node, placement.mode)
        state.pending = ()
    created = _grow(state, placement, frame, description)
    if created is not None and state.rules.version == 2 and len(state.nodes) > 1:
        reconsider(state, descriptor, created.id)
    changed = placement.node if created is None else created.id
    wanted = {"changed": changed != NONE, "created": created is not None}
    if wanted.get(state.rules.merge, False):
        known = None if created is not None or placement.found is None else (point_of(description), placement.found)
        merge_alike(state, changed, known)
    label = int(state.labels[frame])
    reason = _reason(state, placement.reason, frame)
    return Decision(None if label == NONE else label, reason, placement.scores, frame, state.changes)


def place(state: State, descriptor: Descriptor, description: Description) -> Placement:
    """Find where a frame belongs ([I] algorithm 1), without changing the state, which has at least one node."""
    rules = state.rules
    x = rules.x(len(state.nodes))
    point = point_of(description)
    found = node_level(point, state.ordered(), rules.two_sided)
    closing = found.nodes[found.closing(x)].tolist()
    scores: dict[str, Any] = {"x": x, "nodes": found.scores(), "candidates": closing}
    if not closing:
        return Placement(Reason.NO_CANDIDATE_NODE, scores=scores)
    similarity = image_level(descriptor, description, [state.nodes[key] for key in closing], rules.distance)
    node, row = _most_similar(similarity, rules.version)
    match = int(similarity.frames[row])
    if rules.version == 2:
        scores["mean_similarity"] = {str(key): value for key, value in similarity.means().items()}
    scores |= {"node": node, "match": match, "similarity": float(similarity.values[row])}
    mode = int(found.modes[found.nodes == node][0])
    if rules.version == 1:
        heights = prominences_of(similarity, state.labels, closing)
        # In this order, so that a single peak among gamma frames exactly reaches its own limit.
        least = rules.gamma / len(heights) * float(heights.sum())
        scores |= {"prominence": float(heights[row]), "least_prominence": least}
        if heights[row] < least:  # eq. 8; frames that are not a peak have prominence 0
            return Placement(Reason.NOT_PROMINENT, match=match, scores=scores)
    own = state.nodes[node].modes[mode]
    scores |= {"centroid_shift": own.shift(point), "most_centroid_shift": own.reach}
    if own.shift(point) > own.reach:  # eq. 9
        return Placement(Reason.MOVES_CENTROID, match=match, scores=scores)
    return Placement(Reason.ASSIGNED, node, mode, match, scores, found)


def locate(state: State, descriptor: Descriptor, description: Description, poses: list[Any]) -> Location:
    """Find a frame in a state with at least one node; of the nodes, those that close compete, or else the nearest."""
    rules = state.rules
    found = node_level(point_of(description), state.ordered(), rules.two_sided)
    x = rules.x(len(state.nodes))
    rows = found.closing(x)
    closing = found.nodes[rows].tolist()
    candidates = closing or [int(found.nodes[found.best(slice(None))])]
    similarity = image_level(descriptor, description, [state.nodes[key] for key in candidates], rules.distance)
    node, row = _most_similar(similarity, rules.version)
    frame = int(similarity.frames[row])
    scores = {
        "x": x,
        "nodes": found.scores(),
        "candidates": closing,
        "mean_similarity": {str(key): value for key, value in similarity.means().items()},
        "similarity": float(similarity.values[row]),
    }
    heading = None
    if description.orientation is not None:
        gallery = state.nodes[node].modes[int(similarity.modes[row])].gallery
        heading = float(descriptor.align(description, gallery.keep(gallery.frames == frame).shown).heading[0, 0])
    return Location(node, frame, poses[frame], heading, bool(closing), scores)


def _most_similar(similarity: Similarity, version: int) -> tuple[int, int]:
    """Return the most similar node, and the row of its most similar frame.

    Version 1 takes the node of the most similar frame (eq. 7), version 2 that with the highest mean ([T] 4.6).
    """
    if version == 1:
        row = similarity.best()
        return int(similarity.nodes[row]), row
    means = similarity.means()
    node = min(means, key=lambda key: (-means[key], key))
    return node, similarity.best(node)


def maintain(state: State, node: int, descriptions: list[Description]) -> Decision:
    """Give a node another mode: frames of another appearance of its place. Its other modes stay as they are."""
    start = len(state.labels)
    for description in descriptions:
        state.append(description, node, NONE)
    frames = range(start, len(state.labels))
    known = state.nodes[node]
    state.nodes[node] = Node(node, (*known.modes, Mode.of(state.rules, frames, descriptions)))
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
