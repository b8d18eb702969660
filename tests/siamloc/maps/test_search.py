from __future__ import annotations

import tracemalloc
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from analytic.distances import DISTANCES
from siamloc.errors import ConfigError, DataError
from siamloc.maps.search import VectorIndex
from tests.oracles import search as oracle


def nearest(queries, references, k=1, distance="euclidean", memory=256 << 20):
    with mock.patch("siamloc.maps.search.MEMORY", memory):
        return VectorIndex(references, distance).search(queries, k)


TINY = 1  # bytes: forces blocks of one query and one reference
SMALL = 60_000


def gaussian(n: int, m: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, width)).astype(np.float32), rng.normal(size=(m, width)).astype(np.float32)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("width", [1, 2, 5, 64])
@pytest.mark.parametrize("k", [1, 4])
def test_equals_the_loop_over_all_pairs(distance: str, width: int, k: int) -> None:
    queries, references = gaussian(11, 70, width)
    found = nearest(queries, references, k, distance)
    indices, distances = oracle.nearest(queries, references, k, distance)
    np.testing.assert_allclose(found.distances, distances, rtol=1e-9, atol=1e-15)
    if width > 2 or distance not in ("cosine", "correlation"):  # else few directions: all ties up to rounding
        np.testing.assert_array_equal(found.indices, indices)


@settings(max_examples=60, deadline=None)
@given(
    data=st.data(),
    n=st.integers(1, 5),
    m=st.integers(1, 30),
    width=st.integers(1, 6),
    k=st.integers(1, 8),
    distance=st.sampled_from(["euclidean", "manhattan"]),
    memory=st.sampled_from([TINY, 5_000, SMALL, 1 << 28]),
)
def test_ties_go_to_the_smaller_index(
    data: st.DataObject, n: int, m: int, width: int, k: int, distance: str, memory: int
) -> None:
    whole = st.integers(-2, 2).map(float)
    queries = data.draw(arrays(np.float64, (n, width), elements=whole))
    references = data.draw(arrays(np.float64, (m, width), elements=whole))
    found = nearest(queries, references, k, distance, memory)
    indices, distances = oracle.nearest(queries, references, k, distance)
    np.testing.assert_array_equal(found.indices, indices)
    np.testing.assert_allclose(found.distances, distances, rtol=1e-15)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("k", [1, 7])
def test_neither_memory_nor_slices_nor_batch_change_a_bit(distance: str, k: int) -> None:
    queries, references = gaussian(12, 130, 24, seed=1)
    whole = nearest(queries, references, k, distance)
    for memory, values in ((TINY, 1), (SMALL, 24), (1 << 20, 5 * 24)):
        with mock.patch.multiple("siamloc.maps.search", _VALUES_PER_SLICE=values, _REFERENCES_PER_BLOCK=50):
            part = nearest(queries, references, k, distance, memory)
        np.testing.assert_array_equal(part.indices, whole.indices)
        np.testing.assert_array_equal(part.distances, whole.distances)
    for row in (0, 7, 11):
        alone = nearest(queries[row : row + 1], references, k, distance)
        np.testing.assert_array_equal(alone.indices[0], whole.indices[row])
        np.testing.assert_array_equal(alone.distances[0], whole.distances[row])


@pytest.mark.parametrize("distance", ["cosine", "correlation"])
def test_a_zero_query_is_equally_far_from_everything(distance: str) -> None:
    _, references = gaussian(1, 500, 7)
    references[3] = 0
    found = nearest(np.zeros((2, 7)), references, 500, distance)
    assert (found.distances == 1).all()
    assert (found.indices == np.arange(500)).all()


def test_near_zero_distances_far_from_the_origin_are_right() -> None:
    rng = np.random.default_rng(2)
    references = (1000 + 1e-3 * rng.normal(size=(300, 16))).astype(np.float32)
    queries = references[::30].copy()
    found = nearest(queries, references, 3)
    indices, distances = oracle.nearest(queries, references, 3, "euclidean")
    np.testing.assert_array_equal(found.indices, indices)
    np.testing.assert_allclose(found.distances, distances, rtol=1e-12, atol=0)
    assert (found.distances[:, 0] == 0).all()


@pytest.mark.parametrize("distance", ["cosine", "correlation"])
def test_small_angles_are_right(distance: str) -> None:
    rng = np.random.default_rng(3)
    base = rng.normal(size=8)
    references = base + 1e-6 * rng.normal(size=(50, 8))
    queries = references[:5] * 7 + (3 if distance == "correlation" else 0)
    found = nearest(queries, references, 2, distance)
    np.testing.assert_array_equal(found.indices[:, 0], np.arange(5))
    indices, distances = oracle.nearest(queries, references, 2, distance)
    np.testing.assert_array_equal(found.indices, indices)
    np.testing.assert_allclose(found.distances[:, 1], distances[:, 1], rtol=1e-6)


