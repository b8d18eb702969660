"""Following refined poses: a robot that drives on, answers that are wrong once or say nothing, and one carried away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data.moves import moves
from siamloc.errors import ConfigError, DataError
from siamloc.maps import PoseFilter, RefinedPoses
from siamloc.maps.motion import MotionCheck
from siamloc.simulate.odometry import odometry

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


def test_no_number_of_poses_lessens_the_variance_of_the_map():
    xy, names = drive(), ["a"] * 60
    poses = told(xy)
    surveyed = replace(poses, map_variance=np.linspace(0.01, 0.04, 60))
    poses.xy[30] = surveyed.xy[30] = 9.0  # a stray pose says nothing about where the robot is on the map
    plain, found = (PoseFilter(STEP).run(one, names) for one in (poses, surveyed))
    np.testing.assert_array_equal(found.xy, plain.xy)
    added = found.covariance() - plain.covariance()
    expected = surveyed.map_variance.copy()
    expected[30] = expected[29]
    np.testing.assert_allclose(added, expected[:, None, None] * np.eye(2), atol=1e-12)


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


def around(count: int = 400) -> np.ndarray:
    """Poses (count, 3) of a drive that turns left and right by a right angle, again and again."""
    at = np.arange(count)
    heading = np.cumsum(np.where(at % 60 < 12, np.pi / 24, 0.0) * np.where(at // 60 % 2, 1, -1))
    xy = np.cumsum(STEP * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.column_stack([xy, heading])


def seen(poses: np.ndarray, seed: int, wrong: np.ndarray | None = None) -> RefinedPoses:
    """Refined poses of true ones (n, 3); half of the wrong ones are dark, the others are of places far away."""
    rng = np.random.default_rng(seed)
    found = told(poses[:, :2], seed)
    found.theta[:] = poses[:, 2] + np.radians(3) * rng.standard_normal(len(poses))
    if wrong is not None:
        dark = wrong & (rng.random(len(poses)) < 0.5)
        found.information[dark], found.theta[dark] = 0, np.nan
        found.xy[wrong] = rng.uniform(-20, 20, (int(wrong.sum()), 2))
        found.theta[wrong & ~dark] = rng.uniform(-3, 3, int((wrong & ~dark).sum()))
        found.agreement[wrong] = rng.uniform(0.3, 0.9, int(wrong.sum()))
    return found


def wheels(poses: np.ndarray, seed: int = 0) -> np.ndarray:
    """Moves (n, 3) as the wheels of a simulated robot report them."""
    return moves(odometry(poses, np.random.default_rng(seed)))


def turned_away(found: RefinedPoses, poses: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs(np.angle(np.exp(1j * (found.theta - poses[:, 2])))))


@pytest.mark.parametrize("together", [1, 10])
def test_with_odometry_pictures_that_are_foreign_or_dark_do_little_harm(together):
    """One picture in four, alone or ten after one another."""
    poses, with_wheels, without = around(), [], []
    for seed in range(5):
        wrong = np.repeat(np.random.default_rng(seed).random(400 // together) < 0.25, together)
        wrong[:5] = False
        given, names = seen(poses, seed, wrong), ["a"] * 400
        with_wheels.append(errors(PoseFilter(STEP).run(given, names, wheels(poses, seed)), poses[:, :2]))
        without.append(errors(PoseFilter(STEP).run(given, names), poses[:, :2]))
    assert np.percentile(with_wheels, 95) < 0.5 * np.percentile(without, 95)
    assert np.percentile(with_wheels, 95) < 0.12


def test_with_odometry_the_heading_is_filtered_too():
    poses = around()
    given = seen(poses, 0)
    found = PoseFilter(STEP).run(given, ["a"] * 400, wheels(poses))
    assert turned_away(found, poses).mean() < 0.6 * turned_away(given, poses).mean()
    assert np.abs(found.theta).max() <= np.pi
    assert found.inside(poses[:, :2]).mean() > 0.85


def test_a_robot_that_stands_still_is_no_surer_than_one_picture_makes_it():
    poses = around(300)
    given = seen(poses, 0)
    inside = []
    for row in range(20, 300, 10):
        order = [*range(row - 20, row), *[row] * 100]
        motion = np.concatenate([moves(poses)[row - 20 : row + 1], np.zeros((99, 3))])
        found = PoseFilter(STEP).run(given.take(order), ["a"] * 120, motion)
        inside.append(found.take([119]).inside(poses[[row], :2])[0])
    assert np.mean(inside) > 0.85


def test_with_odometry_a_robot_that_was_carried_away_is_found_within_three_pictures():
    poses = around()
    away = poses.copy()
    away[200:] = np.column_stack([50 - poses[200:, 1], poses[200:, 0], poses[200:, 2] + np.pi / 2])
    for seed in range(5):
        found = PoseFilter(STEP).run(seen(away, seed), ["a"] * 400, wheels(poses, seed))
        off = errors(found, away[:, :2])
        assert max(off[:200].max(), off[202:].max()) < 0.3
        assert turned_away(found, away)[202:].max() < 15


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("agreement", [0.03, 0.2, 0.4])
@pytest.mark.parametrize("count", [1, 15])
def test_pictures_of_nothing_at_the_start_do_not_hide_where_the_robot_is(count, agreement, known):
    xy = drive(count + 4)
    poses = told(xy)
    poses.xy[:count] += np.random.default_rng(0).uniform(5, 20, (count, 2))
    poses.agreement[:count] = agreement
    motion = moves(np.column_stack([xy, np.zeros(len(xy))])) if known else None
    found = PoseFilter(STEP).run(poses, ["a"] * len(xy), motion)
    assert errors(found, xy)[count:].max() < 0.25
    assert found.agreement[count] > 0.9, "the first recognized picture is believed at once"


def test_stray_poses_before_do_not_hide_where_a_robot_was_carried():
    """Each stray pose is somewhere else, and all are as unlikely: they must not keep the right one out."""
    poses = around()[:120]
    carried = poses.copy()
    carried[60:, 0] += 30.0
    given = seen(carried, 0)
    for place, row in enumerate(range(54, 60)):
        given.xy[row] = [40.0 + 5 * place, 30.0 - 4 * place]
        given.information[row] = np.eye(2) / 9.0
        given.agreement[row] = 0.05
    motion = moves(poses)
    found = PoseFilter(STEP).run(given, ["a"] * len(poses), motion)
    assert errors(found, carried[:, :2])[62:].max() < 0.3


@pytest.mark.parametrize("count", [12, 40])
def test_a_robot_that_was_carried_with_its_camera_running_is_found_again(count):
    """Its wheels stand still for many pictures, each of which begins a story that the next picture does not confirm."""
    poses = around(200)
    motion = moves(poses)
    motion[100 : 100 + count] = 0.0
    found = PoseFilter(STEP).run(seen(poses, 0), ["a"] * len(poses), motion)
    assert errors(found, poses[:, :2])[103 + count :].max() < 0.3


@pytest.mark.parametrize(
    "factors",
    [[0, 0, 0], [2, 2, 1], [100, 100, 1], [1, -1, -1]],
    ids=["stuck", "doubled", "another unit", "mirrored"],
)
@pytest.mark.parametrize(("strays", "agree"), [(0.25, 0.5), (0.5, 1.0)], ids=["other buildings", "mistaken places"])
def test_motions_that_the_pictures_contradict_are_not_used(factors, strays, agree, monkeypatch):
    monkeypatch.setattr(MotionCheck, "step", lambda *_: None)  # it refuses another unit, but only later
    poses, wrong = around(), np.random.default_rng(0).random(400) < strays
    given = seen(poses, 0, wrong)
    given.agreement[wrong] *= agree
    motion = wheels(poses)
    motion[:200] *= factors
    without, found, right = (
        errors(PoseFilter(STEP).run(given, ["a"] * 400, moved), poses[:, :2]) for moved in (None, motion, wheels(poses))
    )
    assert found[20:200].mean() < 2 * without[20:200].mean()
    np.testing.assert_allclose(found[220:], right[220:], atol=0.01, err_msg="they are used again")


def test_where_nothing_is_recognized_odometry_leads_on_with_growing_doubt():
    poses = around(100)
    given = seen(poses, 0)
    given.information[40:] = 0
    given.xy[40:], given.theta[40:] = np.nan, np.nan
    found = PoseFilter(STEP).run(given, ["a"] * 100, wheels(poses))
    doubt = np.linalg.det(found.covariance())[39:]
    assert (np.diff(doubt) > 0).all()
    travelled = STEP * np.arange(1, 61)
    assert (errors(found, poses[:, :2])[40:] < 0.1 + 0.1 * travelled).all()
    assert turned_away(found, poses)[40:].max() < 15
    assert found.inside(poses[:, :2])[40:].mean() > 0.8
    assert set(found.frame[40:].tolist()) == {39}


def test_after_many_pictures_of_nothing_the_heading_is_that_of_the_position():
    poses = around(61)
    given = seen(poses, 0)
    given.information[20:-1] = 0
    given.xy[20:-1], given.theta[20:-1], given.theta[-1] = np.nan, np.nan, 2.5
    found = PoseFilter(STEP).run(given, ["a"] * 61)
    np.testing.assert_allclose(found.xy[-1], given.xy[-1], atol=0.05)
    assert (found.theta[-1], found.frame[-1]) == (2.5, 60)


def test_a_covariance_of_the_motion_says_how_much_it_counts():
    poses = around(60)
    given, move = seen(poses, 0), moves(poses)
    spreads = {}
    for size in (1e-4, 1.0):
        robot = PoseFilter(STEP)
        found = [robot.step(given.take([row]), move[row], size**2 * np.eye(3)) for row in range(60)]
        spreads[size] = np.linalg.det(found[-1].covariance()[0])
        if size == 1.0:
            np.testing.assert_allclose(found[-1].xy, given.xy[[-1]], atol=0.01)
    assert spreads[1e-4] < 0.1 * spreads[1.0]


def test_unknown_motion_is_as_none():
    xy = drive()
    poses = told(xy)
    plain = PoseFilter(STEP).run(poses, ["a"] * 60)
    unknown = np.full((60, 3), np.nan)
    unknown[:, 0] = STEP
    for motion in (np.full((60, 3), np.nan), unknown):
        found = PoseFilter(STEP).run(poses, ["a"] * 60, motion)
        for name in ("xy", "theta", "information", "agreement", "frame"):
            np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))


def test_odometry_that_comes_and_goes():
    poses = around()
    motion = wheels(poses)
    motion[np.arange(400) % 40 < 10] = np.nan
    found = PoseFilter(STEP).run(seen(poses, 0), ["a"] * 400, motion)
    assert errors(found, poses[:, :2]).max() < 0.25
    assert turned_away(found, poses).max() < 20


def test_a_robot_whose_headings_are_unknown_is_still_tracked_by_its_wheels():
    poses = around()
    given = seen(poses, 0)
    given.theta[:] = np.nan
    found = PoseFilter(STEP).run(given, ["a"] * 400, wheels(poses))
    assert errors(found, poses[:, :2]).max() < 0.3
    assert np.isnan(found.theta[0])
    assert turned_away(found, poses)[50:].max() < 15, "how it moves shows where it looks"


@pytest.mark.parametrize("wheeled", [True, False])
def test_the_axes_do_not_matter(wheeled):
    poses, turn = around(60), 0.9
    given, motion = seen(poses, 0), wheels(poses) if wheeled else None
    given.information[:] = np.diag([400.0, 100.0])
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    about = axes @ given.information @ axes.T
    turned = replace(given, xy=given.xy @ axes.T + 5, theta=given.theta + turn, information=about)
    found, other = (PoseFilter(STEP).run(one, ["a"] * 60, motion) for one in (given, turned))
    np.testing.assert_allclose(other.xy, found.xy @ axes.T + 5, atol=1e-8)
    np.testing.assert_allclose(np.exp(1j * other.theta), np.exp(1j * (found.theta + turn)), atol=1e-8)


@pytest.mark.parametrize(
    ("motion", "covariance", "says"),
    [
        ([1.0, 2.0], None, "a motion is the distance ahead, the distance to the left and the turn .* three numbers"),
        ([1.0, np.inf, 0.0], None, "a motion is the distance ahead"),
        ([1e155, 0.0, 0.0], None, "three numbers up to 10 million"),
        (["a", "b", "c"], None, "a motion is the distance ahead"),
        ([1.0, 0.0, 30.0], None, "the turn of a motion is in rad, at most one full turn, got 30"),
        ([1.0, 0.0, 0.0], np.eye(2), "the covariance of a motion is a symmetric matrix"),
        ([1.0, 0.0, 0.0], -np.eye(3), "the covariance of a motion is a symmetric matrix"),
        ([1.0, 0.0, 0.0], np.full((3, 3), np.nan), "the covariance of a motion is a symmetric matrix"),
    ],
)
def test_bad_motion_is_refused(motion, covariance, says):
    with pytest.raises(DataError, match=says):
        PoseFilter(STEP).step(told(drive(1)), motion, covariance)
    with pytest.raises(DataError, match=r"2 queries need as many motions .* of shape \(2, 3\), got \(1, 3\)"):
        PoseFilter(STEP).run(told(drive(2)), ["a"] * 2, [[0.0, 0.0, 0.0]])
