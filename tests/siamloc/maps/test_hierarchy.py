from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import analytic
from analytic import Description
from siamloc.errors import ConfigError, DataError
from siamloc.maps import match
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.hierarchy import HierarchicalSearch
from siamloc.maps.ranking import NodeRanking
from tests.oracles import hierarchy as oracle
from tests.siamloc.maps.conftest import map_of, plain_map

DISTANCES = ("euclidean", "correlation", "cosine", "manhattan", "minkowski")


def labelled(rng, n: int, nodes: int, unassigned: bool) -> np.ndarray:
    """Return labels in no order; none of the nodes is empty."""
    labels = np.concatenate([np.arange(nodes), rng.integers(-1 if unassigned else 0, nodes, n - nodes)])
    return rng.permutation(labels)


def ranked(rng, n: int, nodes: int, candidates: int) -> NodeRanking:
    order = np.argsort(rng.random((n, nodes)), axis=1)[:, :candidates]
    return NodeRanking(order, np.full(n, nodes))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    distance=st.sampled_from(DISTANCES),
    unassigned=st.booleans(),
    k=st.integers(1, 25),
    candidates=st.integers(1, 4),
)
def test_the_search_equals_the_loop(seed: int, distance: str, unassigned: bool, k: int, candidates: int) -> None:
    rng = np.random.default_rng(seed)
    # Whole numbers: equal distances occur, within a node and between nodes.
    known = plain_map(rng.integers(0, 3, (20, 3)), distance)
    queries, labels = rng.integers(0, 3, (7, 3)).astype(np.float32), labelled(rng, 20, 4, unassigned)
    layer = CoarseLayer.of_labels(known, labels)
    ranking = ranked(rng, 7, 4, candidates)
    result = HierarchicalSearch(known, layer).search(queries, ranking, k)
    assert result.found.indices.shape == (7, min(k, 20))
    for i in range(7):
        frames, distances, compared = oracle.search(
            queries[i].tolist(), known.descriptors.tolist(), labels.tolist(), ranking.nodes[i].tolist(), k, distance
        )
        if distance in ("euclidean", "manhattan"):
            assert result.found.indices[i, : len(frames)].tolist() == frames
            assert result.node[i] == labels[frames[0]]
        np.testing.assert_allclose(result.found.distances[i, : len(frames)], distances, atol=1e-12)
        assert (result.found.indices[i, len(frames) :] == result.found.indices[i, 0]).all()
        assert np.isinf(result.found.distances[i, len(frames) :]).all()
        assert (result.frames_compared[i], result.nodes_compared[i], result.compared[i]) == (compared, 4, compared + 4)
    np.testing.assert_array_equal(result.tried, ranking.nodes)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    distance=st.sampled_from(("euclidean", "manhattan")),
    unassigned=st.booleans(),
    k=st.integers(1, 9),
    along=st.integers(0, 3),
)
def test_the_search_along_the_drive_equals_the_loop(
    seed: int, distance: str, unassigned: bool, k: int, along: int
) -> None:
    rng = np.random.default_rng(seed)
    values, labels = rng.integers(0, 4, (20, 3)), labelled(rng, 20, 6, unassigned)
    drives = ["a"] * 8 + ["b"] * 12
    known = plain_map(values, distance, sequence=drives)
    queries, ranking = rng.integers(0, 4, (7, 3)).astype(np.float32), ranked(rng, 7, 6, 2)
    search = HierarchicalSearch(known, CoarseLayer.of_labels(known, labels), along=along)
    result = search.search(queries, ranking, k)
    for i in range(7):
        frames, distances, compared = oracle.search_along(
            queries[i].tolist(), values.tolist(), labels.tolist(), ranking.nodes[i].tolist(), k, distance, drives, along
        )
        assert result.found.indices[i, : len(frames)].tolist() == frames
        np.testing.assert_allclose(result.found.distances[i, : len(frames)], distances, atol=1e-12)
        assert (result.node[i], result.frames_compared[i]) == (labels[frames[0]], compared)
        assert np.isinf(result.found.distances[i, len(frames) :]).all()


