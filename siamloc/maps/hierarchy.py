"""Hierarchical search: the nearest map frames among those of a few nodes, exactly ([T] 5.2.1).

First the nodes of a coarse layer are ranked, then the frames in the best of them are searched; queries with the same
candidate node are compared with it together. With all nodes as candidates, the result is that of the whole map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import takes, typed
from foundation.columns import Rows
from foundation.settings import Count, Natural, Rule, Settings
from siamloc.errors import ConfigError, DataError
from siamloc.maps.checked_arrays import check_means
from siamloc.maps.coarse import UNASSIGNED, CoarseLayer
from siamloc.maps.grouping import Built
from siamloc.maps.matching import match
from siamloc.maps.ranking import NodeRanking, rank_by_classifier, rank_by_representatives, rank_by_vote
from siamloc.maps.search import Retrieval, VectorIndex, slices
from siamloc.maps.visual_map import VisualMap

Ranking = Literal["representatives", "vote", "classifier"]
"""How nodes are ranked for a query: by their representatives ([C] 4), by the votes of the nearest map frames, or, if
the nodes are rooms, by the classifier that a network was trained with to name them ([T] 5.4.3)."""

_FOUND = 1 << 21  # neighbours gathered before they are sorted


@dataclass(frozen=True, eq=False)
class HierarchicalRetrieval(Rows):
    """Result of a hierarchical search.

    Attributes:
        found: the nearest of the searched frames (n, k). If there are fewer than k, the nearest one is repeated at
            infinite distance.
        node: (n,) the node of the nearest frame, UNASSIGNED if it is in none.
        tried: (n, c) the nodes searched, best first.
        frames_compared: (n,) number of frames searched, including those in no node.
        nodes_compared: (n,) number of descriptors compared to rank the nodes.
    """

    found: Retrieval
    node: NDArray[np.int64]
    tried: NDArray[np.int64]
    frames_compared: NDArray[np.int64]
    nodes_compared: NDArray[np.int64]

    @property
    def compared(self) -> NDArray[np.int64]:
        """Number of descriptors compared for each query (n,), in both layers."""
        return self.frames_compared + self.nodes_compared


@dataclass(frozen=True)
class CoarseRanking(Settings):
    """How the nodes are ranked for a query.

    Attributes:
        by: the distance to the nodes' "representatives", the "vote" of the nearest map frames, or, if nodes are rooms,
            the "classifier" of a network that was trained to name rooms.
        neighbours: number of map frames that vote.
        ratio: candidates whose representative is more than `ratio` times as far as the nearest one are not searched, at
            least 1: most queries are then searched in one node, queries between two nodes in both. None searches all
            candidates.
    """

    WHERE = "task.coarse"

    by: Ranking = "representatives"
    neighbours: Count = 10
    ratio: Annotated[float, Rule("a number from 1", lambda value: value >= 1)] | None = None


@dataclass(frozen=True)
class LayerSearch(CoarseRanking):
    """How a coarse layer is searched before the frames; see `HierarchicalSearch`.

    Attributes:
        candidates: number of nodes searched for each query; all of them if there are fewer.
        along: number of frames before and after the nearest one, in its drive, that are searched as well if they lie
            in another node: for queries at the border of a node. The frames of each drive must then be in order.
    """

    WHERE = "search"

    candidates: Count = 3
    along: Natural = 0


class HierarchicalSearch:
    """A map prepared for searching inside nodes.

    Frames that are in no node are searched for every query, whatever its candidate nodes: otherwise they could not be
    found at all. They count as comparisons.

    Args:
        known: a map of m frames.
        layer: nodes over the same m frames, built over `coarse`, also as `siamloc.maps.group` returns them.
        coarse: a map of the same frames with another descriptor, which ranks the nodes; `known` if None.
        settings: how the nodes are ranked and searched.

    Attributes:
        known: the map in which frames are searched.
        layer: the nodes of that map.
        coarse: the map whose descriptor ranks the nodes; `known` if no other map was given.

    Raises:
        ConfigError: a setting out of range, a ratio without representatives, representatives of descriptors that are
            compared only after turning, whose means are meaningless, or nodes without a classifier that names them.
        DataError: a layer or a coarse map of other frames.

    Example:
        >>> from siamloc.data import FrameTable
        >>> known = VisualMap([[0.0], [1.0], [8.0], [9.0]], FrameTable(path=["a.png", "b.png", "c.png", "d.png"]))
        >>> search = HierarchicalSearch(known, CoarseLayer.of_labels(known, [0, 0, 1, 1]), candidates=1)
        >>> queries = Description(np.array([[8.2], [0.7]]))
        >>> found = search.search(queries, search.rank(queries))
        >>> found.found.indices[:, 0], found.node, found.compared
        (array([2, 1]), array([1, 0]), array([4, 4]))
    """

    @takes(LayerSearch)
    def __init__(
        self, known: VisualMap, layer: CoarseLayer | Built, *, coarse: VisualMap | None = None, settings: LayerSearch
    ) -> None:
        if isinstance(layer, Built):
            layer.check_map(known if coarse is None else coarse)
            layer = layer.layer
        by, along = settings.by, settings.along
        self.known, self.layer, self.coarse = known, layer, known if coarse is None else coarse
        if len(layer.labels) != len(known):
            raise DataError(
                f"the coarse layer has labels for {len(layer.labels)} frames and the map has {len(known)}: "
                "build the layer from this map"
            )
        if not np.array_equal(self.coarse.frames.path, known.frames.path):
            raise DataError("the map that ranks the nodes must hold the map's frames in the same order")
        if by == "classifier" and layer.classifier is None:
            raise ConfigError(
                "a classifier ranks nodes that are the rooms of the map (build=rooms) and that its network was trained "
                "to name, all of them (loss=cross_entropy): build the nodes again over the map with such a network, or "
                "rank them by representatives or vote"
            )
        if by == "representatives":
            check_means(self.coarse, "rank nodes by vote, or by another descriptor")
        if settings.ratio is not None and by != "representatives":
            raise ConfigError("a ratio compares distances of representatives: leave it out, or rank by representatives")
        self._settings = settings
        self._steps = np.array([step for step in range(-along, along + 1) if step], dtype=np.int64)
        self._order = np.argsort(layer.labels, kind="stable")
        # Block b holds node b - 1; frames in no node come first.
        self._bounds = np.searchsorted(layer.labels[self._order], np.arange(UNASSIGNED, len(layer) + 1))
        self._representatives: VectorIndex | None = None

    def __len__(self) -> int:
        return len(self.known)

    def rank(self, queries: Description) -> NodeRanking:
        """Return the candidate nodes of queries (n) that were described with the descriptor of `coarse`.

        Raises:
            AnalyticError, DataError: descriptions that cannot be compared with the coarse map.
        """
        by, candidates = self._settings.by, self._settings.candidates
        if by == "vote":
            found = match(self.coarse, queries, self._settings.neighbours)
            return rank_by_vote(found, self.layer.labels, candidates)
        learned = queries.position[:, : self.coarse.learned.shape[1]]
        if by == "classifier":
            assert self.layer.classifier is not None
            return rank_by_classifier(learned, self.layer.classifier, candidates)
        if self._representatives is None:
            self._representatives = VectorIndex(self.layer.representatives, self.coarse.distance)
        ratio = self._settings.ratio
        return rank_by_representatives(learned, self._representatives, candidates, ratio=ratio)

    @typed
    def search(self, queries: Description | ArrayLike, ranking: NodeRanking, k: Count = 1) -> HierarchicalRetrieval:
        """Return the exact k nearest frames of each query in its candidate nodes, and `along` the nearest one.

        Of equally near frames, the smaller row of the map comes first. The result does not depend on other queries.

        Args:
            queries: n descriptions, or their vectors (n, D) if the descriptor is not aligned.
            ranking: the candidate nodes of each.
            k: number of frames to return, at least 1; min(k, m) are returned.

        Raises:
            AnalyticError, ConfigError, DataError: queries that do not match the map or the ranking, a query with
                nothing to search, or a k below 1.
        """
        described = queries if isinstance(queries, Description) else Description(np.asarray(queries))
        n, k = len(described), min(k, len(self))
        nodes = ranking.nodes
        if n != len(ranking) or (n and not UNASSIGNED <= nodes.min() <= nodes.max() < len(self.layer)):
            raise DataError(f"{n} queries need as many rows in the ranking, of nodes 0 to {len(self.layer) - 1}")
        members = np.diff(self._bounds)
        searched = members[0] + np.where(nodes == UNASSIGNED, 0, members[nodes + 1]).sum(axis=1)
        if (searched == 0).any():
            raise DataError(f"{int((searched == 0).sum())} of {n} queries have no candidate node: nothing to search")
        strangeness = np.full(n, np.inf)  # until a comparison tells it
        best = Retrieval(np.zeros((n, k), dtype=np.int64), np.full((n, k), np.inf), strangeness=strangeness)
        for part in slices(n, _FOUND // (k * (nodes.shape[1] + 1))):
            self._fill(best.take(part), described.take(part), nodes[part])
        if len(self._steps):
            searched = searched + self._fill_along(best, described, nodes)
        empty = np.isinf(best.distances)
        best.indices[empty] = np.broadcast_to(best.indices[:, :1], empty.shape)[empty]
        if np.isinf(strangeness).any():
            best = replace(best, strangeness=None)
        node = self.layer.labels[best.indices[:, 0]]
        return HierarchicalRetrieval(best, node, nodes, searched, ranking.compared)

    def _fill(self, best: Retrieval, queries: Description, nodes: NDArray[np.int64]) -> None:
        """Write the nearest frames of each query in its nodes, and among the frames in no node, in place."""
        k, hits = best.indices.shape[1], []
        for node in np.union1d(nodes, UNASSIGNED).tolist():
            rows = self._order[self._bounds[node + 1] : self._bounds[node + 2]]
            if not len(rows):
                continue
            everyone = np.arange(len(nodes)) if node == UNASSIGNED else np.flatnonzero((nodes == node).any(axis=1))
            found = match(self.known, queries.take(everyone), k, within=rows)
            _keep_least(best, everyone, found)
            hits.append((np.repeat(everyone, found.indices.shape[1]), found.indices.ravel(), found.distances.ravel()))
        query, frame, apart = (np.concatenate(column) for column in zip(*hits, strict=True))
        order = np.lexsort((frame, apart, query))
        query = query[order]
        first = np.flatnonzero(np.diff(query, prepend=-1))
        rank = np.arange(len(query)) - np.repeat(first, np.diff(np.append(first, len(query))))
        near = rank < k
        best.indices[query[near], rank[near]] = frame[order][near]
        best.distances[query[near], rank[near]] = apart[order][near]

    def _fill_along(self, best: Retrieval, queries: Description, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Search along the drive of each query's nearest frame, in place; return the number of frames compared (n,)."""
        nearest = best.indices[:, :1]
        beside = nearest + self._steps
        inside = (beside >= 0) & (beside < len(self))
        beside = np.where(inside, beside, nearest)
        drive, node = self.known.frames.sequence, self.layer.labels[beside]
        known = (node == UNASSIGNED) | (node[:, :, None] == nodes[:, None, :]).any(axis=2)
        further = inside & ~known & (drive[beside] == drive[nearest])
        k = best.indices.shape[1]
        for row in np.flatnonzero(further.any(axis=1)).tolist():
            rows = beside[row][further[row]]
            found = match(self.known, queries.take(slice(row, row + 1)), k, within=rows)
            _keep_least(best, np.array([row]), found)
            frame = np.concatenate([best.indices[row], found.indices[0]])
            apart = np.concatenate([best.distances[row], found.distances[0]])
            order = np.lexsort((frame, apart))[:k]
            best.indices[row], best.distances[row] = frame[order], apart[order]
        return further.sum(axis=1)


def _keep_least(best: Retrieval, queries: NDArray[np.int64], found: Retrieval) -> None:
    """Keep, in place, the least strangeness that some queries (q,) have in any part of the map."""
    if best.strangeness is not None and found.strangeness is not None:
        best.strangeness[queries] = np.minimum(best.strangeness[queries], found.strangeness)
