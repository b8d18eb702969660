import json

import numpy as np
import pytest

from analytic.mapper.graph import connections, coordinates, edges, loops
from foundation.errors import StorageError
from tests.analytic.mapper.world import POSES, mapped

LABELS = np.array([-1, 0, 0, 1, -1, 1, 2, -1, 0, 0, 2, 1])
MATCHES = np.array([-1, -1, 1, -1, 3, 3, -1, -1, 2, 8, 6, 0])


def test_edges_are_counted_between_frames_with_a_node():
    assert edges(LABELS) == {(0, 1): 1, (1, 2): 2, (0, 2): 2}
    assert edges(np.empty(0, dtype=int)) == {}


def test_a_loop_is_a_match_with_another_node_between():
    assert loops(LABELS, MATCHES) == [(8, 2), (10, 6)]
    assert loops(np.empty(0, dtype=int), np.empty(0, dtype=int)) == []


def test_sequences_are_not_connected_with_each_other():
    assert connections(np.array([0, 0, 1, 1]), np.array(["s", "s", "t", "t"])).tolist() == []
    assert connections(np.array([0, -1, 1, 0]), np.array(["s"] * 4)).tolist() == [[0, 1]]


@pytest.mark.parametrize(
    ("pose", "place"),
    [
        ([1, 2.5, 3], (1.0, 2.5)),
        ({"x": 1, "y": 2}, (1.0, 2.0)),
        ("image.jpeg", None),
        (None, None),
        ([1], None),
        ([float("nan"), 1.0], None),
        ({"x": 1}, None),
        ([True, False], None),
    ],
)
def test_coordinates_of_a_pose(pose, place):
    assert coordinates(pose) == place


def test_a_map_as_a_graph(tmp_path):
    mapper = mapped(version=2)
    graph = mapper.graph()
    labels = mapper.labels()
    assert set(graph.nodes) == set(labels[labels >= 0].tolist())
    for node, values in graph.nodes.items():
        assert values["frames"] == (labels == node).sum()
        assert [values["x"], values["y"]] == pytest.approx(POSES[labels == node, :2].mean(axis=0))
    assert graph.loops
    assert all(labels[a] == labels[b] and b < a for a, b in graph.loops)
    graph.to_json(tmp_path / "map.json")
    read = json.loads((tmp_path / "map.json").read_text())
    assert {(e["source"], e["target"]): e["passages"] for e in read["edges"]} == graph.edges
    assert [node["id"] for node in read["nodes"]] == sorted(graph.nodes)
    assert read["loops"] == [list(loop) for loop in graph.loops]


def test_a_graph_that_cannot_be_written(tmp_path):
    with pytest.raises(StorageError, match="cannot be written"):
        mapped(3).graph().to_json(tmp_path)
