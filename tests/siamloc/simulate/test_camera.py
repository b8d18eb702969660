"""Cameras of the training images, against the formulas of their lenses, pixel by pixel."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest

from siamloc.data.panorama import PanoramaView
from siamloc.simulate.camera import HEIGHT, Cameras, draw_camera, fisheye, panorama, photograph

SIZE = (6, 10)


def angles(direction: np.ndarray) -> tuple[float, float]:
    """Return azimuth (left is positive) and elevation."""
    x, y, z = direction
    return math.atan2(y, x), math.asin(z)


@pytest.mark.parametrize("bend", [1.0, 2.0])
def test_a_bent_mirror_keeps_the_upper_rim_and_moves_the_rows(bend):
    view = PanoramaView(8, 32, 40.0, -40.0)
    found = panorama(view, bend).directions(0, 0)
    if bend == 1:
        np.testing.assert_allclose(found, view.directions(), atol=1e-12)
    high, low = math.tan(math.radians(40)), math.tan(math.radians(-40))
    for row in range(8):
        slope = high + ((row + 0.5) / 8) ** bend * (low - high)
        assert math.tan(angles(found[row, 3])[1]) == pytest.approx(slope)


def test_an_ordinary_camera_keeps_straight_lines_and_its_angle_of_view():
    width, aspect, pitch = math.radians(80), 1.5, 0.1
    found = photograph(SIZE, width, aspect, pitch).directions(0.2, -0.1)
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            right = ((column + 0.7) / SIZE[1] * 2 - 1) * math.tan(width / 2)
            up = (1 - (row + 0.4) / SIZE[0] * 2) * math.tan(width / 2) / aspect
            # The axis of a camera that looks up by the pitch, and what is up for it.
            axis, above = (math.cos(pitch), 0, math.sin(pitch)), (-math.sin(pitch), 0, math.cos(pitch))
            ray = np.array(axis) + right * np.array((0, -1, 0)) + up * np.array(above)
            np.testing.assert_allclose(found[row, column], ray / np.linalg.norm(ray), atol=1e-12)


def test_a_fisheye_shows_equal_angles_as_equal_lengths_and_leaves_the_rest_dark():
    radius, angle, aspect = 1.2, math.radians(80), 1.4
    camera = fisheye(SIZE, radius, angle, aspect)
    found = camera.directions(0, 0)
    assert camera.shown is not None
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            right = ((column + 0.5) / SIZE[1] * 2 - 1) * aspect
            up = 1 - (row + 0.5) / SIZE[0] * 2
            off = math.hypot(right, up)
            assert camera.shown[row, column] == (off <= radius)
            assert math.acos(found[row, column, 0]) == pytest.approx(off / radius * angle)
            # Right and left, above and below as in the picture.
            assert np.sign(found[row, column, 1]) == -np.sign(right)
            assert np.sign(found[row, column, 2]) == np.sign(up)


@pytest.mark.parametrize(("make", "lens"), [(panorama, [1.2]), (photograph, [1.2, 1.4]), (fisheye, [1.1, 1.3, 1.4])])
def test_directions_have_length_one_and_neighbours_lie_as_far_apart_as_said(make, lens):
    camera = make(PanoramaView(64, 256) if make is panorama else (64, 256), *lens)
    found = camera.directions(0, 0)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-12)
    beside = np.arccos(np.clip((found[32, 127] * found[32, 128]).sum(), -1, 1))
    # A perspective picture is wider apart in its middle than on average.
    assert beside == pytest.approx(camera.spread.reshape(64, 256)[32, 127], rel=0.35 if make is photograph else 0.05)


@pytest.mark.parametrize(
    "camera",
    [photograph((9, 200), 1.2, 1.4), fisheye((9, 200), 1.1, 1.3, 1.4), fisheye((9, 200), 1.5, 1.3, 1.2)],
    ids=["ordinary", "whole circle", "cut circle"],
)
def test_the_field_of_view_ends_at_the_outermost_columns(camera):
    ahead = camera.directions(0, 0)[4]
    azimuth = np.arctan2(ahead[..., 1], ahead[..., 0])[np.ones(200, bool) if camera.shown is None else camera.shown[4]]
    assert np.ptp(azimuth) == pytest.approx(camera.field, abs=0.03)


def test_cameras_of_all_kinds_are_drawn_from_those_asked_for():
    drawn = {
        cameras: [draw_camera(np.random.default_rng(seed), (16, 64), cameras) for seed in range(60)]
        for cameras in get_args(Cameras)
    }
    kinds = {(camera.wraps, camera.shown is None) for camera, _ in drawn["any"]}
    assert kinds == {(True, True), (False, True), (False, False)}
    assert 0.6 < np.mean([camera.wraps for camera, _ in drawn["any"]]) < 0.9
    assert len({height for _, height in drawn["any"]}) > 30
    assert all(camera.wraps for camera, _ in drawn["panoramas"])
    assert {height for _, height in drawn["built_in"]} == {HEIGHT}
    assert {(camera.wraps, camera.shown is None) for camera, _ in drawn["ordinary"]} == {(False, True), (False, False)}
