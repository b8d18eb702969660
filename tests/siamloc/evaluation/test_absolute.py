from __future__ import annotations

import math

import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.evaluation import metrics
from siamloc.evaluation.absolute import estimate_columns, estimate_measures, pose_measures
from siamloc.evaluation.hierarchy import Hierarchical
from siamloc.evaluation.localize import Localization
from siamloc.maps import VisualMap
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_absolute

RADII = (0.5, 1 / 3)
KS = (1, 5, 10)


def evaluated(n: int = 80, map_frames: int = 150):
    queries = scenes.frames(2, n)
    known = scenes.visual_map(map_frames)
    return evaluate_absolute(known, scenes.describe(queries, seed=2), queries, RADII, KS), known, queries


def test_rows_hold_the_match_and_its_error() -> None:
    result, known, queries = evaluated()
    found = known.search(scenes.describe(queries, seed=2), 1)
    assert len(result) == len(result.rows) == 80
    for i in (0, 41, 79):
        row, match = result.rows[i], int(found.indices[i, 0])
        assert (row["query"], row["path"], row["sequence"]) == (i, queries.path[i], "run2")
        assert (row["lighting"], row["room"]) == (queries.lighting[i], queries.room[i])
        of_map = known.frames.path[match], known.frames.room[match]
        assert (row["match"], row["match_path"], row["match_room"]) == (match, *of_map)
        assert (row["est_x"], row["est_y"]) == tuple(known.frames.xy[match])
        assert row["error"] == pytest.approx(math.dist(known.frames.xy[match], queries.xy[i]))
        assert row["floor"] == pytest.approx(min(math.dist(p, queries.xy[i]) for p in known.frames.xy))
        assert row["excess"] == row["error"] - row["floor"] >= 0
        assert row["descriptor_distance"] == found.distances[i, 0]


def test_measures_equal_the_metrics() -> None:
    result, known, queries = evaluated()
    measures = result.parts["absolute"]
    found = known.search(scenes.describe(queries, seed=2), 10).indices
    night = queries.lighting == "night"
    for group, rows in ((measures["overall"], slice(None)), (measures["lighting"]["night"], night)):
        xy = queries.xy[rows]
        errors = metrics.localization_error(known.frames.xy[found[rows, 0]], xy)
        floor = metrics.error_floor(known.frames.xy, xy)
        assert group["queries"] == len(xy)
        assert group["error"] == metrics.summarize(errors)
        assert group["floor"] == metrics.summarize(floor)
        assert group["excess"] == metrics.summarize(errors - floor)
        for one, tolerance in zip(group["hit_rate"], (0, *RADII), strict=True):
            hits = int((errors - floor <= tolerance + 1e-9).sum())
            assert one == {"tolerance": tolerance, "rate": hits / len(xy), "hits": hits, "queries": len(xy)}
        expected = [
            vars(metrics.recall_at_k(found[rows], known.frames.xy, xy, radius, k)) for radius in RADII for k in KS
        ]
        assert group["recall"] == expected
        assert group["recall_at_one_percent"] == [
            vars(metrics.recall_at_one_percent(found[rows], known.frames.xy, xy, radius)) for radius in RADII
        ]
        assert group["recall_at_one_percent"][0]["k"] == 2
    assert list(measures["lighting"]) == ["cloudy", "night", "sunny"]
    assert list(measures["room"]) == ["CR-A", "KT-A", "ST-A"]
    assert sum(group["queries"] for group in measures["room"].values()) == 80
    assert result.denominators == {
        "queries": 80,
        "map_frames": 150,
        "lighting": {label: group["queries"] for label, group in measures["lighting"].items()},
        "room": {label: group["queries"] for label, group in measures["room"].items()},
    }


def on_a_path(name: str, n: int, **columns: object) -> FrameTable:
    """A drive around a square of 8 m, one frame every 32 / n m."""
    along = np.arange(n) / n * 4
    corner = np.array([[0.0, 0.0], [8, 0], [8, 8], [0, 8], [0, 0]])
    xy = np.stack([np.interp(along, np.arange(5), corner[:, axis]) for axis in (0, 1)], axis=1)
    return FrameTable(
        **{"path": [f"{name}/{i}" for i in range(n)], "x": xy[:, 0], "y": xy[:, 1], "sequence": [name] * n, **columns}
    )


