"""The parts of a building: rooms, openings and items."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Interval = tuple[float, float]
Colour = tuple[float, float, float]
Rng = np.random.Generator


def single(values: Any) -> Array:
    """Return values as a float32 array."""
    return np.asarray(values, dtype=np.float32)


def seeded(*keys: int | str) -> np.random.Generator:
    """Return a random generator that depends only on the given keys.

    >>> seeded(0, "mini", "lamps").random() == seeded(0, "mini", "lamps").random()
    True
    """
    words = [crc32(key.encode()) if isinstance(key, str) else int(key) & 0xFFFFFFFF for key in keys]
    return np.random.default_rng(np.random.SeedSequence(words))


def turning(degrees: float) -> Array:
    """Return the matrix (2, 2) that turns points of the floor plan, as rows (n, 2) before it, counter-clockwise."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, sine], [-sine, cosine]])


#: Half the thickness of a wall between two rooms in metres: a room's inner faces lie this far inside its rectangle.
HALF_WALL = 0.06
#: Depth in metres of a window's reveal in an outer wall.
OUTER_WALL = 0.30


class Rectangle(NamedTuple):
    """A rectangle on the floor plan: start and end in metres along x and along y."""

    x: Interval
    y: Interval

    def corners(self) -> Array:
        """Return the corners (4, 2), counter-clockwise from the smallest x and y."""
        (x0, x1), (y0, y1) = self
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


class Side(NamedTuple):
    """A side of a room on the floor plan, +y being north.

    Its methods take a room, or anything else that has the extents `x` and `y`.

    Attributes:
        along: axis along the wall, "x" or "y".
        across: the other axis.
        end: 1 if the wall is at the upper end of the room's extent across, else 0.
        facing: direction in degrees, counter-clockwise from +x, that faces away from the wall.
    """

    along: str
    across: str
    end: int
    facing: float

    @property
    def inwards(self) -> int:
        """Sign of the direction from the wall into the room, along the axis across: -1 at the upper end, else 1."""
        return 1 - 2 * self.end

    def span(self, room: Any) -> Interval:
        """Return the start and end of the wall in metres, along its axis."""
        return getattr(room, self.along)  # type: ignore[no-any-return]

    def level(self, room: Any) -> float:
        """Return the wall's coordinate in metres on the axis across."""
        return getattr(room, self.across)[self.end]  # type: ignore[no-any-return]

    def plan(self, along: Any, across: Any) -> tuple[Any, Any]:
        """Order two values, along and across the wall, as x and y; or x and y as along and across."""
        return (along, across) if self.along == "x" else (across, along)


SIDES = {
    "north": Side("x", "y", 1, -90.0),
    "south": Side("x", "y", 0, 90.0),
    "east": Side("y", "x", 1, 180.0),
    "west": Side("y", "x", 0, 0.0),
}


def shared_wall(a: Any, b: Any) -> tuple[str, float, Interval] | None:
    """Return the wall between two rooms: the axis along it, its coordinate across and its ends; None without one.

    The rooms are objects with the extents `x` and `y`.
    """
    for side in SIDES.values():
        opposite = getattr(b, side.across)[1 - side.end]
        low, high = max(side.span(a)[0], side.span(b)[0]), min(side.span(a)[1], side.span(b)[1])
        if abs(side.level(a) - opposite) < 1e-6 and high > low:
            return side.along, (opposite, side.level(a))[side.end], (low, high)
    return None


def side_at(room: Any, along: str, level: float) -> str:
    """Return the name of a room's side, a key of `SIDES`.

    Args:
        room: the room, or anything else that has the extents `x` and `y`.
        along: axis along the wall, "x" or "y".
        level: coordinate of the wall on the other axis in metres.
    """
    return next(name for name, side in SIDES.items() if side.along == along and abs(side.level(room) - level) < 1e-6)


@dataclass(frozen=True)
class Item:
    """An item in a room.

    Attributes:
        kind: key of `items.KINDS`.
        x: middle of the footprint in metres.
        y: middle of the footprint in metres.
        facing: direction in degrees, counter-clockwise from +x, that its front faces.
        size: width, depth and height in metres.
        z: height of its base above the floor in metres.
        room: name of the room that the item is in.
        options: values of the keys that `items.KINDS` lists as options of the kind, such as "colour".
    """

    kind: str
    x: float
    y: float
    facing: float
    size: tuple[float, float, float]
    z: float
    room: str
    options: dict[str, Any] = field(default_factory=dict)

    def footprint(self, margin: float = 0.0) -> Array:
        """Return the corners (4, 2) of the item's rectangle on the floor, counter-clockwise, enlarged by a margin."""
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (np.array(self.size[:2]) / 2 + margin)
        return corners @ turning(self.facing - 90) + (self.x, self.y)

    def edges(self) -> Array:
        """Return the edges (4, 2, 2) of the item's rectangle on the floor."""
        corners = self.footprint()
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


