import numpy as np
import pytest

from analytic.mapper import IncrementalMapper
from analytic.mapper.closure import node_level, node_levels
from analytic.mapper.growth import Known
from tests.analytic.mapper.world import World, corridor_drive, rows


def mapped(world, frames, **parameters):
    mapper = IncrementalMapper(world, 2, **parameters)
    for frame in frames:
        mapper.add(frame)
    return mapper


@pytest.mark.parametrize(("size", "two_sided"), [(8, True), (64, True), (64, False)])
def test_nodes_out_of_reach_do_not_close_and_some_are_spared(size, two_sided):
    world = World(size=size, steps=0, reach=4.0, seed=5)
    poses = corridor_drive(500, seed=5, rooms=8)
    mapper = mapped(world, rows(world.at(poses, noise=0.2, seed=5)), two_sided=two_sided, merge="never")
    mapper.maintain(mapper.nodes[1].id, world.at(poses[:12], lighting=2.0))
    state, nodes = mapper._state, mapper.nodes
    generator = np.random.default_rng(0)
    spared = 0
    for scale in (0.0, 1e-3, 0.03, 0.3):
        for frame in world.at(poses[::25], noise=0.2, seed=6).position.astype(np.float64):
            known = Known(frame, node_levels(frame, nodes, two_sided))
            point = frame + scale * generator.normal(size=size)
            beyond = known.out_of_reach(point, state)
            spared += len(beyond)
            assert nodes[1].id not in beyond  # it has two modes
            for node in nodes:
                assert node.id not in beyond or not node_level(point, node, two_sided).closes(state.rules.y)
    assert spared > 100


@pytest.mark.parametrize("size", [16, 64])
def test_what_is_merged_is_the_same_without_anything_known(size, monkeypatch):
    world = World(size=size, steps=0, reach=6.0, seed=2)
    frames = rows(world.at(corridor_drive(400, seed=5, rooms=6), noise=0.2, seed=3))
    found = mapped(world, frames, y=2.5)
    monkeypatch.setattr(Known, "out_of_reach", lambda *_: set())
    assert mapped(world, frames, y=2.5).events == found.events
    assert any("NODES_MERGED" in event and "NEW_NODE" not in event for event in found.events)
