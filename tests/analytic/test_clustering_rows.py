"""The parts of spectral clustering that make it quick: block Lanczos, and k-means that knows when it is done."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.cluster import KMeans

from analytic import clustering
from analytic.clustering import eigenvectors, krylov, rows


def similarity(frames, seed=0, length=6):
    """The normalized similarity of a drive."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(size=(frames, length)), axis=0)
    return eigenvectors.normalized(clustering.affinity(x))


def inertia(points, labels):
    return sum(((points[labels == one] - points[labels == one].mean(axis=0)) ** 2).sum() for one in set(labels))


@pytest.mark.parametrize(("frames", "count"), [(300, 5), (600, 12), (900, 40)])
def test_block_lanczos_finds_the_leading_eigenvectors(frames, count):
    matrix = similarity(frames)
    values, vectors = np.linalg.eigh(matrix)
    assert values[-count] - values[-count - 1] > 1e-7
    found, columns = krylov.inverted(matrix, count)
    np.testing.assert_allclose(found, values[-count:], atol=1e-10)
    np.testing.assert_allclose(columns.T @ columns, np.eye(count), atol=1e-10)
    np.testing.assert_allclose(matrix @ columns, columns * found, atol=1e-10)
    expected = vectors[:, -count:]
    np.testing.assert_allclose(columns @ columns.T, expected @ expected.T, atol=1e-6)
    again = krylov.inverted(matrix, count)
    assert np.array_equal(again[1], columns)


def test_block_lanczos_goes_on_where_its_space_is_exhausted():
    n = 600  # of two eigenvalues, so that two blocks span all there is
    halves = np.kron(np.eye(2), np.ones((n // 2, n // 2))) + 1e-3
    matrix = eigenvectors.normalized(halves)
    found = krylov.inverted(matrix, 2)
    if found is not None:
        values, columns = found
        np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix)[-2:], atol=1e-9)
        np.testing.assert_allclose(columns.T @ columns, np.eye(2), atol=1e-9)
    assert np.array_equal(clustering.partition(halves, 2), np.repeat([0, 1], n // 2))


def test_a_search_that_takes_too_long_gives_up(monkeypatch):
    matrix = similarity(600)
    monkeypatch.setattr(krylov, "_SPARE", 0)
    monkeypatch.setattr(krylov, "_MOST", 2)
    assert krylov.inverted(matrix, 12) is None
    found = eigenvectors.leading(matrix, eigenvectors.parts(matrix), 12)
    np.testing.assert_allclose(matrix @ found, found * np.linalg.eigvalsh(matrix)[:-13:-1], atol=1e-10)


few_points = arrays(np.float64, st.tuples(st.integers(4, 7), st.integers(1, 2)), elements=st.integers(-9, 9))


@settings(max_examples=150, deadline=None)
@given(few_points, st.integers(2, 3))
def test_what_is_called_the_best_has_no_better(points, count):
    points = points / 10
    every = np.array(list(itertools.product(range(count), repeat=len(points))))
    every = every[(np.sort(every, axis=1)[:, :1] == 0)[:, 0]]
    smallest = min(inertia(points, labels) for labels in every)
    for labels in every[:: max(1, len(every) // 40)]:
        if len(set(labels.tolist())) < count:
            continue
        centres = np.stack([points[labels == one].mean(axis=0) for one in range(count)])
        if rows.is_best(points, labels, centres):
            assert inertia(points, labels) <= smallest + 1e-12


def test_clusters_far_apart_are_called_the_best_and_near_ones_are_not():
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(5), 20)
    noise = rng.normal(size=(100, 5)) / np.sqrt(5)
    for spread, sure in ((0.02, True), (0.5, False)):
        points = np.eye(5)[labels] + spread * noise
        centres = np.stack([points[labels == one].mean(axis=0) for one in range(5)])
        assert rows.is_best(points, labels, centres) is sure
    assert not rows.is_best(points, np.zeros(100, dtype=int), np.eye(5)), "a cluster without frames is no cluster"


def test_clear_clusters_need_no_drawn_starts(monkeypatch):
    labels = np.repeat(np.arange(5), 20)
    points = np.eye(5)[labels] + 0.005 * np.random.default_rng(0).normal(size=(100, 5))
    monkeypatch.setattr(rows, "drawn_starts", lambda *_: pytest.fail("drawn without need"))
    found = rows.kmeans(points, 5, 0)
    assert len({tuple(found[labels == one].tolist()) for one in range(5)}) == 5
    assert all(len(set(found[labels == one].tolist())) == 1 for one in range(5))


@pytest.mark.parametrize("seed", range(3))
def test_unclear_rows_are_clustered_as_well_as_by_scikit_learn(seed):
    points = np.random.default_rng(seed).normal(size=(400, 8))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    ours = inertia(points, rows.kmeans(points, 12, seed))
    singles = [KMeans(12, n_init=1, random_state=start).fit(points).inertia_ for start in range(20)]
    assert ours <= np.median(singles)
    assert np.array_equal(rows.kmeans(points, 12, seed), rows.kmeans(points, 12, seed))


def test_drawn_starts_follow_the_seed_and_spread_out():
    labels = np.repeat(np.arange(10), 30)
    points = np.eye(10)[labels] + 1e-3 * np.random.default_rng(0).normal(size=(300, 10))
    starts = rows.drawn_starts(points, 10, 9, 0)
    assert starts.shape == (9, 10)
    assert all(len(set(labels[start].tolist())) == 10 for start in starts)
    assert len({tuple(start.tolist()) for start in starts}) > 1
    assert np.array_equal(starts, rows.drawn_starts(points, 10, 9, 0))
    assert not np.array_equal(starts, rows.drawn_starts(points, 10, 9, 1))
    assert rows.drawn_starts(np.ones((4, 2)), 3, 2, 0).shape == (2, 3), "equal rows can be drawn too"
