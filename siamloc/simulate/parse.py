"""Read a building file: YAML, checked entry by entry."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path as FilePath
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
import yaml

from foundation.errors import not_yaml
from foundation.files import read_text
from foundation.settings import Rule, Seed, Settings, complaint, default_of, fields_of
from siamloc.errors import DataError, hint
from siamloc.simulate.camera import HEIGHT
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import HALF_WALL, SIDES, Array, Building, Item, Opening, Room, shared_wall
from siamloc.simulate.textures import SURFACES

Metres = Annotated[float, Rule("a number", lambda value: abs(value) < 1e6)]
Length = Annotated[float, Rule("a number above 0", lambda value: 0 < value < 1e6)]
Height = Annotated[float, Rule("a number of at least 0", lambda value: 0 <= value < 1e6)]
Pair = tuple[Metres, Metres]
Colour = tuple[Height, Height, Height]
Hundred = Annotated[int, Rule("a whole number from 0 to 100", lambda value: 0 <= value <= 100)]
# For text that becomes part of a file name or of a list whose columns are separated by spaces.
_WORD = re.compile(r"\w[\w.-]*")
Word = Annotated[
    str | int, Rule("a word of letters, digits, '.', '-' and '_'", lambda value: bool(_WORD.fullmatch(str(value))))
]
#: Lowest ceiling over the camera and highest ceiling, and farthest wall from 0, in metres. Farther away, single
#: precision no longer tells a surface from what is right before it.
LOWEST, HIGHEST, FARTHEST = HEIGHT + 0.3, 200.0, 1000.0
THRESHOLD = 0.1  # m
Keys = dict[str, Any]
List = Annotated[list[Any], Rule("a list", lambda value: True)]
Surface: Any = Literal[tuple(SURFACES)]
_WOODS = (*SURFACES, "plain", "plastic", "metal", "fabric", "cork")
Woodwork: Any = Literal[_WOODS]
SideName: Any = Literal[tuple(SIDES)]


class _Entry(Settings):
    """An entry of a building file."""

    ERROR: ClassVar[type[Exception]] = DataError


EntryKind = TypeVar("EntryKind", bound=_Entry)


@dataclass(frozen=True)
class _Building(_Entry):
    rooms: Keys
    name: Word | None = None
    part: Literal["a", "b"] = "a"
    materials: Literal["standard", "drawn", "natural"] = "standard"
    north: Metres = 90.0
    height: Length = 2.8
    doors: List = field(default_factory=list)
    paths: Keys = field(default_factory=dict)


@dataclass(frozen=True)
class _Room(_Entry):
    x: Pair
    y: Pair
    code: Word | None = None
    height: Length | None = None
    floor: Surface = "linoleum"
    walls: Surface = "paint"
    ceiling: Surface = "ceiling_panels"
    paint: Colour = (1.0, 1.0, 1.0)
    wainscot: tuple[Surface, Height] | None = None
    lamps: tuple[Literal["panel", "tube", "round"], Hundred, Hundred] = ("panel", 1, 1)
    windows: List = field(default_factory=list)
    items: List = field(default_factory=list)


@dataclass(frozen=True)
class _Door(_Entry):
    between: tuple[str | int, str | int]
    at: Metres
    width: Length = 1.0
    height: Length = 2.1
    bottom: Height | None = None
    kind: Literal["leaf", "glass", "open", "pane"] = "leaf"
    hinge: Literal["low", "high"] = "low"
    into: str | int | None = None


@dataclass(frozen=True)
class _Window(_Entry):
    wall: SideName
    at: Metres
    width: Length = 1.6
    sill: Metres = 0.9
    head: Metres = 2.3


@dataclass(frozen=True)
class Options(_Entry):
    """Options of items; `items.KINDS` lists the options that each kind of item has."""

    colour: Colour | None = None
    content: Literal["mixed", "books", "binders", "empty"] = "mixed"
    picture: Seed = 0
    screens: Hundred = 1
    wall_units: bool = True
    wood: Woodwork = "beech"


@dataclass(frozen=True, kw_only=True)
class _Item(Options):
    kind: str
    at: Pair | Metres
    against: SideName | None = None
    facing: Metres = 90.0
    size: tuple[Length, Length, Length] | None = None
    z: Metres | None = None


def read_building_file(path: FilePath, seed: int) -> Building:
    """Read and check a building file.

    Args:
        path: the YAML file.
        seed: seed of the building's pictures, colours and small differences.

    Raises:
        DataError: not YAML, or an impossible building; the message names the room.
    """
    try:
        content = yaml.load(read_text(path), _Loader)
    except OSError as error:
        raise DataError(f"the building file {path} cannot be read: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(not_yaml(path, error)) from error
    return parse_building(content, seed, str(path))


def parse_building(content: Any, seed: int, source: str) -> Building:
    """Return the building that a parsed file describes; its paths still have to be checked with `plan.check_paths`.

    Args:
        content: the content of the file as plain values.
        seed: seed of the building's pictures, colours and small differences.
        source: name of the file, for messages.

    Raises:
        DataError: an entry that is missing, unknown, or geometrically impossible.

    >>> parse_building({"rooms": {"cell": {"x": [0, 4], "y": [0, 3]}}}, 0, "jail").bounds
    ((0.0, 4.0), (0.0, 3.0))
    """
    return _Parser(source).building(content, seed)


def _real(value: Any) -> Any:
    """Return a whole number as a float, also in a list."""
    if isinstance(value, tuple):
        return tuple(map(_real, value))
    return float(value) if isinstance(value, int) else value


class _Parser:
    def __init__(self, source: str) -> None:
        self.source = source

    def error(self, message: str) -> DataError:
        """Return the error of an entry."""
        return DataError(f"{self.source}: {message}")

    def entry(self, kind: type[EntryKind], entry: Any, what: str) -> EntryKind:
        """Return the values of an entry, checked; a key without a value counts as absent."""
        if wrong := complaint(entry, Keys):
            raise self.error(f"{what} {wrong}")
        for one in dataclasses.fields(kind):  # type: ignore[arg-type]
            if entry.get(one.name) is None and default_of(one) is dataclasses.MISSING:
                raise self.error(f"{what} needs {one.name!r}")
        known = fields_of(kind)
        try:
            return kind.of({key: value for key, value in entry.items() if value is not None or key not in known})
        except DataError as error:
            raise self.error(f"{what}: {error}") from None

    def choice(self, value: Any, valid: Collection[str], what: str) -> str:
        if str(value) not in valid:
            raise self.error(f"{what} {value!r} is unknown; {hint(str(value), valid)}")
        return str(value)

    def building(self, content: Any, seed: int) -> Building:
        given = self.entry(_Building, content, "a building")
        if not given.rooms:
            raise self.error("a building needs 'rooms'")
        name = str(FilePath(self.source).stem if given.name is None else given.name)
        if wrong := complaint(name, Word):
            raise self.error(f"the building's name {wrong}: give it one as 'name'")
        found = {str(key): self.entry(_Room, entry, f"room {str(key)!r}") for key, entry in given.rooms.items()}
        rooms = {key: self.room(key, one, given.height) for key, one in found.items()}
        self.check_overlaps(rooms)
        openings = [self.door(entry, rooms) for entry in given.doors]
        openings += [self.window(entry, rooms[key], rooms) for key in rooms for entry in found[key].windows]
        self.check_openings(openings)
        items = tuple(self.item(entry, rooms[key]) for key in rooms for entry in found[key].items)
        paths = {str(key): self.path(str(key), points) for key, points in given.paths.items()}
        north, kinds = float(given.north), (given.part, given.materials)
        return Building(name, int(seed), self.source, north, rooms, tuple(openings), items, paths, *kinds)

    def room(self, name: str, given: _Room, height: float) -> Room:
        what = f"room {name!r}"
        if given.code is None and (wrong := complaint(name, Word)):
            raise self.error(f"{what}: without a 'code' of its own, its name {wrong}")
        for axis, (low, high) in (("x", given.x), ("y", given.y)):
            if high - low < 0.8:
                raise self.error(f"{what} must be at least 0.8 m wide, but {axis} runs from {low} to {high}")
            if max(-low, high) > FARTHEST:
                reach = f"{axis} must lie within {FARTHEST:g} m of 0, but runs from {low} to {high}"
                raise self.error(f"{what}: {reach}: lengths are in metres")
        code = str(name if given.code is None else given.code)
        names = ("x", "y", "floor", "walls", "ceiling", "paint", "wainscot")
        values = {key: _real(getattr(given, key)) for key in names}
        high = float(given.height or height)
        if not LOWEST <= high <= HIGHEST:
            heights = f"{LOWEST:g} to {HIGHEST:g} m high, as the camera is {HEIGHT:g} m above the floor"
            raise self.error(f"{what} must be {heights}, got height {high:g}: lengths are in metres")
        return Room(name=name, code=code, height=high, lamps=given.lamps, **values)

    def check_overlaps(self, rooms: dict[str, Room]) -> None:
        for b, a in combinations(rooms.values(), 2):
            width = min(a.x[1], b.x[1]) - max(a.x[0], b.x[0])
            depth = min(a.y[1], b.y[1]) - max(a.y[0], b.y[0])
            if width > 1e-6 and depth > 1e-6:
                raise self.error(f"rooms {b.name!r} and {a.name!r} overlap by {width:.2f} x {depth:.2f} m")

    def door(self, entry: Any, rooms: dict[str, Room]) -> Opening:
        given = self.entry(_Door, entry, "a door")
        a, b = (rooms[self.choice(name, rooms, "room")] for name in given.between)
        what = f"the door between {a.name!r} and {b.name!r}"
        shared = shared_wall(a, b)
        if shared is None:
            raise self.error(f"rooms {a.name!r} and {b.name!r} share no wall for a door")
        along, level, span = shared
        into = b.name if given.into is None else self.choice(given.into, (a.name, b.name), f"{what}: into")
        bottom = (0.9 if given.kind == "pane" else 0.0) if given.bottom is None else given.bottom
        at, width, low, top = map(float, (given.at, given.width, bottom, given.height))
        sides = a.name, b.name
        opening = Opening(given.kind, along, level, at, width, low, top, sides, given.hinge, into)
        self.check_within(opening, span, min(a.height, b.height), what)
        if opening.passable and not (low <= THRESHOLD and top >= LOWEST):
            floor = f"must begin at the floor, or at most {THRESHOLD:g} m above it,"
            ends = f"{floor} and be at least {LOWEST:g} m high, as the camera is at {HEIGHT:g} m"
            raise self.error(f"{what} {ends}, got {low:g} to {top:g}; kind: pane is no way for a robot")
        return opening

    def window(self, entry: Any, room: Room, rooms: dict[str, Room]) -> Opening:
        what = f"a window of room {room.name!r}"
        given = self.entry(_Window, entry, what)
        what, wall = f"{what} in its {given.wall} wall", SIDES[given.wall]
        at, width, sill, head = map(float, (given.at, given.width, given.sill, given.head))
        level = wall.level(room)
        opening = Opening("window", wall.along, level, at, width, sill, head, (room.name, ""))
        self.check_within(opening, wall.span(room), room.height, what)
        low, high = opening.interval
        for other in rooms.values():
            reach, span = getattr(other, wall.across), wall.span(other)
            near = reach[0] - 1e-6 <= level - wall.inwards * 0.05 <= reach[1] + 1e-6
            if other is not room and near and min(high, span[1]) > max(low, span[0]):
                raise self.error(f"{what} does not look outside but into {other.name!r}")
        return opening

    def check_within(self, opening: Opening, span: tuple[float, float], ceiling: float, what: str) -> None:
        """Check that an opening lies in its wall, between the posts, the floor and the ceiling."""
        low, high = opening.interval
        inside = span[0] + HALF_WALL <= low and high <= span[1] - HALF_WALL
        if not inside or not 0 <= opening.bottom < opening.top <= ceiling:
            place = f"{opening.along} = {low:.2f} to {high:.2f} and height {opening.bottom:.2f} to {opening.top:.2f}"
            wall = f"{span[0]:.2f} to {span[1]:.2f} and 0 to {ceiling:.2f}"
            raise self.error(f"{what} lies outside its wall: {place}, the wall {wall}")

    def check_openings(self, openings: list[Opening]) -> None:
        for b, a in combinations(openings, 2):
            (low, high), (start, end) = a.interval, b.interval
            same = a.along == b.along and abs(a.level - b.level) < 1e-6 and set(a.rooms) & set(b.rooms) - {""}
            if same and low < end - 1e-6 and start < high - 1e-6:
                place = f"between {a.along} = {low:.2f} and {high:.2f}"
                raise self.error(f"two openings of room {a.rooms[0]!r} overlap, {place}")

    def item(self, entry: Any, room: Room) -> Item:
        what = f"room {room.name!r}: an item"
        if isinstance(entry, Mapping):
            what = f"room {room.name!r}: " + self.choice(entry.get("kind"), KINDS, f"room {room.name!r}: item")
        given = self.entry(_Item, entry, what)
        spec = KINDS[given.kind]
        for key in fields_of(Options):
            if entry.get(key) is not None and key not in spec.options:
                raise self.error(f"{what} has no option {key!r}; {hint(key, spec.options)}")
        options = {key: entry[key] for key in spec.options if entry.get(key) is not None}
        size: Any = _real(given.size or spec.size)
        at: Any = _real(given.at)
        if given.against is None:
            wrong, facing = complaint(at, Pair), float(given.facing)
        else:
            side = SIDES[given.against]
            wrong, facing = complaint(at, Metres), side.facing
            at = side.plan(at, side.level(room.inner()) + side.inwards * size[1] / 2)
        if wrong:
            raise self.error(f"{what}: at {wrong}")
        z = float(spec.z if given.z is None else given.z)
        x, y = at
        item = Item(given.kind, x, y, facing, size, z, room.name, options)
        corners, inner, top = item.footprint(), np.array(room.inner(-0.02)), z + size[2]
        if (corners < inner[:, 0]).any() or (corners > inner[:, 1]).any() or top > room.height + 1e-6:
            place = f"at ({x:.2f}, {y:.2f}) with footprint {size[0]} x {size[1]} m, up to {top:.2f} m,"
            raise self.error(f"{what} {place} sticks out of the room, which is {room.height:.2f} m high")
        return item

    def path(self, name: str, points: Any) -> Array:
        if not isinstance(points, list) or len(points) < 2:
            raise self.error(f"path {name!r} needs at least two points [x, y]")
        for point in points:
            if wrong := complaint(point, Pair):
                raise self.error(f"path {name!r}: a point {wrong}")
        return np.array(points, dtype=np.float64)


class _Loader(yaml.SafeLoader):
    """Reads YAML; rejects keys that appear twice, and aliases, which can expand without end."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose the next node, unless it is an alias for another one."""
        if self.check_event(yaml.events.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "aliases are not supported: write the value itself", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping; a key must not appear twice."""
        seen: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if str(key.value) in seen:
                message = f"the key {key.value!r} appears twice"
                raise yaml.constructor.ConstructorError(None, None, message, key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)
