"""What hangs on walls or stands in them: posters, boards, signs, radiators, doors that stay shut."""

from __future__ import annotations

from siamloc.simulate.furniture import BLACKISH, CLOTHES, STEEL, Rng, colour_of
from siamloc.simulate.layout import Item
from siamloc.simulate.mesh import MeshBuilder
from siamloc.simulate.prints import BOARDS, NOTICES, POSTERS


def _hung(b: MeshBuilder, item: Item, texture: str, rim: tuple[float, float, float] = (0.2, 0.2, 0.2)) -> None:
    w, d, h = item.size
    b.box((-w / 2, -d / 2, 0), (w / 2, d / 2, h), "plain", rim, skip=("back",), faces={"front": texture})


def poster(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A poster or a framed picture on the wall."""
    number = item.options.get("picture", int(rng.integers(POSTERS)))
    _hung(b, item, f"poster{int(number) % POSTERS}")


def whiteboard(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A whiteboard with writing and a tray."""
    _hung(b, item, f"board{rng.integers(BOARDS)}", STEEL)
    w = item.size[0]
    b.box((-w / 3, 0, -0.03), (w / 3, 0.1, -0.01), "metal")


def notice_board(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A cork board full of paper."""
    _hung(b, item, f"notices{rng.integers(NOTICES)}")


def clock(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A wall clock."""
    del rng
    _hung(b, item, "clock")


def exit_sign(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A lit emergency sign."""
    del rng
    w, d, h = item.size
    b.box((-w / 2, -d / 2, 0), (w / 2, d / 2, h), "plain", skip=("back", "front"))
    b.quad((w / 2, d / 2, 0), (-w / 2, d / 2, 0), (-w / 2, d / 2, h), (w / 2, d / 2, h), "exit",
           emission=(0.8, 0.8, 0.8))  # fmt: skip


def room_sign(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A door plate."""
    _hung(b, item, f"sign{rng.integers(8)}")


def mirror(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A mirror, seen as a pale surface."""
    del rng
    w, d, h = item.size
    b.box((-w / 2, -d / 2, 0), (w / 2, d / 2, h), "metal", (0.75, 0.8, 0.84), skip=("back",))


def extinguisher(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A fire extinguisher with its sign."""
    del rng
    h = item.size[2]
    b.prism(0, 0, (0, h * 0.75), 0.08, "plastic", (0.60, 0.02, 0.02), sides=8)
    b.prism(0, 0, (h * 0.75, h), (0.05, 0.02), "plastic", BLACKISH, sides=6)
    y = -item.size[1] / 2 + 0.005
    b.quad((0.1, y, 0.8), (-0.1, y, 0.8), (-0.1, y, 1.0), (0.1, y, 1.0), "plain", (0.6, 0.03, 0.03))


def blind_door(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A shut door to a room that is not part of the building."""
    w, d, h = item.size
    wood = str(item.options.get("wood", "beech"))
    frame = colour_of(item, rng, ((0.10, 0.13, 0.20),))
    y = -d / 2
    b.box((-w / 2 - 0.07, y, 0), (-w / 2, y + 0.04, h + 0.07), "plain", frame, skip=("back", "bottom"))
    b.box((w / 2, y, 0), (w / 2 + 0.07, y + 0.04, h + 0.07), "plain", frame, skip=("back", "bottom"))
    b.box((-w / 2, y, h), (w / 2, y + 0.04, h + 0.07), "plain", frame, skip=("back",))
    b.box((-w / 2, y, 0.01), (w / 2, y + 0.02, h), wood, skip=("back", "bottom"))
    b.box((w / 2 - 0.18, y + 0.02, 1.02), (w / 2 - 0.06, y + 0.07, 1.05), "metal", (0.35, 0.35, 0.36))


def elevator(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A lift's steel doors."""
    del rng
    w, d, h = item.size
    b.box((-w / 2, -d / 2, 0), (-0.005, d / 4, h), "metal", skip=("back", "bottom"))
    b.box((0.005, -d / 2, 0), (w / 2, d / 4, h), "metal", skip=("back", "bottom"))
    b.box((w / 2 + 0.12, -d / 2, 1.0), (w / 2 + 0.24, -d / 2 + 0.02, 1.25), "metal", BLACKISH, skip=("back",))
    b.box((-w / 2 - 0.08, -d / 2, h), (w / 2 + 0.08, d / 2, h + 0.08), "metal", (0.4, 0.4, 0.4), skip=("back",))


def radiator(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """A ribbed radiator under a window."""
    del rng
    w, d, h = item.size
    b.box((-w / 2, -d / 2, 0), (w / 2, d / 2, h), "plain", (0.85, 0.85, 0.84), faces={"front": "radiator"})


def coats(b: MeshBuilder, item: Item, rng: Rng) -> None:
    """Coats on hooks."""
    w, d, h = item.size
    b.box((-w / 2, -d / 2, h - 0.06), (w / 2, -d / 2 + 0.03, h), "wood", skip=("back",))
    for i in range(3):
        x = (i - 1) * w / 3
        if rng.random() < 0.75:
            colour = CLOTHES[int(rng.integers(len(CLOTHES)))]
            b.prism(x, 0, (0.05, h - 0.05), (0.16, 0.07), "fabric", colour, sides=6, stretch=0.55)
