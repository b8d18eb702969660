import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import silhouette_samples, silhouette_score

from analytic import AnalyticError, distance, measures
from tests.analytic.mapper.world import cold_drive
from tests.oracles import clustering as oracle


def grouped(frames=60, count=5, length=2, seed=0):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, count, frames)
    labels[:count] = np.arange(count)
    return 2.0 * rng.normal(size=(count, length))[labels] + rng.normal(size=(frames, length)), labels


@pytest.mark.parametrize("length", [1, 2, 16, 17, 300])
@pytest.mark.parametrize("count", [2, 5, 40])
def test_the_nearest_silhouette_is_that_of_scikit_learn(length, count):
    x, labels = grouped(count=count, length=length, seed=length)  # 40 of 60: many clusters of one frame
    found = measures.silhouettes(x, labels)
    np.testing.assert_allclose(found.frames, silhouette_samples(x, labels), atol=1e-9)
    assert measures.silhouette(x, labels) == pytest.approx(silhouette_score(x, labels), abs=1e-10)
    assert found.labels.tolist() == list(range(count))
    np.testing.assert_allclose(
        found.clusters, [silhouette_samples(x, labels)[labels == c].mean() for c in range(count)], atol=1e-9
    )
    assert found.sizes.tolist() == np.bincount(labels).tolist()


@pytest.mark.parametrize("mode", ["nearest", "pooled"])
@pytest.mark.parametrize("length", [2, 20])
def test_silhouettes_follow_their_definition(mode, length):
    x, labels = grouped(frames=40, length=length, seed=3)
    labels = labels * 3 - 3 * (labels == 4)  # gaps between the labels
    labels[[5, 17]] = -1
    labels[9] = 100  # a cluster of one
    expected = oracle.silhouettes(x.tolist(), labels.tolist(), mode)
    np.testing.assert_allclose(measures.silhouettes(x, labels, mode).frames, expected, atol=1e-9)
    average = oracle.average_silhouette(x.tolist(), labels.tolist(), mode)
    assert measures.silhouette(x, labels, mode) == pytest.approx(average, abs=1e-10)


@pytest.mark.parametrize("mode", ["nearest", "pooled"])
def test_frames_in_no_cluster_may_count_as_one_more_cluster(mode):
    x, labels = grouped()
    without, with_them = np.where(labels == 2, -1, labels), np.where(labels == 2, 7, labels)
    assert measures.silhouette(x, without, mode, unassigned="cluster") == measures.silhouette(x, with_them, mode)
    assert measures.silhouette(x, labels, mode, unassigned="cluster") == measures.silhouette(x, labels, mode)


@pytest.mark.parametrize("name", ["manhattan", "cosine", "correlation", "minkowski"])
def test_silhouettes_of_descriptors_take_any_distance(name):
    x, labels = grouped(length=6)
    expected = silhouette_score(x, labels, metric={"minkowski": "euclidean"}.get(name, name))
    assert measures.silhouette(x, labels, distance=name) == pytest.approx(expected, abs=1e-10)
    apart = distance(name)(x, x)
    pooled = measures.silhouettes(x, labels, "pooled", name).frames
    for i in range(len(x)):
        own = labels == labels[i]
        a, b = apart[i, own].sum() / (own.sum() - 1), apart[i, ~own].mean()
        assert pooled[i] == pytest.approx((b - a) / max(a, b), abs=1e-10)


def test_frames_in_one_place_have_silhouette_zero():
    assert measures.silhouette(np.ones((4, 2)), [0, 0, 1, 1]) == 0
    assert measures.silhouette(np.ones((4, 2)), [0, 0, 1, 1], "pooled") == 0


def test_many_frames_need_no_full_matrix():
    rng = np.random.default_rng(0)
    x, labels = rng.normal(size=(6000, 2)), rng.integers(0, 50, 6000)
    measures.silhouette(x[:100], labels[:100])
    tracemalloc.start()
    measures.silhouette(x, labels)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6000 * 6000 * 8 / 2


def test_moment_of_inertia_is_the_sum_over_clusters_of_mean_squares():
    x, labels = grouped()
    expected = oracle.moment_of_inertia(x.tolist(), labels.tolist())
    assert measures.moment_of_inertia(x, labels) == pytest.approx(expected, rel=1e-12)
    # Two frames 2 m apart are at 1 m from their mean; three in one place are at 0.
    points, nodes = [[0, 0], [2, 0], [5, 5], [5, 5], [5, 5], [9, 9]], [0, 0, 1, 1, 1, -1]
    assert measures.moment_of_inertia(points, nodes) == 1
    assert measures.moments_of_inertia(points, nodes).tolist() == [1, 0]


rooms_of = st.lists(st.tuples(st.integers(-1, 4), st.sampled_from(["", "a", "b", "c"])), min_size=1, max_size=40)


