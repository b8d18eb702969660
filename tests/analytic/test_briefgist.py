"""BRIEF-gist: bits, turns, disturbances, mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analytic import AnalyticError, descriptor

MADE = descriptor("briefgist", rows=4, columns=8)
BATCH = np.random.default_rng(0).integers(0, 256, (5, 3, 16, 48), dtype=np.uint8)


def test_a_bit_tells_whether_a_window_is_brighter_than_the_one_before():
    picture = np.zeros((4, 6), dtype=np.uint8)
    picture[:2] = [[10, 30, 20, 20, 50, 10], [10, 30, 40, 0, 10, 50]]  # means 20, 20, 30
    picture[2:] = [[90, 90, 80, 80, 70, 70], [90, 90, 80, 80, 70, 70]]
    made = descriptor("briefgist", rows=2, columns=3)
    found = made.describe(picture)
    assert found.position.tolist() == [[0, 0, 1, 1, 0, 0]]
    assert found.orientation[0].tolist() == [[0, 1], [0, 0], [1, 0]]
    assert found.position.dtype == found.orientation.dtype == np.float32
    ordinary = descriptor("briefgist", rows=2, columns=3, circular=False).describe(picture)
    assert ordinary.position.tolist() == [[0, 0, 1, 0, 0, 0]]


def test_the_orientation_part_holds_the_bits_of_the_position_part():
    found = MADE.describe(BATCH)
    assert np.array_equal(found.position.reshape(5, 4, 8).transpose(0, 2, 1), found.orientation)
    assert 0 < found.position.mean() < 1


@given(grey=st.floats(0, 1, width=32))
def test_a_constant_image_has_no_bit_set(grey):
    assert not MADE.describe(np.full((16, 48), grey, dtype=np.float32)).position.any()


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"rows": 0}, "briefgist.rows must be .*, got 0"),
        ({"columns": 1}, "briefgist.columns must be a whole number from 2 to 16,384, got 1"),
        ({"rows": 5, "columns": 8}, "rows=5 does not divide the image's height of 16 pixels: use rows=4 or 8"),
        ({"rows": 64, "columns": 8}, "rows=64 does not divide the image's height of 16 pixels: use rows=16,"),
        ({"rows": 4, "columns": 7}, "use columns=6 or 8, or resize"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("briefgist", **params).describe(BATCH)


def test_an_unknown_distance_is_named():
    found = MADE.describe(BATCH)
    with pytest.raises(AnalyticError, match="unknown distance 'haming'"):
        MADE.pairwise(found, found, "haming")
