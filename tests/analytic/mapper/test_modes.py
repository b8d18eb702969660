import numpy as np
import pytest

from analytic.mapper import IncrementalMapper, Reason
from analytic.mapper.closure import node_level
from analytic.mapper.growth import distinctness, merge
from tests.analytic.mapper.world import World, rows

WORLD = World(size=16, reach=4.0, seed=2)
NIGHT = 1.5


def stay(x, frames, seed):
    generator = np.random.default_rng(seed)
    return np.column_stack([x + generator.normal(0, 0.15, (frames, 2)), generator.uniform(0, 6, frames)])


def two_places(version=1):
    mapper = IncrementalMapper(WORLD, version, merge="never")
    for x in (0.0, 12.0):
        for frame in rows(WORLD.at(stay(x, 40, int(x)), noise=0.1, seed=int(x))):
            mapper.add(frame)
    assert len(mapper.nodes) == 2
    return mapper


def seen_by_night(x, frames, seed):
    return WORLD.at(stay(x, frames, seed), noise=0.1, seed=seed, lighting=NIGHT)


def recognized(mapper, description, node):
    found = [mapper.locate(frame) for frame in rows(description)]
    return np.mean([location.closes and location.node == node for location in found])


@pytest.mark.parametrize("version", [1, 2])
def test_a_place_learns_another_appearance_and_keeps_the_old(version):
    mapper = two_places(version)
    far = mapper.nodes[1]
    day, night = WORLD.at(stay(12.0, 30, 50), noise=0.1, seed=50), seen_by_night(12.0, 30, 51)
    assert recognized(mapper, night, far.id) == 0
    before = recognized(mapper, day, far.id)
    assert before > 0.5
    decision = mapper.maintain(far.id, seen_by_night(12.0, 30, 52))
    assert decision.reason is Reason.MAINTAINED
    assert decision.node == far.id
    assert mapper.nodes[1].modes[0] is far.modes[0]
    assert recognized(mapper, day, far.id) == pytest.approx(before, abs=0.1)
    assert recognized(mapper, night, far.id) > 0.5
    assert mapper.labels()[-30:].tolist() == [far.id] * 30


def test_a_frame_joins_the_mode_that_it_is_like():
    mapper = two_places()
    far = mapper.nodes[1].id
    mapper.maintain(far, seen_by_night(12.0, 30, 52))
    decisions = [mapper.add(frame) for frame in rows(seen_by_night(12.0, 40, 53))]
    joined = [decision.frame for decision in decisions if decision.reason is Reason.ASSIGNED]
    assert joined
    node = mapper.nodes[1]
    assert set(joined) <= set(node.modes[1].frames.tolist())
    assert len(node) == sum(mapper.labels() == node.id)
    assert mapper.graph().nodes[node.id]["modes"] == 2


def test_merging_keeps_the_modes_of_both():
    mapper = two_places()
    near, far = (node.id for node in mapper.nodes)
    mapper.maintain(far, seen_by_night(12.0, 30, 52))
    state = mapper._state.copy()
    found = node_level(state.nodes[far].modes[0].centre, [state.nodes[near]], True)
    assert merge(state, state.nodes[far], 0, found, 0) == near
    (merged,) = state.ordered()
    assert [len(mode) for mode in merged.modes] == [len(mapper.nodes[0]) + len(mapper.nodes[1].modes[0]), 30]
    assert merged.frames == np.flatnonzero(state.labels == near).tolist()
    assert len(mapper.nodes) == 2


def test_nodes_are_as_far_apart_as_their_nearest_modes():
    mapper, point = two_places(), np.zeros(16)
    mapper.maintain(mapper.nodes[1].id, seen_by_night(12.0, 30, 52))
    near, far = ([mode.centre for mode in node.modes] for node in mapper.nodes)
    away = [min(np.linalg.norm(point - centre) for centre in centres) for centres in (near, far)]
    among = min(np.linalg.norm(one - other) for one in near for other in far)
    measured, _ = distinctness(point, mapper.nodes)
    assert list(measured.values()) == pytest.approx([np.mean(away), among])


def test_locating_gives_frame_pose_and_heading():
    mapper = IncrementalMapper(World(size=16, steps=36, reach=4.0, seed=2), 2)
    poses = stay(0.0, 30, 1)
    for frame, pose in zip(rows(mapper.descriptor.at(poses, noise=0.02)), poses, strict=True):
        mapper.add(frame, pose)
    query = poses[7] + [0, 0, 2 * np.pi * 5 / 36]
    found = mapper.locate(mapper.descriptor.at(query, noise=0.0))
    assert found.frame == 7
    assert found.pose == poses[7].tolist()
    assert found.heading == pytest.approx(2 * np.pi * 5 / 36)
    assert found.node == 0


def test_position_alone_where_there_is_no_orientation():
    flat = World(size=16, steps=0, reach=4.0, seed=2)
    mapper = IncrementalMapper(flat)
    for frame in rows(flat.at(stay(0.0, 30, 1))):
        mapper.add(frame)
    found = mapper.locate(flat.at(stay(0.0, 1, 9)))
    assert found.heading is None
    turned = World(size=16, steps=12, reach=4.0, seed=2)
    turned.circular = False
    alike = IncrementalMapper(turned)
    for frame in rows(turned.at(stay(0.0, 30, 1))):
        alike.add(frame)
    assert alike.locate(turned.at(stay(0.0, 1, 9))).heading is None


def test_a_query_unlike_everything_gets_the_least_unlike_node_and_is_told_so():
    mapper = two_places()
    found = mapper.locate(WORLD.at([[12.5, 12.5, 0]], lighting=0.4))
    assert not found.closes
    assert found.scores["candidates"] == []
    assert found.node == mapper.nodes[1].id
