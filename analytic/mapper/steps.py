"""Process a frame: place it ([I] algorithm 1; [T] 4.6), form a node if it is time, merge."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import NodeLevel, Similarity, image_level, node_level, point_of, prominences_of
from analytic.mapper.decision import NONE, Decision, Location, Reason
from analytic.mapper.growth import State, grow_version_1, grow_version_2, join, join_parked, merge_alike, reconsider
from analytic.mapper.node import Mode, Node


@dataclass
class Placement:
    """The node where a frame belongs, and what was measured to find it.

    Attributes:
        reason: why the frame belongs to `node`, or to none.
        node: id of the node, or -1.
        mode: index of the frame's mode in the node.
        match: number of the most similar frame, or -1.
        scores: measured numbers and limits, by name.
    """

    reason: Reason
    node: int = NONE
    mode: int = 0
    match: int = NONE
    scores: dict[str, Any] = field(default_factory=dict)


def step(state: State, descriptor: Descriptor, description: Description) -> Decision:
    """Add a frame to a state, which is changed, and decide where it belongs.

    Args:
        state: a copy of the map.
        descriptor: descriptor of the map.
        description: description of the frame.
    """
    rules = state.rules
    placement = place(state, descriptor, description) if state.nodes else Placement(Reason.FIRST_FRAMES)
    frame = state.append(description, NONE, placement.match)
    created = None
    if placement.node != NONE:
        join(state, frame, description, placement.node, placement.mode)
        state.pending = ()
    if rules.version == 1 and (joined := placement.node == NONE and join_parked(state, frame, description)):
        placement.reason = Reason.JOINED_PARKED
        placement.scores["parked"], created = joined
        state.pending = ()
    elif placement.node == NONE:
        state.pending = (*state.pending, frame)
    if created is None:
        created = (grow_version_1 if rules.version == 1 or not state.nodes else grow_version_2)(state)
    if created is not None and rules.version == 2 and len(state.nodes) > 1:
        reconsider(state, descriptor, created.id)
    changed = placement.node if created is None else created.id
    if changed != NONE and (rules.merge == "changed" or (rules.merge == "created" and created is not None)):
        merge_alike(state, changed)
    reason = placement.reason
    for change in state.changes:  # the last change that moved the frame; a merger moves the frames of the removed node
        if frame in change.frames and change.reason is not Reason.PARKED_FORGOTTEN:
            reason = change.reason
    label = int(state.labels[frame])
    return Decision(None if label == NONE else label, reason, placement.scores, frame, state.changes)


def place(state: State, descriptor: Descriptor, description: Description) -> Placement:
    """Find where a frame belongs ([I] algorithm 1), without changing the state, which has at least one node."""
    rules = state.rules
    point = point_of(description)
    found = node_level(point, state.ordered(), rules.two_sided, rules.x(len(state.nodes)))
    closing, scores = _closing(state, found)
    if not closing:
        return Placement(Reason.NO_CANDIDATE_NODE, scores=scores)
    similarity = image_level(descriptor, description, [state.nodes[key] for key in closing], rules.distance)
    node, row, means = most_similar(similarity, rules.version)
    match = int(similarity.frames[row])
    if rules.version == 2:
        scores["mean_similarity"] = means
    scores |= {"node": node, "match": match, "similarity": float(similarity.values[row])}
    if rules.version == 1:
        heights = prominences_of(similarity, state.labels, closing)
        # In this order, so that a single peak among gamma frames exactly reaches its own limit.
        least = rules.gamma / len(heights) * float(heights.sum())
        scores |= {"prominence": float(heights[row]), "least_prominence": least}
        if heights[row] < least:  # eq. 8; frames that are not a peak have prominence 0
            return Placement(Reason.NOT_PROMINENT, match=match, scores=scores)
    index = int(found.modes[found.nodes == node][0])
    mode = state.nodes[node].modes[index]
    scores |= {"centroid_shift": mode.shift(point), "most_centroid_shift": mode.reach}
    if mode.shift(point) > mode.reach:  # eq. 9
        return Placement(Reason.MOVES_CENTROID, match=match, scores=scores)
    return Placement(Reason.ASSIGNED, node, index, match, scores)


def locate(state: State, descriptor: Descriptor, description: Description, poses: list[Any]) -> Location:
    """Find a frame in a state with at least one node: nodes that close a loop compete, or else the nearest wins."""
    rules = state.rules
    found = node_level(point_of(description), state.ordered(), rules.two_sided)
    closing, scores = _closing(state, found)
    candidates = [state.nodes[key] for key in closing or [int(found.nodes[found.best(slice(None))])]]
    similarity = image_level(descriptor, description, candidates, rules.distance)
    node, row, means = most_similar(similarity, rules.version)
    frame = int(similarity.frames[row])
    scores |= {"mean_similarity": means, "similarity": float(similarity.values[row])}
    heading = None
    if description.orientation is not None:
        gallery = state.nodes[node].modes[int(similarity.modes[row])].gallery
        heading = float(descriptor.align(description, gallery.keep(gallery.frames == frame).shown).heading[0, 0])
    return Location(node, frame, poses[frame], heading, bool(closing), scores)


def _closing(state: State, found: NodeLevel) -> tuple[list[int], dict[str, Any]]:
    """Return the ids of the nodes that close by eq. 4, and what was measured."""
    x = state.rules.x(len(state.nodes))
    closing = found.nodes[found.closing(x)].tolist()
    return closing, {"x": x, "nodes": found.scores(), "candidates": closing}


def most_similar(similarity: Similarity, version: int) -> tuple[int, int, dict[str, float]]:
    """Return the most similar node, the row of its most similar frame, and the mean similarity by id.

    Version 1 takes the node of the most similar frame (eq. 7), version 2 that with the highest mean ([T] 4.6).
    """
    means = similarity.means()
    node = min(means, key=lambda key: (-means[key], key))
    if version == 1:
        node = int(similarity.nodes[similarity.best()])
    return node, similarity.best(node), {str(key): mean for key, mean in means.items()}


def maintain(state: State, node: int, descriptions: list[Description]) -> Decision:
    """Add a mode to a node: frames that show another appearance of its place. The other modes stay as they are."""
    frames = [state.append(description, node, NONE) for description in descriptions]
    modes = (*state.nodes[node].modes, Mode.of(state.rules, frames, descriptions))
    state.nodes[node] = Node(node, modes)
    state.pending = ()
    state.note(Reason.MAINTAINED, node, frames)
    return Decision(node, Reason.MAINTAINED, {"modes": len(modes)}, frames[-1], state.changes)
