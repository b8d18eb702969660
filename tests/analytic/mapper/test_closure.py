import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic.mapper.closure import Similarity, image_level, node_level, prominences
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


@pytest.mark.parametrize("two_sided", [True, False])
def test_nodes_that_cannot_close_are_left_out_and_nothing_else_changes(two_sided):
    frames = rows(World(size=8, steps=0, reach=4.0, seed=5).at(corridor_drive(200, seed=4), noise=0.2))
    nodes = [Node(s, (Mode.of(RULES, range(s, s + 20), frames[s : s + 20]),)) for s in range(0, 160, 20)]
    spared = 0
    for frame in frames[::5]:
        point = frame.position[0].astype(np.float64)
        whole, few = (node_level(point, nodes, two_sided, *most) for most in ((), (1.5,)))
        assert few.nodes[few.closing(1.5)].tolist() == whole.nodes[whole.closing(1.5)].tolist()
        spared += len(nodes) - len(few.nodes)
    assert spared > 50
