"""`summary` and `check`: describe a data set and find its faults before training."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from foundation.calls import typed
from foundation.files import file_hash
from siamloc.data.frames import FrameTable
from siamloc.data.image_files import UnreadableImageError, read_image, size_of, spread
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import diameter
from siamloc.data.picture_checks import drive_faults
from siamloc.data.picture_times import NO_DRIVE
from siamloc.data.trajectory_checks import other_unit

_SHORTEST, _LONGEST = 1e-3, 20.0  # m, usual steps between two images of a robot indoors
_PROBED = 32  # images of a data set that are opened for their size
_FITS, _FAILS = 0.9, 0.7  # how well headings follow the direction of travel, from 0 (not at all) to 1
_PANORAMIC = 1.8  # times as wide as high: the least of whole pictures of a 360-degree camera
_TURN = 2 * np.pi


@typed
def check(
    frames: FrameTable,
    images: PanoramaLibrary | None = None,
    described_by: Descriptor | None = None,
    mounting: bool = True,
) -> list[str]:
    """Check a data set for faults that go unnoticed until the results are poor.

    Checked are headings (degrees instead of radians, clockwise, x and y exchanged), odometry (degrees), missing
    positions and labels, steps that no robot indoors makes, jumps and stops of a drive, times, the sizes of the images,
    and duplicate images. With panoramas, each drive is also checked for exposure, blur, seams, missing parts of the
    turn, a horizon that is not level, the robot's own picture, mirrored images, and poses and odometry of other times
    than the images, by when these turn; with a network, for how the camera is mounted.

    Args:
        frames: the data set.
        images: the panoramas of the data set, if decoded: their size is then compared with the size of the image files.
        described_by: a network that compares, for `find_mounting` and for the turns in images, which correlation
            measures without it, with larger errors.
        mounting: whether that network finds how the camera is mounted.

    Returns:
        A sentence for each fault, with the remedy; an empty list if there is no fault.

    Example:
        >>> angle = np.arange(8) * 45.0
        >>> frames = FrameTable(path=[f"{i}.jpg" for i in range(8)], x=np.sin(angle), y=np.cos(angle), theta=angle)
        >>> check(frames)[0]
        'theta looks like degrees: 7 of 8 headings lie beyond one turn, up to 315. Give radians (multiply by pi / 180).'
    """
    found = [*wrong_headings(frames), *wrong_odometry(frames), *_missing(frames), *_drives(frames)]
    judged = images is not None and not _are_rings(frames, images)
    pictures = wrong_pictures(frames, images, described_by, mounting) if images is not None and judged else []
    return [*found, *wrong_sizes(frames, images), *_copies(frames), *pictures]


@typed
def summary(frames: FrameTable) -> str:
    """Describe a data set in one line per drive and per room: frames, lighting, and how far apart the frames are.

    Example:
        >>> frames = FrameTable(path=["1.jpg", "2.jpg"], x=[0, 1], y=[0, 0], room=["hall"] * 2, sequence=["monday"] * 2)
        >>> print(summary(frames))
        2 frames
          monday: 2 frames, lighting unknown, 1 room (hall), path of 1.0 m, median step 1 m
          room hall: 2 frames, the farthest two 1.00 m apart
    """

    def counted(count: int) -> str:
        return f"{count} frame{'s' * (count != 1)}"

    lines = [counted(len(frames))]
    for name, rows in frames.rows_by("sequence").items():
        part = frames.take(rows)
        lightings = ", ".join(sorted(set(part.lighting.tolist()) - {""})) or "lighting unknown"
        rooms = sorted(set(part.room.tolist()) - {""})
        named = f"{len(rooms)} room{'s' * (len(rooms) > 1)} ({', '.join(rooms)})" if rooms else "no rooms"
        lines.append(f"  {name or '(no sequence)'}: {counted(len(part))}, {lightings}, {named}, {_spacing(part)}")
    for room, (count, largest) in room_sizes(frames).items():
        apart = f", the farthest two {largest:.2f} {frames.unit} apart" if np.isfinite(largest) else ""
        lines.append(f"  room {room}: {counted(count)}{apart}")
    return "\n".join(lines)


@typed
def room_sizes(frames: FrameTable) -> dict[str, tuple[int, float]]:
    """Return the number of frames of each room and the largest distance between two of them ([T] table 5.5).

    Distances are in the unit of the positions, and NaN if fewer than two frames have a position.

    Example:
        >>> room_sizes(FrameTable(path=["1.jpg", "2.jpg"], x=[0, 3], y=[0, 4], room=["hall", "hall"]))
        {'hall': (2, 5.0)}
    """
    found = {}
    for place, rows in frames.rows_by("place").items():
        part = frames.take(rows)
        xy = part.xy[part.has_position]
        if part.room[0] != "":
            found[place] = (len(part), diameter(xy) if len(xy) > 1 else np.nan)
    return found


def _spacing(frames: FrameTable) -> str:
    known = frames.xy[frames.has_position]
    if len(known) < 2:
        return "one position" if len(known) else "no positions"
    steps = np.linalg.norm(np.diff(known, axis=0), axis=1)
    return f"path of {steps.sum():.1f} {frames.unit}, median step {np.median(steps):.3g} {frames.unit}"


def wrong_headings(frames: FrameTable) -> Iterator[str]:
    """Return a sentence for each fault of the headings: degrees instead of rad, or clockwise, or x and y exchanged.

    Headings are compared with the directions in which the robot moves between frames.
    """
    theta = frames.theta[np.isfinite(frames.theta)]
    beyond, largest = int((np.abs(theta) > _TURN + 0.01).sum()), np.abs(theta).max(initial=0)
    heading, travel = _moving(frames)
    follows = _agreement(heading - travel)[0]
    if follows >= _FITS:
        return
    if beyond > len(theta) / 4:
        yield (
            f"theta looks like degrees: {beyond} of {len(theta)} headings lie beyond one turn, up to "
            f"{largest:.4g}. Give radians (multiply by pi / 180)."
        )
        return
    if not follows < _FAILS:
        return
    share, offset = _agreement(-heading - travel)
    if _agreement(np.radians(heading) - travel)[0] >= _FITS:
        remedy = "it counts degrees: give radians (multiply by pi / 180)."
    elif share < _FITS:
        return
    elif abs(abs(offset) - np.pi / 2) < np.pi / 4:
        remedy = (
            "x and y are exchanged, as a compass bearing does: headings run counter-clockwise from +x. "
            "Exchange x and y, or give pi / 2 - theta."
        )
    else:
        remedy = "it runs clockwise: headings run counter-clockwise from +x. Give -theta, or check the sign of y."
    yield f"theta follows the direction of travel if {remedy}"


def wrong_odometry(frames: FrameTable) -> Iterator[str]:
    """Return a sentence if the headings of the odometry are degrees instead of rad.

    They are if the robot moves along its heading only when it is read as degrees, or if it makes many turns between
    two frames that radians do not explain: up to half a turn, and a full turn where angles start again.
    """
    heading, travel = _moving(frames.with_columns(x=frames.odom_x, y=frames.odom_y, theta=frames.odom_theta))
    as_radians, as_degrees = (_agreement(angle - travel)[0] for angle in (heading, np.radians(heading)))
    if as_radians >= _FITS:
        return
    turns = [np.diff(frames.odom_theta[rows]) for rows in frames.rows_by("sequence").values()]
    size = np.abs(np.concatenate([np.zeros(0), *turns]))
    size = size[np.isfinite(size)]
    far = int((size > 1.5 * _TURN).sum())
    if (as_radians < _FAILS and as_degrees >= _FITS) or far > max(2, len(size) / 50):
        yield (
            f"odom_theta looks like degrees: the robot turns by up to {size.max(initial=0):.4g} between two frames. "
            "Give radians (multiply by pi / 180)."
        )


def _moving(frames: FrameTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the headings of the frames after which the robot moved, and the directions of those moves, rad (k,)."""
    headings, travels = [np.zeros(0)], [np.zeros(0)]
    for rows in frames.rows_by("sequence").values():
        step = np.diff(frames.xy[rows], axis=0)
        length = np.linalg.norm(step, axis=1)
        usual = np.median(length[length > 0]) if (length > 0).any() else np.inf
        # Short steps are noise in the positions, long ones are jumps.
        real = (length > usual / 4) & (length < 4 * usual) & np.isfinite(frames.theta[rows[:-1]])
        headings.append(frames.theta[rows[:-1]][real])
        travels.append(np.arctan2(step[real, 1], step[real, 0]))
    return np.concatenate(headings), np.concatenate(travels)


