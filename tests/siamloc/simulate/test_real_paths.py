"""The real drives through COLD-Freiburg fit into the building that is modelled on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from siamloc.errors import DataError
from siamloc.simulate import Run, load_building
from siamloc.simulate.plan import blocked_points, crossings, obstacles, room_codes
from siamloc.simulate.run import draw_run
from siamloc.simulate.shell import leaf_segment
from siamloc.simulate.trajectory import listed

LISTS = Path(__file__).parents[3] / "../shared/data/cold_places"
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not LISTS.is_dir(), reason="the lists of COLD are not next to the project"),
]


@pytest.mark.parametrize("name", ["seq1_cloudy1", "seq2_cloudy1", "seq2_night1", "seq2_sunny1"])
def test_real_drives_are_free(name: str) -> None:
    building = load_building("freiburg_like")
    file = LISTS / f"freiburg_{name}.places.lst"
    labels = [line.split()[1] for line in file.read_text().splitlines() if line.strip()]
    track = listed(building, file)
    assert len(track) == len(labels)
    points = track.poses[:, :2]
    assert not blocked_points(building, points).any()
    agree = np.mean([a == b for a, b in zip(room_codes(building, points), labels, strict=True)])
    assert agree > 0.99
    segments, _ = obstacles(building)
    assert not crossings(np.stack([points[:-1], points[1:]], axis=1), segments).any()


@pytest.mark.parametrize("lighting", ["cloudy", "night", "sunny"])
def test_nothing_of_a_run_stands_on_the_listed_drive(lighting: str) -> None:
    building = load_building("freiburg_like")
    state = draw_run(building, Run(lighting, 1, trajectory=LISTS / f"freiburg_seq2_{lighting}1.places.lst"))
    points = state.track.poses[:, :2]
    assert not blocked_points(building, points, state.items).any()
    leaves = [leaf_segment(building, building.openings[i], a) for i, a in state.fixtures.door_angles.items()]
    moves = np.stack([points[:-1], points[1:]], axis=1)
    assert not crossings(moves, np.concatenate([obstacles(building, state.items)[0], leaves])).any()


def test_a_list_from_another_building_is_refused() -> None:
    with pytest.raises(DataError, match=r"poses lie in a wall or on furniture of building 'mini', the first: t"):
        listed(load_building("mini"), LISTS / "ljubljana_seq1_cloudy1.places.lst")
