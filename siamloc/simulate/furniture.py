"""Office furniture: one builder for each kind, and a table of the kinds at the end of the file.

In an item's frame, x runs across, its back is at y = -depth/2, its front at y = +depth/2, and its base at z = 0. To
add a kind, write a builder and add a line to the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from siamloc.simulate.layout import Colour, Item, Rng
from siamloc.simulate.mesh import WHITE, MeshBuilder, Point
from siamloc.simulate.prints import BOOK_ROWS, SCREENS

Build = Callable[[MeshBuilder, Item, Rng, float, float, float], None]

BLACKISH = (0.035, 0.035, 0.04)
STEEL = (0.55, 0.56, 0.58)
_DUSK = (0.12, 0.1, 0.09)
_CARDBOARD = np.array((0.42, 0.29, 0.16))
SEATS: tuple[Colour, ...] = (
    (0.05, 0.08, 0.22), (0.03, 0.03, 0.035), (0.25, 0.04, 0.04), (0.05, 0.16, 0.10), (0.30, 0.15, 0.04),
    (0.14, 0.15, 0.17),
)  # fmt: skip
FRONTS: tuple[Colour, ...] = ((0.62, 0.63, 0.64), (0.75, 0.72, 0.66), (0.30, 0.36, 0.44), (0.52, 0.55, 0.50))
CLOTHES: tuple[Colour, ...] = (
    (0.10, 0.14, 0.32), (0.45, 0.06, 0.06), (0.05, 0.05, 0.06), (0.60, 0.58, 0.52), (0.08, 0.25, 0.15),
    (0.55, 0.40, 0.10), (0.30, 0.35, 0.42),
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """What all items of a kind have in common, such as chairs.

    Attributes:
        build: (mesh builder, item, generator, width, depth, height) -> None: adds an item of this size in metres to
            the mesh; the generator draws its details.
        size: usual width, depth and height in metres.
        z: usual height of the base above the floor in metres.
        blocks: whether a robot has to drive around it.
        moves: how far it moves from run to run, in metres.
        turns: how far it turns from run to run, in degrees.
        options: further keys that the building file may give, such as "colour" or "wood".
    """

    build: Build
    size: tuple[float, float, float]
    z: float = 0.0
    blocks: bool = True
    moves: float = 0.0
    turns: float = 0.0
    options: tuple[str, ...] = ()


def colour_of(item: Item, rng: Rng, palette: tuple[Colour, ...]) -> Colour:
    """Return the item's own colour if the file gives one, else one from the palette."""
    drawn = palette[rng.integers(len(palette))]
    red, green, blue = item.options.get("colour") or drawn
    return float(red), float(green), float(blue)


def wood_of(item: Item, usual: str = "beech") -> str:
    """Return the texture of the item's wood: the texture in the building file, else the usual texture."""
    return str(item.options.get("wood", usual))


def fill(b: MeshBuilder, item: Item, z: Point, texture: str, tint: Point = WHITE, skip: str = "", **faces: str) -> None:
    """Add a box over the whole width and depth of an item, between the heights `z` in metres.

    The further arguments, such as `skip` and `faces`, are those of `MeshBuilder.box`.
    """
    w, d, _ = item.size
    b.box((-w / 2, -d / 2, z[0]), (w / 2, d / 2, z[1]), texture, tint, skip, **faces)


def front(b: MeshBuilder, item: Item, z: Point, texture: str, tint: Point = WHITE, **more: Any) -> None:
    """Add a panel over the whole front of an item, between the heights `z` in metres.

    The further arguments, such as `emission` and `phase`, are those of `MeshBuilder.quad`.
    """
    w, d, _ = item.size
    b.panel((-w / 2, w / 2), z, d / 2, texture, tint, **more)


def sides(item: Item, thick: float) -> tuple[float, float]:
    """Return the x, in metres, at which boxes of a thickness in metres start at the left and right end of an item."""
    return -item.size[0] / 2, item.size[0] / 2 - thick


def middles(width: float, count: int) -> list[float]:
    """Return the x of the middles of `count` equal parts of an item with this width, all in metres."""
    return [width * ((i + 0.5) / count - 0.5) for i in range(count)]


