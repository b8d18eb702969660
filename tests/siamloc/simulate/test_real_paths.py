"""The real drives through COLD-Freiburg fit into the building that is modelled on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from siamloc.data.cold import read_list
from siamloc.simulate import load_building
from siamloc.simulate.plan import blocked_points, crossings, obstacles, room_codes

LISTS = Path(__file__).parents[3] / "../shared/data/cold_places"
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not LISTS.is_dir(), reason="the lists of COLD are not next to the project"),
]


@pytest.mark.parametrize("name", ["seq1_cloudy1", "seq2_cloudy1", "seq2_night1", "seq2_sunny1"])
def test_real_drives_are_free(name: str) -> None:
    building = load_building("freiburg_like")
    file = LISTS / f"freiburg_{name}.places.lst"
    points = np.array([(frame["x"], frame["y"]) for frame in read_list(file)])
    assert not blocked_points(building, points).any()
    agree = np.mean(np.array(room_codes(building, points)) == [frame["room"] for frame in read_list(file)])
    assert agree > 0.99
    segments, _ = obstacles(building)
    assert not crossings(np.stack([points[:-1], points[1:]], axis=1), segments).any()
