"""Read a building file: YAML, keeping the line of every entry for messages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
import yaml

from foundation.files import read_text
from foundation.settings import Rule, Seed, complaint
from siamloc.errors import DataError, hint
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import HALF_WALL, SIDES, Building, Item, Opening, Path, Room
from siamloc.simulate.textures import SURFACES

_Metres = Annotated[float, Rule("a number", lambda value: abs(value) < 1e6)]
_Length = Annotated[float, Rule("a number above 0", lambda value: 0 < value < 1e6)]
_NotNegative = Annotated[float, Rule("a number of at least 0", lambda value: 0 <= value < 1e6)]
_Pair = Annotated[tuple[_Metres, _Metres], Rule("a list of 2 numbers", lambda value: True)]
_Colour = Annotated[
    tuple[_NotNegative, _NotNegative, _NotNegative], Rule("a list of 3 numbers of at least 0", lambda value: True)
]
_Lengths = Annotated[tuple[_Length, _Length, _Length], Rule("a list of 3 numbers above 0", lambda value: True)]
_Hundred = Annotated[int, Rule("a whole number from 0 to 100", lambda value: 0 <= value <= 100)]
# For text that becomes part of a file name or of a list whose columns are separated by spaces.
_Word = Annotated[
    str | int,
    Rule(
        "a word of letters, digits, '.', '-' and '_'",
        lambda value: re.fullmatch(r"\w[\w.-]*", str(value)) is not None,
    ),
]
_List = Annotated[list[Any], Rule("a list", lambda value: True)]
_Mapping = Annotated[dict[str, Any], Rule("a mapping", lambda value: True)]
_Surface: Any = Literal[tuple(SURFACES)]
_WOODS = (*SURFACES, "plain", "plastic", "metal", "fabric", "cork")
_Side: Any = Literal[tuple(SIDES)]
#: Types of the entries of a building file. A key without a value counts as absent.
_BUILDING = {
    "name": _Word,
    "part": Literal["a", "b"],
    "materials": Literal["standard", "drawn"],
    "north": _Metres,
    "height": _Length,
    "rooms": _Mapping,
    "doors": _List,
    "paths": _Mapping,
}
_ROOM = {
    "code": _Word,
    "x": _Pair,
    "y": _Pair,
    "height": _Length,
    "floor": _Surface,
    "walls": _Surface,
    "ceiling": _Surface,
    "paint": _Colour,
    "wainscot": Annotated[
        tuple[_Surface, _NotNegative], Rule("a list [material, height], such as [tiles_wall, 1.2]", lambda value: True)
    ],
    "lamps": Annotated[
        tuple[Literal["panel", "tube", "round"], _Hundred, _Hundred],
        Rule("a list [kind, count along x, count along y], such as [tube, 2, 1]", lambda value: True),
    ],
    "windows": _List,
    "items": _List,
}
_DOOR = {
    "between": Annotated[tuple[Any, Any], Rule("a list of two rooms", lambda value: True)],
    "at": _Metres,
    "width": _Length,
    "height": _Length,
    "bottom": _NotNegative,
    "kind": Literal["leaf", "glass", "open", "pane"],
    "hinge": Literal["low", "high"],
    "into": str | int,
}
_WINDOW = {
    "wall": _Side,
    "at": _Metres,
    "width": _Length,
    "sill": _Metres,
    "head": _Metres,
}
_ITEM = {
    "kind": Literal[tuple(KINDS)],
    "against": _Side,
    "off": _Metres,
    "facing": _Metres,
    "size": _Lengths,
    "z": _Metres,
}
#: Types of the options of a kind.
OPTIONS = {
    "colour": _Colour,
    "content": Literal["mixed", "books", "binders", "empty"],
    "count": Annotated[int, Rule("a whole number from 1 to 100", lambda value: 1 <= value <= 100)],
    "drawers": bool,
    "picture": Seed,
    "screens": _Hundred,
    "wall_units": bool,
    "wood": Literal[_WOODS],
}
_OUTWARDS = {"north": 1, "south": -1, "east": 1, "west": -1}


def read_building_file(path: FilePath, seed: int) -> Building:
    """Read and check a building file.

    Raises:
        DataError: not YAML, or an impossible building; the message names the room and the line.
    """
    try:
        content = yaml.load(_text(path), _Loader)
    except RecursionError as error:
        raise DataError(f"{path} is nested too deeply to be a building") from error
    except (yaml.YAMLError, ValueError) as error:
        raise DataError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    return parse_building(content, seed, str(path))


def _text(path: FilePath) -> str:
    try:
        return read_text(path)
    except (OSError, ValueError) as error:
        raise DataError(f"the building file {path} cannot be read: {error}") from error


def parse_building(content: Any, seed: int, source: str) -> Building:
    """Return the building that a parsed file describes; its paths still have to be checked with `plan.check_paths`.

    Raises:
        DataError: an entry that is missing, unknown, or geometrically impossible.

    >>> parse_building({"rooms": {"cell": {"x": [0, 4], "y": [0, 3]}}}, 0, "jail").bounds
    ((0.0, 4.0), (0.0, 3.0))
    """
    return _Parser(source).building(content, seed)


class _Parser:
    def __init__(self, source: str) -> None:
        self.source = source

    def error(self, where: Any, message: str) -> DataError:
        line = where if isinstance(where, int) else getattr(where, "line", 0)
        return DataError(f"{self.source}, line {line}: {message}" if line else f"{self.source}: {message}")

    def entry(self, entry: Any, types: Mapping[str, Any], what: str, needs: tuple[str, ...] = ()) -> dict[str, Any]:
        """Return the values of an entry, checked against their types."""
        if wrong := complaint(entry, _Mapping):
            raise self.error(entry, f"{what} {wrong}")
        given = {key: value for key, value in entry.items() if value is not None}
        for key in entry:
            if key not in types:
                raise self.error(entry, f"{what} has an unknown key {key!r}; {hint(str(key), types)}")
            if key in given and get_origin(types[key]) is Literal:
                self.choice(entry, given[key], get_args(types[key]), f"{what}: {key}")
            elif key in given and (wrong := complaint(given[key], types[key])):
                raise self.error(entry, f"{what}: {key} {wrong}")
        for key in needs:
            if key not in given:
                raise self.error(entry, f"{what} needs {key!r}")
        return given

    def choice(self, where: Any, value: Any, valid: Iterable[str], what: str) -> str:
        valid = list(valid)
        if not isinstance(value, str) or value not in valid:
            raise self.error(where, f"{what} {value!r} is unknown; {hint(str(value), valid)}")
        return value

    def building(self, content: Any, seed: int) -> Building:
        given = self.entry(content, _BUILDING, "a building")
        if not given.get("rooms"):
            raise self.error(content, "a building needs 'rooms'")
        height = float(given.get("height", 2.8))
        found = {str(name): self.room(str(name), entry, height) for name, entry in given["rooms"].items()}
        rooms = {name: room for name, (room, _) in found.items()}
        self.check_overlaps(rooms)
        openings = [self.door(entry, rooms) for entry in given.get("doors", ())]
        for room, entry in found.values():
            openings += [self.window(window, room, rooms) for window in entry.get("windows", ())]
        self.check_openings(openings)
        items = [self.item(item, room) for room, entry in found.values() for item in entry.get("items", ())]
        paths = {str(name): self.path(str(name), points) for name, points in given.get("paths", {}).items()}
        name = str(given.get("name", FilePath(self.source).stem))
        if wrong := complaint(name, _Word):
            raise self.error(content, f"the building's name {wrong}: give it one as 'name'")
        return Building(
            name=name,
            seed=int(seed),
            source=self.source,
            north=float(given.get("north", 90.0)),
            rooms=rooms,
            openings=tuple(openings),
            items=tuple(items),
            paths=paths,
            part=given.get("part", "a"),
            materials=given.get("materials", "standard"),
        )

    def room(self, name: str, entry: Any, height: float) -> tuple[Room, dict[str, Any]]:
        what = f"room {name!r}"
        given = self.entry(entry, _ROOM, what, needs=("x", "y"))
        if "code" not in given and (wrong := complaint(name, _Word)):
            raise self.error(entry, f"{what}: without a 'code' of its own, its name {wrong}")
        for axis in ("x", "y"):
            low, high = given[axis]
            if high - low < 0.8:
                raise self.error(entry, f"{what} must be at least 0.8 m wide, but {axis} runs from {low} to {high}")
        wainscot = given.get("wainscot")
        room = Room(
            name=name,
            code=str(given.get("code", name)),
            x=(float(given["x"][0]), float(given["x"][1])),
            y=(float(given["y"][0]), float(given["y"][1])),
            height=float(given.get("height", height)),
            floor=given.get("floor", "linoleum"),
            walls=given.get("walls", "paint"),
            ceiling=given.get("ceiling", "ceiling_panels"),
            paint=tuple(float(value) for value in given.get("paint", (1, 1, 1))),  # type: ignore[arg-type]
            wainscot=None if wainscot is None else (wainscot[0], float(wainscot[1])),
            lamps=tuple(given.get("lamps", ("panel", 1, 1))),  # type: ignore[arg-type]
            line=getattr(entry, "line", 0),
        )
        return room, given

    def check_overlaps(self, rooms: dict[str, Room]) -> None:
        listed = list(rooms.values())
        for i, a in enumerate(listed):
            for b in listed[:i]:
                width = min(a.x[1], b.x[1]) - max(a.x[0], b.x[0])
                depth = min(a.y[1], b.y[1]) - max(a.y[0], b.y[0])
                if width > 1e-6 and depth > 1e-6:
                    raise self.error(
                        a.line,
                        f"rooms {b.name!r} (line {b.line}) and {a.name!r} overlap by {width:.2f} x {depth:.2f} m",
                    )

    def door(self, entry: Any, rooms: dict[str, Room]) -> Opening:
        given = self.entry(entry, _DOOR, "a door", needs=("between", "at"))
        a, b = (rooms[self.choice(entry, name, rooms, "room")] for name in given["between"])
        what = f"the door between {a.name!r} and {b.name!r}"
        along, level, span = self.shared_wall(entry, a, b)
        kind = given.get("kind", "leaf")
        opening = Opening(
            kind=kind,
            along=along,
            level=level,
            centre=float(given["at"]),
            width=float(given.get("width", 1.0)),
            bottom=float(given.get("bottom", 0.9 if kind == "pane" else 0.0)),
            top=float(given.get("height", 2.1)),
            rooms=(a.name, b.name),
            hinge=given.get("hinge", "low"),
            into=self.choice(entry, given.get("into", b.name), (a.name, b.name), f"{what}: into"),
            line=getattr(entry, "line", 0),
        )
        low, high = opening.interval
        if low < span[0] + HALF_WALL or high > span[1] - HALF_WALL:
            raise self.error(
                entry,
                f"{what} reaches from {along} = {low:.2f} to {high:.2f}, outside the wall they share "
                f"({span[0]:.2f} to {span[1]:.2f})",
            )
        if opening.top > min(a.height, b.height):
            raise self.error(entry, f"{what} is {opening.top} m high, the ceiling {min(a.height, b.height)} m")
        if opening.top <= opening.bottom:
            raise self.error(entry, f"{what} ends at {opening.top} m, not above its bottom at {opening.bottom} m")
        return opening

    def shared_wall(self, entry: Any, a: Room, b: Room) -> tuple[str, float, tuple[float, float]]:
        for along, across in (("x", "y"), ("y", "x")):
            for first, second in ((a, b), (b, a)):
                level = getattr(first, across)[1]
                if abs(level - getattr(second, across)[0]) < 1e-6:
                    low = max(getattr(a, along)[0], getattr(b, along)[0])
                    high = min(getattr(a, along)[1], getattr(b, along)[1])
                    if high > low:
                        return along, level, (low, high)
        raise self.error(entry, f"rooms {a.name!r} and {b.name!r} share no wall for a door")

    def window(self, entry: Any, room: Room, rooms: dict[str, Room]) -> Opening:
        what = f"a window of room {room.name!r}"
        given = self.entry(entry, _WINDOW, what, needs=("wall", "at"))
        side = given["wall"]
        along, across = ("x", "y") if side in ("north", "south") else ("y", "x")
        level = getattr(room, across)[1 if side in ("north", "east") else 0]
        opening = Opening(
            kind="window",
            along=along,
            level=level,
            centre=float(given["at"]),
            width=float(given.get("width", 1.6)),
            bottom=float(given.get("sill", 0.9)),
            top=float(given.get("head", 2.3)),
            rooms=(room.name, ""),
            line=getattr(entry, "line", 0),
        )
        low, high = opening.interval
        span = getattr(room, along)
        outside = low < span[0] + HALF_WALL or high > span[1] - HALF_WALL
        if outside or opening.bottom < 0 or opening.top > room.height or opening.top <= opening.bottom:
            raise self.error(
                entry,
                f"{what} lies outside its {side} wall: {along} = {low:.2f} to {high:.2f} and height "
                f"{opening.bottom:.2f} to {opening.top:.2f}, the wall {span[0]:.2f} to {span[1]:.2f} and 0 to "
                f"{room.height:.2f}",
            )
        beyond = _OUTWARDS[side]
        for other in rooms.values():
            reach = getattr(other, across)
            near = reach[0] - 1e-6 <= level + beyond * 0.05 <= reach[1] + 1e-6
            if other is not room and near and min(high, getattr(other, along)[1]) > max(low, getattr(other, along)[0]):
                raise self.error(entry, f"{what} in its {side} wall does not look outside but into {other.name!r}")
        return opening

    def check_openings(self, openings: list[Opening]) -> None:
        for i, a in enumerate(openings):
            for b in openings[:i]:
                same = a.along == b.along and abs(a.level - b.level) < 1e-6
                apart = a.interval[0] >= b.interval[1] - 1e-6 or b.interval[0] >= a.interval[1] - 1e-6
                if same and not apart and set(a.rooms) & set(b.rooms) - {""}:
                    raise self.error(
                        a.line,
                        f"two openings of room {a.rooms[0]!r} overlap, between {a.along} = {a.interval[0]:.2f} and "
                        f"{a.interval[1]:.2f} (the other one: line {b.line})",
                    )

    def item(self, entry: Any, room: Room) -> Item:
        what = f"room {room.name!r}: an item"
        if wrong := complaint(entry, _Mapping):
            raise self.error(entry, f"{what} {wrong}")
        kind = self.choice(entry, entry.get("kind"), KINDS, f"room {room.name!r}: item")
        spec = KINDS[kind]
        what = f"room {room.name!r}: {kind}"
        side = entry.get("against")
        place = {"at": _Pair if side is None else _Metres}
        options = {key: OPTIONS[key] for key in spec.options}
        given = self.entry(entry, {**_ITEM, **place, **options}, what, needs=("at",))
        size = tuple(float(value) for value in given.get("size", spec.size))
        if side is None:
            x, y = (float(value) for value in given["at"])
            facing = float(given.get("facing", 90.0))
        else:
            facing = SIDES[side]
            inner_x, inner_y = room.inner()
            at = float(given["at"])
            reach = size[1] / 2 + float(given.get("off", 0.0))
            x, y = {
                "north": (at, inner_y[1] - reach),
                "south": (at, inner_y[0] + reach),
                "east": (inner_x[1] - reach, at),
                "west": (inner_x[0] + reach, at),
            }[side]
        item = Item(
            kind=kind,
            x=x,
            y=y,
            facing=facing,
            size=(size[0], size[1], size[2]),
            z=float(given.get("z", spec.z)),
            room=room.name,
            options={key: given[key] for key in spec.options if key in given},
            line=getattr(entry, "line", 0),
        )
        corners = item.footprint()
        inner = np.array(room.inner(-0.02))
        if (corners < inner[:, 0]).any() or (corners > inner[:, 1]).any():
            raise self.error(
                entry, f"{what} at ({x:.2f}, {y:.2f}) with footprint {size[0]} x {size[1]} m sticks out of the room"
            )
        if item.z + item.size[2] > room.height + 1e-6:
            raise self.error(entry, f"{what} reaches {item.z + item.size[2]:.2f} m, the ceiling {room.height:.2f} m")
        return item

    def path(self, name: str, points: Any) -> Path:
        if not isinstance(points, list) or len(points) < 2:
            raise self.error(points, f"path {name!r} needs at least two points [x, y]")
        for point in points:
            if wrong := complaint(point, _Pair):
                raise self.error(point if hasattr(point, "line") else points, f"path {name!r}: a point {wrong}")
        values = np.array(points, dtype=np.float64)
        return Path(name, values, tuple(getattr(point, "line", 0) for point in points))


class _LineDict(dict[str, Any]):
    """A mapping that knows the line it began on, counted from 1."""

    line = 0


class _LineList(list[Any]):
    """A sequence that knows the line it began on."""

    line = 0


class _Loader(yaml.SafeLoader):
    """Reads YAML into mappings and sequences that know their lines; rejects aliases, which can expand without end."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose the next node, unless it is an alias for another one."""
        if self.check_event(yaml.events.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "aliases are not supported: write the value itself", mark)
        return super().compose_node(parent, index)


def _mapping(loader: Any, node: yaml.MappingNode) -> _LineDict:
    seen = set()
    for key, _ in node.value:
        if str(key.value) in seen:
            raise yaml.constructor.ConstructorError(None, None, f"the key {key.value!r} appears twice", key.start_mark)
        seen.add(str(key.value))
    value = _LineDict(loader.construct_mapping(node, deep=True))
    value.line = node.start_mark.line + 1
    return value


def _sequence(loader: Any, node: yaml.SequenceNode) -> _LineList:
    value = _LineList(loader.construct_sequence(node, deep=True))
    value.line = node.start_mark.line + 1
    return value


_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)
_Loader.add_constructor("tag:yaml.org,2002:seq", _sequence)
