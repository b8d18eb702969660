from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import DataError
from siamloc.maps import Retrieval, VectorIndex
from siamloc.maps.ranking import rank_by_position, rank_by_representatives, rank_by_vote
from tests.oracles import hierarchy as oracle

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=30, deadline=None)  # the first call imports scipy
@given(seed=seeds, candidates=st.integers(1, 6), distance=st.sampled_from(["euclidean", "correlation", "manhattan"]))
def test_nodes_by_representatives_equal_the_loop(seed: int, candidates: int, distance: str) -> None:
    rng = np.random.default_rng(seed)
    queries, representatives = rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    ranking = rank_by_representatives(queries, VectorIndex(representatives, distance), candidates)
    expected = [oracle.by_representatives(query, representatives, candidates, distance) for query in queries.tolist()]
    assert ranking.nodes.tolist() == expected
    assert ranking.compared.tolist() == [5] * 4


@settings(deadline=None)
@given(seed=seeds, ratio=st.sampled_from([1.0, 1.2, 2.0, 1e9]))
def test_nodes_within_a_ratio_of_the_nearest_stay_candidates(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    queries, representatives = rng.normal(size=(4, 2)), rng.normal(size=(5, 2))
    index = VectorIndex(representatives)
    every, ranking = (rank_by_representatives(queries, index, 3, within) for within in (None, ratio))
    for query, nodes, kept in zip(queries, every.nodes.tolist(), ranking.nodes.tolist(), strict=True):
        apart = [float(np.linalg.norm(query - representatives[node])) for node in nodes]
        # Apart from rounding, which could only matter at the limit itself.
        assert all(abs(value / apart[0] - ratio) > 1e-6 for value in apart[1:])
        assert kept == [node if value <= ratio * apart[0] else -1 for node, value in zip(nodes, apart, strict=True)]
    assert ranking.compared.tolist() == [5] * 4


@settings(max_examples=50, deadline=None)
@given(seed=seeds, k=st.integers(1, 9), candidates=st.integers(1, 5))
def test_nodes_by_vote_equal_the_loop(seed: int, k: int, candidates: int) -> None:
    rng = np.random.default_rng(seed)
    labels = rng.integers(-1, 4, 12)
    indices = np.argsort(rng.random((5, 12)), axis=1)[:, :k]
    ranking = rank_by_vote(Retrieval(indices, np.zeros(indices.shape)), labels, candidates)
    for row, frames in zip(ranking.nodes.tolist(), indices.tolist(), strict=True):
        expected = oracle.by_vote(frames, labels.tolist(), candidates)
        assert row == expected + [-1] * (len(row) - len(expected))
    assert ranking.compared.tolist() == [12] * 5


@settings(deadline=None)
@given(seed=seeds)
def test_the_perfect_layer_is_every_node_with_a_nearest_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Whole numbers: equal distances occur, and frames of equal x and different y.
    map_xy, query_xy, labels = rng.integers(0, 4, (9, 2)), rng.integers(0, 4, (5, 2)), rng.integers(-1, 3, 9)
    ranking = rank_by_position(query_xy, map_xy, labels)
    for row, xy in zip(ranking.nodes.tolist(), query_xy, strict=True):
        expected = oracle.by_position(xy, map_xy, labels)
        assert row == expected + [-1] * (len(row) - len(expected))
    assert ranking.compared.tolist() == [0] * 5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rank_by_representatives([[0.0, 1]], VectorIndex([[0.0]])), "2 values each"),
        (lambda: rank_by_position([[0.0, np.nan]], [[0.0, 0]], [0]), "not finite"),
    ],
)
def test_errors(call, message: str) -> None:
    with pytest.raises(DataError, match=message):
        call()
