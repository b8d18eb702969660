"""What months change in a building: furniture, pictures and lamps are moved, exchanged, added and taken."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from siamloc.simulate.furnishing import draw_common, draw_entry, draw_size
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import SIDES, Array, Building, Item, Room, seeded
from siamloc.simulate.mesh import MeshBuilder
from siamloc.simulate.plan import clearance, inside_item
from siamloc.simulate.trajectory import rounded

What = Literal["moved", "exchanged", "added", "taken"]
"""What may happen to an item; lamps are only exchanged."""

#: Chance of an item in one month; as many are added as are taken.
_MOVED, _EXCHANGED, _TAKEN = 0.12, 0.10, 0.05
_NEW_LAMPS = 0.06  # chance of a room in one month
_KEEP_OFF = 0.42  # metres between the robot's way and furniture
_APART = 0.04  # metres between two items
_SWING = 1.0  # depth in metres of the floor in front of a door that stays free
_NEAR = 1.0  # metres from a table to its chairs
_FLAT = 0.03  # metres; what is lower lies under other items
_GAP = 0.002  # metres between an item's back and the wall
_TRIES = 40  # places
_ROOMS = 8  # rooms that an item is tried in
_BUILT_IN = """basins bathtub big_screen blind_door cables column curtain downpipe dryer elevator exit_sign
    extinguisher fireplace fridge kitchen_counter kitchen_island pipes radiator room_sign shower stairs_down stairs_up
    stall stove switch_cabinet toilet_bowl urinals"""
_LAMPS = ("panel", "tube", "round")
_CHAIRS = ("chair", "visitor_chair")
_TABLES = ("desk", "table", "round_table", "conveyor", "workbench")
#: Kinds that may take each other's place.
_FAMILIES = (
    "shelf cabinet lockers wardrobe sideboard dresser pigeonholes",
    "desk table printer_table",
    "plant floor_lamp coat_rack bin carton vase",
    "sofa armchair bench",
    "lathe mill drill_press workbench",
    "drum compressor pallet_load trolley",
    "poster picture notice_board whiteboard television clock",
)
_ANYWHERE = "shelf cabinet sideboard plant table carton"  # furniture that is added to any room
_MIDDLE = "table carton"  # of these, what stands away from the walls
_ON_WALLS = "poster picture notice_board whiteboard"


@dataclass(frozen=True)
class Change:
    """What happened to one item, or to the lamps of a room.

    Attributes:
        month: 1, 2, ...
        what: "moved", "exchanged", "added" or "taken".
        kind: key of `items.KINDS` of the item as it is after the change, or "lamps".
        room: name of the room.
        x: position of the item after the change, or where it was before it was taken, in metres.
        y: the same along y.
    """

    month: int
    what: What
    kind: str
    room: str
    x: float
    y: float


def aged(building: Building, months: int) -> tuple[Building, tuple[Change, ...]]:
    """Return a building after some months, and all changes; month n is month n - 1 with further changes.

    What is built in stays, chairs follow their table, and the ways of the building's paths stay free.

    >>> from siamloc.simulate import load_building
    >>> later, changes = aged(load_building("mini"), 6)
    >>> changes[0].month, len({change.kind for change in changes}) > 3
    (1, True)
    """
    changes: list[Change] = []
    for number in range(1, months + 1):
        month = _Month(building, number)
        building = month.changed()
        changes += month.changes
    return building, tuple(changes)


class _Month:
    """A building while one month changes it."""

    def __init__(self, building: Building, month: int) -> None:
        self.building, self.month = building, month
        self.rng = building.rng("month", month)
        self.common = draw_common(self.rng)
        # An item's details follow from its number, which it keeps when others are taken.
        self.items = [
            replace(item, options={"number": number, **item.options}) for number, item in enumerate(building.items)
        ]
        self.ways = np.concatenate([np.empty((0, 2)), *(rounded(points)[::4] for points in building.paths.values())])
        self.changes: list[Change] = []

    def changed(self) -> Building:
        """Change items and lamps, and return the building."""
        for item in list(self.items):
            drawn = self.rng.random()
            there = any(item is one for one in self.items)  # chairs go with their table
            if not there or item.kind in _BUILT_IN.split() or self._table_of(item) is not None:
                continue
            if drawn < _MOVED:
                self._move(item)
            elif drawn < _MOVED + _EXCHANGED:
                self._exchange(item)
            elif drawn < _MOVED + _EXCHANGED + _TAKEN:
                self._take(item)
        movable = [item for item in self.items if item.kind not in _BUILT_IN.split()]
        for _ in range(self.rng.poisson(_TAKEN * len(movable))):
            any(self._add(movable) for _ in range(_ROOMS))
        rooms = {name: self._lit(room) for name, room in self.building.rooms.items()}
        return replace(self.building, items=tuple(self.items), rooms=rooms)

    def _move(self, item: Item) -> None:
        chairs = [other for other in self.items if self._table_of(other) is item]
        space = _Space(self.building, item, [one for one in self.items if one is not item and one not in chairs])
        for place in self._places(item, _at_a_wall(item, self.building.rooms[item.room])):
            along = [_carried(chair, item, place) for chair in chairs]
            if all(self._fits(one, space) for one in (place, *along)):
                self._put(dict(zip(map(id, (item, *chairs)), (place, *along), strict=True)))
                self._note("moved", place)
                break

    def _exchange(self, item: Item) -> None:
        family = next((kinds for kinds in map(str.split, _FAMILIES) if item.kind in kinds), [item.kind])
        space = _Space(self.building, item, [one for one in self.items if one is not item])
        ahead = np.array([np.cos(np.radians(item.facing)), np.sin(np.radians(item.facing))])
        for _ in range(_TRIES):
            kind = str(self.rng.choice(family))
            size, z = draw_size(kind, self.rng), item.z if kind == item.kind else KINDS[kind].z
            x, y = (item.x, item.y) + (size[1] - item.size[1]) / 2 * ahead  # its back stays where it is
            new = self._drawn(replace(item, kind=kind, x=float(x), y=float(y), size=size, z=z))
            if self._fits(new, space):
                break
        else:  # the same kind and size with other details
            new = self._drawn(item)
        self._put({id(item): new})
        self._note("exchanged", new)

    def _take(self, item: Item) -> None:
        chairs = [other for other in self.items if self._table_of(other) is item]
        self._put(dict.fromkeys(map(id, (item, *chairs)), None))
        self._note("taken", item)

    def _add(self, movable: Sequence[Item]) -> bool:
        """Add an item to a room, similar to what is there, if there is space; return whether there was."""
        like = movable[int(self.rng.integers(len(movable)))]
        hung = _hangs(like.kind)
        usual = {one.kind for one in movable if one.room == like.room and _hangs(one.kind) == hung} - {*_CHAIRS}
        kind = str(self.rng.choice([*sorted(usual), *(_ON_WALLS if hung else _ANYWHERE).split()]))
        where = self.building.rooms[like.room].centre
        new = self._drawn(Item(kind, *where, 0.0, draw_size(kind, self.rng), KINDS[kind].z, like.room))
        space = _Space(self.building, new, self.items)
        for place in self._places(new, kind not in _MIDDLE.split()):
            if self._fits(place, space):
                self.items.append(place)
                self._note("added", place)
                return True
        return False

    def _lit(self, room: Room) -> Room:
        if self.rng.random() > _NEW_LAMPS:
            return room
        other = str(self.rng.choice([kind for kind in _LAMPS if kind != room.lamps[0]]))
        self.changes.append(Change(self.month, "exchanged", "lamps", room.name, *room.centre))
        return replace(room, lamps=(other, *room.lamps[1:]))

    def _drawn(self, item: Item) -> Item:
        """Return an item with newly drawn details."""
        options = {**draw_entry(item.kind, self.common, self.rng), "number": 1000 * self.month + len(self.changes)}
        del options["kind"]
        return replace(item, options=options)

    def _put(self, new: dict[int, Any]) -> None:
        """Replace items, which are given by their id; None takes an item away."""
        self.items = [one for item in self.items if (one := new.get(id(item), item)) is not None]

    def _note(self, what: What, item: Item) -> None:
        self.changes.append(Change(self.month, what, item.kind, item.room, round(item.x, 3), round(item.y, 3)))

    def _places(self, item: Item, at_a_wall: bool) -> Iterator[Item]:
        """Yield an item at places drawn in its room, with its back at a wall or turned by right angles."""
        inner = self.building.rooms[item.room].inner()
        for _ in range(_TRIES):
            if at_a_wall:
                side = SIDES[str(self.rng.choice(list(SIDES)))]
                off = side.inwards * (item.size[1] / 2 + _GAP)
                x, y = side.plan(self.rng.uniform(*side.span(inner)), side.level(inner) + off)
                yield replace(item, x=x, y=y, facing=side.facing)
            else:
                x, y = (self.rng.uniform(*ends) for ends in inner)
                yield replace(item, x=x, y=y, facing=item.facing + 90.0 * int(self.rng.integers(4)))

    def _fits(self, item: Item, space: _Space) -> bool:
        """Return whether an item is inside its room, touches nothing, and leaves doors and the robot's ways free."""
        if not space.holds(item):
            return False
        if not KINDS[item.kind].blocks:
            return True
        clear = (clearance(self.ways, item.edges()) > _KEEP_OFF).all()
        return bool(clear) and not inside_item(item, self.ways).any()

    def _table_of(self, chair: Item) -> Item | None:
        """Return the nearest table of a chair; None for anything else."""
        if chair.kind not in _CHAIRS:
            return None
        tables = [item for item in self.items if item.kind in _TABLES and item.room == chair.room]
        gaps = [float(clearance(np.array([[chair.x, chair.y]]), table.edges())[0]) for table in tables]
        return tables[int(np.argmin(gaps))] if min(gaps, default=_NEAR) < _NEAR else None


