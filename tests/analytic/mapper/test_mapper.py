import copy
import pickle
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from analytic.descriptors.base import Description
from analytic.mapper import IncrementalMapper, Reason
from analytic.mapper import mapper as mapper_module
from tests.analytic.mapper.world import FRAMES, WIDE, WIDE_FRAMES, WORLD, World, cold_drive, corridor_drive, rows
from tests.oracles.mapper import SlowMapper


def feed(mapper, frames, poses=None):
    poses = [None] * len(frames) if poses is None else poses
    return [mapper.add(frame, pose) for frame, pose in zip(frames, poses, strict=True)]


def between_two_of_six():
    """Stay at four near places and two far ones, then go between the far ones at every frame."""
    near = [[0, 0, 0], [3, 0, 0], [0, 3, 0], [3, 3, 0]]
    stays = [[place] * 35 for place in [*near, [60, 60, 0], [66, 60, 0]]]
    return np.concatenate([*stays, [[60, 60, 0], [66, 60, 0]] * 20]).astype(float)


def compare(mapper, slow, frames):
    """Add frames to both; the labels of all frames must agree after each. Return what happened."""
    seen: Counter[str] = Counter()
    for frame in frames:
        decision = mapper.add(frame)
        slow.add(frame.position[0], None if frame.orientation is None else frame.orientation[0])
        assert mapper.labels().tolist() == slow.labels
        assert decision.node == (None if slow.labels[-1] == -1 else slow.labels[-1])
        seen[decision.reason.name] += 1
        for change in decision.changes:
            seen[f"{change.reason.name} {change.scores.get('trigger', '')}".strip()] += 1
    for node in mapper.nodes:
        assert node.frames == np.flatnonzero(mapper.labels() == node.id).tolist()
    return seen


@pytest.mark.parametrize(
    ("world", "version", "parameters", "happens"),
    [
        (WORLD, 1, {}, {"NODE_PARKED", "JOINED_PARKED"}),
        (WORLD, 1, {"two_sided": False, "y": 0.5}, {"NODE_PARKED"}),
        (WORLD, 2, {"y": 1.5}, {"NODES_MERGED", "REASSIGNED"}),
        (WIDE, 1, {}, {"NODE_PARKED"}),
        (WIDE, 2, {"y": 2.5}, {"NODES_MERGED", "REASSIGNED"}),
        (WIDE, 2, {"y": 2.5, "two_sided": False}, set()),
    ],
)
def test_every_decision_is_that_of_the_oracle(world, version, parameters, happens):
    mapper, slow = IncrementalMapper(world, version, **parameters), SlowMapper(version, **parameters)
    seen = compare(mapper, slow, FRAMES if world is WORLD else WIDE_FRAMES)
    assert happens | {"ASSIGNED", "NO_CANDIDATE_NODE"} <= set(seen)
    assert any(mode.scatter is None for node in mapper.nodes for mode in node.modes) or world is WORLD


