from __future__ import annotations

import json
import math

import numpy as np
import pytest

from foundation.files import plain
from siamloc.errors import DataError
from siamloc.evaluation import absolute
from siamloc.evaluation.absolute import evaluate_absolute
from siamloc.evaluation.columns import located_columns
from siamloc.maps import Retrieval
from siamloc.results import read_results, read_rows, write_results
from tests.siamloc.evaluation import scenes

RADII = (0.5, 1 / 3)


def evaluated(n: int = 60):
    known, queries = scenes.visual_map(), scenes.frames(2, n)
    return known, queries, evaluate_absolute(known, scenes.describe(queries, seed=2), queries, RADII, (1,))


def test_the_single_frame_estimate_has_the_measures_of_absolute_localization() -> None:
    known, queries, result = evaluated()
    again = absolute.estimate_columns("again", known.frames.xy[result.columns["match"]], queries)
    np.testing.assert_array_equal(again["again_error"], result.columns["error"])
    measures = absolute.estimate_measures({**result.columns, **again}, "again", RADII, len(known), "m")
    expected = absolute.pose_measures(result.columns, RADII, (1,), len(known), "m")
    for group, reference in zip(
        (measures["overall"], *measures["lighting"].values(), *measures["room"].values()),
        (expected["overall"], *expected["lighting"].values(), *expected["room"].values()),
        strict=True,
    ):
        assert {name: reference[name] for name in group} == group


def test_a_perfect_estimate_is_below_the_floor_and_a_distant_one_is_not_recalled() -> None:
    known, queries, result = evaluated()
    perfect = absolute.estimate_columns("it", queries.xy, queries, queries.theta + 2 * np.pi)
    overall = absolute.estimate_measures({**result.columns, **perfect}, "it", RADII, len(known), "m")["overall"]
    assert overall["error"]["max"] == 0
    assert overall["excess"]["mean"] == -overall["floor"]["mean"] < 0
    assert [entry["recall"] for entry in overall["recall"]] == [1, 1]
    assert overall["heading_error"]["count"] == np.isfinite(queries.theta).sum() < 60
    assert overall["heading_error"]["max"] < 1e-9
    away = absolute.estimate_columns("it", queries.xy + np.array([3, 4]), queries)
    overall = absolute.estimate_measures({**result.columns, **away}, "it", RADII, len(known), "m")["overall"]
    assert overall["error"]["mean"] == pytest.approx(5)
    assert [entry["hits"] for entry in overall["recall"]] == [0, 0]
    assert "heading_error" not in overall


def test_the_file_alone_gives_the_same_measures(tmp_path) -> None:
    known, queries, result = evaluated()
    rng = np.random.default_rng(0)
    noisy = absolute.estimate_columns("it", queries.xy + rng.normal(size=(60, 2)), queries, rng.uniform(-3, 3, 60))
    columns = {**result.columns, **noisy}
    measures = absolute.estimate_measures(columns, "it", RADII, len(known), "m")
    write_results(tmp_path, {"config": {}, "measures": measures, "denominators": {}}, columns)
    again = absolute.estimate_measures(read_rows(tmp_path), "it", RADII, len(known), "m")
    assert json.dumps(plain(again)) == json.dumps(read_results(tmp_path)["measures"])


def test_queries_without_a_pose_are_listed_with_their_estimates() -> None:
    known = scenes.visual_map()
    queries = scenes.frames(2, 5, x=np.full(5, math.nan))
    found = Retrieval(np.array([[3], [0], [149], [3], [7]]), np.arange(5.0)[:, None])
    columns = located_columns(known, queries, found, [0.1, math.nan, 0, 0, 0])
    np.testing.assert_array_equal(columns["est_x"], known.frames.x[[3, 0, 149, 3, 7]])
    assert columns["match_path"][2] == known.frames.path[149]
    assert columns["est_theta"][0] == 0.1
    assert not {"error", "floor", "x"} & set(columns)


def test_errors() -> None:
    queries = scenes.frames(2, 5)
    with pytest.raises(DataError, match="as many headings"):
        absolute.estimate_columns("it", queries.xy, queries, [0.0])
    with pytest.raises(DataError, match="positions"):
        absolute.estimate_columns("it", np.full((5, 2), np.nan), queries)
