"""Reading a building file: YAML with the line of every entry kept for messages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import yaml

from siamloc.errors import DataError, hint
from siamloc.simulate.kinds import KINDS
from siamloc.simulate.layout import HALF_WALL, SIDES, Building, Item, Opening, Path, Room
from siamloc.simulate.lines import load_with_lines
from siamloc.simulate.textures import SURFACES

_ROOM_KEYS = ["code", "x", "y", "height", "floor", "walls", "ceiling", "paint", "wainscot", "lamps", "windows", "items"]
_DOOR_KEYS = ["between", "at", "width", "height", "bottom", "kind", "hinge", "into"]
_WINDOW_KEYS = ["wall", "at", "width", "sill", "head"]
_TOP_KEYS = ["name", "part", "north", "height", "rooms", "doors", "paths"]
_LAMPS = ("panel", "tube", "round")
_DOOR_KINDS = ("leaf", "glass", "open", "pane")


def read_building_file(path: FilePath, seed: int) -> Building:
    """Read and check a building file.

    Raises:
        DataError: not YAML, or a building that cannot stand; the message names the room and the line.
    """
    try:
        content = load_with_lines(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"the building file {path} cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise DataError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    return parse_building(content, seed, str(path))


def parse_building(content: Any, seed: int, source: str) -> Building:
    """Return the building that a parsed file describes; `plan.check` still has to look at its paths.

    Raises:
        DataError: an entry that is missing, unknown, or geometrically impossible.
    """
    return _Parser(source).building(content, seed)


class _Parser:
    def __init__(self, source: str) -> None:
        self.source = source

    def error(self, where: Any, message: str) -> DataError:
        line = where if isinstance(where, int) else getattr(where, "line", 0)
        return DataError(f"{self.source}, line {line}: {message}" if line else f"{self.source}: {message}")

    def known(self, entry: Any, keys: Iterable[str], what: str) -> None:
        if not isinstance(entry, dict):
            raise self.error(entry, f"{what} must be a mapping, got {entry!r}")
        for key in entry:
            if key not in keys:
                raise self.error(entry, f"{what} has an unknown key {key!r}; {hint(str(key), keys)}")

    def number(self, entry: dict[str, Any], key: str, what: str, default: float | None = None) -> float:
        value = entry.get(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise self.error(entry, f"{what} needs a number as {key!r}, got {value!r}")
        return float(value)

    def numbers(self, where: Any, value: Any, count: int, what: str) -> tuple[float, ...]:
        whole = isinstance(value, (list, tuple)) and len(value) == count
        if not whole or not all(
            isinstance(v, (int, float)) and not isinstance(v, bool) and np.isfinite(v) for v in value
        ):
            raise self.error(where, f"{what} needs {count} numbers, got {value!r}")
        return tuple(float(v) for v in value)

    def choice(self, where: Any, value: Any, valid: Iterable[str], what: str) -> str:
        if not isinstance(value, str) or value not in valid:
            raise self.error(where, f"{what} {value!r} is unknown; {hint(str(value), valid)}")
        return str(value)

    def building(self, content: Any, seed: int) -> Building:
        self.known(content, _TOP_KEYS, "a building")
        if not content.get("rooms"):
            raise self.error(content, "a building needs 'rooms'")
        height = self.number(content, "height", "the building", 2.8)
        rooms = {str(name): self.room(str(name), entry, height) for name, entry in content["rooms"].items()}
        self.check_overlaps(rooms)
        openings = [self.door(entry, rooms) for entry in content.get("doors") or ()]
        for name, entry in content["rooms"].items():
            openings += [self.window(window, rooms[str(name)], rooms) for window in entry.get("windows") or ()]
        self.check_openings(openings)
        items = [
            self.item(entry, rooms[str(name)])
            for name, room in content["rooms"].items()
            for entry in room.get("items") or ()
        ]
        paths = {str(name): self.path(str(name), points) for name, points in (content.get("paths") or {}).items()}
        return Building(
            name=str(content.get("name") or FilePath(self.source).stem),
            seed=int(seed),
            source=self.source,
            north=self.number(content, "north", "the building", 90.0),
            rooms=rooms,
            openings=tuple(openings),
            items=tuple(items),
            paths=paths,
            part=self.choice(content, content.get("part", "a"), ("a", "b"), "part"),
        )

    def room(self, name: str, entry: Any, height: float) -> Room:
        what = f"room {name!r}"
        self.known(entry, _ROOM_KEYS, what)
        extents = []
        for axis in ("x", "y"):
            low, high = self.numbers(entry, entry.get(axis), 2, f"{what}: {axis!r}")
            if high - low < 0.8:
                raise self.error(entry, f"{what} must be at least 0.8 m wide, but {axis} runs from {low} to {high}")
            extents.append((low, high))
        lamps = entry.get("lamps", ["panel", 1, 1])
        if not (isinstance(lamps, list) and len(lamps) == 3):
            raise self.error(entry, f"{what}: lamps are given as [kind, count along x, count along y], got {lamps!r}")
        self.choice(entry, lamps[0], _LAMPS, f"{what}: lamp")
        counts = self.numbers(entry, lamps[1:], 2, f"{what}: 'lamps'")
        wainscot = entry.get("wainscot")
        if wainscot is not None:
            if not (isinstance(wainscot, list) and len(wainscot) == 2):
                raise self.error(entry, f"{what}: a wainscot is given as [material, height], got {wainscot!r}")
            wainscot = (self.material(entry, wainscot[0], what), float(wainscot[1]))
        return Room(
            name=name,
            code=str(entry.get("code", name)),
            x=extents[0],
            y=extents[1],
            height=self.number(entry, "height", what, height),
            floor=self.material(entry, entry.get("floor", "linoleum"), what),
            walls=self.material(entry, entry.get("walls", "paint"), what),
            ceiling=self.material(entry, entry.get("ceiling", "ceiling_panels"), what),
            paint=self.numbers(entry, entry.get("paint", [1, 1, 1]), 3, f"{what}: 'paint'"),  # type: ignore[arg-type]
            wainscot=wainscot,
            lamps=(lamps[0], int(counts[0]), int(counts[1])),
            line=getattr(entry, "line", 0),
        )

    def material(self, where: Any, name: Any, what: str) -> str:
        if name not in SURFACES:
            raise self.error(where, f"{what}: unknown material {name!r}; {hint(str(name), SURFACES)}")
        return str(name)

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
        self.known(entry, _DOOR_KEYS, "a door")
        between = entry.get("between")
        if not (isinstance(between, list) and len(between) == 2):
            raise self.error(entry, f"a door stands between two rooms, got {between!r}")
        a, b = (rooms[self.choice(entry, name, rooms, "room")] for name in between)
        what = f"the door between {a.name!r} and {b.name!r}"
        along, level, span = self.shared_wall(entry, a, b)
        kind = self.choice(entry, entry.get("kind", "leaf"), _DOOR_KINDS, f"{what}: kind")
        opening = Opening(
            kind=kind,
            along=along,
            level=level,
            centre=self.number(entry, "at", what),
            width=self.number(entry, "width", what, 1.0),
            bottom=self.number(entry, "bottom", what, 0.9 if kind == "pane" else 0.0),
            top=self.number(entry, "height", what, 2.1),
            rooms=(a.name, b.name),
            hinge=self.choice(entry, entry.get("hinge", "low"), ("low", "high"), f"{what}: hinge"),
            into=self.choice(entry, entry.get("into", b.name), (a.name, b.name), f"{what}: into"),
            line=getattr(entry, "line", 0),
        )
        low, high = opening.interval
        if low < span[0] + HALF_WALL or high > span[1] - HALF_WALL:
            raise self.error(
                entry,
                f"{what} reaches from {along} = {low:.2f} to {high:.2f}, outside the wall they share "
                f"({span[0]:.2f} to {span[1]:.2f})",
            )
        if opening.top > min(a.height, b.height) or opening.top <= opening.bottom:
            raise self.error(entry, f"{what} is {opening.top} m high, the ceiling {min(a.height, b.height)} m")
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
        raise self.error(entry, f"rooms {a.name!r} and {b.name!r} share no wall, so no door can stand between them")

    def window(self, entry: Any, room: Room, rooms: dict[str, Room]) -> Opening:
        what = f"a window of room {room.name!r}"
        self.known(entry, _WINDOW_KEYS, what)
        side = self.choice(entry, entry.get("wall"), SIDES, f"{what}: wall")
        along, across = ("x", "y") if side in ("north", "south") else ("y", "x")
        level = getattr(room, across)[1 if side in ("north", "east") else 0]
        opening = Opening(
            kind="window",
            along=along,
            level=level,
            centre=self.number(entry, "at", what),
            width=self.number(entry, "width", what, 1.6),
            bottom=self.number(entry, "sill", what, 0.9),
            top=self.number(entry, "head", what, 2.3),
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
        beyond = OUTSIDE[side]
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
        what = f"room {room.name!r}"
        if not isinstance(entry, dict):
            raise self.error(entry, f"{what}: an item must be a mapping, got {entry!r}")
        kind = self.choice(entry, entry.get("kind"), KINDS, f"{what}: item")
        spec = KINDS[kind]
        what = f"{what}: {kind}"
        self.known(entry, ("kind", "at", "against", "off", "facing", "size", "z", *spec.options), what)
        size = self.numbers(entry, entry.get("size", spec.size), 3, f"{what}: 'size'")
        off = self.number(entry, "off", what, 0.0)
        if "against" in entry:
            side = self.choice(entry, entry["against"], SIDES, f"{what}: wall")
            facing = SIDES[side]
            inner_x, inner_y = room.inner()
            at = self.number(entry, "at", what)
            reach = size[1] / 2 + off
            x, y = {
                "north": (at, inner_y[1] - reach),
                "south": (at, inner_y[0] + reach),
                "east": (inner_x[1] - reach, at),
                "west": (inner_x[0] + reach, at),
            }[side]
        else:
            x, y = self.numbers(entry, entry.get("at"), 2, f"{what}: 'at'")
            facing = self.number(entry, "facing", what, 90.0)
        item = Item(
            kind=kind,
            x=x,
            y=y,
            facing=facing,
            size=(size[0], size[1], size[2]),
            z=self.number(entry, "z", what, spec.z),
            room=room.name,
            options={key: entry[key] for key in spec.options if key in entry},
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
        values = [self.numbers(point, point, 2, f"path {name!r}: a point") for point in points]
        return Path(name, np.array(values), tuple(getattr(point, "line", 0) for point in points))


OUTSIDE = {"north": 1, "south": -1, "east": 1, "west": -1}
