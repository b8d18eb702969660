from __future__ import annotations

import math

import numpy as np
import pytest

from analytic import Description
from siamloc import maps
from siamloc.data import FrameTable
from siamloc.errors import ConfigError
from siamloc.evaluation import metrics
from siamloc.evaluation.absolute import neighbours
from siamloc.evaluation.hierarchy import CoarseRanking, evaluate_hierarchical, hierarchical
from siamloc.evaluation.result import Result
from siamloc.maps import VectorIndex, VisualMap
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.hierarchy import HierarchicalSearch
from siamloc.maps.ranking import NodeRanking, rank_by_position, rank_by_representatives
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_absolute
from tests.siamloc.evaluation.world import Reads, drive, library

RADII, KS = (0.5, 1 / 3), (1, 5, 10)


def layer_of(known: VisualMap, side: float = 1.5, unassigned: int = 0) -> CoarseLayer:
    """Return squares of the building as nodes, some frames left out of them."""
    cell = np.floor(known.frames.xy / side).astype(int)
    labels = np.unique(cell[:, 0] * 100 + cell[:, 1], return_inverse=True)[1]
    labels[:unassigned] = -1
    return CoarseLayer.of_labels(known, np.unique(labels, return_inverse=True)[1] - (unassigned > 0))


def evaluated(
    known: VisualMap, layer: CoarseLayer, queries, vectors, candidates: int = 3, ranking: NodeRanking | None = None
) -> Result:
    search = HierarchicalSearch(known, layer)
    ranking = ranking or rank_by_representatives(vectors, VectorIndex(layer.representatives), candidates)
    found = search.search(vectors, ranking, neighbours(KS, len(known)))
    perfect = search.search(vectors, rank_by_position(queries.xy, known.frames.xy, layer.labels))
    return evaluate_hierarchical(known, layer, queries, found, perfect, known.search(vectors), RADII, KS)


def test_columns_and_measures() -> None:
    known, queries = scenes.visual_map(), scenes.frames(2, 80)
    vectors = scenes.describe(queries, seed=2, noise=0.8)
    layer = layer_of(known, unassigned=10)
    result = evaluated(known, layer, queries, vectors, candidates=2)
    measures = result.parts["hierarchical"]
    ranking = rank_by_representatives(vectors, VectorIndex(layer.representatives), 2)
    size = np.bincount(layer.labels[layer.labels >= 0])
    for i in (0, 17, 79):
        row = result.rows[i]
        closest = min(range(150), key=lambda j: math.dist(known.frames.xy[j], queries.xy[i]))
        assert row["true_node"] == layer.labels[closest]
        assert row["nodes_tried"] == " ".join(map(str, ranking.nodes[i]))
        assert row["coarse_correct"] == (layer.labels[closest] in (*ranking.nodes[i], -1))
        assert row["frames_compared"] == 10 + sum(size[node] for node in ranking.nodes[i])
        assert row["comparisons"] == row["frames_compared"] + len(layer)
        assert row["node"] == layer.labels[row["match"]]
        assert row["node"] in (*ranking.nodes[i], -1)
    right = result.columns["coarse_correct"]
    night = queries.lighting == "night"
    for group, rows in ((measures["overall"], np.ones(80, bool)), (measures["lighting"]["night"], night)):
        error, compared = result.columns["error"][rows], result.columns["comparisons"][rows]
        assert group["given_right"]["error"] == metrics.summarize(error[right[rows]])
        assert group["given_wrong"]["error"] == metrics.summarize(error[~right[rows]])
        assert group["given_right"]["queries"] + group["given_wrong"]["queries"] == rows.sum()
        assert group["coarse"]["accuracy"] == right[rows].mean()
        assert group["comparisons"]["share"] == compared.mean() / 150
        assert group["absolute"]["error"] == metrics.summarize(result.columns["error_absolute"][rows])
        assert group["loss"] == error.mean() / group["absolute"]["error"]["mean"] - 1
    assert 0 < measures["overall"]["coarse"]["accuracy"] < 1
    assert measures["overall"]["given_wrong"]["error"]["mean"] > measures["overall"]["given_right"]["error"]["mean"]
    assert sum(group["coarse"]["queries"] for group in measures["room"].values()) == 80
    assert result.tables["nodes"]["frames"].sum() == 140
    absolute = evaluate_absolute(known, vectors, queries, RADII, KS)
    np.testing.assert_array_equal(result.columns["error_absolute"], absolute.columns["error"])
    assert absolute.measures["error"]["mean"] == measures["overall"]["absolute"]["error"]["mean"]