class _Space:
    """The space of a room that is taken: by other items, in front of doors and windows.

    Args:
        building: its rooms and openings.
        item: an item that needs space; only flat items are in the way of a flat item, such as a rug.
        others: all other items of the building.
    """

    def __init__(self, building: Building, item: Item, others: Sequence[Item]) -> None:
        self._room = building.rooms[item.room]
        near = [one for one in others if one.room == item.room and _flat(one) == _flat(item)]
        self._corners = [one.footprint() for one in near]
        self._rise = [(one.z, _top(one)) for one in near]
        for opening in building.openings if not _flat(item) else ():
            if item.room in opening.rooms:
                deep = _SWING if opening.passable else 0.1
                self._corners.append(opening.doorway(-0.1, deep).corners())
                self._rise.append((opening.bottom, opening.top))

    def holds(self, item: Item) -> bool:
        """Return whether an item lies inside the room and touches nothing."""
        corners, inner, top = item.footprint(), np.array(self._room.inner()), _top(item)
        if (corners < inner[:, 0]).any() or (corners > inner[:, 1]).any() or top > self._room.height - 0.05:
            return False
        level = [one for one, rise in zip(self._corners, self._rise, strict=True) if rise[0] < top and rise[1] > item.z]
        return not any(_overlap(item.footprint(_APART), one) for one in level)


