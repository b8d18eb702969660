"""Where a frame belongs among the nodes there are ([I] algorithm 1; [T] 4.6 for version 2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import Closure, Similarity, image_level, node_level, prominences, similarity_curve
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
    """

    reason: Reason
    node: int = NONE
    mode: int = 0
    match: int = NONE
    scores: dict[str, Any] = field(default_factory=dict)


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
    scores: dict[str, Any] = {"x": x, "nodes": {str(c.node): [c.distance, c.mean, c.std] for c in closures.values()}}
    candidates = [node for node in state.ordered() if closures[node.id].closes(x)]
    scores["candidates"] = [node.id for node in candidates]
    if not candidates:
        return Placement(Reason.NO_CANDIDATE_NODE, scores=scores)
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
    found = Placement(Reason.ASSIGNED, match=match, scores=scores)
    if rules.version == 1 and not _stands_out(similarity, row, state, found):
        found.reason = Reason.NOT_PROMINENT
    elif not _keeps_centroid(state.nodes[node].modes[closures[node].mode], description, scores):
        found.reason = Reason.MOVES_CENTROID
    else:
        found.node, found.mode = node, closures[node].mode
    return found


def closures_of(state: State, description: Description) -> dict[int, Closure]:
    """Return how a frame stands to every node at node level, by id."""
    point = description.position[0].astype(np.float64)
    return {node.id: node_level(point, node, state.rules.two_sided) for node in state.ordered()}


def _stands_out(similarity: Similarity, row: int, state: State, found: Placement) -> bool:
    """Return whether eq. 8 holds. The mean is over all candidate images; those that are no peak have prominence 0."""
    curve, where = similarity_curve(similarity, state.labels, found.scores["candidates"])
    heights = prominences(curve)
    prominence = float(heights[where[row]])
    least = state.rules.gamma * float(heights.sum()) / len(where)
    found.scores |= {"prominence": prominence, "least_prominence": least}
    return prominence >= least


def _keeps_centroid(mode: Mode, description: Description, scores: dict[str, Any]) -> bool:
    """Return whether eq. 9 holds."""
    shift, reach = mode.shift(description.position[0].astype(np.float64)), mode.reach
    scores |= {"centroid_shift": shift, "most_centroid_shift": reach}
    return shift <= reach