def test_a_perfect_coarse_layer_finds_the_nearest_frame() -> None:
    known, queries = scenes.visual_map(400), scenes.frames(2, 60)
    known = VisualMap(known.frames.xy, known.frames)
    layer = layer_of(known)
    perfect = rank_by_position(queries.xy, known.frames.xy, layer.labels)
    overall = evaluated(known, layer, queries, queries.xy, ranking=perfect).parts["hierarchical"]["overall"]
    assert overall["excess"]["max"] < 1e-6
    assert overall["error"] == overall["perfect_coarse"]["error"]


@pytest.mark.parametrize("order", [["cloudy", "night"], ["night", "cloudy"]])
def test_every_node_with_an_equally_near_frame_is_right(order: list[str]) -> None:
    stations = np.arange(20.0)
    lighting = np.repeat(order, 20)
    paths = np.array([f"{light}{i:02d}.png" for light in order for i in range(20)])
    frames = FrameTable(path=paths, x=np.tile(stations, 2), y=np.zeros(40), lighting=lighting)
    misled = np.where(lighting == "night", frames.x, np.round(frames.x / 4) * 4)
    known = VisualMap(np.column_stack([misled, 100 * (lighting == "cloudy")]), frames)
    night = frames.select(lighting="night")
    layer = CoarseLayer.of_labels(known, np.repeat([0, 1], 20))
    vectors = np.column_stack([stations, np.zeros(20)])
    overall = evaluated(known, layer, night, vectors, candidates=1).parts["hierarchical"]["overall"]
    assert (overall["coarse"]["accuracy"], overall["hit_rate"][0]["rate"]) == (1, 1)
    assert overall["perfect_coarse"]["error"]["mean"] == 0


def test_the_right_room_is_that_of_the_label_where_the_nearest_frame_is_in_another(tmp_path) -> None:
    monday, tuesday = drive(tmp_path, "monday", 40, 1), drive(tmp_path, "tuesday", 3, 2, x=np.array([1.0, 1.5, 2.0]))
    images = library(tmp_path, monday, tuesday.with_columns(room=np.array(["lab", "", "attic"])))
    known = maps.build(Reads(), images, monday, progress=False)
    rooms = maps.group(known, "rooms")
    found = hierarchical(known, images, images.frames.select(sequence="tuesday"), rooms, candidates=1).tables["queries"]
    assert rooms.layer.names[found["true_node"]].tolist() == ["lab", "office", "office"]
    assert (found["error_perfect_coarse"] > 15).tolist() == [True, False, False]


@pytest.mark.parametrize("n", [1, 7, 99])
def test_small_maps_and_nodes_of_one_frame(n: int) -> None:
    known, queries = scenes.visual_map(n), scenes.frames(2, 10)
    layer = CoarseLayer.of_labels(known, np.arange(n))
    measures = evaluated(known, layer, queries, scenes.describe(queries), candidates=2).parts["hierarchical"]
    overall = measures["overall"]
    assert overall["comparisons"]["mean"] == n + min(n, 2)
    # In a node of one frame the perfect coarse layer leaves nothing to the fine one.
    assert overall["perfect_coarse"]["error"] == overall["floor"]
    if n == 1:
        assert overall["error"] == overall["floor"]
        assert math.isnan(overall["given_wrong"]["error"]["mean"])


def test_a_ratio_of_distances_saves_comparisons() -> None:
    known, queries = scenes.visual_map(), scenes.frames(2, 80)
    described = Description(scenes.describe(queries, seed=2, noise=0.8))
    layer = layer_of(known)

    def compared(**options):
        search = HierarchicalSearch(known, layer, **options)
        found = search.search(described, search.rank(described))
        return found.compared, found.found.indices

    every, one, few = (compared(candidates=3, ratio=ratio) for ratio in (None, 1.0, 1.3))
    np.testing.assert_array_equal(one[1], compared(candidates=1)[1])
    assert one[0].mean() < few[0].mean() < every[0].mean()
    with pytest.raises(ConfigError, match=r"task\.coarse\.ratio"):
        CoarseRanking(ratio=0.5)
    with pytest.raises(ConfigError, match="compares distances of representatives"):
        HierarchicalSearch(known, layer, by="vote", ratio=1.2)
