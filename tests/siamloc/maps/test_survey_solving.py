"""What a solved survey says of drives that are torn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.data.moves import chained, relative
from siamloc.maps.loops import Loops, Reason
from siamloc.maps.pose_graph import Edges, PoseGraph
from siamloc.maps.survey_solving import solution_notes, solved
from siamloc.maps.survey_steps import BEFORE

ROUND, AGAIN = 50, 10  # frames of a circle of 3 m, and of its second round


def notes(
    turns_less=0.0, wrong_at=None, wrong_by=1.2, wrong_turn=0.0, unlike=False, alone=False, wheels=False, anchors=()
) -> list[str]:
    """The notes of a robot that drives in a circle, whose loops are right.

    Args:
        turns_less: share by which the turns of its steps are seen too small.
        wrong_at: a frame before which the robot is seen to drive some metres that it does not drive.
        wrong_by: these metres.
        wrong_turn: radians that it is seen to turn there, too, and does not.
        unlike: whether images are unlike there: only the step to the next one is known, and doubted.
        alone: whether only that step is known there, for certain.
        wheels: whether it has odometry, which is right.
        anchors: frames whose poses are known.
    """
    t = 2 * np.pi * np.arange(ROUND + AGAIN) / ROUND
    true = np.column_stack([3 * np.sin(t), 3 * (1 - np.cos(t)), t])
    first = np.concatenate([np.arange(len(t) - back) for back in BEFORE])
    second = np.concatenate([np.arange(back, len(t)) for back in BEFORE])
    across = np.zeros(len(first), dtype=bool) if wrong_at is None else (first < wrong_at) & (second >= wrong_at)
    kept = (second == first + 1) | ~(across & (unlike or alone))
    first, second, across = first[kept], second[kept], across[kept]
    information = np.diag([1 / 0.03**2, 1 / 0.03**2, 1 / 0.015**2])
    known = np.where(across & unlike, 0.01, 1)[:, None, None] * information
    steps = Edges(first, second, relative(true, first, second), known)
    next_one = second == first + 1
    rolled = replace(steps, pose=steps.pose.copy()).take(next_one if wheels else slice(0, 0))
    steps.pose[:, 2] *= 1 - turns_less
    steps.pose[across] += [wrong_by, 0, wrong_turn]
    again, before = (part.ravel() for part in np.mgrid[ROUND : ROUND + AGAIN, 0:AGAIN])
    loops = Loops(
        before,
        again,
        relative(true, before, again),
        np.tile(information, (len(again), 1, 1)),
        np.full(len(again), 5.0),
        np.full(len(again), Reason.ACCEPTED, dtype=object),
        np.zeros(len(again)),
    )
    drive = np.zeros(len(t), dtype=np.int64)
    graph = PoseGraph(steps, rolled, drive, np.array(anchors, dtype=np.int64))
    start = true if anchors else chained(np.concatenate([np.zeros((1, 3)), steps.pose[next_one]]))
    frames = FrameTable(path=[f"{row}.jpg" for row in range(len(t))], sequence=["monday"] * len(t))
    whole, solution, loops = solved(graph, loops, start)
    return solution_notes(frames, graph, whole, solution, loops)


def test_a_drive_that_loops_tear_is_named():
    assert not notes()
    assert "loops contradict the images: drive monday is torn before its frame" in notes(turns_less=0.1)[0]
    (said,) = notes(wrong_at=30)
    assert "torn before its frame 30 (30.jpg): places may look the same" in said


def test_a_drive_that_one_certain_step_holds_together_is_torn_where_loops_contradict_it():
    (said,) = notes(wrong_at=30, alone=True)
    assert "torn before its frame 30 (30.jpg): places may look the same" in said


@pytest.mark.parametrize("given", ["wheels", "unlike"])
def test_what_odometry_holds_together_is_not_torn_and_what_images_do_not_show_may_be(given):
    assert not notes(wrong_at=30, **{given: True})


def test_anchors_contradict_images_that_show_well_how_the_robot_drove():
    around = (0, 29, 30, 59)
    assert "the anchors contradict the images" in notes(wrong_at=30, anchors=around)[0]
    assert "the anchors contradict the images" in notes(wrong_at=30, alone=True, wheels=True, anchors=around)[0]
    assert not notes(wrong_at=30, wrong_by=0.5, alone=True, wheels=True, anchors=around)
    assert "the anchors contradict" in notes(wrong_at=30, wrong_by=0, wrong_turn=1.0, alone=True, anchors=around)[0]
