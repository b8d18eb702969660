import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic.mapper.closure import Similarity, image_level, prominences, similarity_curve
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


def test_prominence_by_hand():
    assert prominences(np.array([2.0, 1, 5, 4, 4.5, 0, 3, 3])).tolist() == [1, 0, 5, 0, 0.5, 0, 3, 0]


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
    found = image_level(world, query, nodes[::-1], "euclidean", bool(steps))
    slow = SlowMapper()
    slow.frames = [(d.position[0], d.orientation[0] if steps else None) for d in rows(world.at(poses))]
    slow.nodes = {node.id: [(frame, False) for frame in node.frames] for node in nodes}
    compared, expected = slow.similarities((query.position[0], query.orientation[0] if steps else None), [0, 1])
    assert list(zip(found.frames.tolist(), found.nodes.tolist(), strict=True)) == compared
    np.testing.assert_allclose(found.values, expected, rtol=1e-4)
    assert found.means() == pytest.approx(slow.means(compared, expected), rel=1e-4)
    assert found.frames[found.best()] == compared[int(np.argmax(expected))][0]
    assert found.nodes[found.best(node=1)] == 1
    without = image_level(world, query, nodes, "euclidean", bool(steps), leave_out=3)
    assert 3 not in without.frames
    assert len(without.frames) == len(found.frames) - 1


def test_an_equal_image_is_most_similar_and_nothing_is_infinite():
    world = World(steps=0)
    poses = corridor_drive(20)
    nodes = nodes_of(world, poses, np.zeros(20, dtype=int))
    query = world.at(poses).take([4])
    found = image_level(world, query, nodes, "euclidean", False)
    assert found.frames[found.best()] == 4
    assert np.isfinite(found.values).all()
    same = nodes_of(world, np.tile(poses[:1], (20, 1)), np.zeros(20, dtype=int))[0].modes[0]
    alike = Mode.of(RULES, range(5), [same.gallery.row(0)] * 5)
    found = image_level(world, same.gallery.row(0), [Node(0, (alike,))], "euclidean", False)
    assert found.values.tolist() == [0.2] * 5
    assert found.best() == 0


def test_the_curve_falls_to_zero_between_frames_of_other_nodes():
    world = World(steps=0)
    labels = np.array([0] * 12 + [1] * 10 + [0] * 3 + [-1] + [0] * 4)
    nodes = nodes_of(world, corridor_drive(30), labels)
    found = image_level(world, world.at([[0, 0, 0]]), nodes[:1], "euclidean", False)
    curve, where = similarity_curve(found, labels, [0])
    assert np.flatnonzero(curve == 0).tolist() == [12, 16]
    assert curve[where].tolist() == found.values.tolist()


def test_the_mean_similarity_of_a_node_is_that_of_its_best_mode():
    generator = np.random.default_rng(3)
    nodes, modes, values = generator.integers(0, 9, 80), generator.integers(0, 3, 80), generator.random(80)
    found = Similarity(np.arange(80), values, nodes, modes).means()
    assert list(found) == np.unique(nodes).tolist()
    for node, mean in found.items():
        parts = [values[(nodes == node) & (modes == mode)] for mode in np.unique(modes[nodes == node])]
        assert mean == max(part.mean() for part in parts)
