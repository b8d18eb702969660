"""Poses of the robot in every frame: built-in paths, driven a little differently in each run, grids, or a list."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath

import cv2
import numpy as np

from siamloc.data.cold import read_list
from siamloc.data.names import NamedPose, format_name
from siamloc.errors import ConfigError, DataError, hint
from siamloc.simulate.layout import Array, Building, Rng
from siamloc.simulate.plan import blocked_points, clearance, crossings, obstacles, room_at, room_codes
from siamloc.simulate.shell import leaf_segment

#: Distance in metres that the robot's middle keeps from walls and furniture.
BODY = 0.26
SPEED = 0.35
TURN_RATE = 0.9
#: Paths that every building has: the points of a grid over its free floor, and the middles of the grid's squares.
GRIDS = ("grid", "halfway")
_PAUSE = 5.0  # seconds between two pictures of a robot that stands still
_STEP = 0.02
_SHIFT_LENGTH = 2.5
_MAX_SHIFT = 0.3
_MAX_TURN = np.radians(20)


@dataclass(frozen=True)
class Track:
    """The n frames of one drive: poses, times, speeds, names and rooms.

    Attributes:
        poses: x, y in metres and heading in rad (n, 3).
        time: times in seconds (n,).
        speed: speeds in metres per second (n,).
        turn_rate: turn rates in rad per second, counter-clockwise (n,).
        names: image names (n,).
        codes: room codes (n,).
    """

    poses: Array
    time: Array
    speed: Array
    turn_rate: Array
    names: tuple[str, ...]
    codes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.poses)

    def head(self, count: int | None) -> Track:
        """Return the drive with its first `count` frames."""
        return Track(*(values[:count] for values in vars(self).values()))


def drive(building: Building, path: str, spacing: float, rng: Rng, start: float) -> Track:
    """Drive a path of the building for one run: shifted sideways by up to 0.3 m, with an unsteady heading.

    Args:
        building: the building with its paths and obstacles.
        path: name of the path.
        spacing: metres after which the robot takes the next frame, in its steps of 2 cm; it takes one earlier after 20
            degrees of turning, to and fro, in which the swings of the unsteady heading add up.
        rng: draws the shift and the heading.
        start: time of the first frame in seconds.

    Raises:
        ConfigError: the building has no such path.
        DataError: cutting the path's corners leads into a wall or an item.
    """
    if path not in building.paths:
        raise ConfigError(f"building {building.name!r} has no path {path!r}; {hint(path, [*building.paths, *GRIDS])}")
    even = rounded(building.paths[path])
    _check_rounded(building, path, even)
    line = _shifted(building, even, rng)
    heading = _headings(line) + np.radians(4) * _wander(rng, len(line), 1.5)
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    turns = np.abs(np.diff(heading))
    each = np.maximum(steps / SPEED, turns / TURN_RATE), steps, turns
    time, travelled, turned = (np.concatenate([[0.0], np.cumsum(one)]) for one in each)
    keep = [0]
    for row in range(1, len(line)):
        if travelled[row] - travelled[keep[-1]] >= spacing or turned[row] - turned[keep[-1]] >= _MAX_TURN:
            keep.append(row)
    speed = np.gradient(travelled, time)
    rate = cv2.blur(np.gradient(heading, time)[:, None], (1, 15), borderType=cv2.BORDER_REPLICATE)[:, 0]
    poses = np.column_stack([line, (heading + np.pi) % (2 * np.pi) - np.pi])[keep]
    poses, times = np.round(poses, 6), np.round(start + time[keep], 6)
    return _named(building, poses, times, speed[keep], rate[keep])


def _named(building: Building, poses: Array, times: Array, speed: Array, turn_rate: Array) -> Track:
    names = [format_name(NamedPose(t, *pose)) for t, pose in zip(times.tolist(), poses.tolist(), strict=True)]
    return Track(poses, times, speed, turn_rate, tuple(names), tuple(room_codes(building, poses[:, :2])))


def grid(
    building: Building, path: str, spacing: float, rng: Rng, start: float, headings: int, positions: int | None
) -> Track:
    """Stand still on a grid over the free floor of all rooms, or halfway between its points ([T] 3.4.1, [C] 5.1).

    Args:
        building: the building with its obstacles; open doors are obstacles too.
        path: "grid", whose first heading is that of the x axis; or "halfway", for the middle of the grid's squares
            that have a free corner, with a drawn first heading at each position.
        spacing: metres between the points of the grid.
        rng: draws the positions and headings.
        start: time of the first frame in seconds.
        headings: number of frames at each position, evenly turned.
        positions: number of positions, spread over the rooms by their free floor; all if None.

    Raises:
        DataError: fewer free positions than wanted.
    """
    first = 0.5 * spacing * (1 + GRIDS.index(path))
    axes = [np.arange(low + first, high, spacing) for low, high in building.bounds]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = points[_standable(building, points)]
    if path == "halfway":
        corners = points[:, None] + 0.5 * spacing * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
        points = points[_standable(building, corners.reshape(-1, 2)).reshape(-1, 4).any(axis=1)]
    points = points[np.argsort(room_at(building, points), kind="stable")]
    if not len(points):
        raise DataError(
            f"building {building.name!r} has no free position on a grid of {spacing} m: use a smaller spacing"
        )
    wanted = len(points) if positions is None else positions
    if not 0 < wanted <= len(points):
        raise DataError(
            f"building {building.name!r} has {len(points)} free positions on a grid of {spacing} m: "
            f"ask for 1 to {len(points)}, got {wanted}"
        )
    points = points[((np.arange(wanted) + rng.uniform()) * len(points) / wanted).astype(int)]
    turned = np.arange(headings) * 2 * np.pi / headings + (path == "halfway") * rng.uniform(0, 2 * np.pi, (wanted, 1))
    heading = (turned + np.pi) % (2 * np.pi) - np.pi
    poses = np.round(np.column_stack([np.repeat(points, headings, axis=0), heading.ravel()]), 6)
    still = np.zeros(len(poses))
    return _named(building, poses, np.round(start + _PAUSE * np.arange(len(poses)), 6), still, still)


def _standable(building: Building, points: Array) -> Array:
    """Return True for points (n, 2) where the robot keeps clear of walls, furniture and open doors."""
    doors = [opening for opening in building.openings if opening.kind in ("leaf", "glass")]
    leaves = [leaf_segment(building, door, angle)[None] for door in doors for angle in (86, 98)]
    clear = clearance(points, np.concatenate([obstacles(building)[0], *leaves])) >= BODY
    return clear & ~blocked_points(building, points)


def listed(building: Building, file: FilePath) -> Track:
    """Return the drive with the poses of a `places.lst`; image names stay as they are, rooms follow from the plan.

    Raises:
        DataError: a list that cannot be read or names other images than JPEG, or a pose in a wall or an item.
    """
    frames = [frame for frame in read_list(file) if not np.isnan(frame["x"])]
    names = tuple(frame["image"] for frame in frames)
    if other := [name for name in names if not name.lower().endswith((".jpeg", ".jpg"))]:
        raise DataError(f"{file}: images are written as JPEG, but the list names {other[0]}")
    values = np.array([[frame[key] for key in NamedPose._fields] for frame in frames])
    inside = blocked_points(building, values[:, 1:3])
    if inside.any():
        raise DataError(
            f"{file}: {int(inside.sum())} of {len(names)} poses lie in a wall or on furniture of building "
            f"{building.name!r}, the first: {names[int(inside.argmax())]}"
        )
    change = np.zeros_like(values)
    if len(names) > 1:
        change = np.gradient(np.column_stack([values[:, :3], np.unwrap(values[:, 3])]), axis=0)
    seconds = np.maximum(change[:, 0], 0.05)
    speed = np.clip(np.linalg.norm(change[:, 1:3], axis=1) / seconds, 0, 1.0)
    rate = np.clip(change[:, 3] / seconds, -1.5, 1.5)
    codes = tuple(room_codes(building, values[:, 1:3]))
    return Track(values[:, 1:4], values[:, 0], speed, rate, names, codes)


def rounded(points: Array) -> Array:
    """Cut the corners of a polygon of waypoints (n, 2) three times, and resample it in even steps."""
    for _ in range(3):
        inner = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], inner.reshape(-1, 2), points[-1:]])
    return resampled(points, _STEP)


def _check_rounded(building: Building, path: str, line: Array) -> None:
    stuck = line[blocked_points(building, line)]
    if len(stuck):
        x, y = stuck[0]
        points = building.paths[path]
        corner = points[[np.argmin(np.linalg.norm(points - stuck[0], axis=1))]]
        raise DataError(
            f"{building.source}: rounding the corners of path {path!r} leads into a wall or furniture of "
            f"room {room_codes(building, corner)[0]!r} at ({x:.2f}, {y:.2f}): add points around it"
        )


def resampled(points: Array, step: float) -> Array:
    """Return points (n, 2) in even steps of about the given length along a polygon."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(length) > 1e-9])
    at = np.linspace(0, length[-1], max(2, round(length[-1] / step)))
    return np.stack([np.interp(at, length[keep], points[keep, axis]) for axis in (0, 1)], axis=1)


