from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import Retrieval
from siamloc.maps.error_model import ErrorModel, ratio_score
from siamloc.maps.joining import RefinedPoses
from tests.oracles import calibration as oracle
from tests.siamloc.maps.conftest import retrieval

MODEL = ErrorModel("ratio", 1.0, 5, (0.2, 0.5, 0.9), (0.1, 0.4, 3.0), 50)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(0, 4))
def test_the_ratio_equals_the_loop(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    xy, found = rng.uniform(0, 3, (30, 2)), retrieval(rng, 6)
    expected = [
        oracle.ratio(*row, xy, radius) for row in zip(found.indices.tolist(), found.distances.tolist(), strict=True)
    ]
    np.testing.assert_allclose(ratio_score(found, xy, radius), expected, rtol=1e-14)


def test_scores_of_small_examples() -> None:
    xy = np.array([[0.0, 0], [0, 0.5], [0, 3]])  # equal x, different y
    found = Retrieval(np.array([[0, 1, 2]]), np.array([[0.2, 0.3, 0.4]]))
    assert ratio_score(found, xy, 1.0).tolist() == [0.5]
    padded = Retrieval(np.array([[0, 1, 0]]), np.array([[0.2, 0.3, np.inf]]))
    assert ratio_score(padded, xy, 1.0).tolist() == [0.2 / 0.3]
    alike = Retrieval(np.array([[0, 2]]), np.array([[0.0, 0.0]]))
    assert ratio_score(alike, xy, 1.0).tolist() == [1]


def test_the_fit_is_the_isotonic_regression_of_group_means() -> None:
    rng = np.random.default_rng(0)
    xy, found = rng.uniform(0, 9, (30, 2)), retrieval(rng, 260)
    score = ratio_score(found, xy, 1.0)
    error = score**2 + 0.5 * rng.random(260)
    model = ErrorModel.fit(found, xy, error, neighbours=10)
    groups = np.array_split(np.argsort(score, kind="stable"), 10)
    np.testing.assert_allclose(model.knots, [score[rows].mean() for rows in groups])
    expected = oracle.isotonic([error[rows].mean() for rows in groups], [len(rows) for rows in groups])
    np.testing.assert_allclose(model.errors, expected)
    assert (model.queries, model.neighbours) == (260, 10)
    predicted = model.predict(found, xy)
    order = np.argsort(score)
    assert (np.diff(predicted[order]) >= 0).all()
    assert predicted.min() == model.errors[0]
    assert predicted.max() == model.errors[-1]
    # The mean is kept up to what the corners of the function cut off.
    assert abs(predicted.mean() - error.mean()) < 0.02


def test_a_score_that_tells_nothing_gives_the_mean_error_everywhere() -> None:
    rng = np.random.default_rng(1)
    found = Retrieval(np.zeros((40, 1), dtype=int), np.full((40, 1), 0.5))
    error = rng.random(40)
    model = ErrorModel.fit(found, [[0.0, 0.0]], error)
    np.testing.assert_allclose(model.predict(found, [[0.0, 0.0]]), error.mean())


def test_the_prediction_interpolates_and_is_constant_beyond() -> None:
    xy = np.array([[0.0, 0], [9, 0]])
    found = Retrieval(np.tile([0, 1], (4, 1)), np.array([[0.0, 1], [0.35, 1], [0.5, 1], [1, 1]]))
    np.testing.assert_allclose(MODEL.predict(found, xy), [0.1, 0.25, 0.4, 3.0])


def test_the_expected_error_of_a_pose_grows_with_its_deviation_beyond_all_of_the_validation() -> None:
    deviation, agreement = np.array([0.1, 0.4, 0.8, 0.8, np.nan]), np.array([1.0, 1.0, 1.0, 0.1, 0.0])
    n, information = len(agreement), np.eye(2) / np.nan_to_num(deviation, nan=np.inf)[:, None, None] ** 2
    poses = RefinedPoses(np.zeros((n, 2)), np.zeros(n), information, agreement, np.zeros(n, dtype=int), np.zeros(n))
    scores = np.log(2 * np.array([0.1, 0.4]))  # the covariance is twice the scale matrix, in x and in y
    model = ErrorModel("pose", 0.0, 1, tuple(scores), (0.05, 0.2), 50, refine="relative")
    found, xy = Retrieval(np.zeros((n, 1), dtype=int), np.ones((n, 1))), [[0.0, 0.0]]
    np.testing.assert_allclose(model.predict(found, xy, poses), [0.05, 0.2, 0.4, 4.0, 10.0])
    assert replace(model, lost_above=1.0).judged(found, xy, poses)[1].tolist() == [False] * 3 + [True] * 2
    surveyed = replace(poses, map_variance=np.full(n, 1.0))  # does not count: errors are those in the map
    np.testing.assert_array_equal(model.predict(found, xy, surveyed), model.predict(found, xy, poses))


@pytest.mark.parametrize("n", [30, 400])
def test_the_growing_error_is_right_on_average_where_it_was_learned(n):
    rng = np.random.default_rng(0)
    deviation = np.exp(rng.normal(-3, 0.5, n))
    errors = np.hypot(*rng.normal(0, deviation, (2, n)))
    information = np.eye(2) / deviation[:, None, None] ** 2
    poses = RefinedPoses(np.zeros((n, 2)), np.zeros(n), information, np.ones(n), np.zeros(n, dtype=int), np.zeros(n))
    model = ErrorModel.fit_poses(poses, errors)
    expected = model.predict(Retrieval(np.zeros((n, 1), dtype=int), np.ones((n, 1))), [[0.0, 0.0]], poses)
    assert expected.mean() == pytest.approx(errors.mean(), rel=0.05)  # 3 % of 400 lie above the last knot


def test_lost_is_an_expected_error_above_the_threshold() -> None:
    xy = np.array([[0.0, 0], [9, 0]])
    found = Retrieval(np.tile([0, 1], (3, 1)), np.array([[0.35, 1], [0.5, 1], [1, 1]]))
    assert replace(MODEL, lost_above=0.4).judged(found, xy)[1].tolist() == [False, False, True]
    assert MODEL.judged(found, xy)[1] is None
    for threshold in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ConfigError, match="lost_above must be a number"):
            replace(MODEL, lost_above=threshold)


