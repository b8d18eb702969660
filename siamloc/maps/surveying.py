"""`survey`: the poses of the frames of drives, from their images and, if there is any, from odometry.

A network that compares panoramas estimates where each frame was taken relative to the frames just before it, and
relative to frames that look alike, though the robot drove far between them: these loops undo the drift. The most likely
poses of all frames are those of a graph of all these measurements, see `siamloc.maps.pose_graph`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Count, Positive, Settings
from siamloc.data.frames import FrameTable
from siamloc.data.moves import composed, relative, wrapped
from siamloc.errors import ConfigError, DataError
from siamloc.maps.describing import build
from siamloc.maps.loops import Loops, Reason, candidates, judged
from siamloc.maps.pose_graph import Array, Edges, PoseGraph, Solution, covariances, solve
from siamloc.maps.reranking import scaled
from siamloc.maps.survey_steps import (
    ODDS,
    compared_steps,
    comparing,
    from_own_start,
    odometry_of,
    odometry_steps,
    start_of,
    wheel_edges,
)

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor
    from siamloc.data.library import PanoramaLibrary

_CONTRADICTED = 0.15  # weight below which a loop is refused
_FEWEST = 10  # frames of a drive
_LEAST_WAY = 1.0  # metres of a drive
_INLIER = 1.5, np.radians(20)  # how far a loop between drives may be off before drift is undone: metres, rad
_MEETING = 3  # loops that must agree about how two drives lie
_VOTERS = 500  # loops at most that are compared with each other for that


@dataclass(frozen=True)
class SurveySettings(Settings):
    """How loops are searched.

    Attributes:
        apart: way between two frames of a drive that may be a loop, at least, in metres.
        alike: number of most similar frames that each frame is compared with, divided evenly among the drives, but at
            least two in each.
    """

    WHERE = "survey"

    apart: Positive = 3.0
    alike: Count = 8


@dataclass(frozen=True, eq=False, repr=False)
class Survey:
    """Surveyed frames (n) and what they follow from.

    Attributes:
        frames: the frames with the surveyed x, y and theta.
        covariance: (n, 3, 3) covariance of x, y and theta, given the poses of the anchors, or of the first frame.
        loops: all loops that were considered, with the reason why each is used or not; rows count in `frames`.
        steps: compared frames that follow each other.
        odometry: (n, 3) the odometry that was used, each drive from its own first frame; NaN where there is none.
        drive: (n,) number of the drive of each frame.
        solution: scales, gyro biases and weights.
        fixed_by: "anchors", "odometry" or "pictures": what fixes the scale. Only anchors fix position and direction of
            the whole; without them the first frame lies at 0 and looks along x.
        notes: sentences about parts of the data that were not used.
    """

    frames: FrameTable
    covariance: Array
    loops: Loops
    steps: Edges
    odometry: Array
    drive: NDArray[np.int64]
    solution: Solution
    fixed_by: str
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Survey({self.summary()})"

    @property
    def deviation(self) -> Array:
        """Standard deviation of each position (n,): the root of the mean variance of x and y."""
        return np.asarray(np.sqrt((self.covariance[:, 0, 0] + self.covariance[:, 1, 1]) / 2))

    def summary(self) -> str:
        """Say in a line how many frames were surveyed, by how many loops, and what fixes their scale."""
        way = sum(
            float(np.hypot(*np.diff(self.frames.xy[self.drive == one], axis=0).T).sum())
            for one in range(int(self.drive.max()) + 1)
        )
        counts = self.loops.counts()
        refused = sum(counts.values()) - counts["accepted"]
        return (
            f"{len(self.frames)} frames along {way:.1f} m; loops: {counts['accepted']} used, {refused} refused; the "
            f"scale follows from the {self.fixed_by}, typical deviation {np.median(self.deviation):.2f} m"
        )

    def report(self) -> dict[str, Any]:
        """Return figures as plain values: frames, loops by reason, scales, biases, residuals and notes."""
        found = relative(self._poses(), self.steps.first, self.steps.second)
        off = found[:, :2] * self.solution.scale - self.steps.pose[:, :2]
        residual = np.hypot(off[:, 0], off[:, 1])
        drives = [name or "(unnamed)" for name in self.frames.rows_by("sequence")]
        wheels = zip(drives, self.solution.wheel_scale.tolist(), self.solution.gyro_bias.tolist(), strict=True)
        return {
            "frames": len(self.frames),
            "drives": drives,
            "scale_from": self.fixed_by,
            "loops": self.loops.counts(),
            "steps": len(self.steps),
            "residual_of_steps": {"median": float(np.median(residual)), "p95": float(np.quantile(residual, 0.95))},
            "deviation": {"median": float(np.median(self.deviation)), "largest": float(self.deviation.max())},
            "length_of_comparisons": self.solution.scale,
            "odometry": {name: {"length": length, "gyro_bias": bias} for name, length, bias in wheels},
            "notes": list(self.notes),
        }

    def _poses(self) -> Array:
        return np.column_stack([self.frames.xy, self.frames.theta])


@typed
def survey(
    network: Descriptor | nn.Module | str,
    images: PanoramaLibrary,
    frames: FrameTable,
    *,
    odometry: ArrayLike | None = None,
    anchors: FrameTable | None = None,
    settings: SurveySettings | None = None,
    progress: bool = True,
) -> Survey:
    """Estimate the poses of the frames of one or several drives; positions in `frames` are not used.

    With odometry, its scale is a little uncertain and its gyro has a bias, both of which are estimated along. Without
    odometry and anchors, the scale is that of the network, which is off by some percent.

    Args:
        network: a network that compares images, built with relative=True; "pretrained" is the shipped one.
        images: panoramas of the frames.
        frames: n frames, in capture order within each drive (`sequence`); the unit of the result is the metre.
        odometry: (n, 3) x, y in metres and heading in rad by the robot's wheels, or by any other source that is right
            over short ways, each drive in a frame of its own; NaN where unknown. Those of `frames` if None.
        anchors: some of the frames, with their true poses, which fix position, direction and scale of the whole.
        settings: how loops are searched.
        progress: whether to show the progress.

    Raises:
        ConfigError: a network that does not compare.
        DataError: a drive with fewer than 10 frames, or one that stands still; odometry in another unit, in degrees or
            of turns with the wrong sign; drives that have no place in common; anchors that are not among the frames, or
            without a pose.

    Example:
        >>> found = siamloc.maps.survey("pretrained", images, monday)  # doctest: +SKIP
        >>> known = siamloc.maps.build("pretrained", images, found.frames)  # doctest: +SKIP
    """
    settings = SurveySettings() if settings is None else settings
    order = np.concatenate([*frames.rows_by("sequence").values(), np.empty(0, np.int64)])
    wheels = frames.odometry if odometry is None else odometry_of(odometry, len(frames))
    frames, wheels = frames.take(order), wheels[order]
    known = build(network, images, frames, progress=progress)
    if not (getattr(known.describes, "compares", False) and known.heading_by_network):
        raise ConfigError(
            "a survey needs a network that compares panoramas: take pretrained, or a network with the head fourier or "
            "magnitudes that was built and trained with relative=True"
        )
    if len(known) < len(frames):  # images that cannot be read
        kept = set(known.frames.identities())
        wheels = wheels[[key in kept for key in frames.identities()]]
        frames = known.frames
    names = list(frames.rows_by("sequence"))
    drive = np.array([names.index(name) for name in frames.sequence.tolist()], dtype=np.int64)
    notes: list[str] = []
    parts = known.turning().orientation
    assert parts is not None
    _check_lengths(drive, names)
    compared = comparing(known.describes.compare, scaled(parts), progress)  # type: ignore[union-attr]
    steps, seen, certain = compared_steps(compared, drive)
    moved = odometry_steps(wheels, seen, certain, drive, names, notes)
    start = start_of(moved, seen, drive)
    _check_ways(start, drive, names)
    way = np.hypot(*np.diff(start[:, :2], axis=0, prepend=start[:1, :2]).T)
    first, second = candidates(known.descriptors, np.cumsum(way), drive, settings.apart, settings.alike)
    loops = judged(first, second, compared, start, drive, ODDS)
    start = _brought_together(start, loops, drive, names)
    fixed, start = _anchored(frames, anchors, start)
    graph = PoseGraph(steps, wheel_edges(moved), drive, fixed)
    graph, solution, loops = _solved(graph, loops, start)
    if not loops.accepted.any():
        notes.append("no loop was found: drift is not undone; a drive that visits places again has loops")
    by = "anchors" if len(fixed) > 1 else "odometry" if np.isfinite(moved).any() else "pictures"
    x, y, theta = solution.poses.T
    surveyed = replace(frames.with_columns(x=x, y=y, theta=wrapped(theta)), unit="m")
    own = from_own_start(wheels, drive)
    return Survey(surveyed, covariances(graph, solution), loops, steps, own, drive, solution, by, tuple(notes))


def _check_lengths(drive: NDArray[np.int64], names: list[str]) -> None:
    for name, count in zip(names, np.bincount(drive).tolist(), strict=True):
        if count < _FEWEST:
            raise DataError(f"drive {name or '(unnamed)'} has {count} frames: a survey needs {_FEWEST} or more of each")


def _check_ways(start: Array, drive: NDArray[np.int64], names: list[str]) -> None:
    for number, name in enumerate(names):
        xy = start[drive == number, :2]
        if np.hypot(*(xy - xy[0]).T).max() < _LEAST_WAY:
            raise DataError(
                f"drive {name or '(unnamed)'} stays within {_LEAST_WAY:g} m of where it begins: a survey needs a drive "
                "that moves"
            )


def _brought_together(start: Array, loops: Loops, drive: NDArray[np.int64], names: list[str]) -> Array:
    """Return start poses (n, 3) with each drive moved to where its loops to the drives before it agree most.

    Raises:
        DataError: a drive that no loops connect with the others.
    """
    start, used = start.copy(), loops.take(loops.accepted)
    placed, waiting = {0}, set(range(1, len(names)))
    while waiting:
        best: tuple[int, int, Array] = 0, -1, np.empty(3)
        for number in waiting:
            here, there = drive[used.first], drive[used.second]
            forward = np.isin(here, list(placed)) & (there == number)
            backward = np.isin(there, list(placed)) & (here == number)
            # Where the drive's start would be: from the frame that is placed, along the loop, back to the start.
            seen = np.concatenate([used.pose[forward], _inverse(used.pose[backward])])
            known = np.concatenate([used.first[forward], used.second[backward]])
            own = np.concatenate([used.second[forward], used.first[backward]])
            some = np.unique(np.linspace(0, len(known) - 1, _VOTERS).astype(np.int64)) if len(known) else known
            origins = composed(composed(start[known[some]], seen[some]), _inverse(start[own[some]]))
            apart = np.hypot(*(origins[:, None, :2] - origins[None, :, :2]).transpose(2, 0, 1))
            turned = np.abs(wrapped(origins[:, None, 2] - origins[None, :, 2]))
            # Far from the start a turn moves the drive: compare where the frames of the loops would be.
            votes = ((apart < _INLIER[0] * 2) & (turned < _INLIER[1])).sum(axis=1) if len(origins) else np.zeros(1)
            if votes.max() > best[0]:
                agreeing = (apart[votes.argmax()] < 2 * _INLIER[0]) & (turned[votes.argmax()] < _INLIER[1])
                mean = origins[agreeing].mean(axis=0)
                heading = origins[agreeing, 2]
                mean[2] = np.arctan2(np.sin(heading).mean(), np.cos(heading).mean())
                best = int(votes.max()), number, mean
        count, number, origin = best
        if count < _MEETING:
            apart_ones = ", ".join(names[one] or "(unnamed)" for one in sorted(waiting))
            raise DataError(
                f"no places were found that {apart_ones} and {names[0] or '(unnamed)'} have in common: survey drives "
                "apart that never meet, or give one more drive that connects them"
            )
        rows = drive == number
        start[rows] = composed(np.tile(origin, (int(rows.sum()), 1)), start[rows])
        placed.add(number)
        waiting.remove(number)
    return start


def _inverse(pose: Array) -> Array:
    """Return poses (n, 3) of the origin as seen from poses."""
    zero = np.zeros((1, 3))
    both = np.concatenate([zero, pose])
    rows = np.arange(1, len(both))
    return relative(both, rows, np.zeros(len(rows), np.int64))


def _anchored(frames: FrameTable, anchors: FrameTable | None, start: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the rows of the anchors, and start poses (n, 3) in their frame."""
    if anchors is None or not len(anchors):
        return np.empty(0, np.int64), start
    rows = {key: row for row, key in enumerate(frames.identities())}
    missing = [key for key in anchors.identities() if key not in rows]
    if missing:
        raise DataError(f"the anchor {missing[0][1]} is not among the {len(frames)} frames of the survey")
    unknown = ~(anchors.has_position & np.isfinite(anchors.theta))
    if unknown.any():
        raise DataError(f"the anchor {anchors.path[unknown][0]} has no pose: give its x, y and theta")
    fixed = np.array([rows[key] for key in anchors.identities()])
    true = np.column_stack([anchors.xy, anchors.theta])
    origins = composed(true, _inverse(start[fixed]))
    # The start is moved as a whole to the first anchor; all anchors then take their own poses.
    start = composed(np.tile(origins[0], (len(start), 1)), start)
    start[fixed, :2] = true[:, :2]
    start[fixed, 2] += wrapped(true[:, 2] - start[fixed, 2])
    return fixed, start


def _solved(graph: PoseGraph, loops: Loops, start: Array) -> tuple[PoseGraph, Solution, Loops]:
    """Solve the graph with the accepted loops, refuse those that it contradicts, and solve again until none is left."""
    reason, steps = loops.reason.copy(), graph.pictures
    while True:
        used = np.flatnonzero(reason == Reason.ACCEPTED)
        edges = Edges(loops.first[used], loops.second[used], loops.pose[used], loops.information[used])
        graph = replace(graph, pictures=Edges.concatenate([steps, edges]))
        solution = solve(graph, start)
        weight = np.zeros(len(loops))
        weight[used] = solution.weight[len(steps) :]
        wrong = used[weight[used] < _CONTRADICTED]
        if not len(wrong):
            return graph, solution, replace(loops, reason=reason, weight=weight)
        reason[wrong] = Reason.CONTRADICTED
        start = solution.poses