# With more numbers than frames in a node, as images have.
REAL = [
    ("freiburg_seq2_cloudy1", 8, 0.1, 3.0, 1, {}, {"NEW_NODE consecutive", "JOINED_PARKED", "MOVES_CENTROID"}),
    ("freiburg_seq2_cloudy1", 12, 0.3, 3.0, 1, {"gamma": 15.0}, {"NOT_PROMINENT", "NODES_MERGED", "NODE_PARKED"}),
    ("freiburg_seq2_cloudy1", 12, 0.3, 3.0, 2, {"y": 0.5}, {"NEW_NODE forced", "REASSIGNED"}),
    ("freiburg_seq2_cloudy1", 12, 0.3, 1.5, 2, {"y": 3.0}, {"REASSIGNED", "NODES_MERGED"}),
    ("saarbruecken_seq1_cloudy1", 8, 0.3, 1.5, 2, {}, {"NEW_NODE forced", "REASSIGNED", "NODES_MERGED"}),
]


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("name", "size", "noise", "reach", "version", "parameters", "happens"), REAL)
def test_every_decision_on_real_drives_is_that_of_the_oracle(name, size, noise, reach, version, parameters, happens):
    poses = cold_drive(name)
    world = World(size=size, steps=0, reach=reach, seed=3)
    every = 4 if name.startswith("freiburg") else 2
    frames = rows(world.at(poses[::every][:400], noise=noise, seed=1))
    seen = compare(IncrementalMapper(world, version, **parameters), SlowMapper(version, **parameters), frames)
    assert happens <= set(seen)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_every_decision_under_drawn_settings_is_that_of_the_oracle(seed):
    generator = np.random.default_rng(seed)
    size, steps = int(generator.choice([4, 8, 16, 40, 96])), int(generator.choice([0, 8, 12]))
    world = World(size=size, steps=steps, reach=float(generator.choice([2, 4, 6, 8])), seed=seed)
    poses = corridor_drive(200, seed=seed, rooms=int(generator.integers(3, 8)))
    frames = rows(world.at(poses, noise=float(generator.choice([0.05, 0.1, 0.2, 0.3])), seed=seed))
    version = 1 + seed % 2
    parameters = {
        "y": float(generator.choice([0.5, 1.5, 2.5, 3.5])),
        "omega": float(generator.choice([1.7, 1.85, 2.3])),
        "gamma": float(generator.choice([2.0, 5.0, 15.0])),
        "two_sided": bool(generator.integers(2)),
        "merge": str(generator.choice(["changed", "created", "never"])),
    }
    compare(IncrementalMapper(world, version, **parameters), SlowMapper(version, **parameters), frames)


@pytest.mark.data
def test_a_parked_candidate_becomes_a_node_and_the_oldest_is_forgotten():
    poses = cold_drive("freiburg_seq2_cloudy1")
    world = World(size=4, steps=8, reach=4.0, seed=3)
    mapper = IncrementalMapper(world, parked_nodes=1)
    frames = rows(world.at(poses[::2][:400], noise=0.1, seed=1))
    changes = [(decision, change) for decision in feed(mapper, frames) for change in decision.changes]
    promoted = [(d, c) for d, c in changes if c.scores.get("trigger") == "parked"]
    assert promoted
    for decision, change in promoted:
        assert decision.frame in change.frames
        assert len(change.frames) > mapper.parameters.new_node
        assert change.scores["distance"] >= change.scores["least_distance"]
    parked = [c.node for _, c in changes if c.reason is Reason.NODE_PARKED]
    forgotten = [c.node for _, c in changes if c.reason is Reason.PARKED_FORGOTTEN]
    assert forgotten
    assert forgotten == sorted(set(parked) - {c.node for _, c in promoted})[: len(forgotten)]


def test_a_robot_that_keeps_changing_node_gets_a_node_between():
    world = World(size=12, steps=0, reach=8.0, seed=2)
    frames = rows(world.at(between_two_of_six(), noise=0.05, seed=3))
    mapper, slow = IncrementalMapper(world, 2, merge="never"), SlowMapper(2, merge="never")
    seen = compare(mapper, slow, frames)
    assert seen["NEW_NODE changes"] >= 1


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("exemplars", [None, 12])
def test_scores_explain_each_decision(version, exemplars):
    mapper = IncrementalMapper(WORLD, version, exemplars=exemplars)
    for decision in feed(mapper, FRAMES):
        scores = decision.scores
        if decision.reason is Reason.FIRST_FRAMES or "candidates" not in scores:
            continue
        closing = [
            int(node)
            for node, (distance, mean, std) in scores["nodes"].items()
            if abs(distance - mean) <= scores["x"] * std
        ]
        assert closing == scores["candidates"]
        if decision.reason is Reason.ASSIGNED:
            assert scores["centroid_shift"] <= scores["most_centroid_shift"]
            assert scores["node"] in closing
            assert decision.node == scores["node"]
        if decision.reason is Reason.NOT_PROMINENT:
            assert scores["prominence"] < scores["least_prominence"]
        if decision.reason is Reason.MOVES_CENTROID:
            assert scores["centroid_shift"] > scores["most_centroid_shift"]
        if decision.reason is Reason.NO_CANDIDATE_NODE:
            assert not closing
            assert decision.node is None