def looked_for(rng, distance: float, n: int = 200, m: int = 30, k: int = 10) -> Retrieval:
    """Return matches whose best one is at about the given distance, and the others at about 1."""
    distances = np.sort(np.concatenate([rng.normal(distance, 0.05, (n, 1)), rng.normal(1, 0.02, (n, k - 1))], axis=1))
    return Retrieval(np.argsort(rng.random((n, m)), axis=1)[:, :k], np.abs(distances))


def test_what_lies_elsewhere_is_foreign_and_right_answers_are_not() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 30, (30, 2))
    near, far = looked_for(rng, 0.4), looked_for(rng, 0.9)
    model = replace(MODEL, lost_above=5.0)
    assert not model.judged(far, xy)[1].any(), "no error above 5 is expected of anything"
    model = model.with_foreign(near, xy, elsewhere=far)
    expected, lost = model.judged(near, xy)
    np.testing.assert_array_equal(expected, model.predict(near, xy))
    assert not lost.any()
    assert model.judged(far, xy)[1].all()
    known, other = (model.scores(one, xy) + model.foreign_weight * one.distances[:, 0] for one in (near, far))
    strangest = np.sort(known)[197]  # of 200, but for 1 %
    assert model.foreign_above == pytest.approx(strangest + 0.55 * (np.median(other) - strangest))
    near, far = (Retrieval(one.indices, 7 * one.distances) for one in (near, far))
    scaled = model.with_foreign(near, xy, elsewhere=far)
    assert scaled.judged(far, xy)[1].all(), "the unit of distances does not matter"
    assert not scaled.judged(near, xy)[1].any()


def compared(strangeness: list[float]) -> Retrieval:
    """Return matches of a map that compares images."""
    n = len(strangeness)
    return Retrieval(np.tile([0, 1], (n, 1)), np.tile([0.5, 1.0], (n, 1)), None, np.array(strangeness))


