import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic.mapper.closure import Similarity, image_level, prominences
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters
from tests.analytic.mapper.world import World, corridor_drive, rows
from tests.oracles.mapper import SlowMapper, walk

RULES = Parameters()


@settings(deadline=None)
@given(st.lists(st.integers(0, 6), min_size=1, max_size=30))
def test_prominence_is_a_walk_down_from_each_peak(heights):
    curve = np.array(heights, dtype=np.float64)
    padded = [0.0, *heights, 0.0]
    assert prominences(curve).tolist() == [walk(padded, i + 1) for i in range(len(heights))]


def nodes_of(world, poses, labels):
    description = world.at(poses)
    return [
        Node(int(key), (Mode.of(RULES, np.flatnonzero(labels == key), rows(description.take(labels == key))),))
        for key in np.unique(labels[labels >= 0])
    ]


@pytest.mark.parametrize("steps", [0, 12])
def test_similarity_is_the_product_of_two_shares(steps):
    world = World(steps=steps)
    poses = corridor_drive(40)
    labels = np.array([0] * 15 + [-1] * 5 + [1] * 20)
    nodes = nodes_of(world, poses, labels)
    query = world.at(poses[7] + 0.1, seed=1)
    found = image_level(world, query, nodes[::-1], "euclidean")
    slow = SlowMapper()
    slow.frames = [(d.position[0], d.orientation[0] if steps else None) for d in rows(world.at(poses))]
    slow.nodes = {node.id: [(frame, False) for frame in node.frames] for node in nodes}
    compared, expected = slow.similarities((query.position[0], query.orientation[0] if steps else None), [0, 1])
    assert list(zip(found.frames.tolist(), found.nodes.tolist(), strict=True)) == compared
    np.testing.assert_allclose(found.values, expected, rtol=1e-4)
    assert found.means() == pytest.approx(slow.means(compared, expected), rel=1e-4)
    assert found.frames[found.best()] == compared[int(np.argmax(expected))][0]
    assert found.nodes[found.best(node=1)] == 1
    without = image_level(world, query, nodes, "euclidean", leave_out=3)
    assert 3 not in without.frames
    assert len(without.frames) == len(found.frames) - 1


def test_the_mean_similarity_of_a_node_is_that_of_its_best_mode():
    generator = np.random.default_rng(3)
    nodes, modes, values = generator.integers(0, 9, 80), generator.integers(0, 3, 80), generator.random(80)
    found = Similarity(np.arange(80), values, nodes, modes).means()
    assert list(found) == np.unique(nodes).tolist()
    for node, mean in found.items():
        parts = [values[(nodes == node) & (modes == mode)] for mode in np.unique(modes[nodes == node])]
        assert mean == max(part.mean() for part in parts)
