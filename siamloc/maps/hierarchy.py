"""Hierarchical search: the nearest map frames among those of a few nodes, exactly ([T] 5.2.1).

The descriptors are kept in the order of their nodes, so that a node is one contiguous block, and all queries that want
a node are compared with it by one matrix product. As in `siamloc.maps.search`, the product in float32 finds the
candidates and float64 decides among them: the answer is that of a loop over all pairs in float64.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor
from siamloc.errors import ConfigError, DataError
from siamloc.maps.coarse import UNASSIGNED, CoarseLayer
from siamloc.maps.node_ranking import NodeRanking
from siamloc.maps.scores import ProductScores
from siamloc.maps.search import Retrieval, nearest
from siamloc.maps.visual_map import VisualMap

_PAIRS = 1 << 18  # scores held at once; if all tie, as many pairs of descriptors
_ALIGNED_PAIRS = 1 << 17  # distances at the best turn held at once
_FOUND = 1 << 21  # neighbours gathered before they are sorted
_FRAMES = 1 << 16  # map frames prepared at once
_LARGEST = 1e15  # of a scaled query; beyond, float32 products overflow


_BY_QUERY = ("node", "tried", "frames_compared", "nodes_compared")


@dataclass(frozen=True, eq=False)
class HierarchicalRetrieval:
    """What a hierarchical search found.

    Attributes:
        found: the nearest frames of those searched (n, k). Where these are fewer than k, the nearest one is repeated at
            infinite distance.
        node: (n,) the node of the nearest frame, UNASSIGNED if that is in none.
        tried: (n, c) the nodes searched, as ranked.
        frames_compared: (n,) frames searched, those in no node among them.
        nodes_compared: (n,) descriptors compared to rank the nodes.
    """

    found: Retrieval
    node: NDArray[np.int64]
    tried: NDArray[np.int64]
    frames_compared: NDArray[np.int64]
    nodes_compared: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.node)

    @property
    def compared(self) -> NDArray[np.int64]:
        """Descriptors compared for each query (n,), in both layers."""
        return self.frames_compared + self.nodes_compared

    @staticmethod
    def concatenate(parts: Sequence[HierarchicalRetrieval]) -> HierarchicalRetrieval:
        """Return what was found for one batch of queries after the other."""
        found = Retrieval.concatenate([part.found for part in parts])
        return HierarchicalRetrieval(
            found, *(np.concatenate([getattr(part, name) for part in parts]) for name in _BY_QUERY)
        )

    def take(self, rows: NDArray) -> HierarchicalRetrieval:
        """Return what was found for some of the queries: their numbers, or a mask."""
        return HierarchicalRetrieval(self.found.take(rows), *(getattr(self, name)[rows] for name in _BY_QUERY))


class _Hits(NamedTuple):
    """Candidates (p,): row of the query, row of the map, distance."""

    query: NDArray[np.int64]
    frame: NDArray[np.int64]
    distance: NDArray[np.float64]


class HierarchicalSearch:
    """A map made ready for searching inside nodes; it takes as much memory as the map's descriptors once more.

    Frames that are in no node are searched for every query, whatever nodes it tries: otherwise they could not be found
    at all. The comparisons count them.

    Args:
        known: m frames.
        layer: nodes over the same m frames.
        descriptor: what described the map; needed only if it compares after turning (`aligned`).

    Attributes:
        known: the map.
        layer: its nodes.

    Raises:
        DataError: a layer of another number of frames.
    """

    def __init__(self, known: VisualMap, layer: CoarseLayer, descriptor: Descriptor | None = None) -> None:
        if len(layer.labels) != len(known):
            raise DataError(
                f"the coarse layer has labels for {len(layer.labels)} frames and the map has {len(known)}: "
                "build the layer from this map"
            )
        self.known, self.layer = known, layer
        self._descriptor = descriptor
        self._order = np.argsort(layer.labels, kind="stable")
        # Block b holds node b - 1: the frames in no node come first.
        self._bounds = np.searchsorted(layer.labels[self._order], np.arange(UNASSIGNED, len(layer) + 1))
        self._parts: dict[int, Description] = {}
        self._scores: ProductScores | None = None
        self._largest = 1.0
        if descriptor is not None and descriptor.aligned:
            return
        if known.distance in ("manhattan", "minkowski"):
            self._vectors = known.descriptors[self._order]
        else:
            self._prepare_product()

    def __len__(self) -> int:
        return len(self.known)

    def search(self, queries: Description | ArrayLike, ranking: NodeRanking, k: int = 1) -> HierarchicalRetrieval:
        """Return the k nearest frames of each query among those of its candidate nodes, exactly.

        Of equally near frames the smaller row of the map comes first. With all nodes as candidates the answer is that
        of the search in the whole map. It does not depend on the other queries.

        Args:
            queries: n descriptions, or their vectors (n, D) where the descriptor is not aligned.
            ranking: the candidate nodes of each.
            k: how many frames to return, at least 1; min(k, m) of them.

        Raises:
            AnalyticError, ConfigError, DataError: queries that do not fit the map or the ranking, a query without
                anything to search, or a k below 1.
        """
        if int(k) != k or k < 1:
            raise ConfigError(f"a search needs a whole number of neighbours k >= 1, got {k}")
        described = queries if isinstance(queries, Description) else Description(_vectors(queries))
        self._check(described, ranking)
        k, n = min(int(k), len(self.known)), len(ranking)
        members = np.diff(self._bounds)
        wanted = ranking.nodes + 1
        if members[0]:
            wanted = np.column_stack([np.zeros(n, dtype=np.int64), wanted])
        searched = np.where(wanted > 0, members[wanted], 0).sum(axis=1) + members[0]
        if (searched == 0).any():
            raise DataError(f"{int((searched == 0).sum())} of {n} queries have no candidate node: nothing to search")
        best = Retrieval(np.zeros((n, k), dtype=np.int64), np.full((n, k), np.inf))
        step = max(1, _FOUND // (k * wanted.shape[1]))
        for start in range(0, n, step):
            part = slice(start, min(start + step, n))
            hits = list(self._visits(described.take(part), wanted[part], k))
            _keep(best, start, _Hits(*(np.concatenate(column) for column in zip(*hits, strict=True))))
        empty = np.isinf(best.distances)
        best.indices[empty] = np.broadcast_to(best.indices[:, :1], empty.shape)[empty]
        node = self.layer.labels[best.indices[:, 0]]
        return HierarchicalRetrieval(best, node, ranking.nodes, searched, ranking.compared)

    def _visits(self, queries: Description, wanted: NDArray[np.int64], k: int) -> Iterator[_Hits]:
        """Yield what each block that some queries want has for them."""
        prepared = self._scores.queries(queries.position) if self._scores is not None else None
        flat = wanted.ravel()
        order = np.argsort(flat, kind="stable")
        blocks, first = np.unique(flat[order], return_index=True)
        for block, places in zip(blocks.tolist(), np.split(order, first[1:]), strict=True):
            part = slice(int(self._bounds[block]), int(self._bounds[block + 1]))
            size = part.stop - part.start
            if not size or (block == 0 and not self._bounds[1]):
                continue
            everyone = places // wanted.shape[1]
            step = max(1, (_PAIRS if prepared is not None else _ALIGNED_PAIRS) // size)
            for start in range(0, len(everyone), step):
                rows = everyone[start : start + step]
                if prepared is not None:
                    yield self._by_product(_rows(prepared, rows), rows, part, k)
                elif self._descriptor is not None and self._descriptor.aligned:
                    yield self._by_alignment(queries.take(rows), rows, block, part, k)
                else:
                    found = nearest(queries.position[rows], self._vectors[part], k, self.known.distance)
                    yield self._hits(rows, found.indices, found.distances, part)

    def _by_product(self, queries: Any, rows: NDArray[np.int64], part: slice, k: int) -> _Hits:
        assert self._scores is not None
        score, slack = self._scores.block(queries, _rows(self._prepared, part))
        last = score.shape[1] - min(k, score.shape[1])
        top = score.max(axis=1) if k == 1 else np.partition(score, last, axis=1)[:, last]
        needed = (top.astype(np.float64) - 2 * slack).astype(score.dtype)
        row, column = np.nonzero(score >= needed[:, None])
        frames = self._order[part.start + column]
        candidates = self._scores.references(self.known.descriptors[frames])
        exact = self._scores.exact(queries, candidates, row, np.arange(len(row)))
        hits = _Hits(row, frames, exact)
        if len(row) > k * len(rows):  # frames that look alike tie, and there may be very many
            order, rank = _ranked(hits)
            near = order[rank < k]
            hits = _Hits(hits.query[near], hits.frame[near], hits.distance[near])
        return hits._replace(query=rows[hits.query])

    def _by_alignment(self, queries: Description, rows: NDArray[np.int64], block: int, part: slice, k: int) -> _Hits:
        assert self._descriptor is not None
        if block not in self._parts:  # kept with its spectrum, for the next queries
            self._parts[block] = self.known.description.take(self._order[part])
        apart = self._descriptor.pairwise(queries, self._parts[block], self.known.distance)
        order = np.argsort(apart, axis=1, kind="stable")[:, :k]
        return self._hits(rows, order, np.take_along_axis(apart, order, axis=1), part)

    def _hits(
        self, rows: NDArray[np.int64], places: NDArray[np.int64], distances: NDArray[np.float64], part: slice
    ) -> _Hits:
        return _Hits(np.repeat(rows, places.shape[1]), self._order[part.start + places].ravel(), distances.ravel())

    def _prepare_product(self) -> None:
        """Centre and scale the descriptors in the order of their nodes, once for all queries."""
        vectors = self.known.descriptors
        self._largest = max(float(vectors.max()), -float(vectors.min())) or 1.0
        self._scores = ProductScores(self.known.distance, np.empty((0, vectors.shape[1]), np.float32), vectors)
        blocks = []
        for start in range(0, len(vectors), _FRAMES):
            block = self._scores.references(vectors[self._order[start : start + _FRAMES]])
            blocks.append((block.product, block.norm))
        product, norm = (np.concatenate(column) for column in zip(*blocks, strict=True))
        # Exact distances are measured on the map's own descriptors.
        self._prepared = replace(block, vectors=np.empty((len(vectors), 0)), product=product, norm=norm)

    def _check(self, queries: Description, ranking: NodeRanking) -> None:
        if len(queries) != len(ranking):
            raise DataError(f"{len(queries)} queries need as many rows in the ranking, got {len(ranking)}")
        if ranking.nodes.size and not UNASSIGNED <= ranking.nodes.min() <= ranking.nodes.max() < len(self.layer):
            raise DataError(f"the candidates must be nodes of the layer, 0 to {len(self.layer) - 1}")
        if self._descriptor is not None and self._descriptor.aligned:
            return
        values = queries.position
        if values.ndim != 2 or values.shape[1] != self.known.width:
            raise DataError(
                f"queries need vectors of {self.known.width} values like the map's, got shape {values.shape}: "
                "describe both with one model"
            )
        if not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).any(axis=1).sum())
            raise DataError(
                f"{bad} of {len(values)} query descriptors hold values that are not finite: "
                "look at the model and at these images"
            )
        if self.known.distance == "euclidean" and values.size and np.abs(values).max() > _LARGEST * self._largest:
            raise DataError("the queries' values are out of all proportion to the map's: describe both with one model")


def _rows(block: Any, rows: Any) -> Any:
    """Return some rows of a prepared block."""
    return replace(block, vectors=block.vectors[rows], product=block.product[rows], norm=block.norm[rows])


def _ranked(hits: _Hits) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the order by query and then by distance, and the rank from 0 of each in its query's hits."""
    order = np.lexsort((hits.frame, hits.distance, hits.query))
    query = hits.query[order]
    fresh = np.flatnonzero(np.diff(query, prepend=-1))
    return order, np.arange(len(query)) - np.repeat(fresh, np.diff(np.append(fresh, len(query))))


def _keep(best: Retrieval, first: int, hits: _Hits) -> None:
    """Write the nearest hits of each query, whose numbers count from `first`, in place."""
    order, rank = _ranked(hits)
    near = rank < best.indices.shape[1]
    order, rank = order[near], rank[near]
    best.indices[first + hits.query[order], rank] = hits.frame[order]
    best.distances[first + hits.query[order], rank] = hits.distance[order]


def _vectors(queries: ArrayLike) -> NDArray[Any]:
    values = np.asarray(queries)
    return values if values.dtype in (np.float32, np.float64) else values.astype(np.float64)
