from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps import VisualMap
from siamloc.maps.sequence_filter import (
    MotionModel,
    SequenceFilter,
    frame_distances,
    learn_temperature,
    temperature_of_map,
    tune_filter,
)
from tests.oracles import bayes_filter as oracle
from tests.siamloc.maps.conftest import placed


def corridor(n: int = 60, spacing: float = 0.5) -> FrameTable:
    return placed(np.column_stack([spacing * np.arange(n), np.zeros(n)]), time=np.arange(n) * 0.5)


def ambiguous(place: np.ndarray, rng, noise: float = 0.25) -> np.ndarray:
    """Return distances (n, 60) of queries at some places (frames) of a corridor whose two halves look nearly alike."""
    own = np.arange(60)
    seen = np.abs(own % 30 - place[:, None] % 30) / 3 + 0.05 * (own // 30 != place[:, None] // 30)
    return np.minimum(seen, 1.5) + noise * rng.random((len(place), 60))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kidnapping=st.floats(1e-6, 0.5), temperature=st.floats(0.05, 2))
def test_the_filter_equals_the_naive_forward_algorithm(seed: int, kidnapping: float, temperature: float) -> None:
    rng = np.random.default_rng(seed)
    known = placed(np.cumsum(rng.normal(size=(9, 2)), axis=0))
    motion = MotionModel.learn(known, step=float(rng.uniform(0.1, 2)))
    table = oracle.transitions(known.xy.tolist(), motion.step, motion.spacing)
    distances, sequence = rng.uniform(0, 3, (12, 9)), np.array(["a"] * 5 + ["b"] * 7)
    track = SequenceFilter(motion, temperature, kidnapping).run(distances, sequence)
    expected = [
        belief
        for part in (slice(0, 5), slice(5, 12))
        for belief in oracle.forward(distances[part].tolist(), table, temperature, kidnapping)
    ]
    assert track.frame.tolist() == [belief.index(max(belief)) for belief in expected]
    np.testing.assert_allclose(track.probability, [max(belief) for belief in expected], rtol=1e-9)
    for i in (0, 4, 5, 11):
        best = known.xy[track.frame[i]]
        squares = [p * math.dist(xy, best) ** 2 for p, xy in zip(expected[i], known.xy, strict=True)]
        assert track.spread[i] == pytest.approx(math.sqrt(math.fsum(squares)))


def test_the_step_is_learned_from_the_spacing_or_from_speed_and_interval() -> None:
    known = corridor()
    assert MotionModel.learn(known).step == MotionModel.learn(known).spacing == 0.5
    assert MotionModel.learn(known, interval=0.1).step == pytest.approx(0.1)  # 1 m/s
    assert MotionModel.learn(known, step=0.3, interval=0.1).step == 0.3
    assert MotionModel.learn(known.with_columns(time=np.full(60, np.nan)), interval=0.1).step == 0.5
    two = known.with_columns(sequence=np.array(["a"] * 30 + ["b"] * 30), x=np.r_[np.arange(30), 50 + np.arange(30)])
    assert MotionModel.learn(two).spacing == 1  # nobody went from the end of one sequence to the start of the next


def test_frames_of_two_buildings_are_not_neighbours() -> None:
    known = placed([[0, 0], [1, 0], [0, 0], [1, 0]], building=["a", "a", "b", "b"], sequence=["a", "a", "b", "b"])
    motion = MotionModel.learn(known)
    np.testing.assert_allclose(motion.predict(np.array([1.0, 0, 0, 0]))[2:], 0)


def test_a_kidnapped_robot_is_found_within_the_stated_number_of_queries() -> None:
    n, kidnapping, temperature, gap = 200, 1e-4, 0.1, 0.4
    motion = MotionModel.learn(corridor(n))
    place = np.r_[np.arange(20, 50), np.arange(150, 180)]
    distances = gap * (np.abs(np.arange(n) - place[:, None]) > 0)
    track = SequenceFilter(motion, temperature, kidnapping).run(distances, np.zeros(60))
    bound = 1 + math.log(n / kidnapping) / (gap / temperature + math.log(motion.predict(np.eye(n)[100])[101]))
    found = np.flatnonzero(track.frame[30:] == place[30:])[0] + 1
    assert 2 <= found <= bound < 8
    assert (track.frame[30 + int(found) :] == place[30 + int(found) :]).all()
    assert (track.frame[5:30] == place[5:30]).all()


def test_each_sequence_begins_anew_wherever_its_queries_stand() -> None:
    rng = np.random.default_rng(1)
    motion, distances = MotionModel.learn(corridor()), ambiguous(np.r_[0:20, 40:60], rng)
    run = SequenceFilter(motion, 0.2)
    names = np.array(["a"] * 20 + ["b"] * 20)
    track = run.run(distances, names)
    mixed = np.argsort(np.r_[0:20, 0:20], kind="stable")
    again = run.run(distances[mixed], names[mixed])
    np.testing.assert_array_equal(again.frame, track.frame[mixed])
    np.testing.assert_array_equal(again.probability, track.probability[mixed])


