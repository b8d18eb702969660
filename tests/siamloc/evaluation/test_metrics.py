from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import metrics
from siamloc.evaluation.calibration import calibration_curve
from tests.oracles import metrics as oracle

seeds = st.integers(0, 2**32 - 1)


def scene(seed: int, n: int = 12, m: int = 30) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return map positions, query positions, and a shuffled ranking of the whole map for each query."""
    rng = np.random.default_rng(seed)
    # Quarters of a metre: distances that equal a radius exactly do occur.
    map_xy, query_xy = rng.integers(0, 20, (m, 2)) / 4, rng.integers(-8, 28, (n, 2)) / 4
    return map_xy, query_xy, np.argsort(rng.random((n, m)), axis=1)


@settings(deadline=None)  # the first call imports scipy
@given(seed=seeds)
def test_errors_and_floor_equal_the_loops(seed: int) -> None:
    map_xy, query_xy, retrieved = scene(seed)
    error = metrics.localization_error(map_xy[retrieved[:, 0]], query_xy)
    np.testing.assert_allclose(error, oracle.localization_error(map_xy[retrieved[:, 0]], query_xy), rtol=1e-14)
    floor = metrics.error_floor(map_xy, query_xy)
    np.testing.assert_allclose(floor, oracle.error_floor(map_xy, query_xy), rtol=1e-14)
    assert (floor <= error * (1 + 1e-15)).all()


@given(errors=st.lists(st.floats(0, 1e6), min_size=1, max_size=60))
def test_summary_equals_the_loop(errors: list[float]) -> None:
    summary, expected = metrics.summarize(errors), oracle.summarize(errors)
    assert list(summary) == list(expected)
    for key, value in expected.items():
        assert math.isclose(summary[key], value, rel_tol=1e-12, abs_tol=1e-150), key


def test_summary_of_nothing() -> None:
    summary = metrics.summarize([])
    assert summary.pop("count") == 0
    assert all(math.isnan(value) for value in summary.values())
    assert len(summary) == 5


@settings(max_examples=60)
@given(seed=seeds, radius=st.sampled_from([0.0, 0.25, 0.5, 1.25, 100.0]), k=st.integers(1, 40))
def test_recall_equals_the_loop(seed: int, radius: float, k: int) -> None:
    map_xy, query_xy, retrieved = scene(seed)
    recall = metrics.recall_at_k(retrieved, map_xy, query_xy, radius, k)
    hits, answerable = oracle.recall_at_k(retrieved, map_xy, query_xy, radius, k)
    assert (recall.hits, recall.answerable) == (hits, answerable)
    assert (recall.queries, recall.k, recall.radius) == (12, k, radius)
    assert recall.recall == hits / 12
    if answerable:
        assert recall.recall_answerable == hits / answerable
    else:
        assert math.isnan(recall.recall_answerable)


@pytest.mark.parametrize("k", [1.0, np.ceil(0.5), np.int64(1)])
def test_a_whole_k_may_be_a_float(k: float) -> None:
    recall = metrics.recall_at_k([[0], [0]], XY, [[0.0, 0.0], [9.0, 0.0]], 1.0, k)
    assert (recall.hits, recall.queries, recall.k) == (1, 2, 1)
    assert type(recall.k) is int


@pytest.mark.parametrize(("frames", "k"), [(1, 1), (99, 1), (100, 1), (101, 2), (556, 6), (1000, 10)])
def test_one_percent_of_the_map(frames: int, k: int) -> None:
    assert metrics.one_percent(frames) == k


@given(seed=seeds, margin=st.sampled_from([0.5, 1.0, 2.0]), threshold=st.sampled_from([0.1, 0.5, 1.0]))
def test_pair_accuracy_equals_the_loop(seed: int, margin: float, threshold: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 40))
    distances, same = rng.integers(0, 13, n) / 4, rng.random(n) < 0.3
    accuracy = metrics.pair_accuracy(distances, same, margin, threshold)
    right_same, n_same, right_different, n_different = oracle.pair_accuracy(distances, same, margin, threshold)
    assert (accuracy.n_same, accuracy.n_different) == (n_same, n_different)
    for value, right, count in (
        (accuracy.same, right_same, n_same),
        (accuracy.different, right_different, n_different),
        (accuracy.overall, right_same + right_different, n),
    ):
        assert math.isnan(value) if count == 0 else math.isclose(value, right / count, rel_tol=1e-15)


@given(seed=seeds)
def test_no_limit_misjudges_fewer_pairs_than_half_the_fitted_margin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 30))
    distances, same = rng.integers(0, 13, n) / 4, np.arange(n) % 3 == 0
    if len(set(distances.tolist())) < 2:
        return
    limit = metrics.fitted_margin(distances, same) / 2
    right = [sum((d < t) == s for d, s in zip(distances, same, strict=True)) for t in sorted(set(distances))[1:]]
    assert sum((distances < limit) == same) == max(right)
    assert np.abs(distances - limit).min() > 0


def test_the_fitted_margin_lies_in_the_middle_of_the_widest_gap() -> None:
    assert metrics.fitted_margin([0.0, 0.1, 0.5, 0.6], np.array([True, True, False, False])) == 0.6
    for distances, same in (([0.1, 0.2], [True, True]), ([0.1, 0.2], [False, False]), ([0.1, 0.1], [True, False])):
        with pytest.raises(DataError, match="pairs of both kinds at different distances"):
            metrics.fitted_margin(distances, np.array(same))
    with pytest.raises(DataError, match="negative"):
        metrics.fitted_margin([-1.0, 2.0], np.array([True, False]))


@given(seed=seeds, margin=st.sampled_from([0.5, 2.0, 3.0]))
def test_the_threshold_curve_is_the_accuracy_at_every_threshold(seed: int, margin: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 40))
    distances, same = rng.integers(0, 13, n) / 4, rng.random(n) < 0.3
    steps = np.array([0.125, 0.25, 0.5, 0.75, 1.0])
    curve = metrics.pair_threshold_curve(distances, same, margin, steps)
    for i, threshold in enumerate(steps):
        accuracy = metrics.pair_accuracy(distances, same, margin, threshold)
        np.testing.assert_array_equal(
            [curve.same[i], curve.different[i], curve.overall[i]], [accuracy.same, accuracy.different, accuracy.overall]
        )
    ordered, couples = oracle.pair_auc(distances, same, margin)
    assert math.isnan(curve.auc) if couples == 0 else math.isclose(curve.auc, ordered / couples, rel_tol=1e-15)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("abc")), max_size=40))
def test_confusion_matrix_equals_the_loop(pairs: list[tuple[str, str]]) -> None:
    true, predicted = [t for t, _ in pairs], [p for _, p in pairs]
    matrix = metrics.confusion_matrix(np.array(true, dtype=str), np.array(predicted, dtype=str), ["c", "a", "b", "d"])
    np.testing.assert_array_equal(matrix, oracle.confusion(true, predicted, ["c", "a", "b", "d"]))


@given(st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1))
def test_heading_error_equals_the_formula(pairs: list[tuple[float, float]]) -> None:
    a, b = np.array(pairs).T
    error = metrics.heading_error(a, b)
    np.testing.assert_allclose(error, oracle.heading_error(a, b), atol=1e-12)
    assert ((error >= 0) & (error <= np.pi)).all()


XY = [[0.0, 0.0]]
NAN = [[0.0, math.nan]]


@pytest.mark.parametrize("scale", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_errors_of_trajectories_equal_those_of_matrices(seed: int, scale: bool) -> None:
    rng = np.random.default_rng(seed)
    true = np.cumsum(rng.normal(size=(20, 3)), axis=0)
    bent = true + 0.3 * rng.normal(size=true.shape)
    turn = rng.uniform(-np.pi, np.pi)
    bent[:, :2] = 0.7 * bent[:, :2] @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]] + [5.0, -3.0]
    bent[:, 2] += turn
    np.testing.assert_allclose(
        metrics.absolute_trajectory_error(bent, true, scale=scale), oracle.absolute_trajectory_error(bent, true, scale)
    )
    for delta in (1, 4):
        for one, other in zip(
            metrics.relative_trajectory_error(bent, true, delta),
            oracle.relative_trajectory_error(bent, true, delta),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, atol=1e-12)
    found = metrics.aligned_trajectory(true * [2, 2, 1], true, scale=True)
    np.testing.assert_allclose(np.exp(1j * found[:, 2]), np.exp(1j * true[:, 2]))
    np.testing.assert_allclose(found[:, :2], true[:, :2], atol=1e-12)


POSES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 1.0]])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: metrics.localization_error(NAN, XY), DataError, "1 of 1 estimated positions are unknown"),
        (lambda: metrics.localization_error(XY, XY * 2), DataError, "got 1 and 2"),
        (lambda: metrics.localization_error([0.0], XY), DataError, "shape (n, 2), got (1,)"),
        (lambda: metrics.error_floor(np.empty((0, 2)), XY), DataError, "the map is empty"),
        (lambda: metrics.error_floor(XY, XY, np.array([[True]])), DataError, "each query a map frame, got 1 excluded"),
        (lambda: metrics.error_floor(XY, XY, np.array([False])), DataError, "(1, 1) and leave each query"),
        (lambda: metrics.recall_from_ranks([1, 2], [1.0], 1, 3), DataError, "shape (n,), got (2,) and (1,)"),
        (lambda: metrics.summarize(["a"]), DataError, "errors must be an array of numbers"),
        (lambda: metrics.summarize([1.0, math.nan]), DataError, "1 of 2 errors are not finite"),
        (lambda: metrics.summarize(np.ma.array([1.0, 2.0], mask=[0, 1])), DataError, "1 of 2 errors are not finite"),
        (lambda: calibration_curve([1.0, math.nan], [1.0, 2.0]), DataError, "1 of 2 predicted errors are not finite"),
        (lambda: metrics.summarize([[1.0]]), DataError, "shape (n,), got (1, 1)"),
        (lambda: metrics.recall_at_k([[0]], XY, XY, -1, 1), ConfigError, "radius must be a number from 0, got -1"),
        (lambda: metrics.recall_at_k([[0]], XY, XY, 1, 1.5), ConfigError, "k must be a whole number from 1"),
        (lambda: metrics.recall_at_k([[0]], XY, XY, 1, True), ConfigError, "k must be a whole number from 1"),
        (lambda: metrics.recall_at_k([[0]], XY, XY, math.inf, 1), ConfigError, "radius must be a number from 0"),
        (lambda: metrics.recall_at_k([[0]], XY * 3, XY, 1, 2), ConfigError, "recall@2 needs 2 retrieved frames"),
        (lambda: metrics.recall_at_k([[1]], XY, XY, 1, 1), DataError, "rows of the map, 0 to 0"),
        (lambda: metrics.recall_at_k([[0.0]], XY, XY, 1, 1), DataError, "whole numbers of shape (1, K), got float64"),
        (lambda: metrics.pair_accuracy([1.0], [True], margin=0), ConfigError, "margin must be positive, got 0"),
        (lambda: metrics.pair_accuracy([1.0], [True], threshold=0), ConfigError, "(0, 1], got 0"),
        (lambda: metrics.pair_threshold_curve([1.0], [1]), DataError, "got int64 of shape (1,)"),
        (lambda: metrics.pair_threshold_curve([1.0], [True], 2, [0.5, 1.5]), ConfigError, "[0, 1], got 0.5 to 1.5"),
        (lambda: metrics.pair_accuracy([-1.0], [True]), DataError, "1 of 1 pair distances are negative"),
        (lambda: metrics.confusion_matrix(["a"], ["b"], ["a"]), DataError, "labels 'b' are not among a"),
        (lambda: metrics.confusion_matrix(["a"], ["a"], ["a", "a"]), DataError, "must differ"),
        (lambda: metrics.heading_error([0.0], [0.0, 1.0]), DataError, "got 1 and 2"),
        (
            lambda: metrics.aligned_trajectory([[0.0, 0.0]], [[0.0, 0.0, 0.0]]),
            DataError,
            "estimated poses must have shape",
        ),
        (lambda: metrics.aligned_trajectory(POSES[:1], POSES), DataError, "at least one, got 1 and 3"),
        (lambda: metrics.aligned_trajectory(POSES * 0, POSES), DataError, "positions are all the same"),
        (lambda: metrics.aligned_trajectory([[0, 0, 0], [1, 2]], POSES), DataError, "estimated poses must be an array"),
        (lambda: metrics.aligned_trajectory(POSES, "poses"), DataError, "true poses must be an array of numbers"),
        (lambda: metrics.relative_trajectory_error(POSES, POSES, 1.0), ConfigError, "delta must be a whole number"),
        (lambda: metrics.relative_trajectory_error(POSES, POSES, 3), DataError, "a delta from 1 to 2, got 3"),
    ],
)
def test_errors(call, error: type[Exception], message: str) -> None:
    with pytest.raises(error) as raised:
        call()
    assert message in str(raised.value)
