"""Following refined poses: a robot that drives on, answers that are wrong once or say nothing, and one carried away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.errors import ConfigError, DataError
from siamloc.maps import PoseFilter, RefinedPoses

STEP, SD = 0.2, 0.05


def drive(count: int = 60) -> np.ndarray:
    along = np.linspace(0, 1, count)
    return STEP * count * np.stack([along, 0.2 * np.sin(4 * along)], axis=1)


def told(xy: np.ndarray, seed: int = 0, agreement: float = 0.95) -> RefinedPoses:
    """Poses as the refinement gives them for true positions (n, 2), with the errors they claim."""
    rng = np.random.default_rng(seed)
    n = len(xy)
    about = np.tile(np.eye(2) / SD**2, (n, 1, 1))
    agreements, match = np.full(n, agreement), np.full(n, 9.0)
    return RefinedPoses(xy + SD * rng.standard_normal((n, 2)), np.zeros(n), about, agreements, np.arange(n), match)


def errors(found: RefinedPoses, xy: np.ndarray) -> np.ndarray:
    return np.hypot(*(found.xy - xy).T)


def test_a_robot_that_drives_on_is_located_better_than_from_single_poses():
    xy = drive()
    single, found = [], []
    for seed in range(5):
        poses = told(xy, seed)
        single.append(errors(poses, xy))
        found.append(errors(PoseFilter(STEP).run(poses, ["a"] * len(xy)), xy))
    assert np.mean(found) < 0.9 * np.mean(single)


@pytest.mark.parametrize("agreement", [0.3, 0.95])
def test_a_single_wrong_pose_is_passed_over(agreement):
    xy = drive()
    poses = told(xy, agreement=agreement)
    poses.xy[30] += [3.0, -2.0]
    poses.theta[30] = 2.0
    found = PoseFilter(STEP).run(poses, ["a"] * len(xy))
    assert errors(found, xy).max() < 0.25
    assert found.agreement[30] < 0.05
    assert (found.theta[30], found.frame[30]) == (0, 29), "the wrong pose gives no heading either"
    assert found.frame[31] == 31
    assert np.linalg.det(found.information[30]) < np.linalg.det(found.information[29]), "it is less sure there"


@pytest.mark.parametrize(("strange", "value"), [("xy", np.nan), ("information", np.nan), ("information", 0)])
def test_a_pose_that_is_no_number_or_tells_nothing_moves_the_robot_on(strange, value):
    xy = drive()
    poses = told(xy)
    getattr(poses, strange)[30] = value
    poses.xy[30] += 99.0
    found = PoseFilter(STEP).run(poses, ["a"] * len(xy))
    assert errors(found, xy).max() < 0.25
    first = PoseFilter(STEP).step(poses.take([30]))
    np.testing.assert_array_equal(first.xy, poses.xy[[30]])


def test_a_robot_that_was_carried_away_is_found_again():
    xy = drive()
    xy[30:] += [50.0, 7.0]
    found = PoseFilter(STEP).run(told(xy), ["a"] * len(xy))
    off = errors(found, xy)
    assert off[:30].max() < 0.2
    assert off[33:].max() < 0.2, "within three queries"


def test_each_sequence_begins_anew():
    xy = drive()
    poses = told(xy)
    whole = PoseFilter(STEP).run(poses, ["a"] * 30 + ["b"] * 30)
    halves = [PoseFilter(STEP).run(poses.take(rows), ["x"] * 30) for rows in (np.arange(30), np.arange(30, 60))]
    np.testing.assert_array_equal(whole.xy, RefinedPoses.concatenate(halves).xy)


def test_the_axes_do_not_matter():
    xy = drive()
    poses = told(xy)
    poses.information[:] = np.diag([400.0, 100.0])
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    turned = replace(poses, xy=poses.xy @ turn.T + 5, information=turn @ poses.information @ turn.T)
    found = PoseFilter(STEP).run(poses, ["a"] * 60)
    np.testing.assert_allclose(PoseFilter(STEP).run(turned, ["a"] * 60).xy, found.xy @ turn.T + 5, atol=1e-8)


def test_bad_input_is_refused():
    for step in (0, -1, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="step must be a number"):
            PoseFilter(step)
    with pytest.raises(ConfigError, match="kidnapping must be a number between 0 and 1"):
        PoseFilter(1.0, 0)
    with pytest.raises(DataError, match="pose of one query, got 2"):
        PoseFilter(1.0).step(told(drive(2)))
    with pytest.raises(DataError, match="as many names"):
        PoseFilter(1.0).run(told(drive(2)), ["a"])
    none = told(np.zeros((0, 2)))
    assert len(PoseFilter(1.0).run(none, [])) == 0
