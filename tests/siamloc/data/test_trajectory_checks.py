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


def test_a_robot_that_stands_still_is_not_doubted():
    still = Trajectory.planar(np.arange(50.0), np.zeros((50, 3)), "still.txt")
    assert doubts(still) == []