@pytest.mark.parametrize("distance", ["cosine", "correlation"])
def test_a_vector_without_direction_is_at_one_from_everything(distance: str) -> None:
    flat = 0.0 if distance == "cosine" else 4.25
    references = np.array([[1.0, 2, 4], [flat] * 3, [-1.0, -2, -4]])
    queries = np.array([[flat] * 3, [1.0, 2, 4]])
    found = nearest(queries, references, 3, distance)
    np.testing.assert_array_equal(found.indices, [[0, 1, 2], [0, 1, 2]])
    np.testing.assert_allclose(found.distances, [[1, 1, 1], [0, 1, 2]], atol=1e-15)


@pytest.mark.parametrize("scale", [1e-200, 1e-42, 1e-30, 1e30, 1e100])
def test_any_scale(scale: float) -> None:
    queries, references = gaussian(4, 60, 5, seed=4)
    q, r = queries.astype(np.float64) * scale, references.astype(np.float64) * scale
    expected = nearest(queries, references, 3)
    if scale == 1e-200:  # the squares vanish in float64: all distances are 0 and the first frames win
        assert (nearest(q, r, 3).distances == 0).all()
    else:
        np.testing.assert_array_equal(nearest(q, r, 3).indices, expected.indices)
    np.testing.assert_array_equal(nearest(q, r, 3, "cosine").indices, nearest(queries, references, 3, "cosine").indices)


@pytest.mark.parametrize("k", [1, 6])
def test_differences_that_float32_cannot_see(k: int) -> None:
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(400, 12))
    radii = 1 + 1e-10 * rng.permutation(400)
    references = directions * (radii / np.linalg.norm(directions, axis=1))[:, None]
    for memory in (SMALL, 1 << 28):
        found = nearest(np.zeros((1, 12)), references, k, memory=memory)
        np.testing.assert_array_equal(found.indices[0], np.argsort(radii)[:k])


def test_queries_far_from_a_small_map() -> None:
    queries, references = gaussian(6, 200, 4, seed=5)
    queries += 1e6
    indices, distances = oracle.nearest(queries, references, 2, "euclidean")
    found = nearest(queries, references, 2, memory=SMALL)
    np.testing.assert_array_equal(found.indices, indices)
    np.testing.assert_allclose(found.distances, distances, rtol=1e-14)


def test_memory_is_bounded() -> None:
    queries, references = gaussian(3000, 20_000, 8, seed=6)
    for ties in (False, True):
        if ties:
            references[:] = references[0]
            queries = queries[:300]
        tracemalloc.start()
        nearest(queries, references, 1, memory=16 << 20)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 16 << 20


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"distance": "euclidian"}, ConfigError, "unknown distance 'euclidian': did you mean 'euclidean'"),
        ({"k": 0}, ConfigError, "must be a whole number from 1 to 10 million, got 0"),
        ({"k": 1.5}, ConfigError, "k must be a whole number from 1 to 10 million, got 1.5"),
        ({"references": np.empty((0, 3))}, DataError, "the map holds no descriptors"),
        ({"references": np.ones((2, 4))}, DataError, "queries have 3 values each, the map's descriptors 4"),
        ({"queries": np.ones(3)}, DataError, "query descriptors of shape (n, D), got shape (3,)"),
        ({"queries": [[1, np.nan, 2], [1, 2, 3]]}, DataError, "1 of 2 query descriptors"),
        ({"references": [[1, np.inf, 2]]}, DataError, "1 of 1 map descriptors"),
    ],
)
def test_errors(arguments: dict, error: type[Exception], message: str) -> None:
    defaults = {"queries": np.ones((2, 3)), "references": np.ones((5, 3))}
    with pytest.raises(error) as raised:
        nearest(**{**defaults, **arguments})
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("within", "excluded"),
    [([5], None), ([-1], None), ([0.5], None), ([[0, 1]], None), ([0, 1], np.zeros((2, 5), dtype=bool))],
)
def test_rows_to_search_that_are_no_rows(within: list, excluded: np.ndarray | None) -> None:
    with pytest.raises(DataError, match="within takes rows from 0 to 4, and not together with excluded"):
        VectorIndex(np.ones((5, 3))).search(np.ones((2, 3)), within=np.array(within), excluded=excluded)