def _agreement(difference: NDArray[np.float64]) -> tuple[float, float]:
    """Return the length (0 to 1) and the direction (rad) of the mean of unit vectors; NaN for fewer than 10."""
    mean = np.exp(1j * difference).mean() if len(difference) >= 10 else np.nan
    return float(np.abs(mean)), float(np.angle(mean))


def _missing(frames: FrameTable) -> Iterator[str]:
    """Look for what frames lack, and report the consequences."""
    total = len(frames)
    without = int((~frames.has_position).sum())
    if without:
        yield (
            f"{_count(without, total)} have no position: they can be located and, as map frames, recognized, but their "
            "errors cannot be measured. Rooms and mapping by appearance need no positions."
        )
    roomless = int((frames.room == "").sum())
    if 0 < roomless < total:
        yield (
            f"{_count(roomless, total)} have no room, while others do: rooms are measured, grouped and, in buildings "
            "with labels, learned without them. Give their room."
        )


def _drives(frames: FrameTable) -> Iterator[str]:
    """Look for stops, jumps and uneven times in each drive."""
    for name, rows in frames.rows_by("sequence").items():
        own, drive = frames.take(rows), f"sequence {name or '(unnamed)'}"
        known = own.take(own.has_position)
        steps = np.linalg.norm(np.diff(known.xy, axis=0), axis=1)
        moves = steps[steps > 0]
        usual = float(np.median(moves)) if len(moves) else 0.0
        if len(moves) > 10 and not _SHORTEST < usual < _LONGEST and frames.unit == "m":
            other, factor = ("millimetres", "divide by") if usual > _LONGEST else ("kilometres", "multiply by")
            yield (
                f"the usual step of {drive} is {usual:.3g} m, which no robot indoors makes between two images: if x "
                f"and y are {other}, {factor} 1000, or name their unit (data.unit)."
            )
        still = int((steps <= usual / 20).sum())
        if still > len(own) / 5 and len(own) > 2:
            yield (
                f"the robot stands still in {_count(still, len(own))} of {drive}: these frames skew every mean. "
                "Thin them out with spacing (protocol.map.spacing and so on)."
            )
        if len(moves) > 10 and steps.max() > 20 * usual:
            at = int(steps.argmax()) + 1
            yield (
                f"{drive} jumps by {steps.max():.3g} {frames.unit} at {known.path[at]}, where its usual step is "
                f"{usual:.2g} {frames.unit}: if several drives share the name, give each its own."
            )
        gaps = np.diff(own.time) if np.isfinite(own.time).all() else np.zeros(0)
        if len(gaps) > 10 and gaps.max() > max(20 * np.median(gaps), 10.0):
            at = int(gaps.argmax()) + 1
            advice = "a filter over time should start again there. Give it its own sequence."
            if gaps.max() > NO_DRIVE > np.median(gaps):
                advice = "these are times in different units. Give all in seconds."
            yield (
                f"{drive} pauses for {gaps.max():.0f} s before {own.path[at]}, where frames usually are "
                f"{np.median(gaps):.2g} s apart: {advice}"
            )
        if len(moves) > 10 and frames.unit == "m":
            passed = np.diff(known.time)
            moving = (steps > usual / 20) & (passed < 20 * np.median(passed))
            if said := other_unit(drive, float(steps[moving].sum()), float(passed[moving].sum())):
                yield f"{said}."
        same = int((gaps == 0).sum())
        if same:
            yield f"{_count(same, len(own))} of {drive} have the time of the frame before: check the unit of the times."


