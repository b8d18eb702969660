from __future__ import annotations

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.data.moves import moves
from siamloc.errors import DataError
from siamloc.maps import motions


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
