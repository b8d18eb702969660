"""Which nodes of a coarse layer a query may be in: the first step of hierarchical localization ([T] 5.2.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import ConfigError, DataError
from siamloc.maps.coarse import UNASSIGNED
from siamloc.maps.search import Retrieval, nearest

_COUNTS = 1 << 22  # votes counted at once


@dataclass(frozen=True, eq=False)
class NodeRanking:
    """The candidate nodes of each query.

    Attributes:
        nodes: (n, c) the best first, no node twice in a row; UNASSIGNED where a query has fewer candidates.
        compared: (n,) descriptors that were compared to rank them.

    Raises:
        DataError: arrays that do not fit each other, or a node that stands twice in a row.
    """

    nodes: NDArray[np.int64]
    compared: NDArray[np.int64]

    def __post_init__(self) -> None:
        nodes, compared = np.asarray(self.nodes), np.asarray(self.compared)
        whole = nodes.dtype.kind in "iu" and compared.dtype.kind in "iu"
        if not whole or nodes.ndim != 2 or not nodes.shape[1] or compared.shape != nodes.shape[:1]:
            raise DataError(
                f"a ranking needs whole numbers of nodes (n, c) and of comparisons (n,), got {nodes.dtype} "
                f"{nodes.shape} and {compared.dtype} {compared.shape}"
            )
        ordered = np.sort(nodes, axis=1)
        if ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] != UNASSIGNED)).any():
            raise DataError("a ranking names a node twice for one query: rank each node once")
        object.__setattr__(self, "nodes", nodes.astype(np.int64, copy=False))
        object.__setattr__(self, "compared", compared.astype(np.int64, copy=False))

    def __len__(self) -> int:
        return len(self.nodes)

    def take(self, rows: NDArray) -> NodeRanking:
        """Return the ranking for some of the queries: their numbers, or a mask."""
        return NodeRanking(self.nodes[rows], self.compared[rows])

    @staticmethod
    def concatenate(parts: Sequence[NodeRanking]) -> NodeRanking:
        """Return the rankings for one batch of queries after the other."""
        return NodeRanking(
            np.concatenate([part.nodes for part in parts]), np.concatenate([part.compared for part in parts])
        )


def rank_by_representatives(
    queries: ArrayLike, representatives: ArrayLike, candidates: int = 1, distance: str = "euclidean"
) -> NodeRanking:
    """Rank nodes by the distance of a query to what stands for each ([C] 4).

    Representatives are means of vectors: those of a descriptor that is compared after turning mean nothing, and
    such a descriptor ranks nodes by vote.

    Args:
        queries: (n, D), described as the representatives were.
        representatives: (k, D), those of a `CoarseLayer`.
        candidates: how many nodes to keep; all of them if there are fewer.
        distance: that of the map that the coarse layer was made of.

    Raises:
        ConfigError: a number of candidates below 1, or an unknown distance.
        DataError: vectors that do not fit each other.
    """
    found = nearest(queries, representatives, _checked(candidates), distance)
    return NodeRanking(found.indices, np.full(len(found), len(np.asarray(representatives))))


def rank_by_vote(found: Retrieval, labels: ArrayLike, candidates: int = 1, compared: int | None = None) -> NodeRanking:
    """Rank nodes by how many of the nearest map frames lie in them; of equal numbers, that of the nearest one first.

    Nodes without a vote are no candidates, so that a query may have fewer than asked for. Frames in no node have none.

    Args:
        found: the nearest frames of the coarse map for each query (n, k): k votes.
        labels: (m,) the node of each frame of the coarse map.
        candidates: how many nodes to keep.
        compared: descriptors compared for one query; all m if None.

    Raises:
        ConfigError: a number of candidates below 1.
        DataError: retrieved frames that have no label.
    """
    keep, node = _checked(candidates), _labels(labels)
    if found.indices.size and (found.indices.min() < 0 or found.indices.max() >= len(node)):
        raise DataError(f"the votes must come from the {len(node)} frames that have labels, rows 0 to {len(node) - 1}")
    n, k = found.indices.shape
    total = max(int(node.max()) + 1, 1)
    kept = np.full((n, min(keep, total)), UNASSIGNED, dtype=np.int64)
    step = max(1, _COUNTS // total)
    for start in range(0, n, step):
        part = slice(start, start + step)
        kept[part] = _elected(node[found.indices[part]], total, k)[:, : kept.shape[1]]
    return NodeRanking(kept, np.full(n, len(node) if compared is None else compared))


def rank_by_position(query_xy: ArrayLike, map_xy: ArrayLike, labels: ArrayLike) -> NodeRanking:
    """Return the node of the geometrically nearest map frame: the perfect coarse layer, which no query has for itself.

    A query whose nearest frame is in no node has none.

    Args:
        query_xy: (n, 2) true positions.
        map_xy: (m, 2).
        labels: (m,) the node of each map frame.

    Raises:
        DataError: arrays that do not fit each other, or a position that is not finite.
    """
    node = _labels(labels)
    if len(node) != len(np.asarray(map_xy)):
        raise DataError(f"{len(np.asarray(map_xy))} map frames need as many labels, got {len(node)}")
    closest = nearest(query_xy, map_xy, 1)
    return NodeRanking(node[closest.indices], np.zeros(len(closest), dtype=np.int64))


def _elected(votes: NDArray[np.int64], total: int, k: int) -> NDArray[np.int64]:
    """Return all nodes (b, total) of some ballots (b, k), UNASSIGNED in place of those without a vote."""
    row, place = np.nonzero(votes != UNASSIGNED)
    node = votes[row, place]
    count = np.zeros((len(votes), total), dtype=np.int64)
    first = np.full((len(votes), total), k, dtype=np.int64)
    np.add.at(count, (row, node), 1)
    np.minimum.at(first, (row, node), place)
    order = np.argsort(first - count * (k + 1), axis=1, kind="stable")
    return np.where(np.take_along_axis(count, order, axis=1) > 0, order, UNASSIGNED)


def _labels(labels: ArrayLike) -> NDArray[np.int64]:
    node = np.asarray(labels)
    if node.ndim != 1 or not len(node) or node.dtype.kind not in "iu" or (node < UNASSIGNED).any():
        raise DataError(f"labels must be whole numbers of shape (m,), -1 or more, got {node.dtype} {node.shape}")
    return node.astype(np.int64, copy=False)


def _checked(candidates: int) -> int:
    if int(candidates) != candidates or candidates < 1:
        raise ConfigError(f"hierarchical localization needs a whole number of candidate nodes >= 1, got {candidates}")
    return int(candidates)