def wrong_sizes(frames: FrameTable, images: PanoramaLibrary | None) -> Iterator[str]:
    """Check the sizes of some images."""
    counts: Counter[tuple[int, int]] = Counter()
    for path in spread(frames.path, _PROBED):
        with suppress(UnreadableImageError):
            rows, columns = read_image(path).shape[:2]
            counts[rows, columns] += 1
    camera = next(iter(images.cameras.values())) if images is not None else None
    placed = getattr(camera, "whole", False)  # pictures of another shape say what they show
    if len({round(width / height, 1) for height, width in counts}) > 1 and not placed:
        listed = ", ".join(f"{width} x {height} px ({count})" for (height, width), count in counts.items())
        yield (
            f"images have different shapes, among those looked at {listed}: they would be resized to one size and look "
            "different for that reason alone. Use one camera and crop for all."
        )
    if images is None or not counts:
        return
    if camera is not None:
        yield from unseen(images)
        return
    height, width = counts.most_common(1)[0][0]
    if np.nan_to_num(frames.tilt).any():
        yield (
            "the robot's roll and pitch are known, but images that are only resized are not levelled: choose their "
            "camera, such as unwrap=equirectangular."
        )
    rows, columns = images.image_size
    squeezed = (columns / rows) / (width / height)
    if not 0.67 < squeezed < 1.5:
        yield (
            f"images of {width} x {height} px (columns x rows) are resized to {columns} x {rows} without unwrapping, "
            "which changes their shape: whole 360-degree pictures need unwrap=equirectangular, images of a mirror or a "
            "fisheye lens their camera, such as unwrap=polar, others an image_size of their own shape"
            + (", and circular=false if they do not show the full turn." if images.circular else ".")
        )