def ahead(lengths: np.ndarray) -> np.ndarray:
    """Motions (n, 3) of a robot that drives straight ahead."""
    return np.column_stack([lengths, np.zeros((len(lengths), 2))])


@pytest.mark.parametrize("length", [0.0, 0.1, 0.5, 0.8, 1.5, 4.0])
def test_a_robot_of_known_motion_gets_about_as_far_as_it_moved(length: float) -> None:
    known = corridor(120)
    motion = MotionModel.learn(known)
    belief, away = motion.predict(np.eye(120)[60], length), known.x - known.x[60]
    assert belief.sum() == pytest.approx(1)
    expected = (0.5**2 + 0.5**2 / 6) * length / 0.5 if length < 0.5 else length**2 + 0.5**2 / 6
    assert belief @ away**2 == pytest.approx(expected, rel=0.15)


def test_the_usual_step_is_a_motion_like_any_other() -> None:
    belief, motion = np.random.default_rng(0).dirichlet(np.ones(60)), MotionModel.learn(corridor())
    usual = motion.predict(belief)
    for length in (None, 0.5, 0.5 + 1e-9, 0.5 - 1e-9):
        np.testing.assert_allclose(motion.predict(belief, length), usual, atol=1e-8)


def test_a_map_in_one_place_is_kept_whatever_the_motion() -> None:
    motion = MotionModel.learn(placed([[1, 1], [1, 1]]))
    np.testing.assert_allclose(motion.predict(np.array([1.0, 0.0]), 2.0), [0.5, 0.5])


def test_a_robot_that_stands_still_in_the_dark_is_still_there() -> None:
    """After 16 dark pictures, the place two frames on looks more like the robot's than its own does."""
    motion, own = MotionModel.learn(corridor()), np.arange(60)
    seen = np.where(own == 20, 0.2, np.where(own == 22, 0.0, 1.0))
    distances = np.concatenate([1.0 * (own != 20)[None], np.zeros((16, 60)), seen[None]])
    for lengths, place in ((np.zeros(18), 20), (np.full(18, 1 / 16), 22), (np.full(18, np.nan), 22)):
        track = SequenceFilter(motion, 0.1).run(distances, ["a"] * 18, motion=ahead(lengths))
        assert track.frame[-1] == place


def test_pictures_of_one_place_count_as_one() -> None:
    motion, own = MotionModel.learn(corridor()), np.arange(60)
    seen, usual = np.abs(own - own[:, None]) / 3, ahead(np.full(60, 0.5))
    track = SequenceFilter(motion, 0.2).run(seen, ["a"] * 60, motion=usual)
    order = np.r_[:20, [20] * 100]
    standing = SequenceFilter(motion, 0.2).run(seen[order], ["a"] * 120, motion=ahead(0.5 * np.diff(order, prepend=-1)))
    assert standing.spread[-1] > 0.3 * track.spread[20]
    slow = SequenceFilter(motion, 0.2).run(seen.repeat(10, axis=0), ["a"] * 600, motion=usual.repeat(10, axis=0) / 10)
    assert slow.spread[300] > 0.3 * track.spread[30]


@pytest.mark.parametrize("place", [np.r_[5:20, [45] * 20], np.r_[5:40]], ids=["carried away", "stuck wheels"])
def test_pictures_that_contradict_the_wheels_count_fully(place: np.ndarray) -> None:
    seen, lengths = np.abs(np.arange(60) - place[:, None]) / 3, np.full(len(place), 0.5)
    lengths[15:] = 0.0
    track = SequenceFilter(MotionModel.learn(corridor()), 0.1).run(seen, ["a"] * len(place), motion=ahead(lengths))
    assert np.abs(track.frame - place)[18:].max() <= 1


def test_unknown_motion_is_as_none() -> None:
    motion, distances = MotionModel.learn(corridor()), ambiguous(np.r_[0:20], np.random.default_rng(1))
    plain = SequenceFilter(motion, 0.2).run(distances, ["a"] * 20, 1.0)
    found = SequenceFilter(motion, 0.2).run(distances, ["a"] * 20, 1.0, np.full((20, 3), np.nan))
    for name in ("frame", "probability", "spread", "xy"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))


def test_a_map_of_one_frame() -> None:
    known = VisualMap([[1.0]], placed([[2, 3]]))
    motion = MotionModel.learn(known.frames)
    track = SequenceFilter(motion, temperature_of_map(known)).run([[0.3], [7.0]], ["a", "a"])
    assert track.frame.tolist() == [0, 0]
    assert track.probability.tolist() == [1, 1]
    assert track.spread.tolist() == [0, 0]


