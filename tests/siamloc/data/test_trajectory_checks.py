from __future__ import annotations

import numpy as np
import pytest

from siamloc.data.trajectory import Trajectory, read_trajectory
from siamloc.data.trajectory_checks import doubts


def straight(heading: float = 0.02, factor: float = 1.0) -> Trajectory:
    """A robot that drives 10 m in 20 s along its heading, and sways a little."""
    time = np.linspace(0, 20, 101)
    sway = heading + 0.02 * np.sin(time)
    poses = np.column_stack([0.5 * time * np.cos(heading), 0.5 * time * np.sin(heading), sway])
    return Trajectory.planar(time * factor, poses, "drive.txt")


def test_nothing_is_said_about_trajectories_as_they_should_be():
    for heading in (0.02, 1.5, 3.1):
        assert doubts(straight(heading)) == []


@pytest.mark.parametrize("heading", [0.0, np.pi])
def test_quaternions_in_the_other_order_are_doubted_although_they_stay_upright(tmp_path, heading):
    right = straight(heading)
    file = tmp_path / "drive.txt"
    np.savetxt(file, np.column_stack([right.time, right.position, right.quaternion[:, [3, 0, 1, 2]]]))
    (said,) = doubts(read_trajectory(file))
    assert "with the quaternions in the other order: if w stands first give order=wxyz" in said
    assert doubts(read_trajectory(file, order="wxyz")) == []
    file.write_text(f"# time x y z qx qy qz qw\n{file.read_text()}")
    assert doubts(read_trajectory(file)) == [], "the file says the order"


def test_quaternions_with_w_last_in_a_file_that_should_have_it_first_are_doubted(tmp_path):
    right = straight(0.0)
    file = tmp_path / "data.csv"
    np.savetxt(file, np.column_stack([right.time, right.position, right.quaternion]), delimiter=",")
    (said,) = doubts(read_trajectory(file))
    assert "drives backwards all the time" in said


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_in_another_unit_are_doubted(factor, unit):
    (said,) = doubts(straight(factor=factor))
    assert f"the robot drives 10 m in {20 * factor:.0f} s: if they count {unit}, divide them by {factor:.0f}" in said


@pytest.mark.parametrize("lands", [1, -1])
def test_poses_of_a_camera_that_never_turns_are_doubted_as_those_of_a_robot(lands):
    """The camera looks along x of the world, or against it: its z is no direction upwards."""
    along = straight(0.0)
    ahead = np.tile([-0.5, 0.5, -0.5, 0.5], (101, 1))
    camera = Trajectory.of(along.time, lands * along.position, ahead, "drive.txt")
    (said,) = doubts(camera)
    assert said.endswith(
        "rises or sinks by 10 m, and goes 0 m on the level: if these are the poses of a camera, give axes=camera"
    )
    if lands == 1:
        assert doubts(camera, "camera") == []


def test_y_points_down_in_the_world_of_a_camera():
    """As in KITTI's poses, and in those of most programs, whose world is the first picture's frame."""
    along = straight(0.0)
    forward = np.column_stack([0 * along.time, 0 * along.time, along.position[:, 0]])
    assert doubts(Trajectory.of(along.time, forward, np.tile([0.0, 0, 0, 1], (101, 1)), "kitti.txt"), "camera") == []


def test_nothing_is_said_about_a_single_pose():
    assert doubts(Trajectory.planar(np.zeros(1), np.zeros((1, 3)), "one.txt")) == []


def test_a_robot_that_stands_still_is_not_doubted():
    still = Trajectory.planar(np.arange(50.0), np.zeros((50, 3)), "still.txt")
    assert doubts(still) == []


def test_a_robot_that_does_not_stay_upright_is_not_taken_for_a_camera():
    """It is refused, with the reason: here quaternions in the other order, by which the robot seems to rise."""
    time = np.linspace(0, 20, 101)
    right = Trajectory.planar(time, np.column_stack([time, time, time / 5]), "drive.txt")
    assert doubts(Trajectory(time, right.position, right.quaternion[:, [3, 0, 1, 2]], "drive.txt")) == []
