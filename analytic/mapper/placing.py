"""Where a frame belongs among the nodes there are ([I] algorithm 1; [T] 4.6 for version 2)."""

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
from analytic.mapper.decision import Reason
from analytic.mapper.node import Mode
from analytic.mapper.state import NONE, State


@dataclass
class Placement:
    """What was found out about a frame.

    Attributes:
        reason: why it belongs to `node`, or to none.
        node: id, or -1.
        mode: index in the node.
        match: the most similar frame, or -1.
        scores: what was measured.
        closures: how it stands to every node.
    """

    reason: Reason
    node: int = NONE
    mode: int = 0
    match: int = NONE
    scores: dict[str, Any] = field(default_factory=dict)
    closures: Closures | None = None


def place(state: State, descriptor: Descriptor, description: Description, orientation: bool) -> Placement:
    """Return where a frame belongs; nothing changes.

    Args:
        state: the map, with at least one node.
        descriptor: of the map.
        description: of the frame.
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
    """Return how a frame stands to every node at node level, the oldest first."""
    return node_levels(point_of(description), state.ordered(), state.rules.two_sided)


def _stands_out(similarity: Similarity, row: int, state: State, found: Placement) -> bool:
    """Return whether eq. 8 holds. The mean is over all candidate images; those that are no peak have prominence 0."""
    curve, where = similarity_curve(similarity, state.labels, found.scores["candidates"])
    heights = prominences(curve)
    prominence = float(heights[where[row]])
    # In this order, so that the one peak of as many frames as gamma says reaches itself to the last digit.
    least = state.rules.gamma / len(where) * float(heights.sum())
    found.scores |= {"prominence": prominence, "least_prominence": least}
    return prominence >= least


def _keeps_centroid(mode: Mode, description: Description, scores: dict[str, Any]) -> bool:
    """Return whether eq. 9 holds."""
    shift, reach = mode.shift(point_of(description)), mode.reach
    scores |= {"centroid_shift": shift, "most_centroid_shift": reach}
    return shift <= reach
