"""Furnish drawn buildings: what rooms are used for, and what stands and hangs where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from siamloc.simulate.floor_plans import Cell, Plan
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import HALF_WALL, SIDES, Interval, Rectangle, Rng, shared_wall, side_at

Entry = dict[str, Any]
Size = tuple[float, float, float]
_WOODS = ("beech", "wood", "walnut", "plain", "planks")
#: Depth in metres of the area in front of a door that is kept free.
_THRESHOLD = 1.05
_TALL = 1.15
_HUNG = "poster picture poster picture notice_board clock room_sign shelf_board"
_AT_HOME = "poster picture picture picture poster shelf_board clock mirror"
_IN_A_HALL = "blind_door exit_sign extinguisher clock poster notice_board"


@dataclass(frozen=True)
class Use:
    """A kind of room, such as an office: its floors and items, as words separated by spaces.

    Attributes:
        code: room code, with a placeholder for the number.
        floors: suitable floors, names in `textures.SURFACES`.
        walls: items that stand along its walls; more likely the more often they are listed.
        middle: items that stand away from the walls.
        hung: items that hang on its walls, in addition to pictures.
        density: number of items per ten metres of wall.
        usual: pictures and the like that hang on its walls.
        curtains: whether curtains hang beside its windows.
        needs: items that stand along its walls in any case, if there is space.
    """

    code: str
    floors: str
    walls: str
    middle: str = ""
    hung: str = ""
    density: float = 4.0
    usual: str = _HUNG
    curtains: bool = False
    needs: str = ""


_SOFT = "carpet carpet_red carpet_gray parquet linoleum planks"
_HARD = "linoleum linoleum_green tiles_floor terrazzo checker concrete marble"
_CLEAN = "tiles_floor checker linoleum_green terrazzo"
USES: dict[str, Use] = {
    "corridor": Use("CR{}-A", "linoleum linoleum_green carpet_gray parquet terrazzo tiles_floor carpet planks",
        "plant bench lockers cabinet copier vending_machine bin shelf coat_rack column",
        hung="blind_door blind_door extinguisher room_sign notice_board elevator exit_sign", density=1.2),
    "office": Use("{}PO-A", _SOFT, "desk desk desk shelf shelf cabinet sideboard plant bin coat_rack lockers",
        "desk_pair round_table", "whiteboard notice_board"),
    "open_office": Use("LO{}-A", _SOFT, "shelf cabinet sideboard plant copier desk desk coat_rack",
        "desk_pair desk_pair desk_pair column round_table", "whiteboard", 3.0),
    "kitchen": Use("KT{}-A", _CLEAN, "kitchen_counter kitchen_counter fridge sideboard bin visitor_chair",
        "dining round_table", "notice_board"),
    "printer": Use("PA{}-A", _HARD, "copier printer_table pigeonholes shelf cabinet carton bin"),
    "meeting": Use("CNR{}-A", _SOFT, "sideboard plant visitor_chair cabinet", "conference conference",
        "whiteboard whiteboard television", 2.0),
    "toilet": Use("TL{}-A", _CLEAN, "stall stall stall basins urinals bin", "", "dryer mirror", 5.0, ""),
    "storage": Use("SR{}-A", _HARD, "shelf shelf lockers carton carton cabinet shelf", "carton", "", 7.0, ""),
    "laboratory": Use("RL{}-A", _HARD, "table table desk shelf cabinet lockers printer_table carton",
        "table desk_pair", "whiteboard shelf_board", 5.0),
    "lounge": Use("LG{}-A", _SOFT, "sofa armchair vending_machine plant shelf floor_lamp",
        "seating round_table rug", "television"),
    "library": Use("LB{}-A", _SOFT, "shelf shelf shelf shelf shelf shelf desk armchair plant",
        "stacks round_table", "", 6.0),
    "classroom": Use("TR{}-A", _HARD, "cabinet shelf lockers desk bin",
        "benches benches", "whiteboard whiteboard", 1.5),
    "living": Use("LR{}-A", "parquet planks carpet carpet_red terrazzo marble",
        "sofa armchair shelf sideboard plant floor_lamp wardrobe television_set", "seating dining rug",
        "television shelf_board"),
    "bedroom": Use("BR{}-A", "parquet planks carpet carpet_red linoleum",
        "bed bed wardrobe sideboard desk armchair floor_lamp shelf", "rug", "mirror shelf_board"),
    "bath": Use("BT{}-A", _CLEAN, "basins bathtub stall cabinet bin", "", "mirror", 5.0, ""),
    "study": Use("ST{}-A", _SOFT, "desk shelf shelf armchair cabinet plant", "rug", "shelf_board"),
    "entrance": Use("HL{}-A", "parquet planks tiles_floor checker terrazzo marble",
        "wardrobe sideboard coat_rack bench plant shelf", "rug", "mirror coats", 2.0),
    "foyer": Use("FY{}-A", "terrazzo marble tiles_floor checker concrete parquet",
        "bench plant vending_machine sofa lockers sideboard", "column column seating plant_island rug",
        "elevator notice_board blind_door exit_sign", 2.0),
    "workshop": Use("WS{}-A", "concrete linoleum tiles_floor", "table table cabinet lockers shelf carton carton bin",
        "table table column carton", "extinguisher whiteboard blind_door shelf_board"),
    "canteen": Use("CT{}-A", _HARD, "kitchen_counter vending_machine sideboard fridge plant bin",
        "dining dining dining round_table column", "notice_board exit_sign", 2.5),
    "home_entrance": Use("HL{}-A", _SOFT + " tiles_floor marble checker",
        "shoe_rack coat_rack wardrobe dresser bench plant vase shelf", "rug", "mirror coats", 4.0, _AT_HOME),
    "home_living": Use("LR{}-A", "parquet planks parquet planks carpet carpet_red tiles_floor marble",
        "sofa television_wall armchair shelf shelf sideboard plant floor_lamp piano fireplace dresser pouffe toy_chest",
        "seating dining seating rug pouffe", "television shelf_board mirror", 5.0, _AT_HOME, curtains=True,
        needs="sofa television_wall"),
    "home_bedroom": Use("BR{}-A", "parquet planks carpet carpet_red carpet_gray",
        "bed nightstand wardrobe dresser desk armchair floor_lamp shelf cot bunk_bed toy_chest laundry_rack nightstand",
        "rug rug pouffe", "shelf_board", 5.0, _AT_HOME, curtains=True, needs="bed wardrobe"),
    "home_kitchen": Use("KT{}-A", _CLEAN + " planks parquet marble",
        "kitchen_counter stove fridge kitchen_counter washing_machine sideboard bin visitor_chair vase",
        "dining kitchen_island round_table", "shelf_board", 6.0, _AT_HOME, curtains=True,
        needs="kitchen_counter stove fridge"),
    "home_bath": Use("BT{}-A", "tiles_floor checker terrazzo marble tiles_blue",
        "toilet_bowl basins bathtub shower washing_machine laundry_rack bin", "", "mirror", 6.0, "mirror",
        needs="toilet_bowl basins"),
    "home_study": Use("ST{}-A", _SOFT, "desk shelf shelf shelf armchair piano dresser plant floor_lamp carton",
        "rug", "shelf_board", 5.0, _AT_HOME, curtains=True),
    "home_storage": Use("SR{}-A", _HARD, "shelf carton carton washing_machine ladder cabinet laundry_rack drum",
        "carton", "", 6.0, "coats shelf_board"),
    "machine_hall": Use("WS{}-A", "concrete concrete linoleum_green linoleum_green tiles_floor planks",
        "workbench lathe drill_press mill rack rack switch_cabinet drum drum gas_bottles compressor lockers "
        "pallet_load ladder trolley shelf carton cabinet workbench",
        "lathe mill press conveyor workbench pallet_load forklift trolley drum table",
        "pipes pipes cables cables tool_board downpipe downpipe", 4.5, _IN_A_HALL,
        needs="workbench lathe rack workbench"),
    "great_hall": Use("FY{}-A", "marble marble terrazzo tiles_floor parquet checker concrete carpet",
        "bench seat_row seat_row plant planter vending_machine kiosk banner sideboard display_case reception",
        "column column column seat_row planter seating display_case stage statue reception rug",
        "big_screen flag elevator blind_door", 2.0, _IN_A_HALL),
    "sports_hall": Use("SP{}-A", "parquet parquet planks linoleum linoleum_green",
        "goal bench bench stacked_chairs lockers trolley bin", "table_tennis", "flag big_screen downpipe pipes",
        1.5, _IN_A_HALL),
}  # fmt: skip


class Room:
    """A cell that is being furnished: its items, and where there is still space.

    Attributes:
        cell: the cell of the floor plan.
        height: height of the ceiling in metres.
        windows: windows of the room, in the form of a building file.
        x: start and end between the walls along x in metres.
        y: start and end between the walls along y in metres.
        items: the items added so far, in the form of a building file.
    """

    def __init__(self, cell: Cell, plan: Plan, doors: list[Entry], windows: list[Entry]) -> None:
        self.cell, self.height, self.windows = cell, plan.ceiling(cell), windows
        self.x, self.y = ((low + HALF_WALL, high - HALF_WALL) for low, high in (cell.x, cell.y))
        self.items: list[Entry] = []
        self._taken: list[Rectangle] = []  # where something stands on the floor
        self._hung: dict[str, list[tuple[Interval, Interval]]] = {side: [] for side in SIDES}
        for door in doors:
            if cell.name in door["between"]:
                shared = shared_wall(*(one for one in plan.cells if one.name in door["between"]))
                assert shared is not None
                side = side_at(cell, *shared[:2])
                low, high = door["at"] - door["width"] / 2, door["at"] + door["width"] / 2
                deep = max(_THRESHOLD, high - low + 0.1 if high - low < 1.4 else 0.6)
                self._taken.append(self._against(side, (low - 0.12, high + 0.12), deep))
                self._hung[side].append(((low - 0.1, high + 0.1), (0.0, 2.4)))
        for window in windows:
            at, half = window["at"], window["width"] / 2
            rise = (window["sill"] - 0.05, window["head"])
            self._hung[window["wall"]].append(((at - half - 0.08, at + half + 0.08), rise))

    def spot(self, rng: Rng) -> tuple[str, float]:
        """Draw a spot at a wall: a key of `SIDES`, and the coordinate along the wall in metres."""
        side = str(rng.choice(list(SIDES)))
        return side, rng.uniform(*SIDES[side].span(self))

    def _against(self, side: str, along: Interval, deep: float) -> Rectangle:
        """Return the rectangle between two ends along a wall that reaches `deep` metres into the room."""
        edge = SIDES[side].level(self)
        other = edge + SIDES[side].inwards * deep
        return Rectangle(*SIDES[side].plan(along, (min(edge, other), max(edge, other))))

    def _add(self, entry: Entry, size: Size, **where: Any) -> bool:
        """Add an item and return True."""
        self.items.append({**entry, **where, "size": [round(float(value), 2) for value in size]})
        return True

    def stand(self, side: str, at: float, size: Size, entry: Entry) -> bool:
        """Stand an item against a wall if there is space; return whether there was.

        Args:
            side: the wall, a key of `SIDES`.
            at: middle of the item along the wall in metres.
            size: width, depth and height of the item in metres.
            entry: the item's kind and options in the form of a building file, such as {"kind": "desk"}.
        """
        w, d, h = size
        ends = (at - w / 2, at + w / 2)
        box = self._against(side, ends, d)
        low, high = SIDES[side].span(self)
        if h > self.height - 0.05 or not self._free(box) or ends[0] < low or ends[1] > high:
            return False
        near = (one for one in self.windows if one["wall"] == side and abs(one["at"] - at) < (one["width"] + w) / 2)
        if h > _TALL and any(near):
            return False
        self._taken.append(box)
        if h > 0.9:
            self._hung[side].append((ends, (0.0, h)))
        return self._add(entry, size, against=side, at=round(at, 2))

    def place(self, x: float, y: float, facing: float, size: Size, entry: Entry) -> bool:
        """Stand an item anywhere in the room if there is space; return whether there was.

        Args:
            x: middle of the item in metres.
            y: middle of the item in metres.
            facing: direction in degrees, counter-clockwise from +x, that its front faces.
            size: width, depth and height of the item in metres.
            entry: as for `stand`.
        """
        w, d, h = size
        turn = np.radians(facing - 90)
        half_x = abs(np.cos(turn)) * w / 2 + abs(np.sin(turn)) * d / 2
        half_y = abs(np.sin(turn)) * w / 2 + abs(np.cos(turn)) * d / 2
        box = Rectangle((x - half_x, x + half_x), (y - half_y, y + half_y))
        if box.x[0] < self.x[0] or box.x[1] > self.x[1] or box.y[0] < self.y[0] or box.y[1] > self.y[1]:
            return False
        blocks = KINDS[entry["kind"]].blocks
        if h > self.height - 0.05 or (blocks and not self._free(box)):
            return False
        if blocks:
            self._taken.append(box)
        return self._add(entry, size, at=[round(float(x), 2), round(float(y), 2)], facing=round(float(facing), 1))

    def hang(self, side: str, at: float, size: Size, z: float, entry: Entry) -> bool:
        """Hang an item on a wall if there is space; return whether there was.

        Doors, windows, tall furniture and what already hangs on the wall take space.

        Args:
            side: the wall, a key of `SIDES`.
            at: middle of the item along the wall in metres.
            size: width, depth and height of the item in metres.
            z: height of its lower edge above the floor in metres.
            entry: as for `stand`.
        """
        if not self.bare(side, at, size, z):
            return False
        self._hung[side].append(self._on_the_wall(at, size, z))
        return self._add(entry, size, against=side, at=round(at, 2), z=round(z, 2))

    def bare(self, side: str, at: float, size: Size, z: float) -> bool:
        """Return whether there is space for an item to hang on a wall; arguments as for `hang`."""
        (low, high), (across, upright) = SIDES[side].span(self), self._on_the_wall(at, size, z)
        if across[0] < low or across[1] > high or upright[1] > self.height - 0.05:
            return False
        return not any(
            across[0] < span[1] and across[1] > span[0] and upright[0] < rise[1] and upright[1] > rise[0]
            for span, rise in self._hung[side]
        )

    @staticmethod
    def _on_the_wall(at: float, size: Size, z: float) -> tuple[Interval, Interval]:
        return (at - size[0] / 2 - 0.04, at + size[0] / 2 + 0.04), (z, z + size[2])

    def _free(self, box: Rectangle) -> bool:
        (x0, x1), (y0, y1) = ((low - 0.02, high + 0.02) for low, high in box)
        return not any(x1 > x[0] and x0 < x[1] and y1 > y[0] and y0 < y[1] for x, y in self._taken)


def furnish(room: Room, style: Rng, rng: Rng, density: float) -> list[Entry]:
    """Draw what stands and hangs in a room, in the form of a building file.

    Args:
        room: the room with its doors and windows.
        style: draws what all of its furniture has in common.
        rng: draws the items and their places.
        density: amount of furniture; 1 is the usual amount.
    """
    use = USES[room.cell.use]
    common = draw_common(style)
    for kind in use.needs.split():
        any(_along_a_wall(room, kind, *room.spot(rng), common, rng) for _ in range(24))
    area = room.cell.area
    if use.middle and area > 9:
        for _ in range(max(1, round(area / 14 * density))):
            _in_the_middle(room, str(rng.choice(use.middle.split())), common, rng)
    length = 2 * (room.x[1] - room.x[0] + room.y[1] - room.y[0])
    for number in range(max(1, round(length / 10 * use.density * density))):
        # The most characteristic item of the room comes first.
        kind = use.walls.split()[0] if number == 0 else str(rng.choice(use.walls.split()))
        any(_along_a_wall(room, kind, *room.spot(rng), common, rng) for _ in range(6))
    for window in room.windows:
        if window["sill"] > 0.55 and rng.random() < 0.6:
            size = (min(window["width"], 1.6), 0.1, min(0.55, window["sill"] - 0.2))
            room.hang(window["wall"], window["at"], size, 0.12, {"kind": "radiator"})
        if use.curtains and rng.random() < 0.7:
            width, low = rng.uniform(0.2, 0.45), float(rng.choice([0.06, window["sill"]]))
            size = (width, 0.14, min(window["head"] + 0.15, room.height - 0.1) - low)
            for end in (-1, 1):
                at = window["at"] + end * (window["width"] / 2 + width / 2 + 0.13)
                room.hang(window["wall"], at, size, low, {"kind": "curtain", "colour": common["colour"]})
    names = f"{use.hung} {use.usual}".split()
    for _ in range(round(length / 10 * rng.uniform(2.0, 7.0) * density) if names else 0):
        _on_a_wall(room, str(rng.choice(names)), *room.spot(rng), rng)
    return room.items


def draw_common(rng: Rng) -> Entry:
    """Draw what furniture that is bought together has in common: its wood and its linear colour."""
    return {"wood": str(rng.choice(_WOODS)), "colour": [round(float(v), 2) for v in _colour(rng)]}


def _colour(rng: Rng) -> tuple[float, ...]:
    """Draw a linear colour: often grey, rarely strong."""
    grey = rng.uniform(0.04, 0.7)
    tint = rng.uniform(0.5, 1.5, 3) ** rng.choice([0.2, 1.0, 2.0])
    return tuple(np.clip(grey * tint / tint.mean(), 0.01, 0.9).tolist())


def draw_size(kind: str, rng: Rng) -> Size:
    """Draw the width, depth and height in metres of an item of a kind."""
    w, d, h = KINDS[kind].size
    scale = rng.uniform(0.85, 1.2, 3)
    if kind in ("chair", "visitor_chair", "person", "copier", "fridge", "vending_machine", "stall", "elevator"):
        scale = np.full(3, rng.uniform(0.95, 1.05))
    if kind in ("shelf", "cabinet", "lockers", "sideboard", "wardrobe", "bench"):
        scale[0] = rng.uniform(0.6, 1.7)
        scale[2] = rng.uniform(0.5, 1.1) if kind in ("shelf", "cabinet") else scale[2]
    return float(w * scale[0]), float(d * scale[1]), float(h * scale[2])


def draw_entry(kind: str, common: Entry, rng: Rng) -> Entry:
    """Return the entry of an item, with the options that its kind supports."""
    entry: Entry = {"kind": kind}
    known = KINDS[kind].options
    if "wood" in known and rng.random() < 0.8:
        entry["wood"] = common["wood"]
    if "colour" in known and rng.random() < 0.8:
        entry["colour"] = common["colour"] if rng.random() < 0.5 else [round(v, 2) for v in _colour(rng)]
    if "screens" in known:
        entry["screens"] = int(rng.integers(0, 3))
    if "content" in known:
        entry["content"] = str(rng.choice(["mixed", "books", "binders", "empty"], p=[0.4, 0.25, 0.25, 0.1]))
    if "picture" in known:
        entry["picture"] = int(rng.integers(1000))
    return entry


def _along_a_wall(room: Room, kind: str, side: str, at: float, common: Entry, rng: Rng) -> bool:
    if kind in ("television_set", "television_wall"):
        size = draw_size("sideboard", rng)
        above = side, at, (1.1, 0.06, 0.65), size[2] + 0.25
        if kind == "television_wall" and not room.bare(*above):
            return False  # a television_set leaves the sideboard without a television
        done = room.stand(side, at, size, draw_entry("sideboard", common, rng))
        return done and room.hang(*above, {"kind": "television"})
    size = draw_size(kind, rng)
    if kind == "column":
        size = (size[0], size[1], room.height - 0.06)
    if not room.stand(side, at, size, draw_entry(kind, common, rng)):
        return False
    if kind == "desk":
        wall = SIDES[side]
        x, y = wall.plan(at, wall.level(room) + wall.inwards * (size[1] + 0.35))
        room.place(x, y, wall.facing + 180, draw_size("chair", rng), draw_entry("chair", common, rng))
    return True


def _in_the_middle(room: Room, kind: str, common: Entry, rng: Rng) -> None:
    """Place a group of items away from the walls, with a passage around it."""
    margin = 0.95
    (x0, x1), (y0, y1) = room.x, room.y
    if min(x1 - x0, y1 - y0) < 2 * margin + 0.4:
        return
    x, y = rng.uniform(x0 + margin, x1 - margin), rng.uniform(y0 + margin, y1 - margin)
    turn = float(rng.choice([0.0, 90.0]))
    ahead = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
    across = np.array([-ahead[1], ahead[0]])

    def put(name: str, forwards: float, sideways: float, facing: float, size: Size) -> bool:
        place = (x, y) + forwards * ahead + sideways * across
        inside = x0 + 0.75 < place[0] < x1 - 0.75 and y0 + 0.75 < place[1] < y1 - 0.75
        if not inside and name not in ("rug", "chair", "visitor_chair"):
            return False
        return room.place(float(place[0]), float(place[1]), turn + facing, size, draw_entry(name, common, rng))

    if kind == "desk_pair":
        size = draw_size("desk", rng)
        if put("desk", size[1] / 2 + 0.03, 0, 0, size):
            put("chair", size[1] + 0.33, 0, 180, draw_size("chair", rng))
            if put("desk", -size[1] / 2 - 0.03, 0, 180, size):
                put("chair", -size[1] - 0.33, 0, 0, draw_size("chair", rng))
    elif kind in ("dining", "conference"):
        long = float(rng.uniform(1.1, 1.9) if kind == "dining" else rng.uniform(1.6, 3.2))
        deep = rng.uniform(0.7, 1.1)
        if put("table", 0, 0, 0, (long, deep, 0.74)):
            count = max(1, int(long / 0.65))
            for seat in range(count):
                sideways = (seat + 0.5) / count * long - long / 2
                for sign in (1, -1):
                    if rng.random() < 0.85:
                        away, facing = sign * (deep / 2 + 0.2), 180 if sign > 0 else 0
                        put("visitor_chair", away, sideways, facing, KINDS["visitor_chair"].size)
    elif kind == "seating":
        put("rug", 0, 0, 0, draw_size("rug", rng))
        if put("sofa", -0.9, 0, 0, draw_size("sofa", rng)):
            put("table", 0.25, 0, 0, (0.9, 0.55, 0.42))
    elif kind == "benches":
        for line in range(rng.integers(2, 5)):
            for seat in range(2):
                put("table", 1.5 * line - 1.5, 1.7 * seat - 0.85, 0, (1.3, 0.5, 0.74))
                put("visitor_chair", 1.5 * line - 2.0, 1.7 * seat - 0.85, 0, KINDS["visitor_chair"].size)
    elif kind == "stacks":
        size = draw_size("shelf", rng)
        if put("shelf", 0.2, 0, 0, size):
            put("shelf", -0.2, 0, 180, size)
    elif kind == "plant_island":
        for sideways in (-0.35, 0.35):
            put("plant", 0, sideways, 0, draw_size("plant", rng))
    elif kind == "column":
        wide = rng.uniform(0.3, 0.6)
        put("column", 0, 0, 0, (wide, wide, room.height - 0.06))
    else:
        put(kind, 0, 0, 0, draw_size(kind, rng))


def _on_a_wall(room: Room, kind: str, side: str, at: float, rng: Rng) -> None:
    known = KINDS[kind]
    varies = kind in ("poster", "picture", "notice_board", "whiteboard", "mirror")
    scale = rng.uniform(0.7, 1.4) if varies else 1.0
    w, d, h = known.size
    z = known.z + rng.uniform(-0.1, 0.25) * (known.z > 0.6)
    entry: Entry = {"kind": kind}
    if "picture" in known.options:
        entry["picture"] = int(rng.integers(1000))
    if kind == "blind_door":
        entry["wood"] = str(rng.choice(_WOODS))
    room.hang(side, at, (w * scale, d, h * scale), z, entry)
