"""What a map of one in five frames of Freiburg A, path 2, allows at best (real poses)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from siamloc.evaluation.metrics import error_floor
from tests.oracles.cold_lists import read_list

COLD_PLACES = Path(__file__).parents[3] / "../shared/data/cold_places"

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not COLD_PLACES.is_dir(), reason="the real pose lists do not lie beside the project"),
]


def positions(lighting: str, keep: slice = slice(None)) -> np.ndarray:
    """Return positions without the kitchen, which one of the runs lacks; every k-th frame is taken before."""
    frames = read_list(COLD_PLACES / f"freiburg_seq2_{lighting}1.places.lst")[keep]
    return np.array([(x, y) for _, room, _, x, y, _ in frames if not room.startswith("KT")])


def test_queries_of_the_maps_own_run() -> None:
    known, queries = positions("cloudy", slice(None, None, 5)), positions("cloudy")
    floor = error_floor(known, queries)
    assert 0.050 <= floor.mean() <= 0.052
    assert (floor == 0).mean() >= 0.2


@pytest.mark.parametrize("lighting", ["night", "sunny"])
def test_queries_of_another_run(lighting: str) -> None:
    floor = error_floor(positions("cloudy", slice(None, None, 5)), positions(lighting))
    assert 0.125 <= floor.mean() <= 0.155