def _wander(rng: Rng, count: int, metres: float) -> Array:
    """Return smooth random numbers (count,) of about unit size that change over about `metres`."""
    knots = max(4, int(count * _STEP / metres) + 3)
    values = rng.standard_normal(knots)
    at = np.linspace(0, knots - 1, count)
    low = np.clip(at.astype(int), 0, knots - 2)
    share = at - low
    share = share * share * (3 - 2 * share)
    return values[low] * (1 - share) + values[low + 1] * share


def _shifted(building: Building, line: Array, rng: Rng) -> Array:
    """Shift a path sideways as far as walls and furniture allow."""
    segments, _ = obstacles(building)
    room: Array = np.clip(clearance(line, segments) - BODY, 0, _MAX_SHIFT)
    width = int(0.8 / _STEP) | 1
    room = cv2.erode(room[:, None], np.ones((width, 1), np.uint8), borderType=cv2.BORDER_REPLICATE)
    room = cv2.blur(room, (1, width), borderType=cv2.BORDER_REPLICATE)[:, 0]
    wanted = np.tanh(_wander(rng, len(line), _SHIFT_LENGTH) * 0.6) * _MAX_SHIFT
    tangent = np.gradient(line, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    smooth = cv2.GaussianBlur(normal, (1, 2 * width + 1), 0.3 / _STEP, borderType=cv2.BORDER_REPLICATE)
    shifted = resampled(line + np.clip(wanted, -room, room)[:, None] * smooth, _STEP)
    moves = np.stack([shifted[:-1], shifted[1:]], axis=1)
    wall = bool(crossings(moves, segments).any() or blocked_points(building, shifted).any())
    return line if wall else shifted


def _headings(line: Array) -> Array:
    """Return the driving direction (n,), continuous, smoothed over about 0.4 m."""
    tangent = np.gradient(line, axis=0)
    angle = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    width = int(0.4 / _STEP) | 1
    return cv2.blur(angle[:, None], (1, width), borderType=cv2.BORDER_REPLICATE)[:, 0]
