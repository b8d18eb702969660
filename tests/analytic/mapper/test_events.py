import json

import numpy as np
import pytest

from analytic import AnalyticError
from analytic.mapper import IncrementalMapper, Reason, replay
from tests.analytic.mapper.world import FRAMES, POSES, WORLD, mapped


@pytest.mark.parametrize("version", [1, 2])
def test_the_log_gives_the_labels_at_every_frame(version):
    mapper = IncrementalMapper(WORLD, version)
    happened = set()
    for index, (frame, pose) in enumerate(zip(FRAMES, POSES, strict=True)):
        decision = mapper.add(frame, pose)
        happened |= {change.reason for change in decision.changes}
        if decision.changes or index % 40 == 0:
            assert np.array_equal(replay(mapper.events), mapper.labels())
    assert happened >= ({Reason.NODE_PARKED} if version == 1 else {Reason.NODES_MERGED, Reason.REASSIGNED})


def test_a_line_says_what_the_decision_said():
    mapper = IncrementalMapper(WORLD)
    for frame, pose in zip(FRAMES[:30], POSES, strict=False):
        decision = mapper.add(frame, pose)
    head, line = json.loads(mapper.events[0]), json.loads(mapper.events[-1])
    assert head["parameters"]["omega"] == 1.85
    assert head["descriptor"] == WORLD.identity
    assert line["frames"] == [29]
    assert line["poses"] == [POSES[29].tolist()]
    assert Reason[line["reason"]] is decision.reason
    assert line["node"] == decision.node
    assert line["scores"]["x"] == pytest.approx(decision.scores["x"])
    assert line["scores"]["nodes"]["0"] == pytest.approx(decision.scores["nodes"]["0"], rel=1e-5)


def test_maintenance_is_in_the_log():
    mapper = mapped(25)
    mapper.maintain(0, WORLD.at(POSES[:12], lighting=1.0), frames=[f"night {n}" for n in range(12)])
    assert np.array_equal(replay(mapper.events), mapper.labels())
    line = json.loads(mapper.events[-1])
    assert line["reason"] == "MAINTAINED"
    assert line["poses"][3] == "night 3"


def test_what_is_forgotten_leaves_its_node_and_is_in_the_log(tmp_path):
    mapper = mapped(25)
    before, smallest = mapper.labels(), mapper.parameters.smallest_node
    gone = mapper.forget([3, 4])
    assert gone == [3, 4]
    after = mapper.labels()
    assert (np.flatnonzero(before != after) == [3, 4]).all()
    assert (after[[3, 4]] == -1).all()
    assert not {3, 4} & {frame for node in mapper.nodes for frame in node.frames}
    assert np.array_equal(replay(mapper.events), after)
    assert json.loads(mapper.events[-1])["reason"] == "FORGOTTEN"
    assert mapper.locate(WORLD.at(POSES[3:4])).frame not in (3, 4)
    node = mapper.nodes[0]
    assert mapper.forget(node.frames[: len(node) - smallest + 1]) == [], "the node would be too small"
    assert mapper.forget([]) == []
    mapper.save(tmp_path / "mapper.npz")
    again = type(mapper).load(tmp_path / "mapper.npz", mapper.descriptor)
    assert np.array_equal(again.labels(), after)
    with pytest.raises(AnalyticError, match="is read-only"):
        again.forget([5])
    with pytest.raises(AnalyticError, match="the map has no frame 25: it has 25"):
        mapper.forget([25])


@pytest.mark.parametrize(
    ("events", "says"),
    [
        (['{"format": "analytic.mapper.log", "version": 2}'], "in version 2, not analytic.mapper.log in version 1"),
        (['{"frames": [0], "node": nul'], "event 1 of the log is not a line that a mapper wrote"),
        (['{"frames": [3], "node": null, "changes": []}'], r"event 1 .* about frames \[3\], but 0 came before"),
    ],
)
def test_what_is_no_log_is_refused(events, says):
    with pytest.raises(AnalyticError, match=says):
        replay(events)


def test_an_empty_log_is_an_empty_map():
    assert replay([]).tolist() == []
    assert replay(["", '{"frames": [0], "node": null, "changes": []}']).tolist() == [-1]
