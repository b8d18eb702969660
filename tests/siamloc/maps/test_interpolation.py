from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import ConfigError, DataError
from siamloc.maps import Retrieval
from siamloc.maps.refinement import interpolate_poses
from tests.oracles import interpolation as oracle
from tests.siamloc.maps.conftest import placed, retrieval


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 6), radius=st.floats(0, 12))
def test_poses_equal_the_loop(seed: int, k: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    frames = placed(np.cumsum(rng.normal(size=(10, 2)), axis=0), sequence=rng.choice(["a", "b"], 10))
    found, headings = retrieval(np.random.default_rng(seed), 5, 10, 6), rng.uniform(-math.pi, math.pi, (5, 6))
    poses = interpolate_poses(found, frames, k, radius, headings, 1e-3)
    for i in range(5):
        x, y, theta = oracle.pose(
            found.indices[i], found.distances[i], frames.xy, frames.sequence, headings[i], k, radius, 1e-3
        )
        assert poses.xy[i] == pytest.approx([x, y])
        assert math.cos(poses.theta[i] - theta) == pytest.approx(1)
    assert ((poses.agreement >= 1 / k) & (poses.agreement <= 1)).all()


@pytest.mark.parametrize(
    ("frames", "distances", "x"),
    [
        ([0, 1], [0.25, 0.75], 0.25),
        ([0, 1], [0.0, 0.5], 0),
        ([0, 1], [0.0, 0.0], 0.5),
        ([1, 1], [0.5, math.inf], 1),
        ([0], [0.3], 0),
    ],
    ids=["between two frames", "on a frame", "on both", "one found", "a map of one frame"],
)
def test_a_query_lies_between_its_frames(frames: list[int], distances: list[float], x: float) -> None:
    known = placed([[n, 0] for n in range(max(frames) + 1)])
    poses = interpolate_poses(Retrieval(np.array([frames]), np.array([distances])), known, 2, 2.0)
    np.testing.assert_allclose(poses.xy, [[x, 0]], atol=1e-5)
    assert np.isnan(poses.theta).all()


def test_headings_on_either_side_of_the_seam_and_unknown_ones() -> None:
    frames = placed([[0, 0], [1, 0]])
    found = Retrieval(np.array([[0, 1]] * 3), np.full((3, 2), 0.5))
    headings = [[math.pi - 0.1, -math.pi + 0.3], [math.nan, 2.0], [math.nan, math.nan]]
    theta = interpolate_poses(found, frames, 2, 2.0, headings).theta
    np.testing.assert_allclose(theta, [-math.pi + 0.1, 2.0, math.nan])


def test_errors() -> None:
    frames, found = placed([[0, 0], [1, 0]]), retrieval(np.random.default_rng(0), 2, 2, 2)
    less = Retrieval(found.indices[:, :1], found.distances[:, :1])
    for asked, error, says in (
        ((found, frames, 0), ConfigError, "k must be a whole number from 1"),
        ((found, frames, 1, -1), ConfigError, "radius must be a number from 0"),
        ((less, frames, 2), DataError, r"needs 2 neighbours a query, rows 0 to 1 of the map, got shape \(2, 1\)"),
        ((Retrieval(found.indices + 1, found.distances), frames, 2), DataError, "rows 0 to 1"),
        ((found, frames, 2, 1, [[0.0], [1.0]]), DataError, "2 queries need headings by 2 neighbours"),
        ((found, placed([[0, 0], [math.nan, 0]]), 2), DataError, "1 of the 2 map frames have no position"),
    ):
        with pytest.raises(error, match=says):
            interpolate_poses(*asked)
