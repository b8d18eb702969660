"""The floor plan from the robot's point of view: where it may drive and which room it is in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from siamloc.errors import DataError
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import HALF_WALL, SIDES, Array, Building, Interval, Item, Room, turning


def room_at(building: Building, points: Array) -> Array:
    """Return the index of the room around each point (n, 2), -1 outside; rooms reach to the middle of their walls."""
    points = np.asarray(points, dtype=np.float64)
    found = np.full(len(points), -1)
    for index, room in enumerate(building.rooms.values()):
        found[_inside_box(points, room.x, room.y) & (found < 0)] = index
    return found


def room_codes(building: Building, points: Array) -> list[str]:
    """Return the room code of each point (n, 2), "" outside."""
    codes = [room.code for room in building.rooms.values()] + [""]
    return [codes[index] for index in room_at(building, points)]


def obstacles(building: Building, items: Iterable[Item] | None = None) -> tuple[Array, list[str]]:
    """Return the obstacles of a robot as segments (n, 2, 2) in metres, and a description of each one.

    Args:
        building: gives the walls and openings.
        items: items in the rooms in a run; the items of the building file if None.
    """
    segments: list[Array] = []
    names: list[str] = []
    for room in building.rooms.values():
        pieces = _wall_segments(building, room)
        segments += pieces
        names += [f"a wall of room {room.name!r}"] * len(pieces)
    for opening in building.openings:
        if opening.passable:
            for end in opening.interval:
                segments.append(np.array([opening.point(end, -HALF_WALL), opening.point(end, HALF_WALL)]))
                names.append(f"a door post of room {opening.rooms[0]!r}")
    for item in building.items if items is None else items:
        if KINDS[item.kind].blocks:
            segments += [*item.edges()]
            names += [f"the {item.kind} of room {item.room!r}"] * 4
    return np.stack(segments), names


def _wall_segments(building: Building, room: Room) -> list[Array]:
    """Return a room's inner faces as segments (2, 2), with gaps where a robot may drive through."""
    pieces: list[Array] = []
    for name in ("south", "north", "west", "east"):
        side = SIDES[name]
        (cursor, high), face = side.span(room.inner()), side.level(room.inner())
        gaps = sorted(opening.interval for _, opening in building.openings_in(room, name) if opening.passable)
        for start, end in [*gaps, (high, high)]:
            if start > cursor:
                pieces.append(np.array([side.plan(cursor, face), side.plan(start, face)]))
            cursor = end
    return pieces


def blocked_points(building: Building, points: Array, items: Iterable[Item] | None = None) -> Array:
    """Return True for points (n, 2) inside a wall or an item, or outside the building."""
    points = np.asarray(points, dtype=np.float64)
    free = np.zeros(len(points), dtype=bool)
    for room in building.rooms.values():
        free |= _inside_box(points, *room.inner())
    for opening in building.openings:
        if opening.passable:
            free |= _inside_box(points, *opening.doorway())
    for item in building.items if items is None else items:
        if KINDS[item.kind].blocks:
            free &= ~inside_item(item, points)
    return ~free


def inside_item(item: Item, points: Array, margin: float = 0.0) -> Array:
    """Return True for points (n, 2) inside an item's footprint, enlarged by a margin."""
    local = (points - (item.x, item.y)) @ turning(90 - item.facing)
    return np.asarray((np.abs(local) < np.array(item.size[:2]) / 2 + margin).all(axis=1))


def _inside_box(points: Array, x: Interval, y: Interval) -> Array:
    inside = (points[:, 0] >= x[0]) & (points[:, 0] <= x[1])
    return inside & (points[:, 1] >= y[0]) & (points[:, 1] <= y[1])


def clearance(points: Array, segments: Array) -> Array:
    """Return the distance in metres of each point (n, 2) to the nearest of m segments (m, 2, 2)."""
    points = np.asarray(points, dtype=np.float64)
    nearest = np.full(len(points), np.inf)
    for a, b in segments:
        edge = b - a
        share = np.clip((points - a) @ edge / max(float(edge @ edge), 1e-12), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * edge, axis=1))
    return nearest


def crossings(moves: Array, segments: Array) -> Array:
    """Return True (n, m) where a move (n, 2, 2) crosses a segment (m, 2, 2)."""
    a, b = moves[:, None, 0], moves[:, None, 1]
    c, d = segments[None, :, 0], segments[None, :, 1]

    def side(p: Array, q: Array, r: Array) -> Array:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    return (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)


def check_paths(building: Building) -> None:
    """Check that every path of a building runs through free space.

    Raises:
        DataError: a path that leaves the building or runs through a wall or an item; the message names the path's
            point and the room.
    """
    segments, names = obstacles(building)
    for name, points in building.paths.items():
        what = f"{building.source}: path {name!r}"
        moves = np.stack([points[:-1], points[1:]], axis=1)
        hits = crossings(moves, segments)
        if hits.any():
            move, segment = np.argwhere(hits)[0]
            (x0, y0), (x1, y1) = moves[move]
            raise DataError(
                f"{what} runs through {names[segment]} between ({x0:.2f}, {y0:.2f}) and "
                f"({x1:.2f}, {y1:.2f}): move the point or open a door"
            )
        for (x, y), stuck in zip(points, blocked_points(building, points), strict=True):
            if stuck:
                raise DataError(f"{what} leaves the free floor at ({x:.2f}, {y:.2f}), for a wall, an item or outside")