@pytest.mark.parametrize("score", ["ratio", "pose"])
def test_where_images_are_compared_their_strangeness_tells_what_is_foreign(score, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 30, (2, 2))
    model = replace(MODEL, score=score, refine="relative" if score == "pose" else "none", lost_above=5.0)
    model = model.with_foreign(compared([0.3] * 200), xy)
    assert model.foreign_weight is None
    assert model.foreign_above == 0.78, "nothing elsewhere is needed"
    assert model.foreign(compared([0.2, -0.4, 0.78, 0.8, np.nan]), xy).tolist() == [False, False, False, True, True]
    # Where right answers look strange, 99 % of them are none the less not foreign.
    assert model.with_foreign(compared(list(np.arange(200) / 10)), xy).foreign_above == 19.7
    with pytest.raises(DataError, match=r"at least 10 validation queries .* got 9 and 0"):
        model.with_foreign(compared([0.3] * 9), xy)
    with pytest.raises(ConfigError, match=r"search with siamloc\.maps\.match"):
        model.foreign(Retrieval(np.zeros((1, 1), dtype=int), np.zeros((1, 1))), xy)
    pose = replace(MODEL, score="pose", refine="relative")
    with pytest.raises(DataError, match="only if the map's distance is euclidean"):
        pose.with_foreign(looked_for(rng, 0.4), xy, elsewhere=looked_for(rng, 0.9))
    model.save(tmp_path / "error.json")
    assert ErrorModel.load(tmp_path / "error.json") == model


def test_where_both_look_alike_right_answers_count_more() -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 30, (30, 2))
    near, far = looked_for(rng, 0.8), looked_for(rng, 0.82)
    model = replace(MODEL, lost_above=5.0).with_foreign(near, xy, elsewhere=far)
    assert model.judged(near, xy)[1].mean() == pytest.approx(0.01, abs=0.005)
    assert model.judged(far, xy)[1].mean() < 0.5


def test_what_is_foreign_is_not_learned_from_a_few() -> None:
    rng = np.random.default_rng(2)
    xy = rng.uniform(0, 30, (30, 2))
    with pytest.raises(DataError, match=r"at least 10 validation queries .* got 9 and 20"):
        MODEL.with_foreign(looked_for(rng, 0.4, 9), xy, elsewhere=looked_for(rng, 0.9, 20))
    with pytest.raises(DataError, match=r"at least 10 validation queries .* got 20 and 0"):
        MODEL.with_foreign(looked_for(rng, 0.4, 20), xy)
    assert MODEL.judged(looked_for(rng, 0.4, 3), xy)[1] is None
    with pytest.raises(ConfigError, match="learned from refined poses"):
        replace(MODEL, score="pose", refine="relative").judged(looked_for(rng, 0.4, 3), xy)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"format": "other"}, "this is not a siamloc error model"),
        ({**MODEL.as_dict(), "version": 9}, "format version 9, this siamloc reads version 8: update siamloc"),
        ({**MODEL.as_dict(), "version": 7}, "format version 7, this siamloc reads version 8: make it again"),
        ({**MODEL.as_dict(), "foreign_weight": -1}, "not a whole error model"),
        ({**MODEL.as_dict(), "knots": [0.5]}, "not a whole error model"),
        ({**MODEL.as_dict(), "errors": [3, 2, 1]}, "not a whole error model"),
        ({**MODEL.as_dict(), "knots": None}, "not a whole error model"),
        ({**MODEL.as_dict(), "score": "luck"}, "not a whole error model .score must be ratio or pose, got 'luck'"),
    ],
)
def test_files_that_are_no_error_model(values, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        ErrorModel.from_dict(values, "this")


def test_errors(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    xy, found = rng.uniform(0, 9, (30, 2)), retrieval(rng, 20)
    with pytest.raises(FormatError, match="does not exist"):
        ErrorModel.load(tmp_path / "error.json")
    few = Retrieval(found.indices[:9], found.distances[:9])
    for learned, options, error, says in (
        ((found, xy, np.zeros(20)), {"radius": -1}, ConfigError, "radius must be a number from 0, got -1"),
        ((found, xy, np.zeros(20)), {"neighbours": 0}, ConfigError, "neighbours must be a whole number from 1"),
        ((found, xy, np.zeros(19)), {}, DataError, "20 validation queries need as many errors"),
        ((found, xy, np.full(20, np.nan)), {}, DataError, "finite and >= 0"),
        ((few, xy, np.zeros(9)), {}, DataError, "at least 10 validation queries, got 9"),
    ):
        with pytest.raises(error, match=says):
            ErrorModel.fit(*learned, **options)
    with pytest.raises(DataError, match=r"map positions \(m, 2\), all known"):
        MODEL.predict(found, np.full((30, 2), np.nan))
    with pytest.raises(DataError, match=r"needs 5 neighbours a query, got shape \(20, 2\)"):
        MODEL.predict(Retrieval(found.indices[:, :2], found.distances[:, :2]), xy)
