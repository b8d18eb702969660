"""Several buildings in one evaluation: no distance between two of them counts."""

import numpy as np
import pytest

from siamloc import evaluation, maps
from siamloc.evaluation.side_by_side import side_by_side
from tests.siamloc.evaluation.world import Reads, drive, library


def in_two(frames, **columns):
    """Return the frames of a corridor as those of two buildings with the same coordinates."""
    south = frames.x > 15
    return frames.with_columns(x=frames.x - 15 * south, building=np.where(south, "south", "north"), **columns)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    folder = tmp_path_factory.mktemp("buildings")
    monday, tuesday = drive(folder, "monday", 40, 1), drive(folder, "tuesday", 30, 2)
    images = library(folder, monday, tuesday)
    known, queries = maps.build(Reads(), images, in_two(monday), progress=False), in_two(tuesday)
    return known, images, queries


def test_no_distance_between_two_buildings_counts(both):
    known, images, queries = both
    away = np.linalg.norm(queries.xy[:, None] - known.frames.xy, axis=2)
    away[queries.building[:, None] != known.frames.building] = np.inf
    result = evaluation.localization(known, images, queries, filter=True)
    match, right = result.columns["match"], np.arange(len(queries))
    near = np.isfinite(away[right, match])
    np.testing.assert_allclose(result.columns["floor"], away.min(axis=1))
    np.testing.assert_allclose(result.columns["error"][near], away[right, match][near])
    assert (result.columns["error"][~near] > 24).all()
    assert "x is moved in south by 40 m" in result.table()
    layer = maps.group(known, "sample", nodes=8, progress=False)
    nodes = evaluation.hierarchical(known, images, queries, layer).columns
    np.testing.assert_array_equal(nodes["true_node"], layer.layer.labels[away.argmin(axis=1)])
    np.testing.assert_allclose(nodes["floor"], away.min(axis=1))
    disturbed = evaluation.robustness(known, images, queries, every=1, noise=(0,), occlusion=(), turn=())
    np.testing.assert_allclose(disturbed.tables["answers"]["floor"], away.min(axis=1))
    compact = evaluation.compact(known, images, queries, nodes=(40,), ways=("sample",)).tables["answers"]
    np.testing.assert_allclose(compact["floor"], away.min(axis=1))
    places = evaluation.mapping(known, layer).tables
    assert places["nodes"]["x"].max() > 40 > places["frames"]["x"][known.frames.building == "north"].max()


def test_matches_in_another_building_are_counted(both):
    known, images, queries = both
    swapped = queries.with_columns(building=np.where(queries.building == "north", "south", "north"))
    result = evaluation.localization(known, images, swapped)
    assert f"{len(queries)} of {len(queries)} queries are matched in another building" in result.table()
    assert not any(one["hits"] for one in result.measures["recall"] if one["k"] == 1)


def test_learned_values_fit_the_map_whose_buildings_were_moved(both):
    known, _, queries = both
    moved = side_by_side(known, queries)[0]
    assert moved.digest == known.digest
    assert not np.array_equal(moved.frames.x, known.frames.x)


@pytest.mark.parametrize("unnamed", [{}, {"building": [""] * 30}])
def test_frames_of_one_building_stay_where_they_are(both, unnamed):
    known, images, queries = both
    north = known.take(known.frames.building == "north")
    asked = queries.with_columns(**unnamed) if unnamed else queries.select(building="north")
    result = evaluation.localization(north, images, asked)
    np.testing.assert_array_equal(result.columns["x"], asked.x)
    assert "buildings" not in result.skipped
