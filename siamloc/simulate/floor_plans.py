"""Floor plans of drawn buildings: which rooms there are, where they are, and which of them a door joins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

from siamloc.simulate.layout import SIDES, Interval, Rng, shared_wall

#: Smallest distance in metres of a door from the ends of the wall that two cells share.
_MARGIN = 0.22
_NARROWEST = 0.95


@dataclass(frozen=True)
class Cell:
    """A room or corridor on a floor plan: a rectangle.

    Attributes:
        name: unique name within the plan.
        use: what the room is used for: a key of `furnishing.USES`.
        x: start and end along x in metres.
        y: start and end along y in metres.
    """

    name: str
    use: str
    x: Interval
    y: Interval

    @property
    def area(self) -> float:
        """Area in square metres."""
        return (self.x[1] - self.x[0]) * (self.y[1] - self.y[0])

    def outside(self, side: str, others: list[Cell]) -> list[Interval]:
        """Return the stretches (start, end) in metres of a wall of the cell behind which there is no other cell.

        Args:
            side: the wall, a key of `layout.SIDES`: "west", "east", "south" or "north".
            others: the cells of the floor plan.
        """
        wall = SIDES[side]
        parts = [wall.span(self)]
        for other in others:
            shared = None if other is self else shared_wall(self, other)
            if shared is not None and shared[:2] == (wall.along, wall.level(self)):
                low, high = shared[2]
                cut = [[(a, min(b, low)), (max(a, high), b)] for a, b in parts]
                parts = [(a, b) for pair in cut for a, b in pair if b - a > 1e-6]
        return parts


def _room_for_a_door(a: Cell, b: Cell) -> Interval | None:
    """Return the part of the wall between two cells in which a door may lie; None if no door fits."""
    shared = shared_wall(a, b)
    if shared is None or shared[2][1] - shared[2][0] < _NARROWEST + 2 * _MARGIN:
        return None
    return shared[2][0] + _MARGIN, shared[2][1] - _MARGIN


@dataclass
class Plan:
    """The cells of a floor, in the order in which a robot may visit them, and their doors.

    Attributes:
        height: height of the ceilings in metres.
        cells: the cells; the robot starts in the first cell.
        doors: names of two cells and the kind of the door between them: "leaf", "glass" or "open".
        beside: height of the ceilings beside the first cell, if that is a hall; None if all are equally high.
    """

    height: float
    cells: list[Cell] = field(default_factory=list)
    doors: list[tuple[str, str, str]] = field(default_factory=list)
    beside: float | None = None

    def ceiling(self, cell: Cell) -> float:
        """Return the height of the ceiling of a cell in metres."""
        return self.height if self.beside is None or cell.name == self.cells[0].name else self.beside

    def add(self, use: str, x: Interval, y: Interval) -> Cell:
        """Add a cell and return it.

        Args:
            use: what the room is used for: a key of `furnishing.USES`.
            x: start and end along x in metres, which are rounded to centimetres.
            y: start and end along y in metres, which are rounded to centimetres.
        """
        cell = Cell(f"{use}_{len(self.cells)}", use, (round(x[0], 2), round(x[1], 2)), (round(y[0], 2), round(y[1], 2)))
        self.cells.append(cell)
        return cell

    def join(self, a: Cell, b: Cell, kind: str) -> None:
        """Join two cells with a door of the kind "leaf", "glass" or "open", if they share enough of a wall for one."""
        if _room_for_a_door(a, b):
            self.doors.append((a.name, b.name, kind))

    def place_doors(self, rng: Rng) -> list[dict[str, object]]:
        """Return the doors in the form of a building file, each somewhere in the wall that its two cells share."""
        by_name = {cell.name: cell for cell in self.cells}
        doors: list[dict[str, object]] = []
        for one, other, kind in self.doors:
            ends = _room_for_a_door(by_name[one], by_name[other])
            assert ends is not None
            low, high = ends
            widest = rng.uniform(1.2, 3.2) if kind == "open" else rng.uniform(0.95, 1.3)
            width = min(float(widest), high - low)
            at = low + width / 2 + rng.random() * max(high - low - width, 0.0)
            top = min(rng.uniform(2.0, 2.25) if kind != "open" else rng.uniform(2.1, 2.6), self.height - 0.1)
            size = {"at": round(float(at), 2), "width": int(width * 50) / 50, "height": round(float(top), 2)}
            doors.append({"between": [one, other], **size, "kind": kind, "hinge": str(rng.choice(["low", "high"]))})
        return doors


def _leaf(rng: Rng) -> str:
    return str(rng.choice(["leaf", "glass", "open"], p=[0.72, 0.13, 0.15]))


def _uses(rng: Rng, count: int, often: str, others: tuple[str, ...]) -> list[str]:
    """Draw the uses of rooms: about half of them have the same use."""
    return [often if rng.random() < 0.5 else str(rng.choice(others)) for _ in range(count)]


_OFFICE = ("office", ("kitchen", "printer", "meeting", "toilet", "storage", "laboratory", "lounge", "library"))
_SCHOOL = ("classroom", ("office", "toilet", "library", "laboratory", "storage", "meeting", "lounge"))


def _row(
    plan: Plan, rng: Rng, corridor: Cell, side: str, uses: list[str], at: float, widths: Interval, depths: Interval
) -> float:
    """Add rooms along one side of a corridor, each with a door, and return where the row ends."""
    wall = SIDES[side]
    level = wall.level(corridor)
    depth = rng.uniform(*depths)
    for use in uses:
        width = rng.uniform(*widths) * (1.6 if use == "classroom" else 1.0)
        deep = max(2.4, depth + rng.uniform(-0.8, 0.4) * (rng.random() < 0.4))
        along = (at, at + width)
        room = plan.add(use, *wall.plan(along, (level, level + deep) if wall.end else (level - deep, level)))
        plan.join(corridor, room, _leaf(rng))
        at = wall.span(room)[1]
        if rng.random() < 0.15:
            at += rng.uniform(0.3, 1.8)
    return at


def offices(rng: Rng) -> Plan:
    """Draw a corridor with rooms on one or two sides, perhaps with a wing across its beginning."""
    plan = Plan(rng.uniform(2.4, 3.2))
    often, others = _OFFICE if rng.random() < 0.7 else _SCHOOL
    width = rng.uniform(1.6, 3.0)
    both = rng.random() < 0.7
    counts = rng.integers(1 if both else 2, 4 if both else 5, 2)
    # The corridor is as long as its rows need: they are drawn first, and it is put before them.
    draft = Plan(plan.height)
    probe = draft.add("corridor", (0.0, 60.0), (-width / 2, width / 2))
    ends = [_row(draft, rng, probe, "north", _uses(rng, int(counts[0]), often, others), 0.0, (2.8, 6.0), (3.2, 6.2))]
    if both:
        first = rng.uniform(0.0, 1.2) * (rng.random() < 0.5)
        row = _uses(rng, int(counts[1]), often, others)
        ends.append(_row(draft, rng, probe, "south", row, first, (2.8, 6.0), (3.2, 6.2)))
    length = round(max(ends) + rng.uniform(0.0, 1.5), 2)
    plan.cells = [Cell(probe.name, probe.use, (0.0, length), probe.y), *draft.cells[1:]]
    plan.doors = draft.doors
    corridor = plan.cells[0]
    if rng.random() < 0.4:  # a wing across its beginning
        wide = rng.uniform(1.6, 2.6)
        reach = rng.uniform(0.5, 7.0, 2)
        wing = plan.add("corridor", (-wide, 0.0), (corridor.y[0] - float(reach[0]), corridor.y[1] + float(reach[1])))
        plan.join(corridor, wing, "open" if rng.random() < 0.7 else "glass")
        row = _uses(rng, int(rng.integers(1, 3)), often, others)
        _row(plan, rng, wing, "west", row, wing.y[0], (2.8, 4.5), (3.2, 5.5))
        _trim(plan)
    if rng.random() < 0.35:  # a room at its end
        half = rng.uniform(0.9, 2.6, 2) + width / 2
        x = (corridor.x[1], corridor.x[1] + rng.uniform(3.0, 6.0))
        end = plan.add(str(rng.choice([often, *others])), x, (-float(half[0]), float(half[1])))
        plan.join(corridor, end, _leaf(rng))
    return plan


def _trim(plan: Plan) -> None:
    """Leave out rooms without a door: their corridor ends before they begin."""
    kept = {name for door in plan.doors for name in door[:2]}
    plan.cells = [cell for cell in plan.cells if cell.name in kept]


def ring(rng: Rng) -> Plan:
    """Draw corridors around a core, with rooms on their outer sides."""
    plan = Plan(rng.uniform(2.5, 3.3))
    often, others = _OFFICE if rng.random() < 0.6 else _SCHOOL
    wide, long, deep = (rng.uniform(*span) for span in ((1.6, 2.4), (4.5, 9.0), (2.6, 5.5)))
    south = plan.add("corridor", (-wide, long + wide), (-wide, 0.0))
    north = plan.add("corridor", (-wide, long + wide), (deep, deep + wide))
    west = plan.add("corridor", (-wide, 0.0), (0.0, deep))
    east = plan.add("corridor", (long, long + wide), (0.0, deep))
    for a, b in ((south, west), (west, north), (north, east), (east, south)):
        plan.join(a, b, "open" if rng.random() < 0.8 else "glass")
    if rng.random() < 0.5:
        core = plan.add(str(rng.choice(others)), (0.0, long), (0.0, deep))
        plan.join([south, north, west, east][rng.integers(4)], core, _leaf(rng))
    for corridor, side in ((south, "south"), (north, "north")):
        row = _uses(rng, int(rng.integers(1, 4)), often, others)
        _row(plan, rng, corridor, side, row, -wide, (2.8, 5.0), (3.0, 5.5))
    _trim(plan)
    return plan


def home(rng: Rng, uses: str = "", largest: Interval = (9.0, 20.0)) -> Plan:
    """Draw a flat: a rectangle split into rooms, the most central of which leads to the others.

    Args:
        rng: draws the plan.
        uses: what the names of the rooms' uses begin with.
        largest: limits in square metres of the area above which a room is split.
    """
    plan = Plan(rng.uniform(2.3, 3.1))
    size = (rng.uniform(7.5, 12.5), rng.uniform(6.5, 10.5))
    boxes = _split((0.0, size[0]), (0.0, size[1]), rng.uniform(*largest), rng)
    cells = [Cell(str(number), "", x, y) for number, (x, y) in enumerate(boxes)]
    touching = [(i, j) for i, a in enumerate(cells) for j, b in enumerate(cells) if i != j and _room_for_a_door(a, b)]
    if any(not any(pair[0] == i for pair in touching) for i in range(len(cells))):
        return home(rng, uses, largest)
    central = max(range(len(cells)), key=lambda i: (sum(pair[0] == i for pair in touching), -cells[i].area))
    order, links = [central], []
    while len(order) < len(cells):
        open_links = [pair for pair in touching if pair[0] in order and pair[1] not in order]
        if not open_links:
            return home(rng, uses, largest)
        near = [pair for pair in open_links if pair[0] == central] or open_links
        chosen = near[rng.integers(len(near))]
        links.append(chosen)
        order.append(chosen[1])
    by_size = sorted((i for i in order if i != central), key=lambda i: -cells[i].area)
    wanted = ["living", "bedroom", "kitchen", "bath", "bedroom", "study", "storage", "bedroom"]
    wanted += ["study"] * len(cells)
    use = {i: wanted[number] for number, i in enumerate(by_size)} | {central: "entrance"}
    if len(by_size) > 3:  # the smallest one is the bathroom
        last = by_size[-1]
        other = next(i for i in by_size if use[i] == "bath")
        use[other], use[last] = use[last], use[other]
    made = {i: plan.add(uses + use[i], cells[i].x, cells[i].y) for i in order}
    for i, j in links:
        bath = "bath" in (use[i], use[j])
        plan.join(made[i], made[j], "leaf" if bath else _leaf(rng) if rng.random() < 0.7 else "open")
    known = {frozenset(pair) for pair in links}
    for i, j in touching:
        if i < j and frozenset((i, j)) not in known and rng.random() < 0.12 and "bath" not in (use[i], use[j]):
            plan.join(made[i], made[j], _leaf(rng))
    return plan


def _split(x: Interval, y: Interval, largest: float, rng: Rng) -> list[tuple[Interval, Interval]]:
    wide, deep = x[1] - x[0], y[1] - y[0]
    if wide * deep <= largest or max(wide, deep) < 4.2:
        return [(x, y)]
    share = rng.uniform(0.36, 0.64)
    if wide > deep:
        cut = round(x[0] + share * wide, 2)
        return [*_split((x[0], cut), y, largest, rng), *_split((cut, x[1]), y, largest, rng)]
    cut = round(y[0] + share * deep, 2)
    return [*_split(x, (y[0], cut), largest, rng), *_split(x, (cut, y[1]), largest, rng)]


def hall(rng: Rng) -> Plan:
    """Draw a hall with rooms along one or two of its sides."""
    plan = Plan(rng.uniform(2.8, 4.8))
    use = str(rng.choice(["foyer", "workshop", "canteen", "open_office"]))
    room = plan.add(use, (0.0, rng.uniform(8.0, 15.0)), (0.0, rng.uniform(6.0, 11.0)))
    often, others = _OFFICE
    for side in ("north", "south")[: 1 + int(rng.random() < 0.6)]:
        row = _uses(rng, int(rng.integers(1, 4)), often, others)
        _row(plan, rng, room, side, row, rng.uniform(0.0, 1.5), (2.8, 5.0), (2.8, 5.0))
    if rng.random() < 0.5:
        middle = rng.uniform(1.0, room.y[1] - 1.0)
        wide = rng.uniform(1.7, 2.8)
        y = (max(0.0, middle - wide / 2), min(room.y[1], middle + wide / 2))
        corridor = plan.add("corridor", (room.x[1], room.x[1] + rng.uniform(4.0, 10.0)), y)
        plan.join(room, corridor, "open")
    _trim(plan)
    return plan


def dwelling(rng: Rng) -> Plan:
    """Draw a home of small rooms that open into each other."""
    return home(rng, "home_", (8.0, 16.0))


def workshop(rng: Rng) -> Plan:
    """Draw a large, high workshop, perhaps with a few rooms along one side."""
    return _large(rng, ("machine_hall",), (3.2, 6.0), ("office", "storage", "workshop", "toilet", "laboratory"))


def great_hall(rng: Rng) -> Plan:
    """Draw a high hall, such as a foyer or a gymnasium, perhaps with a few rooms along one side."""
    uses = ("great_hall", "great_hall", "sports_hall")
    return _large(rng, uses, (3.8, 7.0), ("storage", "toilet", "canteen", "foyer", "meeting"))


def _large(rng: Rng, uses: tuple[str, ...], heights: Interval, others: tuple[str, ...]) -> Plan:
    plan = Plan(rng.uniform(*heights), beside=rng.uniform(2.7, 3.2))
    size = (rng.uniform(9.0, 17.0), rng.uniform(7.0, 12.0))
    room = plan.add(str(rng.choice(uses)), (0.0, size[0]), (0.0, size[1]))
    count = int(rng.integers(0, 4))
    if count:
        row = [str(rng.choice(others)) for _ in range(count)]
        _row(plan, rng, room, "north", row, rng.uniform(0.0, 1.5), (2.8, 5.0), (2.8, 5.0))
    _trim(plan)
    return plan if count and len(plan.cells) > 1 else replace(plan, cells=[room])


Plans = tuple[tuple[Callable[[Rng], Plan], float], ...]
#: Plans of office floors and the like, and how often each is drawn.
PLANS: Plans = ((offices, 0.45), (ring, 0.15), (home, 0.25), (hall, 0.15))
Kind = Literal["office", "home", "workshop", "hall"]
"""Kinds of buildings: "office" stands for all plans in `PLANS`, with rooms that are mostly tidy."""
_PLANS: dict[Kind, Plans] = {
    "office": PLANS,
    "home": ((dwelling, 1.0),),
    "workshop": ((workshop, 1.0),),
    "hall": ((great_hall, 1.0),),
}


def draw_plan(rng: Rng, kind: Kind = "office") -> Plan:
    """Draw the floor plan of a building of a kind.

    >>> import numpy as np
    >>> plan = draw_plan(np.random.default_rng(0))
    >>> all(any(cell.name in door[:2] for door in plan.doors) for cell in plan.cells)
    True
    """
    plans = _PLANS[kind]
    chances = [chance for _, chance in plans]
    return plans[int(rng.choice(len(plans), p=chances))][0](rng)
