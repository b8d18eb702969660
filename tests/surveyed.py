"""A small survey that tests draw and write."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from siamloc.data import FrameTable
from siamloc.maps.loops import Loops, Reason
from siamloc.maps.pose_graph import Edges, PoseGraph, Solution
from siamloc.maps.surveying import Survey


def a_survey(folder: Path = Path()) -> Survey:
    """Two drives of six frames around an ellipse, with four loops."""
    n = 12
    angle = 2 * np.pi * np.arange(n) / 6
    frames = FrameTable(
        path=[str(folder / f"{row}.png") for row in range(n)],
        **{"x": 4 * np.cos(angle), "y": 2 * np.sin(angle), "theta": angle + np.pi / 2},
        deviation=np.full(n, 0.1), theta_deviation=np.full(n, 0.02), sequence=["monday"] * 6 + ["tuesday"] * 6,
        odom_x=np.arange(n), odom_y=np.zeros(n), odom_theta=np.zeros(n),
    )  # fmt: skip
    reason = np.array([Reason.ACCEPTED, Reason.ACCEPTED, Reason.CONTRADICTED, Reason.ALONE], dtype=object)
    pose, sure = np.zeros((4, 3)), np.tile(np.eye(3), (4, 1, 1))
    loops = Loops(np.array([0, 1, 2, 3]), np.array([6, 7, 11, 9]), pose, sure, np.ones(4), reason, np.ones(4))
    steps = Edges(np.arange(5), np.arange(1, 6), np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1)))
    drive = np.repeat([0, 1], 6)
    solution = Solution(np.zeros((n, 3)), 1.0, np.ones(2), np.zeros(2), np.ones(7), 0.0)
    wheels = steps.take(slice(0, 3))  # of monday
    graph = PoseGraph(steps, wheels, drive, np.empty(0, np.int64))
    return Survey(frames, np.tile(np.eye(3), (n, 1, 1)), 0.01, loops, graph, solution, "odometry")
