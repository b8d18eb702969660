"""Which nodes of a coarse layer a query is searched in: four ways to rank them ([C] 4, [T] 5.4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.columns import Rows
from siamloc.maps.coarse import UNASSIGNED
from siamloc.maps.search import Retrieval, VectorIndex, checked, slices
from siamloc.models.room_classifier import RoomClassifier

_COUNTS = 1 << 22  # votes counted at once


@dataclass(frozen=True, eq=False)
class NodeRanking(Rows):
    """The candidate nodes of each query.

    Attributes:
        nodes: (n, c) best first, no node twice in a row of the array; UNASSIGNED where a query has fewer candidates.
        compared: (n,) number of descriptors that were compared to rank them.
    """

    nodes: NDArray[np.int64]
    compared: NDArray[np.int64]


def rank_by_representatives(
    queries: ArrayLike, representatives: VectorIndex, candidates: int = 1, ratio: float | None = None
) -> NodeRanking:
    """Rank nodes by the distance of a query to their representatives ([C] 4).

    Args:
        queries: (n, D), described as the representatives were.
        representatives: those of a `CoarseLayer` (k, D), with the distance of the map that it was built from.
        candidates: number of nodes to keep; all of them if there are fewer.
        ratio: nodes more than `ratio` times as far as the nearest one are not candidates; see `HierarchicalSearch`.

    Raises:
        ConfigError: a number of candidates below 1.
        DataError: vectors of different lengths.
    """
    found = representatives.search(queries, candidates)
    nodes = found.indices
    if ratio is not None:
        nodes = np.where(found.distances <= ratio * found.distances[:, :1], nodes, UNASSIGNED)
    return NodeRanking(nodes, np.full(len(found), len(representatives)))


def rank_by_classifier(queries: ArrayLike, classifier: RoomClassifier, candidates: int = 1) -> NodeRanking:
    """Rank nodes by the probability that a classifier gives each, the most probable first ([T] 5.4.3, "CNN simple").

    Args:
        queries: (n, D), described with the network that the classifier was trained with.
        classifier: with a class for each node, from a `CoarseLayer`.
        candidates: number of nodes to keep; all of them if there are fewer.

    Raises:
        DataError: vectors of another length.
    """
    scores = classifier.scores(queries)
    nodes = np.argsort(-scores, axis=1, kind="stable")[:, :candidates].astype(np.int64)
    return NodeRanking(nodes, np.full(len(scores), len(classifier)))


def rank_by_vote(found: Retrieval, labels: ArrayLike, candidates: int = 1) -> NodeRanking:
    """Rank nodes by how many of the nearest map frames lie in them; in a tie, the node of the nearer frame comes first.

    Nodes without a vote are not candidates, so a query may have fewer than requested. Frames in no node do not vote.

    Args:
        found: the nearest frames of the coarse map for each query (n, k), which give k votes.
        labels: (m,) the node of each frame of the coarse map.
        candidates: number of nodes to keep.
    """
    node = np.asarray(labels)
    n, k = found.indices.shape
    total = max(int(node.max()) + 1, 1)
    kept = np.full((n, min(candidates, total)), UNASSIGNED, dtype=np.int64)
    for part in slices(n, _COUNTS // total):
        kept[part] = _elected(node[found.indices[part]], total, k)[:, : kept.shape[1]]
    return NodeRanking(kept, np.full(n, len(node)))


def rank_by_position(query_xy: ArrayLike, map_xy: ArrayLike, labels: ArrayLike) -> NodeRanking:
    """Return the node of the geometrically nearest map frame: a perfect coarse layer, which no robot has.

    Nodes whose nearest frames are equally near up to rounding (a nanometre) are all candidates, by number. A query with
    such a frame in no node has UNASSIGNED as its first candidate.

    Args:
        query_xy: (n, 2) true positions.
        map_xy: (m, 2).
        labels: (m,) the node of each map frame.

    Raises:
        DataError: a position that is not finite.
    """
    from scipy.spatial import cKDTree

    queries, tree, labels = checked(query_xy, "query")[0], cKDTree(checked(map_xy, "map")[0]), np.asarray(labels)
    near = tree.query_ball_point(queries, tree.query(queries)[0] + 1e-9)
    found = [np.unique(labels[rows]) for rows in near]
    nodes = np.full((len(found), max(map(len, found), default=1)), UNASSIGNED)
    for row, own in zip(nodes, found, strict=True):
        row[: len(own)] = own
    return NodeRanking(nodes, np.zeros(len(nodes), dtype=np.int64))


def _elected(votes: NDArray[np.int64], total: int, k: int) -> NDArray[np.int64]:
    """Return the nodes (b, total) in the order of their votes (b, k), UNASSIGNED in place of nodes without votes."""
    row, place = np.nonzero(votes != UNASSIGNED)
    node = votes[row, place]
    count = np.zeros((len(votes), total), dtype=np.int64)
    first = np.full((len(votes), total), k, dtype=np.int64)
    np.add.at(count, (row, node), 1)
    np.minimum.at(first, (row, node), place)
    order = np.argsort(first - count * (k + 1), axis=1, kind="stable")
    return np.where(np.take_along_axis(count, order, axis=1) > 0, order, UNASSIGNED)