def test_the_answer_depends_neither_on_the_other_queries_nor_on_the_size_of_the_parts(monkeypatch) -> None:
    rng = np.random.default_rng(4)
    known = plain_map(rng.normal(size=(200, 8)))
    layer = CoarseLayer.of_labels(known, labelled(rng, 200, 7, True))
    queries, ranking = rng.normal(size=(50, 8)), ranked(rng, 50, 7, 3)
    search = HierarchicalSearch(known, layer)
    whole = search.search(queries, ranking, 5)
    rows = np.array([44, 2, 2, 17])
    part = search.search(queries[rows], NodeRanking(ranking.nodes[rows], ranking.compared[rows]), 5)
    np.testing.assert_array_equal(part.found.indices, whole.found.indices[rows])
    np.testing.assert_array_equal(part.found.distances, whole.found.distances[rows])
    for name, value in (("hierarchy._FOUND", 40), ("aligned._VALUES", 50)):
        monkeypatch.setattr(f"siamloc.maps.{name}", value)
    small = HierarchicalSearch(known, layer).search(queries, ranking, 5)
    np.testing.assert_array_equal(small.found.indices, whole.found.indices)
    np.testing.assert_array_equal(small.found.distances, whole.found.distances)


def test_descriptors_that_are_compared_after_turning() -> None:
    rng = np.random.default_rng(5)
    descriptor = analytic.descriptor("briefgist", rows=4, columns=16)
    images = rng.integers(0, 256, (14, 16, 64), dtype=np.uint8)
    known = map_of(descriptor, images)
    layer = CoarseLayer.of_labels(known, [0, 0, 1, 1, 2, 2, 2, -1, 3, 3, 3, 0, 1, 2])
    noisy = np.clip(np.roll(images, 8, axis=2) + rng.normal(0, 40, images.shape), 0, 255).astype(np.uint8)
    queries = descriptor.describe(noisy[[1, 3, 7, 9, 6]])
    search = HierarchicalSearch(known, layer, by="vote")
    ranking = NodeRanking(np.array([[0], [1], [2], [3], [2]]), np.full(5, 4))
    few = search.search(queries, ranking, 2)
    assert few.node.tolist() == [0, 1, -1, 3, 2]
    assert few.compared.tolist() == [4 + 1 + n for n in (3, 3, 4, 3, 4)]
    whole_drive = HierarchicalSearch(known, layer, by="vote", along=13).search(queries, ranking, 3)
    np.testing.assert_array_equal(whole_drive.found.indices, match(known, queries, 3).indices)
    assert whole_drive.frames_compared.tolist() == [14] * 5


def test_frames_in_no_node_are_always_found() -> None:
    known = plain_map([[0.0], [10.0], [5.0]])
    search = HierarchicalSearch(known, CoarseLayer.of_labels(known, [0, 1, -1]))
    result = search.search([[5.1], [5.1]], NodeRanking(np.array([[0], [-1]]), np.array([2, 2])), 1)
    assert result.found.indices.tolist() == [[2], [2]]
    assert result.node.tolist() == [-1, -1]
    assert result.frames_compared.tolist() == [2, 1]


def test_errors() -> None:
    known = plain_map(np.eye(4))
    layer = CoarseLayer.of_labels(known, [0, 0, 1, 1])
    search = HierarchicalSearch(known, layer)
    one = NodeRanking(np.array([[0]]), np.array([2]))
    with pytest.raises(DataError, match="labels for 4 frames and the map has 3"):
        HierarchicalSearch(known.take([0, 1, 2]), layer)
    with pytest.raises(ConfigError, match="must be a whole number from 1 to 10 million, got 0"):
        search.search(np.eye(4)[:1], one, 0)
    with pytest.raises(ConfigError, match=r"search\.along must be a whole number from 0"):
        HierarchicalSearch(known, layer, along=-1)
    for queries, ranking, says in (
        (np.eye(4)[:2], one, "2 queries need as many rows in the ranking"),
        (np.eye(4)[:1], NodeRanking(np.array([[2]]), np.array([2])), "of nodes 0 to 1"),
        (np.eye(4)[:1], NodeRanking(np.array([[-1]]), np.array([2])), "1 of 1 queries have no candidate node"),
        (np.eye(3)[:1], one, "queries have 3 values each, the map's descriptors 4"),
        (np.full((1, 4), np.nan), one, "1 of 1 query descriptors hold values that are not finite"),
        (np.full((1, 4), 1e20), one, "out of all proportion"),
    ):
        with pytest.raises(DataError, match=says):
            search.search(queries, ranking)
    assert search.search(Description(np.eye(4)[2:3]), NodeRanking(np.array([[1]]), np.array([2]))).node.tolist() == [1]
