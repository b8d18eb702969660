from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc.data.names import NamedPose, format_name, parse_name

numbers = st.floats(-1e6, 1e6, allow_nan=False)
suffixes = st.sampled_from([".jpeg", ".jpg", ".png", ".JPEG"])


@given(numbers, numbers, numbers, numbers, suffixes)
def test_a_written_pose_is_read_back_to_the_sixth_decimal(time, x, y, theta, suffix):
    pose = NamedPose(time, x, y, theta)
    again = parse_name(format_name(pose, suffix))
    assert again is not None
    assert again == pytest.approx(pose, abs=5.1e-7, rel=1e-15)


@given(numbers, numbers, numbers, numbers)
def test_numbers_in_shortest_form_are_read_back_exactly(time, x, y, theta):
    """`repr` writes exponents such as 1e-05 where they are shorter."""
    assert parse_name(f"t{time!r}_x{x!r}_y{y!r}_a{theta!r}.jpeg") == (time, x, y, theta)


@pytest.mark.parametrize(
    ("name", "pose"),
    [
        ("t1152889564.947042_x0.200000_y-0.000000_a0.000000.jpeg", (1152889564.947042, 0.2, 0.0, 0.0)),
        ("t1_x1e-05_y-2.5E+1_a+.5.jpg", (1.0, 1e-5, -25.0, 0.5)),
        ("t1._x2._y3._a4..png", (1.0, 2.0, 3.0, 4.0)),
    ],
)
def test_names_of_the_database(name, pose):
    assert parse_name(name) == pose


def test_a_name_without_a_pose_gives_the_time():
    found = parse_name("t1152889564.947042.jpeg")
    assert found.time == 1152889564.947042
    np.testing.assert_array_equal(found[1:], [np.nan] * 3)


@pytest.mark.parametrize(
    "name",
    [
        "folder/t1_x1_y1_a1.jpeg", " t1_x1_y1_a1.jpeg", "t1_x1_y1_a1.jpeg\n", "t1_x1_y1_a1.jpeg.bak",
        "t1_x1_y1_a1.gif", "t1_x1_y1.jpeg", "t1_y1_x1_a1.jpeg", "t1_x_y1_a1.jpeg", "t1_xnan_y1_a1.jpeg",
        "t1_x1e999_y1_a1.jpeg", "t1_x١_y1_a1.jpeg", "old_t1_x1_y1_a1.jpeg",
    ],
)  # fmt: skip
def test_other_names_carry_no_pose(name):
    assert parse_name(name) is None
