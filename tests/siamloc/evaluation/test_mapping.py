import json
import math

import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.evaluation import Result
from siamloc.evaluation.layers import closures, mapping, mapping_measures
from siamloc.maps import Built, CoarseLayer, VisualMap
from siamloc.summaries import tables_of

THUMBNAIL = analytic.descriptor("thumbnail", rows=1, columns=2)


def lap_twice(frames=40):
    """A drive around a square, twice: descriptors are the position, rooms its quarters."""
    turn = np.linspace(0, 4 * np.pi, 2 * frames, endpoint=False)
    xy = 5 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    quarter = (turn % (2 * np.pi) // (np.pi / 2)).astype(int)
    table = FrameTable(
        path=[f"{i}.png" for i in range(len(turn))],
        x=xy[:, 0],
        y=xy[:, 1],
        room=np.array(["n", "w", "s", "e"])[quarter],
        sequence=["s"] * len(turn),
    )
    descriptors = xy + np.random.default_rng(0).normal(0, 1e-3, xy.shape)
    return VisualMap(descriptors, table, THUMBNAIL.identity), quarter


def measured(known, labels, seconds=(0.8,), reasons=(), **settings):
    layer = CoarseLayer.of_labels(known, labels)
    return mapping(known, Built(layer, np.asarray(seconds), known.digest, tuple(reasons)), **settings)


def test_a_perfect_layer_has_perfect_purity_and_closures():
    known, quarter = lap_twice()
    found = measured(known, quarter).parts["mapping"]
    assert found["nodes"] == 4
    assert found["purity"]["overall"] == 1
    assert {room: part["frames"] for room, part in found["purity"]["room"].items()} == dict.fromkeys("enws", 20)
    assert found["closures"]["precision"] == 1
    # The second lap, and the last frame of the first, which is near its beginning but in another node.
    assert (found["closures"]["closed"], found["closures"]["revisits"]) == (40, 41)
    assert found["ms_per_frame"]["mean"] == pytest.approx(10)
    assert found["unassigned"] == {"frames": 0, "share": 0}
    assert found["bytes"] == {"representatives": 4 * 2 * 4, "descriptors": 80 * 2 * 4}


def test_closures_are_the_most_similar_earlier_frames_of_the_node():
    known, quarter = lap_twice()
    labels = quarter.copy()
    labels[7] = -1
    found = closures(known, labels, gap=30)
    for i in range(len(known)):
        allowed = [j for j in range(i - 29) if labels[j] == labels[i] and labels[i] >= 0]
        distances = [np.linalg.norm(known.descriptors[i] - known.descriptors[j]) for j in allowed]
        expected = allowed[int(np.argmin(distances))] if allowed else -1
        assert found[i] == expected, i


def test_every_number_follows_from_the_tables(tmp_path):
    known, quarter = lap_twice()
    labels = np.where(np.arange(80) % 9 == 0, -1, quarter)
    reasons = np.where(labels < 0, "NO_CANDIDATE_NODE", "ASSIGNED")
    result = measured(known, labels, np.linspace(0, 0.1, 80), reasons.tolist(), closure_radius=1.5, closure_gap=20)
    result.save(tmp_path, pictures=False)
    columns = Result.load(tmp_path).tables["frames"]
    again = mapping_measures(columns, 1.5, 20)
    measures = result.parts["mapping"]
    assert json.dumps({key: measures[key] for key in again}) == json.dumps(again)
    assert again["reasons"] == {"ASSIGNED": 71, "NO_CANDIDATE_NODE": 9}
    assert result.tables["nodes"]["frames"].sum() == 71
    nodes = analytic.measures.silhouettes(known.frames.xy, labels, unassigned="cluster")
    silhouette = again["silhouette"]
    assert silhouette["with_unassigned"] == nodes.mean < silhouette["nearest"]
    assert silhouette["by_node"] == nodes.clusters.mean()


def test_what_cannot_be_measured():
    known, quarter = lap_twice()
    lost = VisualMap(known.descriptors, known.frames.with_columns(x=np.full(80, np.nan)), known.identity)
    result = measured(lost, quarter)
    found = result.parts["mapping"]
    for number in (found["silhouette"]["pooled"], found["inertia"]):
        assert math.isnan(number)
    assert all(math.isnan(found["closures"][key]) for key in ("recall", "right", "closed", "revisits"))
    table = tables_of(result.name, result.parts, {}, {})[0].text()
    assert "purity by room" in table
    assert "closures" not in table
    assert "revisits" not in table
    assert found["purity"] == measured(known, quarter).parts["mapping"]["purity"]
    single = measured(known, np.zeros(80, dtype=int)).parts["mapping"]
    assert math.isnan(single["silhouette"]["nearest"])
    assert math.isnan(single["descriptor_silhouette"])
    half = np.where(np.arange(80) % 2, np.nan, known.frames.x)
    found = measured(VisualMap(known.descriptors, known.frames.with_columns(x=half), known.identity), quarter)
    assert found.measures["inertia"] > 0
    assert math.isnan(found.measures["closures"]["precision"])