@pytest.mark.parametrize(
    ("drift", "says"),
    [
        (np.zeros((100, 2)), False),
        (np.full((100, 2), 1.5), True),
        (np.linspace(0, 4, 100)[:, None] * [1, 0], True),
        # Long runs of queries are taken for the same wrong place, as in corridors that look alike.
        (None, False),
    ],
    ids=["as the map's", "own origin", "drift", "wrong matches"],
)
def test_a_drive_whose_positions_disagree_with_the_map_s_is_remarked(drift: np.ndarray | None, says: bool) -> None:
    known, queries = on_a_path("monday", 150), on_a_path("tuesday", 100)
    seen, moved = scenes.describe(queries, seed=3, noise=0.1), queries
    if drift is None:
        wrong = np.repeat(np.random.default_rng(0).uniform(0, 8, (10, 2)), 10, axis=0)
        seen = np.column_stack([wrong, np.zeros(100)]).astype("f4")
    else:
        moved = queries.with_columns(x=queries.x + drift[:, 0], y=queries.y + drift[:, 1])
    of_monday = VisualMap(scenes.describe(known, seed=1, noise=0.1), known, {"name": "p"})
    result = evaluate_absolute(of_monday, seen, moved)
    assert ("positions" in result.skipped) == says
    assert ("tuesday look like map frames" in result.table()) == says
    assert "left out" not in result.table()


@pytest.mark.parametrize(
    ("columns", "labels"),
    [
        ({"room": ["KT-A"] * 3 + [""] * 5, "lighting": [""] * 8}, {"(unlabelled)": 5, "KT-A": 3}),
        ({"room": ["KT"] * 8, "building": ["saar"] * 4 + ["frei"] * 4}, {"frei/KT": 4, "saar/KT": 4}),
    ],
    ids=["missing labels", "two buildings"],
)
def test_groups_have_the_labels_of_the_queries(columns: dict, labels: dict) -> None:
    queries = scenes.frames(2, 8, **{name: np.array(values) for name, values in columns.items()})
    measures = evaluate_absolute(scenes.visual_map(), scenes.describe(queries), queries).parts["absolute"]
    assert {label: group["queries"] for label, group in measures["room"].items()} == labels
    assert ("lighting" in columns) == (measures["lighting"] == {})


@pytest.mark.parametrize("kind", [Localization, Hierarchical])
def test_radii_and_ks_out_of_range(kind: type) -> None:
    for name, values in (("radii", ((), (-1,), (1, 1), (math.inf,))), ("ks", ((), (0,), (1, 1), (1.5,)))):
        for wrong in values:
            with pytest.raises(ConfigError, match=rf"task\.{name} must be a list of one or more"):
                kind(**{name: wrong})


def test_the_single_frame_estimate_has_the_measures_of_absolute_localization() -> None:
    result, known, queries = evaluated()
    again = estimate_columns("again", known.frames.xy[result.columns["match"]], queries)
    np.testing.assert_array_equal(again["again_error"], result.columns["error"])
    about = {**result.parts["absolute"], "ks": [1]}
    measures = estimate_measures({**result.columns, **again}, "again", about)
    expected = pose_measures(result.columns, about)
    for group, reference in zip(
        (measures["overall"], *measures["lighting"].values(), *measures["room"].values()),
        (expected["overall"], *expected["lighting"].values(), *expected["room"].values()),
        strict=True,
    ):
        assert {name: reference[name] for name in group} == group


def test_a_perfect_estimate_is_below_the_floor_and_a_distant_one_is_not_recalled() -> None:
    result, _, queries = evaluated()
    perfect = estimate_columns("it", queries.xy, queries, queries.theta + 2 * np.pi)
    overall = estimate_measures({**result.columns, **perfect}, "it", result.parts["absolute"])["overall"]
    assert overall["error"]["max"] == 0
    assert overall["excess"]["mean"] == -overall["floor"]["mean"] < 0
    assert [entry["recall"] for entry in overall["recall"]] == [1, 1]
    assert overall["heading_error"]["count"] == np.isfinite(queries.theta).sum() < 80
    assert overall["heading_error"]["max"] < 1e-9
    away = estimate_columns("it", queries.xy + np.array([3, 4]), queries)
    overall = estimate_measures({**result.columns, **away}, "it", result.parts["absolute"])["overall"]
    assert overall["error"]["mean"] == pytest.approx(5)
    assert [entry["hits"] for entry in overall["recall"]] == [0, 0]
    assert "heading_error" not in overall