def _are_rings(frames: FrameTable, images: PanoramaLibrary) -> bool:
    """Return whether images that are only resized are a mirror's or a lens's, by their shape; see `wrong_sizes`."""
    size = next((size for path in frames.path.tolist() if (size := size_of(path)) is not None), None)
    if size is None or not images.circular or any(camera is not None for camera in images.cameras.values()):
        return False
    shape = size[1] / size[0]
    return shape <= _PANORAMIC and images.image_size[1] / images.image_size[0] > 1.5 * shape


def unseen(images: PanoramaLibrary) -> Iterator[str]:
    """Report how much of the panorama the camera of the first drive does not see."""
    view, sees = images.preprocessing.view, images.seen(next(iter(images.cameras)))
    if sees is not None and sees.mean() < 0.98:
        rows = np.degrees(view.row_elevation())[(sees.mean(axis=1) > 0.98)]
        whole = f"it sees all around from {rows.max():.0f} to {rows.min():.0f}" if len(rows) else "in no row all around"
        yield (
            f"the camera does not see {1 - sees.mean():.0%} of a panorama from {view.top:g} to {view.bottom:g} degrees "
            f"({whole}), which is filled with what is next to it: check unwrap, or choose another unwrap.top and "
            "unwrap.bottom."
        )


def wrong_pictures(
    frames: FrameTable, images: PanoramaLibrary, described_by: Descriptor | None = None, mounting: bool = True
) -> Iterator[str]:
    """Yield the faults that the panoramas of each drive show; see `drive_faults`."""
    for name, rows in frames.rows_by("sequence").items():
        for fault in drive_faults(images.readable(frames.take(rows)), images, described_by, mounting):
            yield f"sequence {name or '(unnamed)'}: {fault}."


def _copies(frames: FrameTable) -> Iterator[str]:
    """Look for images that occur more than once: the same file, or files with the same contents."""
    paths: dict[str, str] = {}
    for sequence, path in frames.identities():
        paths.setdefault(path, sequence)
    if len(paths) < len(frames):
        yield (
            f"{_count(len(frames) - len(paths), len(frames))} show an image that another frame shows too: a query "
            "whose own image is in the map is found without any skill. Set protocol.leave_one_out=true."
        )
    by_size: dict[int, list[str]] = {}
    for path in paths:
        if os.path.isfile(path):  # noqa: PTH113 (names may be too long)
            by_size.setdefault(Path(path).stat().st_size, []).append(path)
    first: dict[str, str] = {}
    copies = []
    for group in by_size.values():
        for path in group if len(group) > 1 else []:
            original = first.setdefault(file_hash(path), path)
            if original != path:
                copies.append((original, path))
    if copies:
        between = sum(paths[a] != paths[b] for a, b in copies)
        yield (
            f"{len(copies)} images are copies of others, {between} of them of another sequence's, the first: "
            f"{copies[0][1]} of {copies[0][0]}. A query with a copy in the map is found without any skill: remove them."
        )


def _count(some: int, total: int) -> str:
    return f"all {total} frames" if some == total else f"{some} of {total} frames"