def _overlap(one: Array, other: Array) -> bool:
    """Return whether two rectangles (4, 2) overlap: on no line along an edge are their shadows apart."""
    for axis in (one[1] - one[0], one[2] - one[1], other[1] - other[0], other[2] - other[1]):
        a, b = one @ axis, other @ axis
        if a.max() < b.min() or b.max() < a.min():
            return False
    return True


def _carried(chair: Item, table: Item, moved: Item) -> Item:
    """Return a chair that keeps its place at a table that moved."""
    turn = moved.facing - table.facing
    cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    dx, dy = chair.x - table.x, chair.y - table.y
    x, y = moved.x + cosine * dx - sine * dy, moved.y + sine * dx + cosine * dy
    return replace(chair, x=float(x), y=float(y), facing=chair.facing + turn)


def _at_a_wall(item: Item, room: Room) -> bool:
    """Return whether an item stands or hangs with its back at a wall."""
    for side in SIDES.values():
        back = side.plan(item.x, item.y)[1] - side.inwards * item.size[1] / 2
        aligned = abs((item.facing - side.facing + 180) % 360 - 180) < 1
        if aligned and abs(back - side.level(room.inner())) < 0.1:
            return True
    return False


def _hangs(kind: str) -> bool:
    return not KINDS[kind].blocks and KINDS[kind].size[2] > _FLAT


def _flat(item: Item) -> bool:
    return item.size[2] <= _FLAT


def _top(item: Item) -> float:
    """Return the height of an item's upper end, such as that of a desk's screens, in metres."""
    return item.z + _height(item.kind, item.size, item.options.get("screens"))


@lru_cache(maxsize=4096)
def _height(kind: str, size: tuple[float, float, float], screens: int | None) -> float:
    builder = MeshBuilder(defaultdict(lambda: (0, None)))
    options = {} if screens is None else {"screens": screens}
    KINDS[kind].build(builder, Item(kind, 0.0, 0.0, 90.0, size, 0.0, "", options), seeded(0), *size)
    return max(size[2], float(builder.build().corners[..., 2].max()))
