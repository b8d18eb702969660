"""Candidates for loops, and which of them agree."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.data.moves import relative
from siamloc.maps.loops import Loops, Reason, agreed, agreeing, judged_again, loops_of, most_alike
from siamloc.maps.pose_graph import Edges


@pytest.mark.parametrize("seed", range(3))
def test_candidates_are_the_most_similar_frames_far_away_along_the_path(seed):
    rng = np.random.default_rng(seed)
    n, k, apart = 40, 8, 4.0
    descriptors = rng.normal(size=(n, 5)).astype(np.float32)
    drive = np.repeat([0, 1, 2], [15, 15, 10])
    path = np.cumsum(rng.uniform(0, 1, n))
    expected = set()
    for row in range(n):
        for other in range(3):
            usable = [
                j for j in range(n) if drive[j] == other and (other != drive[row] or abs(path[j] - path[row]) >= apart)
            ]
            usable.sort(key=lambda j: float(np.square(descriptors[row] - descriptors[j]).sum()))
            expected |= {(min(row, j), max(row, j)) for j in usable[:3]}  # 8 in three drives
    first, second = most_alike(descriptors, path, drive, apart, k)
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == sorted(expected)


def two_rounds(count: int = 20) -> np.ndarray:
    angle = 2 * np.pi * np.arange(2 * count) / count
    return np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), angle + np.pi / 2])


def true_loops(poses, first, second) -> Loops:
    pose = relative(poses, first, second)
    return loops_of(Edges(first, second, pose, np.tile(np.eye(3), (len(first), 1, 1))), np.full(len(first), 5.0))


def test_loops_of_neighbouring_frames_agree_unless_one_is_wrong():
    poses = two_rounds()
    first = np.arange(20)
    loops = true_loops(poses, first, first + 20)
    drive = np.zeros(40, dtype=np.int64)
    counts = agreeing(loops, poses, drive)
    inner = np.minimum(3, first) + np.minimum(3, 19 - first)  # loops at most three frames to either side
    assert counts.tolist() == inner.tolist()
    loops.pose[10, 0] += 2.0
    counts = agreeing(loops, poses, drive)
    assert counts[10] == 0
    assert counts[9] == inner[9] - 1
    # A drive whose whole path is off still tells how the robot moved over a few frames.
    drifted = poses.copy()
    drifted[:, 2] += 0.7
    turned = relative(drifted, first, first + 20)
    assert np.abs(turned - loops.pose).max() > 0.5
    bent = np.column_stack([np.cos(0.7) * poses[:, 0] - np.sin(0.7) * poses[:, 1] + 5,
                            np.sin(0.7) * poses[:, 0] + np.cos(0.7) * poses[:, 1], poses[:, 2] + 0.7])  # fmt: skip
    assert agreeing(loops, bent, drive).tolist() == counts.tolist()


def test_frames_of_two_drives_are_no_neighbours():
    poses = two_rounds()
    first = np.array([18, 19, 20, 21])
    loops = true_loops(poses, np.array([0, 1, 2, 3]), first)
    one = agreeing(loops, poses, np.zeros(40, dtype=np.int64))
    two = agreeing(loops, poses, np.repeat([0, 1], 20))
    assert one.tolist() == [3, 3, 3, 3]
    assert two.tolist() == [1, 1, 1, 1]


def test_each_loop_has_its_reason():
    poses = two_rounds()
    first, second = np.arange(8), np.arange(8) + 20
    wrong = 6
    pose = relative(poses, first, second)
    pose[wrong] += [1.5, 0.0, 0.0]
    edges = Edges(first, second, pose, np.tile(np.eye(3), (8, 1, 1)))
    loops = loops_of(edges, np.where(first == 2, -1.0, 4.0))
    loops, none = (agreed(one, poses, np.zeros(40, dtype=np.int64)) for one in (loops, loops.take(slice(0))))
    assert [reason.name for reason in loops.reason] == [
        "ACCEPTED", "ACCEPTED", "UNLIKE", "ACCEPTED", "ACCEPTED", "ACCEPTED", "ALONE", "ACCEPTED",
    ]  # fmt: skip
    assert loops.counts() == {"accepted": 6, "unlike": 1, "alone": 1, "contradicted": 0}
    assert loops.accepted.sum() == 6
    assert none.counts()["accepted"] == 0


def test_a_solution_judges_loops_again():
    poses, n = two_rounds(), 6
    loops = true_loops(poses, np.arange(n), np.arange(n) + 20)
    found = loops.pose.copy()
    loops.reason[:] = Reason.ACCEPTED
    loops.reason[3:] = [Reason.ALONE, Reason.CONTRADICTED, Reason.UNLIKE]
    loops.pose[1, 0] += 0.5  # far off, whatever weight its uncertainty leaves
    loops.pose[2, 2] += np.pi * 2 + 0.05
    loops.information[2] *= 40_000  # near, but certain of something else
    contradicted, confirmed = judged_again(loops, found)
    assert np.flatnonzero(contradicted).tolist() == [1, 2]
    assert np.flatnonzero(confirmed).tolist() == [3, 4]
    loops.pose[3, 0] += 0.5
    loops.pose[4, 2] += 0.2
    assert not judged_again(loops, found)[1].any()
