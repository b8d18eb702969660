"""All kinds of items, and how items become quads.

The table of the kinds joins office furniture (`furniture`) and the items that are data (`things`) with the machines,
kitchens, toilets, stairs, people and items on walls that this file builds.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from siamloc.errors import DataError
from siamloc.simulate.furniture import (
    BLACKISH,
    CLOTHES,
    FURNITURE,
    STEEL,
    Build,
    Kind,
    colour_of,
    fill,
    front,
    middles,
    screen,
    sides,
    wood_of,
)
from siamloc.simulate.layout import Building, Item, Rng
from siamloc.simulate.mesh import WHITE, MeshBuilder, Point
from siamloc.simulate.prints import BOARDS, NOTICES, POSTERS
from siamloc.simulate.things import THINGS

_PORCELAIN = (0.9, 0.9, 0.9)
_IRON = (0.15, 0.15, 0.16)
_GRIP = (0.35, 0.35, 0.36)
_HANDRAIL = (0.6, 0.5, 0.4)
_SKIN = ((0.60, 0.40, 0.29), (0.42, 0.25, 0.16), (0.20, 0.11, 0.07), (0.68, 0.48, 0.36))
_HAIR = ((0.02, 0.015, 0.01), (0.10, 0.05, 0.02), (0.35, 0.22, 0.08), (0.3, 0.3, 0.3))


def copier(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A large copier with paper trays and a lid."""
    fill(b, item, (0.05, h - 0.12), "plastic", (0.72, 0.73, 0.72), "bottom", front="copier")
    b.box((-w / 2 + 0.02, -d / 2, h - 0.10), (w / 2 - 0.15, d / 2 - 0.08, h), "plastic", (0.55, 0.56, 0.56))
    b.box((w / 2 - 0.14, d / 2 - 0.25, h - 0.12), (w / 2, d / 2, h - 0.04), "plastic", BLACKISH)
    b.box((w / 2, -d / 3, 0.55), (w / 2 + 0.25, d / 3, 0.58), "plastic", (0.5, 0.5, 0.5))


