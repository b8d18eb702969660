"""The steps of a survey: how a robot moved from frame to frame, by compared panoramas and by odometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_opening, binary_propagation

from siamloc.data.frames import ODOMETRY, FrameTable
from siamloc.data.moves import chained, moves, relative, wrapped
from siamloc.data.picture_checks import time_offset
from siamloc.errors import DataError
from siamloc.maps.comparing import ODDS, Compares
from siamloc.maps.loops import Pairs
from siamloc.maps.motion import MIRRORED
from siamloc.maps.pose_graph import Array, Edges
from siamloc.maps.search import slices
from siamloc.progress import track

BEFORE = (1, 2, 3, 5)
"""How many frames before it each frame is compared with."""
_DOUBTED = 100.0  # the information of a step between images that are not alike is divided by this
_AT_ONCE = 2048  # pairs to compare
_SHARE = 0.03  # deviation of the way by odometry, as a share
_STILL, _ROLLED = 2e-3, np.radians(0.05)  # deviation of odometry however short the way
_SURE = 0.05  # metres: a displacement that comparisons see for certain
_UNITS = 0.4, 2.5  # ratio of the ways by odometry and by comparison; outside, the units differ
_JUMP, _FROZEN = 1.0, 5  # metres beyond three times the compared way; frames
_SLIPS, _SLIP_WAY = 0.5, 2.0  # share of the usual way by odometry, for so many metres by comparison
_WAY = 0.3  # metres over which units and signs are judged
_TURNED = np.radians(3)  # a turn that comparisons of good panoramas see for certain
_CLEAR = np.radians(10)  # and one that those of any camera see
_ENOUGH = 10  # steps from which units and signs are judged
_LATE = 10  # rows by which odometry may be late, at most
_OTHER_TURNS = 0.75  # usual error of turns by odometry, as a share, from which on they are not those of the images
_NEXT_TO_NOTHING = np.radians(1)  # error of a turn
_ALONG = 0.5  # mean cosine of the angles between the directions by odometry and by comparison, at least


def comparing(compare: Compares, parts: NDArray[np.float32], progress: bool) -> Pairs:
    """Return a function that compares frames by their orientation parts (n, K, F)."""

    def compared(first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[Edges, Array]:
        blocks = slices(len(first), _AT_ONCE)
        if progress:
            blocks = track(blocks, len(first), "comparing frames", size=lambda rows: rows.stop - rows.start)
        none = np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0)
        found = [none, *(compare(parts[second[rows]], parts[first[rows]]) for rows in blocks)]
        pose, information, odds = (np.concatenate(values).astype(np.float64) for values in zip(*found, strict=True))
        return Edges(first, second, pose, information), odds

    return compared


def compared_steps(compared: Pairs, drive: NDArray[np.int64]) -> tuple[Edges, Array, NDArray[np.bool_]]:
    """Compare each frame with a few frames before it.

    Returns:
        The steps between images that are alike, and all steps from frame to frame; the poses (n - 1, 3) of each frame
        but the first, as seen from the frame before it, NaN between drives; and which of them are certain (n - 1,).
    """
    n = len(drive)
    first = np.concatenate([np.arange(n - back) for back in BEFORE])
    second = np.concatenate([np.arange(back, n) for back in BEFORE])
    same = drive[first] == drive[second]
    steps, odds = compared(first[same], second[same])
    next_one = steps.second == steps.first + 1
    before = steps.first[next_one]
    seen, certain = np.full((n - 1, 3), np.nan), np.zeros(n - 1, dtype=bool)
    seen[before], certain[before] = steps.pose[next_one], odds[next_one] >= ODDS
    return trusted(steps, odds), seen, certain


def trusted(steps: Edges, odds: Array) -> Edges:
    """Return the steps (e) between images that are alike by their log odds, and all to the next frame, if doubted."""
    doubted = odds < ODDS
    information = np.where(doubted[:, None, None], steps.information / _DOUBTED, steps.information)
    return replace(steps, information=information).take((steps.second == steps.first + 1) | ~doubted)


def odometry_of(values: ArrayLike, count: int) -> Array:
    """Return odometry as numbers (n, 3).

    Raises:
        DataError: another shape, or texts.
    """
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(f"odometry must be numbers, x, y and heading for each frame: {error}") from error
    if found.shape != (count, 3):
        raise DataError(f"odometry needs x, y and heading of {count} frames, shape ({count}, 3), got {found.shape}")
    return found


def with_odometry(frames: FrameTable, odometry: Array) -> FrameTable:
    """Return frames (n) with the odometry (n, 3); values that are not finite are unknown."""
    known = np.where(np.isfinite(odometry), odometry, np.nan)
    return frames.with_columns(**dict(zip(ODOMETRY, known.T, strict=True)))


def odometry_steps(
    odometry: Array,
    seen: Array,
    certain: NDArray[np.bool_],
    drive: NDArray[np.int64],
    names: Sequence[str],
    notes: list[str],
    time: Array | None = None,
) -> Array:
    """Return the poses (n - 1, 3) of each frame but the first as seen from the frame before it, by odometry.

    They are NaN between drives, where odometry is unknown, and where it cannot be true: after a reset, while it is
    frozen, and where wheels slip for metres, as comparisons (n - 1, 3) show that are certain (n - 1,). `notes` gets a
    sentence about each such part. The times (n,) of the frames, in s, only serve to say how late odometry is.

    Raises:
        DataError: odometry in another unit, in degrees, of other turns or directions, or late.
    """
    steps = moves(odometry)[1:]
    steps[drive[1:] != drive[:-1]] = np.nan
    way, compared = np.hypot(steps[:, 0], steps[:, 1]), np.hypot(seen[:, 0], seen[:, 1])
    for number, name in enumerate(names):
        said = f"the odometry of drive {name}"
        unknown = int((~np.isfinite(odometry[drive == number]).all(axis=1)).sum())
        if unknown > 0 and np.isfinite(odometry).any():
            seldom = unknown < (drive == number).sum() and not np.isfinite(way[drive[1:] == number]).any()
            then = "it is not used, since no two frames in a row have it" if seldom else "images alone bridge the gap"
            notes.append(f"{said} is unknown for {unknown} frame{'s' * (unknown > 1)}: {then}")
        mine = (drive[1:] == number) & np.isfinite(way) & certain
        if not mine.any():
            continue
        rows = np.flatnonzero(drive == number)
        times = np.full(len(rows), np.nan) if time is None else time[rows]
        _check_odometry(said, odometry[rows], seen[rows[:-1]], certain[rows[:-1]], times)
        reset = mine & (way > 3 * compared + _JUMP)
        frozen = binary_opening(mine & (way < 0.1 * compared) & (compared > _SURE), np.ones(_FROZEN))
        unmoved = (drive[1:] == number) & (way < _STILL) & (np.abs(steps[:, 2]) < _ROLLED)
        frozen = binary_propagation(frozen, mask=unmoved | frozen)  # also over steps that images do not see for certain
        frozen[1:] |= frozen[:-1]  # the next step makes up for them
        slips = _slipping(way, compared, mine & ~reset & ~frozen & (compared > _SURE))
        for bad, text in (
            (reset, "jumps"),
            (frozen, "stands still while the images move"),
            (slips, "moves much less than the images, as wheels do that slip,"),
        ):
            if bad.any():
                frame, count = int(np.flatnonzero(bad)[0]) + 1 - int(rows[0]), int(bad.sum())
                where = f"{count} step{'s' * (count > 1)}, {'first ' * (count > 1)}before frame {frame}"
                notes.append(f"{said} {text} at {where}: left out there")
        steps[reset | frozen | slips] = np.nan
    return steps


def _check_odometry(said: str, odometry: Array, seen: Array, certain: NDArray[np.bool_], time: Array) -> None:
    """Refuse odometry (n, 3) of a drive if its unit, sign, times or directions contradict the compared steps.

    It is judged over as many frames as the robot needs for 0.3 m, so that frames may be dense.
    """
    compared = np.hypot(seen[:, 0], seen[:, 1])
    back = int(np.clip(np.ceil(_WAY / max(float(np.median(compared[certain])), 1e-6)), 1, max(1, len(seen) // 4)))
    first = np.arange(len(odometry) - back)
    unsure = np.concatenate([[0], np.cumsum(~certain)])
    first = first[unsure[first + back] == unsure[first]]
    by_images = relative(
        chained(np.concatenate([np.zeros((1, 3)), np.where(certain[:, None], seen, 0)])), first, first + back
    )
    by_wheels, raw = relative(odometry, first, first + back), odometry[first + back, 2] - odometry[first, 2]
    way, wanted = (np.hypot(one[:, 0], one[:, 1]) for one in (by_wheels, by_images))
    moving = (wanted > _SURE) & (way > 0)
    judged, weight = moving.sum() >= _ENOUGH, wanted[moving]  # by the way, so that noise at rest counts little
    ratio = float(np.median(np.repeat(way[moving] / weight, (weight / _SURE).astype(int)))) if judged else 1.0
    if not _UNITS[0] <= ratio <= _UNITS[1]:
        raise DataError(f"{said} moves {ratio:.3g} times as far as its images show: give odom_x and odom_y in metres")
    turning = (np.abs(by_images[:, 2]) > _TURNED) & np.isfinite(raw)
    if turning.sum() >= _ENOUGH:
        slope = float(np.median(raw[turning] / by_images[turning, 2]))
        if abs(slope) > 10:
            raise DataError(
                f"{said} turns {slope:.0f} times as far as its images show: give odom_theta in radians, not degrees, "
                "counter-clockwise"
            )
        if float(np.mean(by_wheels[turning, 2] * by_images[turning, 2] < 0)) > 0.7:
            raise DataError(f"{said} {MIRRORED} odom_theta with the other sign, or mirror the panoramas")
        late = _rows_late(odometry[:, 2], by_images[turning, 2], first[turning], back)
        if late != 0:
            offset: float = late
            by = f"{abs(late)} row{'s' * (abs(late) > 1)}"
            remedy = "give each image the odometry of its own time, and correct the offset between their times"
            if (step := float(np.median(np.diff(time)))) > 0:
                finer = time_offset(np.where(certain, seen[:, 2], np.nan), time, odometry[:, 2], signs=(1,))
                offset = finer if finer * late > 0 else late * step
                by = f"{abs(offset):.2f} s"
                remedy = (
                    f"add {offset:+.2f} s to the times of the images (column time, recording.offset or data.offset), "
                    "or give each image the odometry of its own time"
                )
            raise DataError(f"{said} turns {by} {'after' if offset > 0 else 'before'} its images do: {remedy}")
        clear = moving & (np.abs(by_images[:, 2]) > _CLEAR)
        wrong = np.abs(wrapped(by_wheels[clear, 2] - by_images[clear, 2]) / by_images[clear, 2])
        if clear.sum() >= _ENOUGH * back and np.median(wrong) > _OTHER_TURNS:  # a step counts in `back` of them
            raise DataError(
                f"{said} turns otherwise than its images show: give that of this drive, in the clock of its images "
                "(recording.offset or data.offset corrects their times), whose headings follow the robot's turns"
            )
    direction = np.arctan2(by_wheels[moving, 1], by_wheels[moving, 0])
    direction -= np.arctan2(by_images[moving, 1], by_images[moving, 0])
    if judged and np.average(np.cos(direction), weights=weight) < _ALONG:
        raise DataError(
            f"{said} moves in other directions than its images show: odom_theta must be the heading in the frame of "
            "odom_x and odom_y, in radians counter-clockwise, each row that of its image, and the middle of a panorama "
            "must look ahead"
        )


def _rows_late(heading: Array, turns: Array, first: NDArray[np.int64], back: int) -> int:
    """Return by how many rows headings (n,) are late, negative if early; 0 unless another row fits twice as well.

    Rows within half of `_WAY` are not told apart, nor errors below a degree: such odometry is good enough.

    Args:
        heading: by odometry, in rad.
        turns: by comparisons, from some rows to those `back` rows later (k,), in rad.
        first: these rows (k,).
        back: number of rows.
    """
    inner = (first >= _LATE) & (first + back + _LATE < len(heading))
    late = np.arange(-_LATE, _LATE + 1)
    rows = first[inner] + late[:, None]
    off = np.abs(wrapped(heading[rows + back] - heading[rows] - turns[inner]))
    known = np.isfinite(off).all(axis=0)
    if known.sum() < _ENOUGH * back:
        return 0
    typical = np.median(off[:, known], axis=1)
    best = int(typical.argmin())
    wrong = 2 * abs(late[best]) >= back and typical[_LATE] > max(2 * typical[best], _NEXT_TO_NOTHING)
    return int(late[best]) if wrong else 0


def wheel_edges(steps: Array, drift: float) -> Edges:
    """Return odometry from frame to frame (n - 1, 3), where it is known, as edges with their information.

    Args:
        steps: the odometry.
        drift: standard deviation of its heading after a metre, in degrees.
    """
    first = np.flatnonzero(np.isfinite(steps).all(axis=1)).astype(np.int64)
    way = np.hypot(steps[first, 0], steps[first, 1])
    along = (_SHARE * way) ** 2 + _STILL**2
    turn = np.radians(drift) ** 2 * way + _ROLLED**2
    information = np.zeros((len(first), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = 1 / along
    information[:, 2, 2] = 1 / turn
    return Edges(first, first + 1, steps[first], information)


def start_of(odometry_steps: Array, seen: Array, drive: NDArray[np.int64]) -> Array:
    """Return poses (n, 3) by odometry, and by comparisons where it is unknown, each drive from 0."""
    steps = np.where(np.isfinite(odometry_steps.sum(axis=1, keepdims=True)), odometry_steps, seen)
    poses = np.zeros((len(drive), 3))
    for number in range(int(drive.max()) + 1):
        rows = np.flatnonzero(drive == number)
        poses[rows] = chained(np.concatenate([np.zeros((1, 3)), steps[rows[:-1]]]))
    return poses


def _slipping(way: Array, compared: Array, judged: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the steps (n,) of ways of `_SLIP_WAY` metres on which odometry moves much less than elsewhere.

    Where its units are right, odometry is about as long as comparisons. These may be too short for long, but hardly too
    long: a drive in which they are usually short is judged as if they were right.

    Args:
        way: lengths of the steps by odometry.
        compared: their lengths by comparison.
        judged: the steps of a drive whose lengths are worth comparing.
    """
    rows, found = np.flatnonzero(judged), np.zeros(len(way), dtype=bool)
    if not len(rows):
        return found
    way, compared = way[rows], compared[rows]
    usual, along = min(float(np.median(way / compared)), 1.0), np.concatenate([[0.0], np.cumsum(compared)])
    ends = np.maximum(np.searchsorted(along, along[:-1] + _SLIP_WAY), np.arange(len(rows)) + _FROZEN)
    for begin, end in enumerate(ends[ends <= len(rows)].tolist()):
        if way[begin:end].sum() < _SLIPS * usual * compared[begin:end].sum():
            found[rows[begin:end]] = True
    return found