@given(rooms_of)
def test_purity_counts_frames_in_nodes_of_their_room(frames):
    labels, rooms = [label for label, _ in frames], [room for _, room in frames]
    found = measures.purity(labels, rooms)
    assert found.counted == sum(label >= 0 and room != "" for label, room in frames)
    if not found.counted:
        assert math.isnan(found.overall)
        assert found.rooms == {}
        return
    overall, per_room = oracle.purity(labels, rooms)
    assert found.overall == pytest.approx(overall)
    assert found.rooms == pytest.approx(per_room)
    assert sum(found.frames_per_room.values()) == found.counted


def test_a_node_has_the_room_of_most_of_its_frames():
    labels = [0, 0, 0, 1, 1, 1, 2, -1]
    rooms = ["KT-A", "KT-A", "CR-A", "CR-A", "CR-A", "KT-A", "", "CR-A"]
    found = measures.purity(labels, rooms)
    assert found.labels.tolist() == [0, 1]
    assert found.nodes.tolist() == pytest.approx([2 / 3, 2 / 3])
    assert found.room_of_node == ["KT-A", "CR-A"]
    assert measures.purity([0, 0], np.array(["b", "a"], dtype=object)).room_of_node == ["a"]


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 25), st.integers(0, 10_000), st.integers(1, 6), st.sampled_from([0.0, 1.0, 2.0]))
def test_closures_are_counted_as_defined(frames, seed, gap, radius):
    rng = np.random.default_rng(seed)
    positions = rng.integers(0, 4, (frames, 2)).astype(float)
    pairs = rng.integers(0, frames, (rng.integers(0, 30), 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    found = measures.closure_scores(pairs, positions, radius, gap)
    expected = oracle.closure_counts(pairs.tolist(), positions.tolist(), radius, gap)
    assert {name: getattr(found, name) for name in expected} == expected
    assert math.isnan(found.precision) == (not found.closures)
    assert math.isnan(found.recall) == (not found.revisits)
    if found.closures:
        assert found.precision == found.right / found.closures
    if found.revisits:
        assert found.recall == found.closed / found.revisits
        assert 0 <= found.f1 <= 1


@pytest.mark.data
def test_on_a_real_path_the_pooled_silhouette_rises_with_the_nodes_and_the_nearest_falls():
    points = cold_drive("freiburg_seq2_cloudy1")[:, :2]
    chunks = {count: np.arange(len(points)) * count // len(points) for count in (6, 40)}
    pooled, nearest = (
        [measures.silhouette(points, chunks[count], mode) for count in (6, 40)] for mode in ("pooled", "nearest")
    )
    assert pooled == pytest.approx([0.64, 0.90], abs=0.005)
    assert nearest == pytest.approx([0.29, 0.08], abs=0.005)  # the published one falls from about 0.25 to 0.1
    # Three in five frames in no node: as one node, which spreads over the whole path, they make the mean negative.
    parked = np.where(np.arange(len(points)) % 100 < 60, -1, chunks[40])
    assert measures.silhouette(points, parked, unassigned="cluster") < -0.15 < measures.silhouette(points, parked)


P = np.arange(10.0).reshape(5, 2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: measures.silhouette(P, [0] * 5), "needs at least two, got 1"),
        (lambda: measures.silhouette(P, [0, 1]), "got 2 labels for 5 frames"),
        (lambda: measures.silhouette(P, [0.0, 1, 0, 1, 1]), "labels must be whole numbers"),
        (lambda: measures.silhouette(np.where(P > 8, np.inf, P), [0, 0, 1, 1, 1]), "1 of 5 .* not finite"),
        (lambda: measures.silhouette(P, [0, 0, 1, 1, 1], "mean"), "mode must be nearest or pooled, got 'mean'"),
        (lambda: measures.silhouette(P, [0, 0, 1, 1, 1], distance="cosinus"), "did you mean 'cosine'"),
        (lambda: measures.silhouette(P, [0, 0, 1, 1, 1], unassigned="no"), "unassigned must be left_out or cluster"),
        (lambda: measures.moment_of_inertia(P, [-1] * 5), "no frame is in a cluster"),
        (lambda: measures.purity([0, 1], ["a"]), "got 2 labels for 1 frames"),
        (lambda: measures.purity([0, 1], np.array(["a", None], dtype=object)), "rooms must be strings"),
        (lambda: measures.closure_scores([(0, 5)], P, 1.0), "frames from 0 to 4, got 0 to 5"),
        (lambda: measures.closure_scores([(2, 2)], P, 1.0), "same frame twice"),
        (lambda: measures.closure_scores([0, 1], P, 1.0), r"shape \(m, 2\), got int64 of shape \(2,\)"),
        (lambda: measures.closure_scores([], P, -1.0), "the radius must be a number from 0, got -1.0"),
        (lambda: measures.closure_scores([], P, 1.0, gap=0), "the gap must be a whole number from 1 .*, got 0"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
