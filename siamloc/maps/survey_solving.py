"""Solve the graph of a survey: which loops are true, and what the solution says against anchors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.data.moves import relative, wrapped
from siamloc.maps.loops import Loops, Reason, judged_again
from siamloc.maps.pose_graph import Array, Edges, PoseGraph, Solution, solve
from siamloc.maps.survey_steps import BEFORE

_DOUBTED = 0.1  # weight of comparisons below which they contradict the solution: 6 deviations
_TORN = 0.75  # metres by which the solution contradicts a step, from which on a drive is torn there
_TURNED = 0.5  # rad by which anchors contradict a step, from which on a drive is torn there
_ENOUGH = 1e-3  # m or rad to which a graph is solved to judge its loops
_ROUGHLY = 1e6  # degrees of freedom with which no measurement is weighted down


def solved(graph: PoseGraph, loops: Loops, start: Array) -> tuple[PoseGraph, Solution, Loops]:
    """Solve the graph with the accepted loops, judge all of them again, and solve until nothing changes.

    A refused loop is accepted once at most, after all contradicted ones are out.
    """
    reason, steps, may_return = loops.reason.copy(), graph.pictures, True
    starts: list[Array | Solution] = [start]
    while True:
        used = np.flatnonzero(reason == Reason.ACCEPTED)
        graph = replace(graph, pictures=Edges.concatenate([steps, loops.take(used)]))
        if starts[0] is start:  # a robust solution that begins far off may take what is right for wrong
            starts.append(solve(graph, start, _ROUGHLY).poses)
        solution = min((solve(graph, one, enough=_ENOUGH) for one in starts), key=lambda one: one.cost)
        weight = np.zeros(len(loops))
        weight[used] = solution.weight[len(steps) :]
        loops, starts = replace(loops, reason=reason.copy(), weight=weight), [solution]
        seen = relative(solution.poses, loops.first, loops.second) * [solution.scale, solution.scale, 1]
        contradicted, confirmed = judged_again(loops, seen)
        if contradicted.any():
            reason[contradicted] = Reason.CONTRADICTED
        elif may_return and confirmed.any():
            reason[confirmed], may_return = Reason.ACCEPTED, False
        else:
            solution = solve(graph, solution)
            weight[used] = solution.weight[len(steps) :]
            return graph, solution, replace(loops, weight=weight)


def solution_notes(
    frames: FrameTable, graph: PoseGraph, whole: PoseGraph, solution: Solution, loops: Loops
) -> list[str]:
    """Return sentences about missing loops, and about anchors or loops that the images contradict.

    Args:
        frames: the frames (n).
        graph: steps and odometry.
        whole: the same with the accepted loops.
        solution: what follows from it.
        loops: judged loops.
    """
    notes = []
    if not loops.accepted.any():
        found = "contradict all other measurements" if (loops.reason == Reason.CONTRADICTED).any() else "were not found"
        notes.append(f"loops {found}: drift is not undone; a drive that visits places again has loops")
    anchored, torn = len(graph.fixed) > 1, torn_before(graph, solution)
    if anchored and (doubted := _doubted_anchors(whole, solution)).size:
        notes.append(
            f"{doubted.size} of {len(graph.fixed)} anchors contradict the images around them, the first is "
            f"{frames.path[doubted[0]]}: check their poses"
        )
    elif torn.size:
        name, before = frames.sequence[torn[0]], int((graph.drive[: torn[0]] == graph.drive[torn[0]]).sum())
        where = f"drive {name or '(unnamed)'} is torn before its frame {before}"
        places = f", the first of {torn.size} places" if torn.size > 1 else ""
        notes.append(
            f"the anchors contradict the images: {where}: check the poses of the anchors, in metres and rad"
            if anchored
            else f"loops contradict the images: {where} ({frames.path[torn[0]]}){places}: places may look the same, "
            "which odometry tells apart, or something moved beside the robot there: then leave these frames out"
        )
    return notes


def _doubted_anchors(graph: PoseGraph, solution: Solution) -> NDArray[np.int64]:
    """Return the rows of the fixed frames whose comparisons with others the solution weighs down, most of them."""
    ends = np.concatenate([graph.pictures.first, graph.pictures.second])
    votes = np.bincount(ends, np.where(np.tile(solution.weight, 2) < _DOUBTED, 1, -1), minlength=len(graph.drive))
    return graph.fixed[votes[graph.fixed] > 0]


def residual_of_steps(graph: PoseGraph, solution: Solution) -> Array:
    """Return by how many metres a solution contradicts each step that was compared (n,)."""
    steps = graph.pictures
    off = relative(solution.poses, steps.first, steps.second)[:, :2] * solution.scale - steps.pose[:, :2]
    return np.hypot(off[:, 0], off[:, 1])


def torn_before(graph: PoseGraph, solution: Solution) -> NDArray[np.int64]:
    """Return the frames before which a drive is torn: the solution contradicts all steps across, by their weights.

    Where images are unlike, so that only the step to the next frame is known, it may be a little wrong: a drive is torn
    there if it is far off, for anchors also in its turn. Without anchors, that is so even if other steps across, over a
    tear beside it, agree; and odometry across holds a drive together all the same.
    """
    steps = graph.pictures
    weight = solution.weight[: len(steps)]
    across, count = np.full(len(graph), np.nan), np.zeros(len(graph), dtype=int)
    for later in range(1, max(BEFORE) + 1):
        there = steps.first + later <= steps.second
        np.fmax.at(across, (steps.first + later)[there], weight[there])
        np.add.at(count, (steps.first + later)[there], 1)
    doubted = (steps.second == steps.first + 1) & (weight < _DOUBTED)
    far = doubted & (residual_of_steps(graph, solution) > _TORN)
    torn, several = across < _DOUBTED, count > 1
    if len(graph.fixed) < 2:
        torn = torn & several | np.isin(np.arange(len(graph)), steps.second[far])
        torn &= ~np.isin(np.arange(len(graph)), graph.wheels.second)
    else:
        turns = relative(solution.poses, steps.first, steps.second)[:, 2] - steps.pose[:, 2]
        far |= doubted & (np.abs(wrapped(turns)) > _TURNED)
        torn &= several | np.isin(np.arange(len(graph)), steps.second[far])
    return np.flatnonzero(torn)