def printer_table(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A small table with a laser printer and paper below."""
    fill(b, item, (h - 0.03, h), "beech")
    for x in sides(item, 0.03):
        b.box((x, -d / 2, 0), (x + 0.03, d / 2, h - 0.03), "beech", WHITE, "bottom top")
    fill(b, item, (0.2, 0.23), "beech")
    for i in range(3):
        left, right, top = -w / 2 + 0.06 + 0.24 * i, -w / 2 + 0.27 + 0.24 * i, 0.23 + rng.uniform(0.1, 0.3)
        b.box((left, -0.15, 0.23), (right, 0.15, top), "plain", (0.85, 0.86, 0.9), "bottom")
    b.box((-0.25, -0.22, h), (0.25, 0.22, h + 0.36), "plastic", (0.75, 0.75, 0.73), "bottom")
    b.box((-0.2, -0.12, h + 0.36), (0.2, 0.2, h + 0.40), "plastic", (0.20, 0.20, 0.21), "bottom")
    b.panel((-0.2, 0.2), (h + 0.08, h + 0.16), 0.225, "plastic", BLACKISH)


def vending_machine(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A vending machine with a lit front."""
    fill(b, item, (0, h), "metal", (0.45, 0.08, 0.08), "bottom front")
    front(b, item, (0, h), "machine", emission=(0.5, 0.5, 0.5))


def kitchen_counter(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A kitchen counter with sink, hob, coffee machine and wall units."""
    low, high = (-w / 2, -d / 2, 0.1), (w / 2, d / 2 - 0.02, h - 0.04)
    b.box(low, high, "plain", WHITE, "bottom top", front="kitchen_fronts")
    fill(b, item, (h - 0.04, h), "walnut")
    x = -w / 2 + 0.55
    b.slab((x - 0.28, x + 0.28), (-0.2, 0.2), h + 0.003, "metal", (0.35, 0.36, 0.38))
    b.box((x - 0.015, -0.24, h), (x + 0.015, -0.21, h + 0.28), "metal")
    b.box((x - 0.015, -0.24, h + 0.25), (x + 0.015, -0.02, h + 0.28), "metal")
    b.box((w / 2 - 0.4, -0.25, h), (w / 2 - 0.1, 0.1, h + 0.36), "plastic", BLACKISH, "bottom")
    b.prism(w / 2 - 0.25, 0.16, (h, h + 0.12), 0.05, "plastic", (0.25, 0.12, 0.06), sides=6)
    for i in range(4):
        x, y = 0.1 + 0.12 * i + rng.uniform(-0.03, 0.03), rng.uniform(-0.2, 0.1)
        b.prism(x, y, (h, h + 0.1), 0.04, "plastic", rng.uniform(0.1, 0.9, 3), sides=6)
    if item.options.get("wall_units", True):
        low, high = (-w / 2, -d / 2, 1.45), (w / 2, -d / 2 + 0.34, 2.1)
        b.box(low, high, "plain", (0.82, 0.82, 0.8), front="kitchen_fronts")
        b.box((-w / 2, -d / 2, h), (w / 2, -d / 2 + 0.01, 1.45), "tiles_blue", WHITE, "back")


def fridge(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A fridge-freezer with notes on its door."""
    fill(b, item, (0.03, h), "plastic", WHITE, "bottom", front="fridge")
    for _ in range(3):
        x, z = rng.uniform(-w / 2 + 0.05, w / 2 - 0.2), rng.uniform(0.9, h - 0.3)
        b.panel((x, x + 0.14), (z, z + 0.18), d / 2 + 0.004, f"sheet{rng.integers(4)}")


def stall(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A toilet cubicle with its door ajar and the bowl inside."""
    colour = colour_of(item, rng, ((0.30, 0.45, 0.60), (0.55, 0.55, 0.50)))
    for x in sides(item, 0.03):
        b.box((x, -d / 2, 0.15), (x + 0.03, d / 2, h), "plain", colour)
    b.box((-w / 2, d / 2 - 0.03, 0.15), (-w / 2 + 0.17, d / 2, h), "plain", colour)
    b.box((w / 2 - 0.17, d / 2 - 0.03, 0.15), (w / 2, d / 2, h), "plain", colour)
    with b.at(-w / 2 + 0.17, d / 2 - 0.03, 0, rng.uniform(-75, -15)):
        b.box((0, 0, 0.15), (w - 0.36, 0.03, h - 0.05), "plain", colour)
        b.box((w - 0.46, 0.03, 0.95), (w - 0.4, 0.07, 1.02), "metal", BLACKISH)
    b.prism(0, -d / 2 + 0.45, (0, 0.42), (0.14, 0.2), "plastic", _PORCELAIN, stretch=1.25)
    b.box((-0.2, -d / 2, 0.42), (0.2, -d / 2 + 0.18, 0.85), "plastic", _PORCELAIN, "back")


def basins(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """Wash basins below mirrors, with a towel dispenser."""
    back = -d / 2
    for x in middles(w, 2):
        b.prism(x, 0.02, (h - 0.2, h), (0.14, 0.26), "plastic", _PORCELAIN, sides=10, stretch=0.85)
        b.box((x - 0.07, back, 0.1), (x + 0.07, back + 0.14, h - 0.18), "plastic", _PORCELAIN)
        b.box((x - 0.015, back + 0.02, h), (x + 0.015, back + 0.05, h + 0.18), "metal")
        b.box((x - 0.015, back + 0.02, h + 0.15), (x + 0.015, back + 0.16, h + 0.18), "metal")
        b.box((x - 0.25, back, h + 0.3), (x + 0.25, back + 0.015, h + 1.05), "mirror", (0.72, 0.78, 0.82), "back")
    b.box((w / 2 - 0.1, back, h + 0.25), (w / 2 + 0.1, back + 0.12, h + 0.55), "plastic", WHITE, "back")


def urinals(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A row of urinals with partitions."""
    count = max(1, round(w / 0.7))
    for i, x in enumerate(middles(w, count)):
        b.prism(x, -d / 2 + 0.14, (0.45, 1.05), (0.13, 0.18), "plastic", _PORCELAIN, stretch=0.8)
        edge = w * ((i + 1) / count - 0.5)
        b.box((edge - 0.02, -d / 2, 0.5), (edge, d / 2, 1.35), "plain", (0.55, 0.6, 0.65), "back")


def stairs_up(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A flight of stairs that rises from the front to the back of its footprint."""
    steps = max(2, round(h / 0.17))
    for i in range(steps):
        y, z = d / 2 - i * d / steps, (i + 1) * h / steps
        b.box((-w / 2, -d / 2, z - h / steps), (w / 2, y, z), "concrete", WHITE, "back bottom")
        b.box((-w / 2, y - 0.04, z), (w / 2, y + 0.01, z + 0.006), "plain", (0.05, 0.05, 0.05), "bottom")
    for x in (-w / 2 + 0.03, w / 2 - 0.03):
        for i in range(0, steps, 2):
            y, z = d / 2 - (i + 0.5) * d / steps, (i + 1) * h / steps
            b.box((x - 0.015, y - 0.015, z), (x + 0.015, y + 0.015, z + 0.9), "metal", _IRON)
        low, high = (x, d / 2, 0.17 + 0.9), (x, -d / 2, h + 0.9)
        b.quad(low, high, (*high[:2], high[2] + 0.07), (*low[:2], low[2] + 0.07), "wood", _HANDRAIL)


def stairs_down(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """The head of a flight of stairs that leads down: dark steps behind a railing, which look like a lowered floor."""
    across, steps = (-w / 2, w / 2), 8
    for i in range(steps):
        shade = 0.5 * (1 - i / steps) + 0.03
        y1, y0 = d / 2 - i * d / steps, d / 2 - (i + 1) * d / steps
        b.slab(across, (y0, y1 - 0.05), 0.004, "concrete", (shade, shade, shade))
        b.slab(across, (y1 - 0.05, y1), 0.005, "plain", (0.02, 0.02, 0.02))
    for x in across:
        with b.at(x, -d / 2, 0, 90.0):
            b.box((0, -0.03, h - 0.05), (d, 0.03, h), "wood", _HANDRAIL)
            b.box((0, -0.015, 0.12), (d, 0.015, 0.15), "metal", _IRON)
            for i in range(int(d / 0.14) + 1):
                post = min(i * 0.14, d - 0.02)
                b.box((post, -0.01, 0), (post + 0.02, 0.01, h - 0.05), "metal", _IRON, "top bottom")


def person(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A standing person; the clothes are drawn."""
    trousers = CLOTHES[rng.integers(len(CLOTHES))]
    shirt = colour_of(item, rng, CLOTHES)
    skin = _SKIN[rng.integers(len(_SKIN))]
    stride = rng.uniform(0.0, 0.12)
    for x, y in ((-0.09, stride), (0.09, -stride)):
        b.prism(x, y, (0.06, 0.47 * h), (0.06, 0.085), "fabric", trousers, sides=6)
        b.box((x - 0.05, y - 0.08, 0), (x + 0.05, y + 0.16, 0.07), "plastic", BLACKISH, "bottom")
    b.prism(0, 0, (0.45 * h, 0.82 * h), (0.16, 0.21), "fabric", shirt, stretch=0.6)
    for x in (-0.24, 0.24):
        b.prism(x, 0.02, (0.44 * h, 0.81 * h), (0.045, 0.06), "fabric", shirt, sides=6)
        b.prism(x, 0.03, (0.40 * h, 0.44 * h), 0.04, "plain", skin, sides=5)
    b.prism(0, 0, (0.82 * h, 0.86 * h), 0.055, "plain", skin, sides=6)
    b.prism(0, 0.01, (0.86 * h, 0.95 * h), (0.075, 0.09), "plain", skin)
    b.prism(0, -0.01, (0.93 * h, h), (0.098, 0.06), "fabric", _HAIR[rng.integers(len(_HAIR))])


def poster(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A poster or a framed picture on the wall."""
    number = item.options.get("picture", int(rng.integers(POSTERS)))
    board(f"poster{int(number) % POSTERS}")(b, item, rng, w, d, h)


def television(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A large flat screen, on or off."""
    b.box((-w / 2, -d / 2, 0), (w / 2, d / 2 - 0.005, h), "plastic", BLACKISH, "back")
    screen(b, rng, (-w / 2, w / 2), (0, h), d / 2, 0.5, (1.0, 1.0, 1.1))


def whiteboard(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A whiteboard with writing and a tray."""
    board("board", BOARDS, STEEL)(b, item, rng, w, d, h)
    b.box((-w / 3, 0, -0.03), (w / 3, 0.1, -0.01), "metal")


def exit_sign(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A lit emergency sign."""
    fill(b, item, (0, h), "plain", WHITE, "back front")
    front(b, item, (0, h), "exit", emission=(0.8, 0.8, 0.8))


def extinguisher(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A fire extinguisher with its sign."""
    b.prism(0, 0, (0, h * 0.75), 0.08, "plastic", (0.60, 0.02, 0.02), sides=8)
    b.prism(0, 0, (h * 0.75, h), (0.05, 0.02), "plastic", BLACKISH, sides=6)
    b.panel((-0.1, 0.1), (0.8, 1.0), -d / 2 + 0.005, "plain", (0.6, 0.03, 0.03))


def blind_door(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A closed door to a room that is not part of the building."""
    frame = colour_of(item, rng, ((0.10, 0.13, 0.20),))
    y = -d / 2
    b.box((-w / 2 - 0.07, y, 0), (-w / 2, y + 0.04, h + 0.07), "plain", frame, "back bottom")
    b.box((w / 2, y, 0), (w / 2 + 0.07, y + 0.04, h + 0.07), "plain", frame, "back bottom")
    b.box((-w / 2, y, h), (w / 2, y + 0.04, h + 0.07), "plain", frame, "back")
    b.box((-w / 2, y, 0.01), (w / 2, y + 0.02, h), wood_of(item), WHITE, "back bottom")
    b.box((w / 2 - 0.18, y + 0.02, 1.02), (w / 2 - 0.06, y + 0.07, 1.05), "metal", _GRIP)


def elevator(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """The steel doors of a lift."""
    b.box((-w / 2, -d / 2, 0), (-0.005, d / 4, h), "metal", WHITE, "back bottom")
    b.box((0.005, -d / 2, 0), (w / 2, d / 4, h), "metal", WHITE, "back bottom")
    b.box((w / 2 + 0.12, -d / 2, 1.0), (w / 2 + 0.24, -d / 2 + 0.02, 1.25), "metal", BLACKISH, "back")
    b.box((-w / 2 - 0.08, -d / 2, h), (w / 2 + 0.08, d / 2, h + 0.08), "metal", (0.4, 0.4, 0.4), "back")


def coats(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """Coats on hooks."""
    b.box((-w / 2, -d / 2, h - 0.06), (w / 2, -d / 2 + 0.03, h), "wood", WHITE, "back")
    for x in (-w / 3, 0.0, w / 3):
        if rng.random() < 0.75:
            colour = CLOTHES[rng.integers(len(CLOTHES))]
            b.prism(x, 0, (0.05, h - 0.05), (0.16, 0.07), "fabric", colour, sides=6, stretch=0.55)


def block(texture: str, tint: Point = WHITE, skip: str = "", **faces: str) -> Build:
    """Return the `Kind.build` of items that are a plain box, with pictures on some of the box's faces.

    The box takes the whole width, depth and height of an item. Its faces are called "front", "back", "left", "right",
    "top" and "bottom".

    Args:
        texture: texture of the faces, a name in `base_textures`.
        tint: linear colour that multiplies this texture.
        skip: faces to leave out since nobody sees them, separated by spaces, such as "back bottom".
        faces: textures of single faces by the face's name, which are not tinted; a name in `base_textures` or
            `print_textures`.

    Example:
        >>> shelf = Kind(block("beech", WHITE, "bottom", front="pigeonholes"), size=(1.2, 0.35, 1.5))
    """

    def build(b: MeshBuilder, item: Item, _: Rng, _w: float, _d: float, h: float) -> None:
        fill(b, item, (0, h), texture, tint, skip, **faces)

    return build


def board(picture: str, count: int = 0, rim: Point = (0.2, 0.2, 0.2)) -> Build:
    """Return the `Kind.build` of items that are a flat box with a picture on the front.

    Args:
        picture: texture of the front, a name in `print_textures`; without its number if there are several pictures.
        count: how many numbered pictures there are, one of which is drawn for each item; 0 for a single picture.
        rim: linear colour of the other faces.
    """

    def build(b: MeshBuilder, item: Item, rng: Rng, _w: float, _d: float, h: float) -> None:
        drawn = f"{picture}{rng.integers(count)}" if count else picture
        fill(b, item, (0, h), "plain", rim, "back", front=drawn)

    return build


def hung(build: Build, width: float, height: float, z: float, depth: float = 0.03, **more: Any) -> Kind:
    """Return the kind of items that hang on a wall, out of a robot's way.

    Args:
        build: adds an item to a mesh, as in `Kind`.
        width: usual width in metres.
        height: usual height in metres.
        z: usual height of the lower edge above the floor in metres.
        depth: usual depth in metres.
        more: further attributes of `Kind`, such as `options`.
    """
    return Kind(build, (width, depth, height), z, blocks=False, **more)


#: Every kind that a building file may place, with its usual size; items that hang do not block a robot.
KINDS: dict[str, Kind] = FURNITURE | {
    **THINGS,
    "copier": Kind(copier, (0.7, 0.7, 1.15)),
    "printer_table": Kind(printer_table, (0.8, 0.6, 0.7)),
    "pigeonholes": Kind(block("beech", WHITE, "bottom", front="pigeonholes"), (1.2, 0.35, 1.5)),
    "vending_machine": Kind(vending_machine, (0.85, 0.8, 1.85)),
    "kitchen_counter": Kind(kitchen_counter, (2.4, 0.62, 0.9), options=("wall_units",)),
    "fridge": Kind(fridge, (0.62, 0.62, 1.75)),
    "stall": Kind(stall, (1.0, 1.4, 2.0), options=("colour",)),
    "basins": Kind(basins, (1.4, 0.5, 0.85)),
    "urinals": Kind(urinals, (1.4, 0.35, 1.0)),
    "dryer": hung(block("plastic", WHITE, "back"), 0.28, 0.3, 1.15, 0.18),
    "stairs_up": Kind(stairs_up, (1.3, 2.8, 2.4)),
    "stairs_down": Kind(stairs_down, (1.3, 2.8, 1.0)),
    "column": Kind(block("concrete", WHITE, "bottom top"), (0.4, 0.4, 2.8)),
    "person": Kind(person, (0.5, 0.4, 1.75), options=("colour",)),
    "poster": hung(poster, 0.6, 0.85, 1.1, options=("picture",)),
    "picture": hung(poster, 0.9, 0.6, 1.35, options=("picture",)),
    "television": hung(television, 1.1, 0.65, 1.1, 0.06),
    "whiteboard": hung(whiteboard, 1.8, 1.1, 0.95, 0.05),
    "notice_board": hung(board("notices", NOTICES), 1.2, 0.9, 1.1, 0.04),
    "clock": hung(board("clock"), 0.35, 0.35, 2.05),
    "exit_sign": hung(exit_sign, 0.4, 0.2, 2.3, 0.06),
    "room_sign": hung(board("sign", 8), 0.2, 0.2, 1.45, 0.02),
    "extinguisher": hung(extinguisher, 0.2, 0.55, 0.5, 0.18),
    "blind_door": hung(blind_door, 0.96, 2.06, 0.0, 0.06, options=("colour", "wood")),
    "elevator": hung(elevator, 1.1, 2.1, 0.0, 0.08),
    "radiator": hung(block("plain", (0.85, 0.85, 0.84), front="radiator"), 1.2, 0.55, 0.15, 0.1),
    "mirror": hung(block("mirror", (0.75, 0.8, 0.84), "back"), 1.2, 0.8, 1.1),
    "coats": hung(coats, 1.0, 0.9, 0.9, 0.2),
}


def add_items(builder: MeshBuilder, building: Building, items: Iterable[Item]) -> None:
    """Add items to a mesh; an item's details depend on its number and its look, not on the run.

    The number is that in its options, which it keeps through months, or else its position in the list.

    Raises:
        DataError: an item that is too small for its parts.
    """
    for position, item in enumerate(items):
        number, look = (int(item.options.get(key, usual)) for key, usual in (("number", position), ("look", 0)))
        builder.room = building.room_index(item.room)
        with builder.at(item.x, item.y, item.z, item.facing - 90):
            rng = building.rng("item", number, look)
            try:
                KINDS[item.kind].build(builder, item, rng, *item.size)
            except ValueError as error:  # a part would have to lie between two ends that cross
                where = f"{building.source}: room {item.room!r}: {item.kind}"
                raise DataError(f"{where} is too small for its parts at {item.size}: give it a larger size") from error
