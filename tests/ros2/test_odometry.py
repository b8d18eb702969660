"""The history of a robot's odometry, without ROS."""

import math
from collections import deque

import numpy as np
import pytest

from siamloc.errors import DataError

STILL = np.zeros(3)


def test_the_pose_between_two_messages(odometry):
    history = odometry.OdometryHistory(0.6)
    assert np.isnan(history.at(1.5)).all()
    history.add(1.0, [0, 0, 3.0], STILL)  # turns left, across +-pi
    history.add(2.0, [1, 2, -3.0], STILL)
    at = history.at(1.5)
    np.testing.assert_allclose(at[:2], [0.5, 1.0])
    assert math.cos(at[2] - math.pi) == pytest.approx(1)


def test_beyond_the_newest_message_the_velocity_counts_within_the_gap(odometry):
    history = odometry.OdometryHistory(0.2)
    history.add(1.0, [0, 0, 0], [1, 0, 0])
    history.add(2.0, [1, 2, math.pi / 2], [1.0, 0.5, 0])
    np.testing.assert_allclose(history.at(2.1), [0.95, 2.1, math.pi / 2])
    np.testing.assert_allclose(history.at(0.9), [-0.1, 0, 0], atol=1e-12)
    assert np.isnan(history.at(2.3)).all()
    history.add(3.0, [0, 0, 0], [1.0, 0, 2.0])  # an arc with a radius of 0.5 m
    arc = [0.5 * math.sin(0.2), 0.5 * (1 - math.cos(0.2)), 0.2]
    np.testing.assert_allclose(history.at(3.1), arc, atol=2e-4)  # its chord is shorter by a share of 0.2^2 / 24


def test_what_is_at_fault_names_how_far_the_stamps_are_apart(odometry):
    history = odometry.OdometryHistory(0.2)
    assert history.fault(5.0) == "no odometry has arrived"
    assert math.isnan(history.age(5.0))
    history.add(4.1, STILL, STILL)
    text = "the stamps of the image and of the nearest odometry are 0.90 s apart, more than odometry_gap (0.2 s)"
    assert (history.fault(5.0), history.fault(4.2)) == (text, "")
    assert history.age(5.0) == pytest.approx(0.9)
    assert "1000.00 s apart" in history.fault(1004.1)


def test_a_late_message_is_dropped_and_a_clock_that_begins_again_forgets_the_others(odometry):
    history = odometry.OdometryHistory(0.2)
    for time in (10.0, 11.0):
        history.add(time, STILL, STILL)
    for late in (11.0, 10.5):
        with pytest.raises(DataError, match="is not after"):
            history.add(late, STILL, STILL)
    assert len(history) == 2
    history.add(3.0, STILL, STILL)
    assert (len(history), history.age(3.0)) == (1, 0)


def test_the_history_is_locked_while_it_is_read(odometry):
    history, locked = odometry.OdometryHistory(0.2), []

    class Watched(deque):
        def __iter__(self):
            locked.append(history._lock.locked())
            return super().__iter__()

    history.add(1.0, STILL, STILL)
    history._kept = Watched(history._kept)
    assert np.isfinite(history.at(1.0)).all()
    assert history.fault(1.0) == ""
    assert history.age(1.0) == 0
    assert locked == [True] * 3
    assert not history._lock.locked()
