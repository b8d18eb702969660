from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from siamloc.evaluation import metrics, room_retrieval
from siamloc.evaluation.columns import missing_rooms
from siamloc.evaluation.room_retrieval import evaluate_pairs
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_rooms


def test_pairs_by_lighting() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(50, 4)), rng.normal(size=(50, 4)) * 0.7
    same, lighting = rng.random(50) < 0.4, rng.choice(["cloudy", "night"], 50)
    names = np.array([f"{i}.jpeg" for i in range(50)])
    result = evaluate_pairs(first, second, same, 2.5, 0.6, lighting, {"first_path": names})
    distance = np.array([math.dist(a, b) for a, b in zip(first, second, strict=True)])
    np.testing.assert_allclose(result.columns["distance"], distance, rtol=1e-14)
    measures = result.parts["room_pairs"]
    assert (measures["margin"], measures["threshold"]) == (2.5, 0.6)
    night = lighting == "night"
    by_night = dict(measures["lighting"]["night"])
    curve = by_night.pop("curve")
    for group, rows in ((measures["overall"], slice(None)), (by_night, night)):
        accuracy = vars(metrics.pair_accuracy(distance[rows], same[rows], 2.5, 0.6))
        assert group == {**accuracy, "auc": metrics.pair_threshold_curve(distance[rows], same[rows], 2.5).auc}
    assert measures["auc"] == measures["overall"]["auc"]
    for points, group in ((curve, by_night), (measures["curve"], measures["overall"])):
        at_threshold = {name: group[name] for name in ("same", "different", "overall")}
        assert points[60] == {"threshold": 0.6, **at_threshold}
        assert len(points) == 101
    assert 0 < measures["overall"]["overall"] < 1
    assert result.columns["correct"].mean() == measures["overall"]["overall"]


def test_the_room_is_that_of_the_frame_that_looks_most_alike() -> None:
    known, queries = scenes.visual_map(), scenes.frames(2, 9)
    found = known.search(scenes.describe(queries, seed=2, noise=0.6), 40)
    alike = found.indices[np.arange(9), np.arange(9)]
    columns = room_retrieval.evaluate_rooms(known, queries, replace(found, alike=alike)).columns
    assert columns["match"].tolist() == alike.tolist()
    assert columns["predicted_room"].tolist() == known.frames.room[alike].tolist()
    assert columns["descriptor_distance"].tolist() == found.distances[np.arange(9), np.arange(9)].tolist()
    first = columns["first_rank"] == 1
    assert first.any()
    assert first.tolist() == columns["correct"].tolist()


def test_rooms_by_the_nearest_frame() -> None:
    known, queries = scenes.visual_map(), scenes.frames(2, 90)
    descriptors = scenes.describe(queries, seed=2, noise=0.6)
    result = evaluate_rooms(known, descriptors, queries)
    match = known.search(descriptors, 1).indices[:, 0]
    correct = [known.frames.room[match[i]] == queries.room[i] for i in range(90)]
    measures = result.parts["room_retrieval"]
    shares = {"accuracy": sum(correct) / 90, "correct": sum(correct), "queries": 90}
    assert measures["overall"].items() >= shares.items()
    assert 0.5 < measures["overall"]["accuracy"] < 1
    counts = np.array(measures["confusion"]["counts"])
    labels = measures["confusion"]["labels"]
    assert labels == ["CR-A", "KT-A", "ST-A"]
    assert counts.sum() == 90
    assert np.trace(counts) == sum(correct)
    assert counts.sum(axis=1).tolist() == [measures["room"][label]["queries"] for label in labels]
    by_lighting = {label: np.array(part) for label, part in measures["confusion"]["lighting"].items()}
    assert list(by_lighting) == ["cloudy", "night", "sunny"]
    assert (sum(by_lighting.values()) == counts).all()
    sunny = queries.lighting == "sunny"
    true, predicted = queries.room[sunny], result.columns["predicted_room"][sunny]
    assert (by_lighting["sunny"] == metrics.confusion_matrix(true, predicted, labels)).all()
    assert measures["lighting"]["sunny"]["accuracy"] == (true == predicted).mean()
    assert measures["rooms_missing_in_map"] == []


