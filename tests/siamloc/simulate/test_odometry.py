"""Odometry: exact without errors, and as far off as stated with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.simulate.odometry import WheelErrors, odometry

NONE = WheelErrors(scale=0, bias=0, distance=0, turn=0, slips=0)
DRIVES = 400


def curve(n: int = 200) -> np.ndarray:
    """A winding drive of 15 cm steps that also turns in place and drives back."""
    heading = np.cumsum(np.where(np.arange(n) % 50 < 10, 0.3, 0.02))
    step = np.where(np.arange(n) % 40 == 5, 0.0, np.where(np.arange(n) % 40 < 5, -0.15, 0.15))
    xy = np.cumsum(step[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return np.column_stack([xy, heading])


def straight(metres: float, step: float = 0.15) -> np.ndarray:
    along = np.arange(0, metres + step / 2, step)
    return np.column_stack([along, np.zeros((len(along), 2))])


def ends(errors: WheelErrors, metres: float, step: float = 0.15) -> np.ndarray:
    """Last poses (DRIVES, 3) of as many drives straight ahead."""
    poses = straight(metres, step)
    return np.array([odometry(poses, np.random.default_rng(seed), errors)[-1] for seed in range(DRIVES)])


def test_without_errors_it_is_the_drive_seen_from_its_first_pose():
    poses = curve()
    found = odometry(poses, np.random.default_rng(0), NONE)
    assert found[0].tolist() == [0, 0, 0]
    x, y, start = poses[0]
    back = np.array([[np.cos(start), np.sin(start)], [-np.sin(start), np.cos(start)]])
    np.testing.assert_allclose(found[:, :2], (poses[:, :2] - [x, y]) @ back.T, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * found[:, 2]), np.exp(1j * (poses[:, 2] - start)))
    assert np.abs(found[:, 2]).max() <= np.pi


def test_the_same_generator_gives_the_same_errors():
    first, again, other = (odometry(curve(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    assert first[0].tolist() == [0, 0, 0]


@pytest.mark.parametrize("metres", [6.0, 24.0])
def test_each_error_grows_as_stated(metres):
    scaled = ends(replace(NONE, scale=0.02), metres)
    assert scaled[:, 0].std() == pytest.approx(0.02 * metres, rel=0.15)
    assert np.abs(scaled[:, 1:]).max() == 0
    assert ends(replace(NONE, bias=0.01), metres)[:, 2].std() == pytest.approx(0.01 * metres, rel=0.15)
    for step in (0.15, 0.3):
        turned = ends(replace(NONE, turn=0.01), metres, step)[:, 2].std()
        assert turned == pytest.approx(0.01 * np.sqrt(metres), rel=0.15), "whatever the distance of the frames"
        wide = ends(replace(NONE, distance=0.05), metres, step)[:, 0].std()
        assert wide == pytest.approx(0.05 * step * np.sqrt(metres / step), rel=0.15)


def test_wheels_slip_about_once_in_so_many_metres():
    poses, lost, turned = straight(30), [], []
    for seed in range(DRIVES):
        found = odometry(poses, np.random.default_rng(seed), replace(NONE, slips=1 / 10))
        gone = np.hypot(*np.diff(found[:, :2], axis=0).T) / 0.15
        lost += (1 - gone[gone < 0.999]).tolist()
        angle = np.abs(np.diff(found[:, 2]))
        turned += np.degrees(angle[angle > 1e-9]).tolist()
    assert (len(lost) + len(turned)) / DRIVES == pytest.approx(3, rel=0.1)
    assert len(lost) == pytest.approx(len(turned), rel=0.2)
    assert 0.1 <= min(lost) < 0.12 < 0.48 < max(lost) <= 0.5
    assert 1 <= min(turned) < 1.2 < 4.8 < max(turned) <= 5.01