@dataclass(frozen=True)
class Opening:
    """A hole in a wall: a door, a free passage, a window or a pane between two rooms.

    Attributes:
        kind: "leaf" (a door with a leaf), "glass" (a door with a glazed leaf), "open" (a passage), "window" (to
            the outside), "pane" (fixed glass between two rooms).
        along: "x" if the wall runs along x, else "y".
        level: other coordinate of the wall's middle in metres.
        centre: middle of the opening along the wall in metres.
        width: width in metres.
        bottom: lower edge in metres above the floor.
        top: upper edge in metres above the floor.
        rooms: names of the rooms on both sides; the second is "" for the outside.
        hinge: "low" or "high": the end along the wall where the leaf is hinged.
        into: name of the room into which the leaf swings.
    """

    kind: str
    along: str
    level: float
    centre: float
    width: float
    bottom: float
    top: float
    rooms: tuple[str, str]
    hinge: str = "low"
    into: str = ""

    @property
    def passable(self) -> bool:
        """Whether a robot may drive through the opening."""
        return self.kind in ("leaf", "glass", "open")

    @property
    def interval(self) -> Interval:
        """Start and end of the opening along the wall in metres."""
        return self.centre - self.width / 2, self.centre + self.width / 2

    def doorway(self, shorter: float = 0.0, deeper: float = 0.0) -> Rectangle:
        """Return the floor rectangle of the opening, as deep as the wall is thick.

        Args:
            shorter: metres by which the rectangle is shorter at each end along the wall.
            deeper: metres by which it reaches farther into each of the two rooms.
        """
        low, high = self.interval
        depth = HALF_WALL + deeper
        span, across = (low + shorter, high - shorter), (self.level - depth, self.level + depth)
        return Rectangle(span, across) if self.along == "x" else Rectangle(across, span)

    def point(self, along: float, off: float) -> tuple[float, float]:
        """Return the position x, y on the floor plan of a point at the wall, in metres.

        Args:
            along: coordinate of the point along the wall in metres.
            off: distance from the wall's middle in metres, positive towards larger coordinates.
        """
        return (along, self.level + off) if self.along == "x" else (self.level + off, along)


@dataclass(frozen=True)
class Room:
    """A rectangular room.

    Attributes:
        name: unique name within the building.
        code: label of its frames; several rooms may share one.
        x: extent in metres, from the middle of one wall to the middle of the other.
        y: extent in metres.
        height: height of the ceiling in metres.
        floor: texture of the floor, a name in `textures.SURFACES`.
        walls: texture of the walls, a name in `textures.SURFACES`.
        ceiling: texture of the ceiling, a name in `textures.SURFACES`.
        paint: linear colour that multiplies the walls' texture.
        wainscot: texture and height in metres of the lower part of the walls, or None.
        lamps: kind ("panel", "tube", "round") and counts along x and y.
    """

    name: str
    code: str
    x: Interval
    y: Interval
    height: float
    floor: str
    walls: str
    ceiling: str
    paint: tuple[float, float, float]
    wainscot: tuple[str, float] | None
    lamps: tuple[str, int, int]

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the floor."""
        return (self.x[0] + self.x[1]) / 2, (self.y[0] + self.y[1]) / 2

    def inner(self, margin: float = 0.0) -> Rectangle:
        """Return the extents along x and y in metres between the wall faces, reduced by a margin at each end."""
        inset = HALF_WALL + margin
        return Rectangle((self.x[0] + inset, self.x[1] - inset), (self.y[0] + inset, self.y[1] - inset))


@dataclass(frozen=True)
class Building:
    """A building as described by its file and its seed.

    Attributes:
        name: name of the building and of its folder.
        seed: seed of its pictures, colours and small differences.
        source: file that it was read from, for messages.
        north: direction of north in degrees counter-clockwise from +x.
        rooms: rooms by name.
        openings: doors, windows and panes.
        items: everything in the rooms.
        paths: waypoints in metres (n, 2) of the robot's drives, such as "path1", by name.
        part: COLD's part letter, "a" or "b".
        materials: "standard"; "drawn": the colours of its floors, walls and woods also follow from the seed; or
            "natural": so do grain, laid floors and wallpaper, and some floors, tables, mirrors and panes reflect.
    """

    name: str
    seed: int
    source: str
    north: float
    rooms: dict[str, Room]
    openings: tuple[Opening, ...]
    items: tuple[Item, ...]
    paths: dict[str, Array]
    part: str = "a"
    materials: str = "standard"

    def __repr__(self) -> str:
        rooms, paths = ", ".join(self.codes), ", ".join(self.paths)
        return f"Building({self.name!r}, seed={self.seed}: rooms {rooms}; {len(self.items)} items; paths {paths})"

    def rng(self, *keys: int | str) -> Rng:
        """Return a random generator that depends only on the building's seed and name and on the given keys."""
        return seeded(self.seed, self.name, *keys)

    def room_index(self, name: str) -> int:
        """Return the index of a room, by its name, in the order of the building's rooms."""
        return list(self.rooms).index(name)

    def openings_in(self, room: Room, side: str) -> list[tuple[int, Opening]]:
        """Return the openings in one wall of a room, each with its index in `openings`; `side` is a key of `SIDES`."""
        return [
            (index, opening)
            for index, opening in enumerate(self.openings)
            if room.name in opening.rooms and side_at(room, opening.along, opening.level) == side
        ]

    def neighbours(self, room: str) -> list[str]:
        """Return the rooms that light from a room can reach directly, beginning with the room."""
        found = [room]
        for opening in self.openings:
            if room in opening.rooms:
                found += [other for other in opening.rooms if other and other not in found]
        return found

    @property
    def codes(self) -> list[str]:
        """The room codes in the order of the file, each once."""
        return list(dict.fromkeys(room.code for room in self.rooms.values()))

    @property
    def bounds(self) -> tuple[Interval, Interval]:
        """Start and end in metres along x and along y over all rooms."""
        xs = [value for room in self.rooms.values() for value in room.x]
        ys = [value for room in self.rooms.values() for value in room.y]
        return (min(xs), max(xs)), (min(ys), max(ys))
