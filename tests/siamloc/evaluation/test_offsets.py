"""Positions without a common origin."""

import numpy as np
import pytest

from siamloc import evaluation, maps
from tests.siamloc.evaluation.world import Reads, drive, library


@pytest.mark.parametrize("moved", [0, 15])
def test_buildings_that_lie_over_each_other_are_named(moved, tmp_path):
    monday, tuesday = drive(tmp_path, "monday", 40, 1), drive(tmp_path, "tuesday", 30, 2)
    images = library(tmp_path, monday, tuesday)
    south = monday.x > 15
    frames = monday.with_columns(x=monday.x - moved * south, building=np.where(south, "south", "north"))
    known = maps.build(Reads(), images, frames, progress=False)
    said = "the positions of the buildings north and south overlap"
    layer = maps.group(known, "sample", nodes=8, progress=False)
    results = (
        evaluation.localization(known, images, tuesday),
        evaluation.hierarchical(known, images, tuesday, layer),
        evaluation.mapping(known, layer),
    )
    assert [said in result.table() for result in results] == [bool(moved)] * 3
    both = tuesday.with_columns(building=np.where(tuesday.x > 15, "south", "north"))
    choice = evaluation.buildings(known, images, both)  # which measures no distances
    north = evaluation.localization(
        known.take(known.frames.building == "north"), images, both.select(building="north")
    )  # as the sentence says
    assert [said in result.table() for result in (choice, north)] == [False, False]


def test_matches_in_another_building_are_counted(tmp_path):
    monday, tuesday = drive(tmp_path, "monday", 40, 1), drive(tmp_path, "tuesday", 30, 2, building=["south"] * 30)
    images = library(tmp_path, monday, tuesday)
    known = maps.build(Reads(), images, monday.with_columns(building=["north"] * 40), progress=False)
    told = evaluation.localization(known, images, tuesday).table()
    assert "30 of 30 queries are matched in another building" in told
    assert "the positions of the buildings north and south overlap" in told