def test_the_temperature_is_the_likeliest_one() -> None:
    rng = np.random.default_rng(2)
    distances = rng.uniform(0, 1, (400, 8))
    weight = np.exp(-distances / 0.3)
    draw = (rng.random((400, 1)) < np.cumsum(weight / weight.sum(axis=1, keepdims=True), axis=1)).argmax(axis=1)
    learned = learn_temperature(distances, draw)

    def log_likelihood(temperature: float) -> float:
        weight = np.exp(-distances / temperature)
        return float(np.log(weight[np.arange(400), draw] / weight.sum(axis=1)).sum())

    assert log_likelihood(learned) >= max(log_likelihood(learned * factor) for factor in (0.97, 1.03))
    assert 0.2 < learned < 0.45
    # Fully informative distances make it cold, uninformative ones hot; neither makes it infinite.
    certain = learn_temperature([[0.0, 1.0]] * 3, np.zeros(3, dtype=int))
    useless = learn_temperature([[0.0, 1.0]] * 3, np.ones(3, dtype=int))
    assert 0 < certain < 0.1 < 10 < useless < math.inf


def test_the_temperature_of_a_map_leaves_each_frame_out() -> None:
    rng = np.random.default_rng(3)
    table = corridor(40)
    known = VisualMap(table.xy + 0.2 * rng.normal(size=(40, 2)), table)
    apart, away = frame_distances(known, known.description), np.abs(np.subtract.outer(table.x, table.x))
    apart[np.eye(40, dtype=bool)] = away[np.eye(40, dtype=bool)] = np.inf
    assert temperature_of_map(known) == pytest.approx(learn_temperature(apart, away.argmin(axis=1)))


def test_tuning_finds_settings_that_suit_the_validation_sequence() -> None:
    place = np.arange(60)
    motion, distances = MotionModel.learn(corridor()), ambiguous(place, np.random.default_rng(5))
    truth, names = motion.xy[place], np.zeros(60)
    tried = tune_filter(motion, distances, truth, names, 1e-3, softer=(1, 100), kidnapping=(0.5, 1e-4))
    assert len(tried) == 4
    assert [settings.error for settings in tried] == sorted(settings.error for settings in tried)
    assert (tried[0].temperature, tried[0].kidnapping) == (0.1, 1e-4)
    best = SequenceFilter(motion, 0.1, 1e-4).run(distances, names)
    assert tried[0].error == pytest.approx(np.hypot(*(motion.xy[best.frame] - truth).T).mean())
    truth[::2] = math.nan
    known = tune_filter(motion, distances, truth, names, 0.1, softer=(1,), kidnapping=(1e-4,))[0]
    assert known.error == pytest.approx(np.hypot(*(motion.xy[best.frame] - truth)[1::2].T).mean())


def test_errors() -> None:
    known, one = corridor(4), [np.zeros((1, 4))]
    motion, gap = MotionModel.learn(known), known.with_columns(x=[0, 1, math.nan, 2])
    for call, error, says in (
        (lambda: MotionModel.learn(known, step=0), ConfigError, "step must be a number above 0, or null, got 0"),
        (lambda: MotionModel.learn(known, interval=math.nan), ConfigError, "interval must be a number .*, got nan"),
        (lambda: MotionModel.learn(gap), DataError, "1 of the 4 map frames have no position"),
        (lambda: MotionModel.learn(known.take([])), DataError, "0 of the 0 map frames"),
        (lambda: SequenceFilter(motion, 0), ConfigError, "temperature must be a number above 0, got 0"),
        (lambda: SequenceFilter(motion, 1, 0), ConfigError, "kidnapping must be a number between 0 and 1, got 0"),
        (lambda: SequenceFilter(motion, 1).run([[0.0, 1, 2]], ["a"]), DataError, r"shape \(1, 4\), got \(1, 3\)"),
        (lambda: temperature_of_map(VisualMap(np.eye(4), gap)), DataError, "which a temperature needs"),
        (lambda: tune_filter(motion, *one, [[0, 0]], ["a"], 1, softer=()), ConfigError, "at least one factor"),
        (lambda: tune_filter(motion, *one, [[0, math.nan]], ["a"], 1), DataError, "true positions"),
    ):
        with pytest.raises(error, match=says):
            call()
    for wrong in ([0.0, 1, 2, math.nan], [0.0, 1, 2, -math.inf], [math.inf] * 4, [0.0, 1, 2]):
        with pytest.raises(DataError, match="a query needs 4 distances to the map"):
            SequenceFilter(motion, 1).step(wrong)
    assert SequenceFilter(motion, 1).step([0.0, 1, 2, math.inf])[3] == 0