@pytest.mark.parametrize("with_excluded", [False, True])
def test_ranks_precision_and_chance_equal_a_loop_over_the_ranking(with_excluded) -> None:
    known, queries = scenes.visual_map(60), scenes.frames(2, 30)
    descriptors = scenes.describe(queries, seed=2, noise=1.5)
    excluded = np.random.default_rng(1).random((30, 60)) < 0.3 if with_excluded else None
    found = known.search(descriptors, 20)
    result = room_retrieval.evaluate_rooms(known, queries, found, excluded)
    for i in range(30):
        right = [known.frames.room[row] == queries.room[i] for row in found.indices[i]]
        allowed = [j for j in range(60) if excluded is None or not excluded[i, j]]
        findable = sum(known.frames.room[j] == queries.room[i] for j in allowed)
        seen, total = 0, 0.0
        for place, hit in enumerate(right, start=1):
            seen += hit
            total += seen / place if hit else 0
        columns = {name: column[i] for name, column in result.columns.items()}
        assert columns["first_rank"] == (right.index(True) + 1 if any(right) else 0)
        assert columns["average_precision"] == pytest.approx(total / min(20, findable))
        assert columns["chance"] == pytest.approx(findable / len(allowed))
    overall = result.parts["room_retrieval"]["overall"]
    rank = result.columns["first_rank"]
    assert overall["top"] == {str(k): np.mean((rank > 0) & (rank <= k)) for k in (1, 5, 10)}
    assert overall["mean_average_precision"] == pytest.approx(result.columns["average_precision"].mean())


def test_a_room_the_map_lacks_is_named_and_wrong() -> None:
    known = scenes.visual_map(4, room=np.array(["CR-A", "CR-A", "KT-A", "XX-A"]))
    queries = scenes.frames(2, 3, room=np.array(["CR-A", "LO-A", "LO-A"]))
    measures = evaluate_rooms(known, scenes.describe(queries), queries).parts["room_retrieval"]
    assert measures["rooms_missing_in_map"] == ["LO-A"]
    assert measures["room"]["LO-A"].items() >= {"accuracy": 0, "correct": 0, "queries": 2, "chance": 0}.items()
    assert measures["confusion"]["labels"] == ["CR-A", "KT-A", "LO-A", "XX-A"]


def test_equal_room_codes_of_two_buildings_are_different_rooms() -> None:
    known = scenes.visual_map(3, room=np.array(["KT"] * 3), building=np.array(["saar"] * 3))
    queries = scenes.frames(2, 2, room=np.array(["KT"] * 2), building=np.array(["saar", "frei"]))
    result = evaluate_rooms(known, scenes.describe(queries), queries)
    assert result.columns["correct"].tolist() == [True, False]
    assert result.parts["room_retrieval"]["rooms_missing_in_map"] == ["frei/KT"]


def test_queries_that_state_no_building_are_in_the_only_one_of_the_map() -> None:
    queries = scenes.frames(2, 2, room=np.array(["KT"] * 2))
    known = scenes.visual_map(3, room=np.array(["KT"] * 3), building=np.array(["saar"] * 3))
    assert evaluate_rooms(known, scenes.describe(queries), queries).columns["correct"].all()
    several = scenes.visual_map(3, room=np.array(["KT"] * 3), building=np.array(["saar", "saar", "frei"]))
    found = evaluate_rooms(several, scenes.describe(queries), queries)
    assert not found.columns["correct"].any()
    said = missing_rooms(several.frames, queries)
    assert said.startswith("2 of 2 queries state no building, and the rooms of the map are those of frei, saar: give")
