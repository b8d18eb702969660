"""Whether the positions of a drive have the axes and the unit of a map: `check_axes` compares them with the answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foundation.columns import spread_rows
from siamloc.data.frames import FrameTable
from siamloc.errors import DataError, logger
from siamloc.maps.comparing import comparison_of
from siamloc.maps.matching import match
from siamloc.maps.refinement import refine
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap

_SOME, _FEW, _MOST = 10, 0.25, 0.6  # frames, and shares of them that agree: with other axes, at most and at least
_COMPARED = 3  # map frames that a frame is compared with
_JUDGED = 25  # frames of a drive of a map with which it is judged
_LOOKED_AT = 30  # frames of each drive of a map
_MOTIONS = 300  # that are tried
_SURE = 0.5  # share of the map frames that agree where a frame is located
_HALF = 0.5  # share of such frames: of the drive, and of those that agree with other axes, at most
_OFF = 0.25  # metres that positions by comparison may be off, as those that comparisons are judged by
_UNIT, _UNIT_OF_FEW = 1.5, 10.0  # ratio of distances from which on they are in another unit: feet, centimetres
_FEWEST, _CLOSE = 5, 0.1  # frames; share of the variance of their places that may be left if they are few

Points = NDArray[np.complex128]
Distances = NDArray[np.float64] | np.float64


class WrongAxesError(DataError):
    """The positions of a drive are not where a map locates its frames; the only argument says how they differ."""

    @property
    def finding(self) -> str:
        """How they differ; the message of the error also says what to do with them in a table."""
        return str(self.args[0])

    def __str__(self) -> str:
        return (
            f"{self.finding}. Leave x, y and theta out, so that the drive is located in the map, or give them as "
            "odom_x, odom_y and odom_theta. If the drive shows a place that the map lacks, and that only looks like "
            "one of its own, give its frames another name in the column building"
        )


def check_axes(known: VisualMap, drive: VisualMap, alike: Retrieval, located: NDArray[np.int64], radius: float) -> None:
    """Refuse a drive whose positions have axes or a unit of their own.

    Where the map compares images, axes that differ by little are refused, too, and positions that bend, as those of
    odometry that drifts.

    Args:
        known: a map whose frames all have positions.
        drive: the drive (n frames), whose frames all have positions.
        alike: the map frames that resemble them most.
        located: the map frame at which each frame of the drive is located (n,).
        radius: distance within which positions agree.

    Raises:
        WrongAxesError: the positions are not where the frames are located, and one motion puts them right; or
            comparisons locate most frames, and hardly any where its position is.
    """
    there = known.frames.take(located)
    _check_motion(drive.frames, there.building, there.xy, radius, _FEW)
    compares, described, placed = comparison_of(known), drive.turning(), np.isfinite(known.frames.theta)
    if compares is None or described.orientation is None or not placed.any():
        return
    if not placed.all():
        known = known.take(placed)
        alike = match(known, described, alike.indices.shape[1])
    poses = refine(known, described, alike, compares)
    sure = np.flatnonzero(poses.agreement >= _SURE)
    compared, building = drive.frames.take(sure), known.frames.building[poses.frame[sure]]
    _check_motion(compared, building, poses.xy[sure], _OFF, _HALF)
    off = np.linalg.norm(compared.xy - poses.xy[sure], axis=1)
    agree = (off <= np.fmax(_OFF, 2 * compared.deviation))[compared.building == building]  # NaN is unknown
    if len(agree) >= max(_SOME, _HALF * len(drive)) and agree.sum() <= _FEW * len(agree):
        raise WrongAxesError(
            f"the drive's positions are not where its images show it: {agree.sum()} of {len(agree)} frames are within "
            f"{_OFF:g} {drive.unit} of where comparisons with the map locate them, as if odometry had drifted"
        )


def warn_of_axes(known: VisualMap, radius: float = 1.0) -> None:
    """Warn of each drive of a map whose positions are not where the drives before it locate its frames.

    Drives with few frames are not judged.

    Args:
        known: the map.
        radius: as of `check_axes`.
    """
    placed, before = known.frames.has_position, np.empty(0, dtype=np.int64)
    for name, rows in known.frames.rows_by("sequence").items():
        if len(rows := rows[placed[rows]]) < _JUDGED:
            continue
        if before.size:
            earlier, drive = known.take(before), known.take(rows[spread_rows(len(rows), _LOOKED_AT)])
            alike = match(earlier, drive.turning(), min(_COMPARED, len(earlier)))
            try:
                check_axes(earlier, drive, alike, alike.indices[:, 0], radius)
            except WrongAxesError as error:
                logger.warning(
                    "drive %s of this map and the drives before it seem to be in different frames: %s. Bring all into "
                    "one frame, give those of another building its name in the column building, or map one drive",
                    *(name, error.finding),
                )
        before = np.concatenate([before, rows])


def _check_motion(
    drive: FrameTable, building: NDArray[np.str_], xy: NDArray[np.float64], radius: float, few: float
) -> None:
    """Refuse a drive if one motion brings most of its positions to where the map locates its frames, and few agree now.

    Args:
        drive: its frames (n).
        building: the building in which the map locates each frame (n,).
        xy: where the map locates each frame (n, 2).
        radius: distance within which positions agree.
        few: share of the frames that agree with other axes, at most.
    """
    same = drive.building == building
    given, found = ((one[:, 0] + 1j * one[:, 1])[same] for one in (drive.xy, xy))
    agreeing = int((np.abs(found - given) <= radius).sum())
    if len(given) < _FEWEST or agreeing > few * len(given):
        return
    best_motion = _motion if len(given) >= _SOME else _motion_of_few
    for axes, exchanged in ((given, ""), (given.conj(), ", with x and y exchanged or one of them reversed,")):
        near, agree, scaled = best_motion(axes, found, radius)
        if agree < max(_MOST * len(given), 2 * agreeing):
            continue
        middle, there = axes[near].mean(), found[near].mean()
        motion = _fitted(axes[near], found[near])  # that of two frames may be off by the radius
        unit = f" and a factor of {float(f'{abs(motion):.1g}'):g}, as between units," if scaled else ""
        if not (exchanged or unit):
            moved_by = np.median(np.abs(motion / abs(motion) * (given - middle) + there - given))
            degrees = abs(np.degrees(np.angle(motion)))
            unit = f" by {moved_by:.2f} {drive.unit} and {degrees:.0f} degrees"
        raise WrongAxesError(
            f"the drive's positions have other axes than the map's: one motion{exchanged}{unit} brings "
            f"{near.sum()} of {len(given)} frames to where the map locates them"
        )


def _motion(axes: Points, found: Points, radius: float) -> tuple[NDArray[np.bool_], int, bool]:
    """Find the motion, perhaps with a factor, that brings most positions (n,) to where their frames are located (n,).

    Returns:
        Which positions it brings there (n,), how many of them any factor would not, and whether it has a factor.
    """
    first, second = np.random.default_rng(0).integers(len(axes), size=(2, _MOTIONS))
    moved, wanted = found[second] - found[first], axes[second] - axes[first]
    rigid = (np.abs(wanted) > 4 * radius) & (np.abs(np.abs(moved) - np.abs(wanted)) < radius)
    some = rigid | ((np.abs(moved) > 4 * radius) & _other_unit(np.abs(moved), np.abs(wanted), _UNIT))
    if not some.any():
        return some, 0, False
    turn, start, rigid = (moved[some] / wanted[some])[:, None], first[some, None], rigid[some, None]
    turn /= np.where(rigid, np.abs(turn), 1)
    near = np.abs(turn * (axes - axes[start]) + found[start] - found) <= radius
    agree = (near & (rigid | (np.abs(found - found[start]) > radius))).sum(axis=1)  # any factor keeps what stays
    best = agree.argmax()
    return near[best], int(agree[best]), not rigid[best, 0]


def _motion_of_few(axes: Points, found: Points, radius: float) -> tuple[NDArray[np.bool_], int, bool]:
    """Find the motion of fewer positions, as `_motion`: only one with a large factor that fits closely is certain."""
    offset, there = axes - axes.mean(), found - found.mean()
    turn = _fitted(axes, found)
    left, all_of = (float(np.square(np.abs(one)).sum()) for one in (turn * offset - there, there))
    certain = left < _CLOSE * all_of and np.abs(there).max() > radius / 2
    certain &= bool(_other_unit(np.abs(turn), np.float64(1), _UNIT_OF_FEW))
    near = np.abs(turn * offset - there) <= radius
    return near, int(near.sum()) if certain else 0, True


def _other_unit(moved: Distances, wanted: Distances, factor: float) -> NDArray[np.bool_]:
    """Return where the ratio of two distances is larger than a factor, either way, and finite."""
    return np.asarray((wanted > 0) & ((wanted > factor * moved) | (moved > factor * wanted)))


def _fitted(axes: Points, found: Points) -> complex:
    """Return the turn and factor that bring positions (n,) closest to others (n,), about the means of both."""
    offset, there = axes - axes.mean(), found - found.mean()
    return complex(np.vdot(offset, there) / max(np.vdot(offset, offset).real, 1e-12))
