"""`survey`: the poses of the frames of drives, from their images and, if there is any, from odometry.

A network that compares panoramas estimates where each frame was taken relative to the frames just before it, and
relative to frames that look alike, though the robot drove far between them: these loops undo the drift. The most likely
poses of all frames are those of a graph of all these measurements, see `siamloc.maps.pose_graph`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Count, Positive, Settings
from siamloc.data.checks import wrong_odometry
from siamloc.data.frames import FrameTable
from siamloc.data.mounting import estimate
from siamloc.data.moves import way_along, wrapped
from siamloc.errors import DataError
from siamloc.maps.comparing import Compares, scaled
from siamloc.maps.describing import UNPOSED_YAW, build
from siamloc.maps.floor import (
    DEVIATION,
    Floor,
    FloorScale,
    elevations_known,
    floor_scale,
    lengthening,
    seen_by_all,
    shows_floor,
)
from siamloc.maps.loops import Loops, agreed, checked_pairs, far_apart, loops_of, most_alike
from siamloc.maps.pose_graph import SCALE, Array, Edges, PoseGraph, Solution, covariances, of_shape
from siamloc.maps.survey_checks import check_drives, check_lengths, comparing_descriptor
from siamloc.maps.survey_solving import residual_of_steps, solution_notes, solved, torn_before
from siamloc.maps.survey_start import anchored, brought_together, check_anchors, of_drives
from siamloc.maps.survey_steps import (
    compared_steps,
    comparing,
    odometry_of,
    odometry_steps,
    start_of,
    wheel_edges,
    with_odometry,
)

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor
    from siamloc.data.library import PanoramaLibrary
    from siamloc.maps.visual_map import VisualMap

_BY_ODOMETRY = 0.9  # share of the steps whose odometry is known from which on the floor is not needed


@dataclass(frozen=True)
class SurveySettings(Settings):
    """How loops are searched, how exact odometry is, and how high the camera is.

    Attributes:
        apart: way between two frames of a drive that may be a loop, at least, in metres.
        alike: number of most similar frames that each frame is compared with, divided evenly among the drives, but at
            least two in each.
        drift: standard deviation of the heading by odometry after a metre, in degrees; it grows with the root of the
            way.
        height: height of the camera above the floor, in metres, which gives the scale where neither odometry of most
            frames nor two anchors do.
    """

    WHERE = "survey"

    apart: Positive = 3.0
    alike: Count = 8
    drift: Positive = 0.5
    height: Positive | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Survey:
    """Surveyed frames (n) and what they follow from.

    Attributes:
        frames: the frames with the surveyed x, y and theta, their deviations, and the odometry that was given, if any.
        covariance: (n, 3, 3) covariance of x, y and theta given the poses of the anchors; without them after the best
            rigid motion and scale.
        scale_deviation: standard deviation of the scale, as a share; 0 if anchors fix it.
        loops: all loops that were considered, with the reason why each is used or not; rows count in `frames`.
        graph: what was measured, without loops: compared frames that follow each other, and odometry if it is used.
        solution: scales, gyro biases and weights.
        fixed_by: "anchors", "odometry", "height" (of the camera), "odometry and height" or "pictures": what fixes the
            scale. Only anchors fix position and direction of the whole; without them the first frame lies at 0 and
            looks along x.
        notes: sentences about parts of the data that were not used.
        floor: what the floor says about displacements, None where it was not used.
    """

    frames: FrameTable
    covariance: Array
    scale_deviation: float
    loops: Loops
    graph: PoseGraph
    solution: Solution
    fixed_by: str
    notes: tuple[str, ...] = ()
    floor: FloorScale | None = None

    def __repr__(self) -> str:
        return f"Survey({self.summary()})"

    @property
    def typical_deviation(self) -> float:
        """Median of the standard deviations of the positions, in metres; of no worth if `torn` is above 0."""
        return float(np.median(self.frames.deviation))

    @cached_property
    def torn(self) -> int:
        """Number of places where the survey is torn, because loops or anchors contradict the images."""
        return len(torn_before(self.graph, self.solution))

    @property
    def doubt(self) -> str:
        """What follows the figures of a torn survey, "; do not rely on it: torn in 2 places"; "" of a whole one."""
        return f"; do not rely on it: torn in {self.torn} place{'s' * (self.torn > 1)}" if self.torn else ""

    def summary(self) -> str:
        """Say in a line how many frames were surveyed, by how many loops, and what fixes their scale."""
        way = sum(float(way_along(self.frames.xy[rows])[-1]) for rows in self.frames.rows_by("sequence").values())
        counts = self.loops.counts()
        refused = sum(counts.values()) - counts["accepted"]
        within = f" within {self.scale_deviation:.1%}" if self.scale_deviation else ""
        return (
            f"{len(self.frames)} frames along {way:.1f} m; loops: {counts['accepted']} used, {refused} refused; the "
            f"scale follows from the {self.fixed_by}{within}, typical deviation {self.typical_deviation:.2f} m"
            f"{self.doubt}"
        )

    def report(self) -> dict[str, Any]:
        """Return figures as plain values: frames, loops by reason, scales, biases, residuals, summary and notes.

        Drives without odometry are not in `odometry`.
        """
        steps, wheels = self.graph.pictures, self.graph.wheels
        residual, deviation = residual_of_steps(self.graph, self.solution), self.frames.deviation
        drives = [name or "(unnamed)" for name in self.frames.rows_by("sequence")]
        known = np.unique(self.graph.drive[wheels.first]).tolist()
        odometry = {
            drives[one]: {"length": self.solution.wheel_scale[one], "gyro_bias": self.solution.gyro_bias[one]}
            for one in known
        }
        return {
            "frames": len(self.frames),
            "drives": drives,
            "scale_from": self.fixed_by,
            "scale_deviation": self.scale_deviation,
            "loops": self.loops.counts(),
            "steps": len(steps),
            "residual_of_steps": {"median": float(np.median(residual)), "p95": float(np.quantile(residual, 0.95))},
            "deviation": {"median": self.typical_deviation, "largest": float(deviation.max())},
            "length_of_comparisons": self.solution.scale,
            "height": None if self.floor is None else self.floor.height,
            "odometry": odometry,
            "torn": self.torn,
            "summary": self.summary(),
            "notes": list(self.notes),
        }


@typed
def survey(
    network: Descriptor | nn.Module | str,
    images: PanoramaLibrary,
    frames: FrameTable | Sequence[FrameTable],
    *,
    odometry: ArrayLike | None = None,
    anchors: FrameTable | None = None,
    candidates: ArrayLike | None = None,
    settings: SurveySettings | None = None,
    progress: bool = True,
) -> Survey:
    """Estimate the poses of the frames of one or several drives; positions in `frames` are not used.

    With odometry, its scale is a little uncertain and its gyro has a bias, both of which are estimated along. Unless
    most frames have it, the floor that the robot drives over tells how lengths in one part of the building compare with
    those in another, and what they are in metres if the height of the camera is known (`settings.height`). Without
    that, odometry and anchors, the scale is that of the network, which is off by some percent.

    Args:
        network: a network that compares images, built with relative=True; "pretrained" is the shipped one.
        images: panoramas of the frames.
        frames: n frames, in capture order within each drive (`sequence`), or a table for each drive, together of n
            frames; the unit of the result is the metre.
        odometry: (n, 3) x, y in metres and heading in rad by the robot's wheels, or by any other source that is right
            over short ways, each drive in a frame of its own; NaN where unknown. Those of `frames` if None.
        anchors: some of the frames, with their true poses, which fix position, direction and scale of the whole.
        candidates: (p, 2) rows of pairs of frames that may show one place, such as `IncrementalMapper.graph().loops`
            of the same frames: loops are searched among them, instead of among the frames that look most alike.
        settings: how loops are searched, how exact odometry is, and the height of the camera.
        progress: whether to show the progress.

    Returns:
        The survey; its frames are in the order of the drives.

    Raises:
        ConfigError: a network that does not compare; a height, but panoramas that do not show the floor.
        DataError: a drive with fewer than 10 frames, in another order than that of their times, or one that stands
            still; odometry in another unit, in degrees, or of other turns, times or directions than the images; drives
            that have no place in common; anchors that are not among the frames, are given twice, or without a pose,
            or most of them in another unit, in degrees, or mirrored; candidates that are not pairs of rows.

    Example:
        >>> found = siamloc.maps.survey("pretrained", images, monday)  # doctest: +SKIP
        >>> known = siamloc.maps.build("pretrained", images, found.frames)  # doctest: +SKIP
    """
    settings = SurveySettings() if settings is None else settings
    frames = frames if isinstance(frames, FrameTable) else of_drives(frames)
    order = np.concatenate([*frames.rows_by("sequence").values(), np.empty(0, np.int64)])
    place = np.full(len(frames), -1)
    pairs = None if candidates is None else checked_pairs(candidates, len(frames))
    wheels = frames.odometry if odometry is None else odometry_of(odometry, len(frames))
    frames = with_odometry(frames, wheels).take(order)
    looks_down = shows_floor(images, settings.height)
    check_lengths(frames)
    check_anchors(frames, anchors)
    for finding in wrong_odometry(frames):
        raise DataError(f"the odometry of a survey cannot be used: {finding}")
    described = comparing_descriptor(network, images.circular)
    rolled = frames.with_columns(x=frames.odom_x, y=frames.odom_y, theta=frames.odom_theta)
    known = build(described, images, rolled, progress=progress)  # odometry tells the camera's mounting
    if len(known) < len(frames):  # images that cannot be read
        left = frames.rows_in(known.frames) >= 0
        frames, order = frames.take(left), order[left]
        check_lengths(frames)
    if pairs is not None:
        place[order] = np.arange(len(order))
        pairs = place[pairs]
    straight = (known.mounting.straight(batch) for batch in images.batches(frames))
    looks = None
    if looks_down:
        sees = known.mounting.straight(seen_by_all(images))
        looks = partial(Floor.seen, straight, images.preprocessing.view, sees), elevations_known(images)
    return of_descriptions(frames, known, described.compare, anchors, pairs, settings, progress, looks)


def of_descriptions(
    frames: FrameTable,
    described: VisualMap,
    compare: Compares,
    anchors: FrameTable | None,
    pairs: NDArray[np.int64] | None,
    settings: SurveySettings,
    progress: bool,
    looks_down: tuple[Callable[[], Floor], bool] | None = None,
) -> Survey:
    """Survey frames (n), drive by drive, by their descriptions; see `survey`.

    Args:
        frames: the frames, with their odometry.
        described: the same frames, described.
        compare: compares orientation parts.
        anchors: some of the frames, with their poses.
        pairs: (p, 2) candidates for loops, -1 for a frame that is left out; those that look alike if None.
        settings: how loops are searched, and the height of the camera.
        progress: whether to show the progress.
        looks_down: what returns the floor that the panoramas show, and whether their elevations are known; None if
            they show none.
    """
    drive, names = np.zeros(len(frames), dtype=np.int64), list[str]()
    for number, (name, rows) in enumerate(frames.rows_by("sequence").items()):
        drive[rows] = number
        names.append(name or "(unnamed)")
    notes: list[str] = []
    if described.mounting.mirrored:
        notes.append(
            "the panoramas are taken to be mirrored, since they turn against the odometry: if they are not, odom_y and "
            "odom_theta have the wrong sign, and the map is mirrored"
        )
    parts = described.turning().orientation
    assert parts is not None
    parts = scaled(parts)
    if anchors is None and not np.isfinite(frames.odometry).any():
        left = estimate(described.frames, parts, compare, posed=False)  # of the corrected panoramas
        if not abs(left.yaw) < UNPOSED_YAW:  # NaN is not
            notes.append(
                f"the robot's front was not found in the panoramas ({left.summary()}), so headings may be wrong by any "
                "constant angle: give odometry, or say where the front is, as by unwrap.forward"
            )
    compared = comparing(compare, parts, progress)
    steps, seen, certain = compared_steps(compared, drive)
    moved = odometry_steps(frames.odometry, seen, certain, drive, names, notes, frames.time)
    known = certain | np.isfinite(moved).all(axis=1)
    scale: FloorScale | None = None
    by_wheels = np.isfinite(moved[drive[1:] == drive[:-1]]).all(axis=1)
    if len(by_wheels) and by_wheels.mean() >= _BY_ODOMETRY:
        if settings.height is not None:
            notes.append("odometry tells the scale: the height of the camera is not used")
    elif looks_down is not None:
        floor = looks_down[0]()
        scale_known = bool(np.isfinite(moved).any()) or (anchors is not None and len(anchors) > 1)
        told = _told_by_floor(floor, looks_down[1], steps, seen, settings.height, notes, scale_known)
        if told is not None:
            scale, steps = told
            compared, next_one = lengthening(compared, scale, floor), steps.second == steps.first + 1
            seen[steps.first[next_one]] = steps.pose[next_one]
    fixed, start = anchored(start_of(moved, seen, drive), drive, frames, anchors)
    held = np.isin(np.arange(len(frames)), fixed)
    check_drives(known, start, np.where(held, -1, drive), names)
    path, apart = way_along(start), settings.apart
    if pairs is None:
        first, second = most_alike(described.learned, path, drive, apart, settings.alike)
    else:
        first, second = far_apart(pairs, path, drive, apart)
    unsettled = ~(held[first] & held[second])
    loops = agreed(loops_of(*compared(first[unsettled], second[unsettled])), start, drive)
    placed = set(drive[fixed].tolist()) or {0}
    start = brought_together(start, loops, drive, names, notes, placed)
    deviation = DEVIATION if scale is not None and scale.given else SCALE
    graph = PoseGraph(steps, wheel_edges(moved, settings.drift), drive, fixed, deviation)
    return concluded(frames, graph, loops, start, notes, scale)


def concluded(
    frames: FrameTable,
    graph: PoseGraph,
    loops: Loops,
    start: Array,
    notes: Sequence[str] = (),
    floor: FloorScale | None = None,
) -> Survey:
    """Return the survey that follows from measurements.

    Args:
        frames: the frames (n), with their odometry.
        graph: steps and odometry.
        loops: judged loops.
        start: start poses (n, 3), with the given poses of the anchors.
        notes: sentences about parts of the data that are not used.
        floor: what the floor says about displacements.
    """
    whole, solution, loops = solved(graph, loops, start)
    notes = [*notes, *solution_notes(frames, graph, whole, solution, loops)]
    height = floor is not None and floor.given
    by = " and ".join(["odometry"] * (len(graph.wheels) > 0) + ["height"] * height) or "pictures"
    by = "anchors" if len(graph.fixed) > 1 else by
    x, y, theta = solution.poses.T
    covariance, scale_deviation = covariances(whole, solution), 0.0
    if by != "anchors":
        covariance, scale_deviation = of_shape(covariance, whole, solution)
    variances = np.einsum("nii->ni", covariance)
    surveyed = frames.with_columns(
        x=x,
        y=y,
        theta=wrapped(theta),
        deviation=np.sqrt(variances[:, :2].mean(axis=1)),  # the root of the mean variance of x and y
        theta_deviation=np.sqrt(variances[:, 2]),
        unit="m",
    )
    return Survey(surveyed, covariance, scale_deviation, loops, graph, solution, by, tuple(notes), floor)


def _told_by_floor(
    floor: Floor,
    known: bool,
    steps: Edges,
    seen: Array,
    height: float | None,
    notes: list[str],
    scale_known: bool,
) -> tuple[FloorScale, Edges] | None:
    gap = np.nan_to_num(np.hypot(seen[:, 0], seen[:, 1]), nan=100.0)  # metres, between drives
    told = floor_scale(floor, steps, np.concatenate([[0.0], np.cumsum(gap)]), height)
    if told is None and height is not None:
        notes.append(
            "the height of the camera is not used: the floor shows too little, frames are too far apart, or the height "
            f"in metres is another one{'' if known else ', or the panoramas show other elevations than assumed'}"
        )
    elif told is not None and known and height is None and not scale_known:
        notes.append(
            f"the scale is right if the camera is {told[0].height:.2f} m above the floor: if not, give its height "
            "(survey.height)"
        )
    if told is not None and known and (degrees := round(float(np.degrees(floor.pitch)))):
        notes.append(
            f"by the edges that stand upright, the camera looks about {abs(degrees)} degrees "
            f"{'down' if degrees > 0 else 'up'} ahead on average, which lengths make up for: mount it level, or level "
            "its pictures if the camera's model is known (unwrap.level=true)"
        )
    return told