def _legs(b: MeshBuilder, item: Item, top: float, colour: Colour, thick: float = 0.05) -> None:
    w, d, _ = item.size
    for x in (-w / 2 + 0.04, w / 2 - 0.04 - thick):
        for y in (-d / 2 + 0.04, d / 2 - 0.04 - thick):
            b.box((x, y, 0), (x + thick, y + thick, top), "metal", colour, "bottom top")


def _clutter(b: MeshBuilder, item: Item, rng: Rng, y: Point) -> None:
    """Put one to three things on an item, at depths between two limits."""
    w, _, h = item.size
    for _ in range(rng.integers(1, 4)):
        x = rng.uniform(-w / 2 + 0.2, w / 2 - 0.2)
        clutter(b, x, rng.uniform(*y) if y[0] < y[1] else 0.0, h, rng)


def desk(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A desk: people sit at its front, the screens are at its back."""
    wood = wood_of(item)
    fill(b, item, (h - 0.035, h), wood)
    _legs(b, item, h - 0.035, STEEL)
    b.box((-w / 2 + 0.1, -d / 2 + 0.05, 0.35), (w / 2 - 0.1, -d / 2 + 0.07, h - 0.035), wood, (0.8, 0.8, 0.8))
    x = (1 if rng.random() < 0.5 else -1) * (w / 2 - 0.32)
    low, high = (x - 0.21, -d / 2 + 0.1, 0.05), (x + 0.21, d / 2 - 0.08, h - 0.1)
    b.box(low, high, "plain", (0.6, 0.6, 0.6), "bottom", front="drawers")
    screens = int(item.options.get("screens", 1))
    for i in range(screens):
        x = (i - (screens - 1) / 2) * 0.56 + rng.uniform(-0.05, 0.05)
        with b.at(x, -d / 2 + 0.22, h, rng.uniform(-12, 12)):
            _monitor(b, rng)
    if screens:
        x, y = rng.uniform(-0.12, 0.12), d / 2 - 0.28
        back, ahead = (y + 0.08, h + 0.02), (y - 0.08, h + 0.025)
        b.quad((x + 0.22, *back), (x - 0.22, *back), (x - 0.22, *ahead), (x + 0.22, *ahead), "keyboard")
        b.box((x + 0.27, y - 0.04, h), (x + 0.33, y + 0.06, h + 0.03), "plastic", BLACKISH, "bottom")
    _clutter(b, item, rng, (-d / 2 + 0.15, 0))


def screen(b: MeshBuilder, rng: Rng, x: Point, z: Point, y: float, lit: float, light: Colour) -> None:
    """Add the face of a screen, which faces +y and shines with the probability `lit`.

    Args:
        b: the mesh to add to.
        rng: draws whether the screen is on, and its picture.
        x: left and right edge in metres.
        z: lower and upper edge in metres.
        y: depth at which the face lies, in metres.
        lit: probability that the screen is on.
        light: radiosity of the red, green and blue light that white pixels emit.
    """
    if rng.random() < lit:
        b.panel(x, z, y, f"screen{rng.integers(SCREENS)}", (0.3, 0.3, 0.3), emission=light)
    else:
        b.panel(x, z, y, "plastic", BLACKISH)


def _monitor(b: MeshBuilder, rng: Rng) -> None:
    """Add a flat screen that faces along y."""
    b.box((-0.26, -0.02, 0.11), (0.26, 0.02, 0.45), "plastic", BLACKISH)
    screen(b, rng, (-0.25, 0.25), (0.12, 0.44), 0.022, 0.75, (1.1, 1.15, 1.25))
    b.box((-0.03, -0.03, 0.0), (0.03, 0.0, 0.2), "plastic", BLACKISH, "bottom top")
    b.box((-0.12, -0.1, 0.0), (0.12, 0.08, 0.015), "plastic", BLACKISH, "bottom")


def clutter(b: MeshBuilder, x: float, y: float, z: float, rng: Rng) -> None:
    """Add a sheet of paper, a stack of books, a cup or a lamp on a table top, at x, y and the height z in metres."""
    kind = int(rng.integers(5))
    with b.at(x, y, z, rng.uniform(-40, 40)):
        if kind <= 1:
            stack = 0.004 if kind == 0 else rng.uniform(0.03, 0.12)
            b.box((-0.11, -0.15, 0), (0.11, 0.15, stack), "plain", WHITE, "bottom", top=f"sheet{rng.integers(4)}")
        elif kind == 2:
            for level in range(rng.integers(2, 5)):
                low, high = (-0.09, -0.12, 0.03 * level), (0.09, 0.12, 0.03 * level + 0.028)
                b.box(low, high, "plain", rng.uniform(0.03, 0.5, 3), "bottom")
        elif kind == 3:
            b.prism(0, 0, (0, 0.1), 0.04, "plastic", rng.uniform(0.1, 0.9, 3), sides=6)
        else:
            b.prism(0, 0, (0, 0.02), 0.08, "metal", BLACKISH, sides=6)
            b.box((-0.01, -0.01, 0.02), (0.01, 0.01, 0.42), "metal", BLACKISH)
            b.prism(0, 0.06, (0.38, 0.47), (0.09, 0.05), "metal", (0.5, 0.05, 0.05), sides=6)


def chair(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A swivel chair; a person sitting on it faces its front."""
    colour = colour_of(item, rng, SEATS)
    b.box((-0.24, -0.22, 0.43), (0.24, 0.24, 0.51), "fabric", colour)
    b.box((-0.22, -0.28, 0.60), (0.22, -0.22, 1.0), "fabric", colour)
    b.box((-0.03, -0.27, 0.45), (0.03, -0.24, 0.62), "plastic", BLACKISH)
    b.box((-0.03, -0.03, 0.08), (0.03, 0.03, 0.43), "metal", BLACKISH, "top bottom")
    for i in range(5):
        with b.at(0, 0, 0, i * 72):
            b.box((-0.025, 0.0, 0.05), (0.025, 0.30, 0.09), "plastic", BLACKISH)
            b.box((-0.025, 0.25, 0.0), (0.025, 0.30, 0.05), "plastic", BLACKISH, "bottom")
    for x in (-0.29, 0.25):
        b.box((x, -0.15, 0.66), (x + 0.04, 0.14, 0.69), "plastic", BLACKISH)
        b.box((x, -0.03, 0.45), (x + 0.04, 0.02, 0.66), "plastic", BLACKISH, "top")


def visitor_chair(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A chair with four legs."""
    colour = colour_of(item, rng, SEATS)
    b.box((-w / 2, -d / 2 + 0.04, 0.43), (w / 2, d / 2, 0.47), "fabric", colour)
    b.box((-w / 2, -d / 2, 0.55), (w / 2, -d / 2 + 0.03, h), "fabric", colour)
    _legs(b, item, 0.43, STEEL, 0.03)
    for x in sides(item, 0.03):
        b.box((x, -d / 2, 0.43), (x + 0.03, -d / 2 + 0.03, 0.56), "metal", STEEL)


def table(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A table with things on it."""
    fill(b, item, (h - 0.04, h), wood_of(item))
    _legs(b, item, h - 0.04, STEEL, 0.06)
    _clutter(b, item, rng, (-d / 4, d / 4))


def round_table(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A round table on one foot."""
    radius = w / 2
    b.prism(0, 0, (h - 0.04, h), radius, wood_of(item), sides=12)
    b.prism(0, 0, (0.03, h - 0.04), 0.05, "metal", STEEL, sides=6)
    b.prism(0, 0, (0, 0.03), radius * 0.55, "metal", STEEL, sides=8)
    for _ in range(2):
        clutter(b, rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), h, rng)


def sofa(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A sofa with cushions."""
    colour = colour_of(item, rng, SEATS)
    fill(b, item, (0.08, 0.30), "fabric", colour)
    b.box((-w / 2, -d / 2, 0.30), (w / 2, -d / 2 + 0.2, h), "fabric", colour, "bottom")
    for x in sides(item, 0.16):
        b.box((x, -d / 2 + 0.2, 0.30), (x + 0.16, d / 2, 0.58), "fabric", colour, "bottom")
    for x0, x1 in ((-w / 2 + 0.17, -0.01), (0.01, w / 2 - 0.17)):
        b.box((x0, -d / 2 + 0.2, 0.30), (x1, d / 2, 0.44), "fabric", [1.3 * value for value in colour], "bottom")


def bench(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A bench without a back."""
    fill(b, item, (h - 0.05, h), wood_of(item, "wood"))
    _legs(b, item, h - 0.05, BLACKISH)


def shelf(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """An open shelf with rows of books or binders."""
    wood = wood_of(item)
    levels = max(1, round(h / 0.38))
    content = str(item.options.get("content", "mixed"))
    t = 0.025
    b.box((-w / 2, -d / 2, 0), (-w / 2 + t, d / 2, h), wood, WHITE, "bottom back")
    b.box((w / 2 - t, -d / 2, 0), (w / 2, d / 2, h), wood, WHITE, "bottom back")
    b.box((-w / 2 + t, -d / 2, 0), (w / 2 - t, -d / 2 + 0.01, h), wood, (0.75, 0.75, 0.75), "bottom top")
    for level in range(levels + 1):
        z = level * (h - t) / levels
        b.box((-w / 2 + t, -d / 2, z), (w / 2 - t, d / 2, z + t), wood, WHITE, "left right back")
        if level == levels:
            break
        top = z + t + (h - t) / levels * 0.88
        kind = content if content != "mixed" else ("books" if rng.random() < 0.6 else "binders")
        if kind == "empty" or rng.random() < 0.06:
            continue
        end = w / 2 - t - (0 if rng.random() < 0.7 else rng.uniform(0.1, 0.45) * w)
        low, high = (-w / 2 + t, -d / 2 + 0.01, z + t), (end, d / 2 - 0.06, top)
        b.box(low, high, "plain", _DUSK, "bottom back left", front=f"{kind}{rng.integers(BOOK_ROWS)}")


def shelf_board(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A board on the wall with one row of books."""
    fill(b, item, (0, 0.025), wood_of(item))
    low, high = (-w / 2 + 0.05, -d / 2, 0.025), (w / 2 - 0.2, d / 2 - 0.05, 0.31)
    b.box(low, high, "plain", _DUSK, "bottom back", front=f"books{rng.integers(BOOK_ROWS)}")


def cabinet(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A closed cabinet with two doors, perhaps with cartons on top."""
    colour = colour_of(item, rng, FRONTS)
    fill(b, item, (0.06, h), "plain", colour, "bottom front")
    front(b, item, (0.06, h), "cabinet_doors", colour)
    b.box((-w / 2 + 0.03, -d / 2, 0), (w / 2 - 0.03, d / 2 - 0.04, 0.06), "plain", BLACKISH, "bottom top")
    if rng.random() >= 0.5 or h >= 2.1:
        return
    x = -w / 2 + 0.03
    while x < w / 2 - 0.3:
        width, height = rng.uniform(0.22, 0.4), rng.uniform(0.15, 0.35)
        width = min(width, w / 2 - 0.02 - x)
        if rng.random() < 0.7:
            low, high = (x, -d / 2 + 0.04, h), (x + width, d / 2 - 0.06, h + height)
            b.box(low, high, "plain", rng.uniform(0.7, 1.0) * _CARDBOARD, "bottom")
        x += width + 0.04


def sideboard(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A low cabinet with things on it."""
    colour = colour_of(item, rng, FRONTS)
    fill(b, item, (0.04, h - 0.03), "plain", colour, "bottom front top")
    front(b, item, (0.04, h - 0.03), "cabinet_doors", colour)
    fill(b, item, (h - 0.03, h), wood_of(item))
    _clutter(b, item, rng, (0, 0))


def lockers(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A block of steel lockers."""
    colour = colour_of(item, rng, FRONTS)
    fill(b, item, (0, h), "metal", colour, "bottom front")
    front(b, item, (0, h), "lockers", colour)


def coat_rack(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A coat stand with a coat."""
    b.prism(0, 0, (0, 0.04), 0.2, "metal", BLACKISH)
    b.prism(0, 0, (0.04, h), 0.02, "metal", BLACKISH, sides=6)
    b.prism(0.1, 0, (0.7, h - 0.1), (0.16, 0.07), "fabric", CLOTHES[rng.integers(len(CLOTHES))], sides=6)


def waste_bin(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A waste bin."""
    radius = w / 2
    colour = colour_of(item, rng, ((0.05, 0.08, 0.20), BLACKISH, (0.35, 0.36, 0.38)))
    b.prism(0, 0, (0, h), (radius * 0.75, radius), "plastic", colour)


def carton(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A cardboard box."""
    fill(b, item, (0, h), "plain", rng.uniform(0.8, 1.1) * _CARDBOARD, "bottom")
    b.slab((-0.04, 0.04), (-d / 2, d / 2), h + 0.003, "plain", (0.6, 0.5, 0.35))


def plant(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A potted plant."""
    b.prism(0, 0, (0, 0.32), (w * 0.25, w * 0.33), "plastic", (0.45, 0.16, 0.08))
    b.prism(0, 0, (0.3, h * 0.55), 0.025, "wood", (0.4, 0.4, 0.4), sides=5)
    for _ in range(9):
        with b.at(0, 0, float(rng.uniform(0.35, 0.7) * h), rng.uniform(0, 360)):
            reach, rise = rng.uniform(0.28, 0.48) * w * 1.4, rng.uniform(0.1, 0.35) * h
            half = rng.uniform(0.06, 0.13)
            left, right = (-half * 0.7, reach, rise), (half * 0.7, reach, rise)
            b.quad((-half, 0.03, 0), (half, 0.03, 0), right, left, "leaf")
            tip = (reach * 1.5, rise * 0.7)
            b.quad(left, right, (half * 0.2, *tip), (-half * 0.2, *tip), "leaf")


def floor_lamp(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A floor lamp (not lit)."""
    b.prism(0, 0, (0, 0.03), 0.16, "metal", BLACKISH)
    b.prism(0, 0, (0.03, h - 0.3), 0.015, "metal", BLACKISH, sides=5)
    b.prism(0, 0, (h - 0.3, h), (0.2, 0.13), "fabric", (0.85, 0.8, 0.65))


def bed(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A bed with its head at its back."""
    colour, wood = colour_of(item, rng, SEATS), wood_of(item)
    b.box((-w / 2, -d / 2, 0), (w / 2, -d / 2 + 0.05, h), wood, WHITE, "bottom")
    b.box((-w / 2, -d / 2 + 0.05, 0.12), (w / 2, d / 2, 0.3), wood, WHITE, "bottom")
    b.box((-w / 2 + 0.03, -d / 2 + 0.05, 0.3), (w / 2 - 0.03, d / 2 - 0.02, 0.48), "fabric", (0.8, 0.8, 0.78))
    b.box((-w / 2, -d / 2 + 0.65, 0.32), (w / 2, d / 2, 0.53), "fabric", colour, "bottom")
    for x in middles(w, 2 if w > 1.3 else 1):
        b.box((x - 0.3, -d / 2 + 0.1, 0.48), (x + 0.3, -d / 2 + 0.5, 0.58), "fabric", (0.85, 0.85, 0.85))


def armchair(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """An armchair."""
    colour = colour_of(item, rng, SEATS)
    fill(b, item, (0.1, 0.4), "fabric", colour, "bottom")
    b.box((-w / 2, -d / 2, 0.4), (w / 2, -d / 2 + 0.2, h), "fabric", colour, "bottom")
    for x in sides(item, 0.15):
        b.box((x, -d / 2 + 0.2, 0.4), (x + 0.15, d / 2, 0.6), "fabric", colour, "bottom")


def rug(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
    """A rug with a border; a robot drives over it."""
    colour = np.array(colour_of(item, rng, SEATS))
    border = np.clip(colour * rng.uniform(0.3, 2.5, 3), 0.01, 0.9)
    b.slab((-w / 2, w / 2), (-d / 2, d / 2), 0.004, "fabric", border)
    x, y = w / 2 - 0.12, d / 2 - 0.12
    b.slab((-x, x), (-y, y), 0.006, "fabric", colour)


def wardrobe(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A wooden wardrobe with doors."""
    fill(b, item, (0, h), wood_of(item), WHITE, "bottom back")
    count = max(2, round(w / 0.5))
    for i in range(1, count):
        x = w * (i / count - 0.5)
        b.box((x - 0.005, d / 2, 0.08), (x + 0.005, d / 2 + 0.004, h - 0.05), "plain", (0.05, 0.05, 0.05), "back")
        if i % 2:
            b.box((x + 0.03, d / 2, 0.95), (x + 0.05, d / 2 + 0.03, 1.2), "metal", WHITE, "back")
    b.box((-w / 2, -d / 2, h), (w / 2, d / 2 + 0.03, h + 0.04), wood_of(item))


def bathtub(b: MeshBuilder, item: Item, _: Rng, w: float, d: float, h: float) -> None:
    """A bathtub."""
    white = (0.88, 0.88, 0.88)
    fill(b, item, (0, h), "plastic", white, "bottom top")
    x, y = w / 2 - 0.08, d / 2 - 0.08
    whole, inner, left, right = (-w / 2, w / 2), (-y, y), (-w / 2, -x), (x, w / 2)
    for across, along in ((whole, (-d / 2, -y)), (whole, (y, d / 2)), (left, inner), (right, inner)):
        b.slab(across, along, h, "plastic", white)
    b.slab((-x, x), inner, h - 0.3, "plastic", (0.7, 0.7, 0.7))
    b.box((-w / 2 + 0.1, -0.03, h), (-w / 2 + 0.14, 0.03, h + 0.2), "metal")


#: The kinds that belong in offices and flats, with their usual sizes.
FURNITURE: dict[str, Kind] = {
    "desk": Kind(desk, (1.6, 0.8, 0.74), options=("screens", "wood")),
    "chair": Kind(chair, (0.56, 0.56, 1.0), moves=0.25, turns=60, options=("colour",)),
    "visitor_chair": Kind(visitor_chair, (0.5, 0.5, 0.85), moves=0.15, turns=20, options=("colour",)),
    "table": Kind(table, (1.4, 0.8, 0.74), options=("wood",)),
    "round_table": Kind(round_table, (1.1, 1.1, 0.74), options=("wood",)),
    "sofa": Kind(sofa, (1.7, 0.8, 0.8), options=("colour",)),
    "bench": Kind(bench, (1.2, 0.4, 0.45), options=("wood",)),
    "shelf": Kind(shelf, (1.0, 0.35, 2.0), options=("wood", "content")),
    "cabinet": Kind(cabinet, (1.0, 0.45, 1.9), options=("colour",)),
    "sideboard": Kind(sideboard, (1.2, 0.45, 0.8), options=("colour", "wood")),
    "lockers": Kind(lockers, (1.2, 0.5, 1.8), options=("colour",)),
    "coat_rack": Kind(coat_rack, (0.5, 0.5, 1.75), moves=0.1),
    "bin": Kind(waste_bin, (0.32, 0.32, 0.4), moves=0.2, turns=180, options=("colour",)),
    "carton": Kind(carton, (0.5, 0.4, 0.4), moves=0.3, turns=40),
    "plant": Kind(plant, (0.5, 0.5, 1.5), turns=180),
    "floor_lamp": Kind(floor_lamp, (0.4, 0.4, 1.7)),
    "bed": Kind(bed, (1.4, 2.0, 0.95), options=("colour", "wood")),
    "armchair": Kind(armchair, (0.85, 0.8, 0.85), options=("colour",)),
    "rug": Kind(rug, (2.0, 1.4, 0.01), blocks=False, options=("colour",)),
    "wardrobe": Kind(wardrobe, (1.4, 0.6, 2.05), options=("wood",)),
    "bathtub": Kind(bathtub, (1.7, 0.75, 0.56)),
    "shelf_board": Kind(shelf_board, (1.0, 0.28, 0.35), 1.5, blocks=False, options=("wood", "content")),
}
