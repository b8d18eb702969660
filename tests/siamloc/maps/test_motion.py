from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.data.moves import chained, moves
from siamloc.errors import DataError
from siamloc.maps import MotionModel, PoseFilter, RefinedPoses, SequenceFilter, motions
from siamloc.maps.motion import WrongUnitError


def test_each_drive_has_moves_of_its_own():
    rng = np.random.default_rng(0)
    x, y, theta = rng.normal(size=(3, 8))
    names = np.array(["a", "b"] * 4)
    frames = FrameTable(path=np.arange(8).astype(str), sequence=names, odom_x=x, odom_y=y, odom_theta=theta)
    found = motions(frames)
    for name in ("a", "b"):
        np.testing.assert_array_equal(found[names == name], moves(frames.odometry[names == name]))
    assert np.isnan(found).any(axis=1).tolist() == [True] * 2 + [False] * 6


def test_where_odometry_is_unknown_so_is_the_motion():
    assert np.isnan(motions(FrameTable(path=["a", "b"]))).all()
    assert motions(FrameTable(path=[])).shape == (0, 3)
    frames = FrameTable(path=list("abcd"), odom_x=[0, 1, 2, 3], odom_y=[0] * 4, odom_theta=[0, np.nan, 0, 0])
    assert np.isnan(motions(frames)).all(axis=1).tolist() == [True, True, True, False]


def test_odometry_in_degrees_is_refused():
    angle = np.arange(0, 720, 30.0)
    at = {"odom_x": np.cumsum(np.cos(np.radians(angle))), "odom_y": np.cumsum(np.sin(np.radians(angle)))}
    frames = FrameTable(path=np.arange(len(angle)).astype(str), odom_theta=angle, **at)
    with pytest.raises(DataError, match="tracked by its odometry: odom_theta looks like degrees"):
        motions(frames)


def along(places, moved, recognized=None, tracked_by="poses", heading=None):
    """Track a robot whose images show places (n, 2) and headings (n,), and whose odometry shows poses (n, 3)."""
    motion, names = moves(moved), np.full(len(places), "drive")
    if tracked_by == "frames":
        x, y, _ = circle().T
        frames = FrameTable(path=np.arange(len(x)).astype(str), x=x, y=y)
        apart = np.linalg.norm(places[:, None] - frames.xy, axis=2)
        return SequenceFilter(MotionModel.learn(frames, step=0.3), 0.2).run(apart, names, motion=motion)
    sure = np.ones(len(places)) if recognized is None else recognized
    information = np.tile(100 * np.eye(2), (len(places), 1, 1))
    theta = np.full(len(places), np.nan) if heading is None else heading
    poses = RefinedPoses(places, theta, information, sure, np.zeros(len(places), int), 9 * sure)
    return PoseFilter(0.3).run(poses, names, motion)


def circle(count=60):
    """Return the poses of a robot that drives around a circle of 6 m (n, 3)."""
    angle = 0.1 * np.arange(count)
    return np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), angle + np.pi / 2])


@pytest.mark.parametrize("tracked_by", ["poses", "frames"])
@pytest.mark.parametrize("factor", [1000, 100, 0.05, 1.0, 0.8])
def test_motions_in_another_unit_than_the_map_are_refused(tracked_by, factor):
    poses = circle()
    places = poses[:, :2] + np.random.default_rng(0).normal(size=(60, 2)) * 0.05
    wrong = not 1 / 3 < factor < 3
    said = "the odometry of the robot moves .* times as far as its images show: give it in the unit of the map's"
    with pytest.raises(WrongUnitError, match=said) if wrong else nullcontext():
        along(places, poses * [factor, factor, 1], tracked_by=tracked_by)


@pytest.mark.parametrize("tracked_by", ["poses", "frames"])
def test_a_robot_that_slips_stands_or_is_lost_is_not_said_to_have_another_unit(tracked_by):
    poses, rng = circle(), np.random.default_rng(1)
    noise = rng.normal(size=(60, 2)) * 0.05
    still = np.zeros((60, 2)) + noise
    lost = rng.uniform(-5, 5, (60, 2))
    kidnapped = poses[:, :2] + noise + np.where(np.arange(60)[:, None] < 12, -2.0, 2.0)
    for places, moved in ((still, poses), (still, poses * 0), (lost, poses), (lost, poses * 0), (kidnapped, poses)):
        along(places, moved, tracked_by=tracked_by)


def test_few_recognized_images_say_nothing_about_the_unit_of_motions():
    poses = circle()
    along(poses[:, :2], poses * [1000, 1000, 1], np.where(np.arange(60) % 6 == 0, 1.0, 0.2))


@pytest.mark.parametrize("factors", [[1, -1, -1], [1, 1, -1], [1, 1, 1], [0, 0, 0]])
@pytest.mark.parametrize("straight_first", [True, False])
def test_motions_that_turn_the_other_way_are_refused(factors, straight_first):
    poses, rng = circle(), np.random.default_rng(0)
    if straight_first:
        ahead = poses[0] + np.outer(np.arange(-40, 0), [0, 0.3, 0])
        poses = np.concatenate([ahead, poses])
    heading = poses[:, 2] + rng.normal(size=len(poses)) * 0.05
    foreign = rng.random(len(poses)) < 0.25
    heading[foreign] = rng.uniform(-3, 3, foreign.sum())
    moved = chained(moves(poses) * factors)
    said = "the odometry of the robot turns left where its images turn right: .*; give headings with the other sign"
    with pytest.raises(WrongUnitError, match=said) if factors[2] < 0 else nullcontext():
        along(poses[:, :2] + rng.normal(size=(len(poses), 2)) * 0.05, moved, heading=heading)
