import tracemalloc
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import sparse
from sklearn.cluster import SpectralClustering
from sklearn.metrics import adjusted_rand_score

from analytic import AnalyticError, clustering
from analytic.clustering import spectral_clustering
from tests.oracles import clustering as oracle


def blocks(frames=120, count=6, length=32, apart=3.0, seed=0):
    """Descriptors about planted centres, shuffled, and the planted labels in order of first appearance."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.arange(frames) % count)
    return apart * rng.normal(size=(count, length))[truth] + rng.normal(size=(frames, length)), first_first(truth)


def drive(frames=300, length=24, seed=0):
    """Descriptors that change steadily along a path: no clusters stand out."""
    rng = np.random.default_rng(seed)
    corners = np.cumsum(rng.normal(size=(frames // 20 + 2, length)), axis=0)
    place = np.linspace(0, len(corners) - 1.001, frames)
    left, share = place.astype(int), (place % 1)[:, None]
    return corners[left] * (1 - share) + corners[left + 1] * share + 0.05 * rng.normal(size=(frames, length))


def first_first(labels):
    return np.array(oracle.renumbered(np.asarray(labels).tolist()))


def partition(similarity, count):
    """The clusters of given similarities, in the order of first appearance."""
    matrix = spectral_clustering._normalized(similarity)
    return first_first(spectral_clustering._clustered(matrix, spectral_clustering._parts(matrix), count, 0, "kmeans"))


@pytest.mark.parametrize("shape", [(2, 1), (9, 2), (25, 3), (30, 40)])
def test_similarity_follows_its_equation(shape):
    x = np.random.default_rng(1).normal(size=shape) * 5 + 100
    n = len(x)
    np.testing.assert_allclose(clustering.affinity(x, 4.0), oracle.affinity(x, 4.0), atol=1e-12)
    np.testing.assert_allclose(clustering.affinity(x), oracle.affinity(x, oracle.chosen_sigma(x)), atol=1e-11)
    for t in {1, min(4, n - 1), n - 1}:
        for sigma in (4.0, None):
            found = clustering.affinity(x, sigma, t)
            assert sparse.issparse(found)
            expected = oracle.affinity(x, sigma or oracle.chosen_sigma(x), t)
            np.testing.assert_allclose(found.toarray(), expected, atol=1e-11)
            assert np.array_equal(found.toarray() > 0, expected > 0)
    found = clustering.affinity(x)
    np.testing.assert_allclose(found, found.T, rtol=1e-9)


def test_similarity_needs_neither_units_nor_an_origin():
    x = np.random.default_rng(2).normal(size=(20, 6))
    for factor in (1e-9, 1e-3, 1e8):
        np.testing.assert_allclose(clustering.affinity(factor * x), clustering.affinity(x), rtol=1e-9, atol=1e-12)
        scaled = clustering.affinity(factor * x, factor * 0.7)
        np.testing.assert_allclose(scaled, clustering.affinity(x, 0.7), rtol=1e-9, atol=1e-12)
    assert np.array_equal(clustering.affinity(np.ones((4, 3))), np.ones((4, 4)))
    assert np.array_equal(clustering.affinity(x, 1e-9), np.eye(20))


@pytest.fixture(params=[1000, 100])
def small(request, monkeypatch):
    """Frames up to which the full decomposition is taken: these tests hold for Lanczos too."""
    monkeypatch.setattr(spectral_clustering, "_SMALL", request.param)


@pytest.mark.usefixtures("small")
def test_equal_eigenvalues_of_separate_parts_are_all_found():
    rng = np.random.default_rng(0)
    part = rng.permutation(np.repeat(np.arange(20), 45))
    dense = (part[:, None] == part) * rng.uniform(0.5, 1, (900, 900))
    graph = sparse.csr_array(dense + dense.T)
    matrix = spectral_clustering._normalized(graph)
    assert np.array_equal(first_first(spectral_clustering._parts(matrix)), first_first(part))
    found = spectral_clustering._leading_eigenvectors(matrix, spectral_clustering._parts(matrix), 20)
    np.testing.assert_allclose(matrix @ found, found, atol=1e-9)
    np.testing.assert_allclose(found.T @ found, np.eye(20), atol=1e-9)
    assert np.array_equal(partition(graph, 20), first_first(part))
    assert partition(np.eye(3), 3).tolist() == [0, 1, 2]


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("weak", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_array])
def test_parts_with_hardly_a_link_are_told_apart(weak, kind):
    rng = np.random.default_rng(0)
    part = rng.permutation(np.repeat(np.arange(12), 50))
    dense = np.where(part[:, None] == part, rng.uniform(0.5, 1, (600, 600)), 0)
    first = [np.flatnonzero(part == number)[0] for number in range(12)]
    dense[first[:-1], first[1:]] = weak * 50
    graph = kind(dense + dense.T)
    matrix = spectral_clustering._normalized(graph)
    assert spectral_clustering._parts(matrix).max() == 0
    assert np.array_equal(partition(graph, 12), first_first(part))


@pytest.mark.usefixtures("small")
def test_blocks_of_equal_similarities_are_clusters():
    """Nearly all eigenvalues of such a block are equal but for rounding, on which LAPACK's own search may fail."""
    blocks, size = 12, 60
    graph = np.kron(np.eye(blocks), np.ones((size, size)))
    ends = size * np.arange(blocks)
    graph[ends, np.roll(ends, 1)] = graph[np.roll(ends, 1), ends] = 6e-11
    order = np.random.default_rng(0).permutation(len(graph))
    labels = partition(graph[np.ix_(order, order)], blocks)
    assert adjusted_rand_score(labels, order // size) == 1


@pytest.mark.parametrize("options", [{}, {"neighbours": 8}, {"sigma": 6.0}, {"neighbours": 5, "sigma": 3.0}])
@pytest.mark.parametrize("assign", ["kmeans", "som"])
def test_the_planted_partition_is_found(options, assign):
    x, planted = blocks()
    found = clustering.spectral(x, 6, assign=assign, **options)
    assert np.array_equal(found, planted)
    assert found.dtype == np.int64


@pytest.mark.usefixtures("small")
def test_many_blocks_are_found_from_every_seed():
    x, planted = blocks(frames=800, count=40, length=64)
    for seed in range(3):
        assert np.array_equal(clustering.spectral(x, 40, neighbours=10, seed=seed), planted)
    assert np.array_equal(clustering.spectral(x, 40), planted)


@pytest.mark.parametrize("neighbours", [None, 12])
@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_the_partition_is_that_of_scikit_learn(neighbours, seed):
    x, planted = blocks(frames=450, count=5, length=8, apart=2.5, seed=seed)
    similarity = clustering.affinity(x, 3.0, neighbours)
    similarity = similarity + 1e-6 if neighbours is None else similarity + sparse.csr_array(np.full((450, 450), 1e-6))
    judge = SpectralClustering(5, affinity="precomputed", assign_labels="kmeans", random_state=0)
    expected = judge.fit_predict(similarity)
    found = partition(similarity, 5)
    assert adjusted_rand_score(expected, found) == 1.0
    assert adjusted_rand_score(planted, found) > 0.95


@pytest.mark.parametrize("neighbours", [None, 6])
def test_the_order_of_frames_only_changes_the_numbering(neighbours):
    x = drive(250)
    order = np.random.default_rng(5).permutation(len(x))
    for method in (
        lambda rows: clustering.spectral(rows, 12, neighbours=neighbours),
        lambda rows: clustering.spectral(rows, 12, neighbours=neighbours, assign="som"),
        lambda rows: clustering.som(rows, (4, 3)),
    ):
        straight = method(x)
        assert np.array_equal(straight, method(x))
        assert np.array_equal(first_first(straight[order]), method(x[order]))
        assert np.array_equal(straight, first_first(straight))


def test_neighbours_along_a_drive_stay_together():
    labels = clustering.spectral(drive(300), 15, neighbours=6)
    assert len(set(labels.tolist())) == 15
    assert (np.diff(labels) != 0).sum() == 14


def test_equal_descriptors_share_a_label_and_count_once():
    x, planted = blocks(frames=40, count=4)
    twice = np.concatenate([x, x[:25], x[:25]])
    found = clustering.spectral(twice, 4)
    assert np.array_equal(found, np.concatenate([planted, planted[:25], planted[:25]]))
    few = np.repeat(np.array([[0.0, 0], [5, 5], [-5, 5]]), [7, 1, 3], axis=0)
    assert clustering.spectral(few, 3).tolist() == [0] * 7 + [1] + [2] * 3
    assert clustering.spectral(few, 1).tolist() == [0] * 11
    assert clustering.spectral(few, 2, neighbours=1).max() == 1
    assert clustering.som(np.ones((5, 3)), (2, 2)).tolist() == [0] * 5


whole_rows = arrays(np.float64, array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(-3, 3))


@settings(max_examples=60, deadline=None)
@given(whole_rows, st.data())
def test_any_descriptors_are_grouped(x, data):
    different = len(np.unique(x, axis=0))
    count = data.draw(st.integers(1, different))
    neighbours = data.draw(st.none() | st.integers(1, different - 1)) if different > 1 else None
    sigma = data.draw(st.sampled_from([None, 0.01, 1.0, 100.0]))
    found = clustering.spectral(x, count, sigma=sigma, neighbours=neighbours)
    assert np.array_equal(found, first_first(found))
    assert found.max() < count
    for i in range(len(x)):
        for j in range(i):
            assert not np.array_equal(x[i], x[j]) or found[i] == found[j]


def test_more_parts_than_clusters_join_their_nearest():
    rng = np.random.default_rng(0)
    centres = np.array([0.0, 10, 100, 110, 1000, 1010])
    x = np.repeat(centres, 20)[:, None] + 0.1 * rng.normal(size=(120, 4))
    for neighbours in (None, 5):
        found = clustering.spectral(x, 3, sigma=0.1, neighbours=neighbours)
        assert found.tolist() == [0] * 40 + [1] * 40 + [2] * 40


def test_a_lonely_frame_goes_to_what_is_nearest():
    x, planted = blocks(frames=60, count=3)
    nearest = x[planted == 0][0]
    lonely = nearest + 40 * (nearest - x.mean(axis=0)) / np.linalg.norm(nearest - x.mean(axis=0))
    found = clustering.spectral(np.vstack([x, lonely]), 3, sigma=2.0)
    assert np.array_equal(found[:-1], planted)
    assert found[-1] == 0


@pytest.mark.parametrize(
    ("grid", "length"),
    # Of numbers on a line, the units of a grid with two sides start in pairs, which rounding alone tells apart.
    [*product([(1, 1), (2, 2), (3, 2), (2, 5), (6, 1)], [2, 7]), ((1, 1), 1), ((6, 1), 1)],
)
def test_the_map_organizes_itself_as_described(grid, length):
    rng = np.random.default_rng(length)
    x = rng.normal(size=(40, length)) * np.linspace(3, 1, length)
    x[30:] = x[:10]
    assert clustering.som(x, grid).tolist() == oracle.renumbered(oracle.som(x, grid))


@given(st.integers(1, 200), st.data())
def test_plain_sampling_takes_runs_of_frames(n, data):
    count = data.draw(st.integers(1, n))
    labels = clustering.sample(n, count)
    sizes = np.bincount(labels)
    assert len(labels) == n
    assert np.array_equal(labels, np.sort(labels))
    assert len(sizes) == count
    assert sizes.max() - sizes.min() <= 1
    rows = clustering.sample_rows(n, count)
    for cluster, row in enumerate(rows):
        members = np.flatnonzero(labels == cluster)
        assert row == members[(len(members) - 1) // 2]


def test_representatives_and_positions_are_means():
    rng = np.random.default_rng(0)
    x, points = rng.normal(size=(30, 5)), rng.normal(size=(30, 2))
    labels = rng.permutation(np.arange(30) % 4)
    labels[:3] = -1
    points[labels == 2] = np.nan
    points[np.flatnonzero(labels == 1)[0], 1] = np.nan
    means = clustering.representatives(x, labels)
    places = clustering.positions(points, labels)
    for cluster in range(4):
        np.testing.assert_allclose(means[cluster], x[labels == cluster].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(places[0], points[labels == 0].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(places[1], points[labels == 1][1:].mean(axis=0), atol=1e-12)
    assert np.isnan(places[2]).all()
    gaps = clustering.representatives(x, labels * 10)
    np.testing.assert_allclose(gaps, means)


def test_neighbours_need_no_full_matrix():
    x = np.random.default_rng(0).normal(size=(6000, 17)).astype(np.float32)
    clustering.affinity(x[:50], None, 5)
    tracemalloc.start()
    clustering.affinity(x, None, 5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6000 * 6000 * 8 / 2


X = np.arange(12.0).reshape(6, 2) ** 2


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: clustering.spectral(X, 7), "7 clusters need at least as many frames, got 6"),
        (lambda: clustering.spectral(X, 0), "the number of clusters must be a whole number from 1 .*, got 0"),
        (
            lambda: clustering.spectral(np.repeat(X[:2], 3, axis=0), 3),
            "3 clusters need as many different descriptors, got 2",
        ),
        (lambda: clustering.spectral(np.where(X > 90, np.nan, X), 2), "1 of 6 descriptors are not finite"),
        (lambda: clustering.spectral(X[0], 2), r"shape \(n, D\) .* got \(2,\)"),
        (lambda: clustering.spectral(X, 2, sigma=0), "sigma must be a number above 0, or null, got 0"),
        (lambda: clustering.spectral(X, 2, neighbours=6), "6 frames has at most 5 neighbours, got neighbours=6"),
        (lambda: clustering.spectral(X, 2, assign="dbscan"), "assign must be kmeans or som, got 'dbscan'"),
        (lambda: clustering.spectral(X, 2, seed=-1), "the seed must be a whole number from 0 to 4,294,967,295, got -1"),
        (lambda: clustering.affinity(X[:1], None, 1), "has at most 0 neighbours, got neighbours=1"),
        (lambda: clustering.som(X, (2, 0)), r"the grid must be two whole numbers .* got \(2, 0\)"),
        (lambda: clustering.som(X, (4, 2)), "4 x 2 units need 8 frames, got 6"),
        (lambda: clustering.sample(0, 1), "the number of frames must be a whole number from 1 .*, got 0"),
        (lambda: clustering.sample(5, 6), "6 clusters need at least as many frames, got 5"),
        (lambda: clustering.representatives(X, [0, 1]), "got 2 labels for 6 frames"),
        (lambda: clustering.representatives(X, [-1] * 6), "no frame is in a cluster"),
        (lambda: clustering.positions(np.full((6, 2), np.inf), [0] * 6), "6 of 6 positions are not finite"),
        (lambda: clustering.positions(np.zeros(6), [0] * 6), r"positions must have shape \(n, D\)"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