@pytest.mark.parametrize("seed", [5, 16])
def test_a_node_keeps_one_of_its_bounded_exemplars_when_frames_leave_it(seed):
    world = World(size=8, steps=0, reach=6.0, seed=seed)
    mapper = IncrementalMapper(world, 2, exemplars=2)
    for frame in rows(world.at(corridor_drive(200, seed=seed, rooms=5), noise=0.2, seed=seed)):
        mapper.add(frame)
        assert all(len(mode.gallery) for node in mapper.nodes for mode in node.modes)


@pytest.mark.parametrize("version", [1, 2])
def test_an_interruption_at_any_line_leaves_the_map_as_it_was(version):
    """Interrupt one of the many lines that work in a frame, and in turn each of those that make it part of the map."""
    calm, shaken = IncrementalMapper(WORLD, version), IncrementalMapper(WORLD, version)
    generator = np.random.default_rng(version)
    keeping = ("_commit",)
    for index, frame in enumerate(FRAMES[:90]):
        with Interrupted() as lines:
            calm.add(frame)
        before = (shaken.labels().tolist(), shaken.events, shaken.poses)
        # Not in the last third, since a second try finds some things computed.
        anywhere = Interrupted(int(generator.integers(1, 2 * len(lines.passed) // 3)))
        kept = [name for name in lines.passed if name in keeping]
        for interrupted in (anywhere, Interrupted(1 + index % len(kept), keeping)):
            with pytest.raises(KeyboardInterrupt), interrupted:
                shaken.add(frame)
            assert (shaken.labels().tolist(), shaken.events, shaken.poses) == before
        shaken.add(frame)
    assert shaken.events == calm.events


class Interrupted:
    """Raise KeyboardInterrupt before one of the lines of the mapper, or of some of its functions, counted from 1."""

    def __init__(self, line=None, functions=None):
        self.line, self.functions, self.passed = line, functions, []
        self.own = str(Path(mapper_module.__file__).parent)

    def __enter__(self):
        self.tracing = sys.gettrace()
        sys.settrace(self.trace)
        return self

    def __exit__(self, *_):
        sys.settrace(self.tracing)

    def trace(self, frame, *_):
        code = frame.f_code
        if not code.co_filename.startswith(self.own):
            return None
        return self.count if self.functions is None or code.co_name in self.functions else None

    def count(self, frame, event, _):
        if event == "line":
            self.passed.append(frame.f_code.co_name)
            if len(self.passed) == self.line:
                raise KeyboardInterrupt
        return self.count


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda mapper: pickle.loads(pickle.dumps(mapper))])
def test_a_copy_goes_on_as_the_map_does_and_leaves_it_alone(version, copied):
    frames, half = FRAMES, 130
    mapper = IncrementalMapper(WORLD, version)
    feed(mapper, frames[:half])
    other, again = copied(mapper), copied(mapper)
    feed(again, frames[half:][::-1])
    assert feed(other, frames[half:]) == feed(mapper, frames[half:])
    assert other.events == mapper.events


@pytest.mark.parametrize("size", [6, 96])
def test_a_robot_that_stops_stays_in_its_node_though_the_held_out_frames_are_all_equal(size):
    """Their distances then have no spread, and rounding alone must not distinguish the next equal frame from them."""
    for seed in range(12):
        world = World(size=size, steps=0, reach=4.0, seed=seed)
        frames = rows(world.at(corridor_drive(5, seed=seed), noise=0.2, seed=seed))
        mapper = IncrementalMapper(world, 2)
        decisions = feed(mapper, [*frames[:4], *[frames[4]] * 30])
        (mode,) = mapper.nodes[0].modes
        assert len(np.unique(mode.points[mode.held], axis=0)) == 1
        assert {decision.reason for decision in decisions[20:]} == {Reason.ASSIGNED}


def test_labels_and_nodes_are_copies_of_what_the_map_holds():
    mapper = IncrementalMapper(WORLD)
    position, turned = FRAMES[0].position.copy(), FRAMES[0].orientation.copy()
    mapper.add(Description(position, turned))
    position[:] = np.inf
    mapper.labels()[:] = 7
    assert mapper.labels().tolist() == [-1]
    feed(mapper, FRAMES[1:20])
    assert np.isfinite(mapper.nodes[0].modes[0].centre).all()
