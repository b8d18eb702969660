"""Walls, floors, ceilings, doors, windows and lamps of a building, as quads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from siamloc.simulate.layout import HALF_WALL, OUTER_WALL, SIDES, Array, Building, Colour, Opening, Rng, Room, side_at
from siamloc.simulate.mesh import WHITE, MeshBuilder, Point

SKIRTING = 0.09
_CASING = 0.07
_GAP = 0.005


@dataclass(frozen=True)
class Fixtures:
    """The state of a building's doors and blinds in one run.

    Attributes:
        door_angles: degrees that each leaf is open, by position in `Building.openings`.
        blinds: share of each window that its blind covers, by position in `Building.openings`.
    """

    door_angles: dict[int, float]
    blinds: dict[int, float]


@dataclass(frozen=True)
class Style:
    """Linear colours of a building's woodwork.

    Attributes:
        frame: colour of the door frames.
        leaves: texture and colour of the doors' leaves, which the doors use in turn.
        skirting: colour of the skirting boards.
    """

    frame: Colour
    leaves: tuple[tuple[str, Colour], ...]
    skirting: Colour


@dataclass(frozen=True)
class Lamp:
    """A lamp: the middle of its luminous face, its area in square metres, its radiosity if lit, and its room."""

    x: float
    y: float
    z: float
    area: float
    radiosity: Colour
    room: str


def draw_style(rng: Rng, materials: str = "standard") -> Style:
    """Draw the woodwork of a building.

    Args:
        rng: draws the colours.
        materials: as in `Building`: "standard" draws the frames from a few colours, others give them any colour.
    """
    frames = ((0.10, 0.13, 0.20), (0.30, 0.08, 0.07), (0.08, 0.20, 0.14), (0.22, 0.22, 0.24), (0.75, 0.74, 0.70))
    leaves = ("beech", "wood", "walnut", "plain")
    frame = frames[rng.integers(len(frames))]
    if materials != "standard":
        grey, tint = rng.uniform(0.03, 0.8), rng.uniform(0.4, 1.6, 3) ** rng.choice([0.2, 1.0])
        frame = tuple(np.clip(grey * tint / tint.mean(), 0.02, 0.85).tolist())
    drawn = []
    for leaf in rng.permutation(leaves):
        shade = rng.uniform(0.6, 1.0)
        drawn.append((str(leaf), (0.7 * shade, 0.8 * shade, shade) if leaf == "plain" else (shade, shade, shade)))
    shade = rng.uniform(0.06, 0.3)
    return Style(frame, tuple(drawn), (shade, shade, shade))


def add_shell(builder: MeshBuilder, building: Building, fixtures: Fixtures, style: Style) -> list[Lamp]:
    """Add a building's walls, floors, ceilings, doors, windows and lamps; return all lamps, with radiosity 1.

    Args:
        builder: the mesh to add to.
        building: the floor plan.
        fixtures: how far doors are open and blinds are down.
        style: colours of door frames, door leaves and skirting boards.
    """
    lamps: list[Lamp] = []
    for index, room in enumerate(building.rooms.values()):
        builder.room = index
        x, y = room.inner()
        builder.slab(x, y, 0, room.floor)
        builder.slab(x, y[::-1], room.height, room.ceiling)
        for side in SIDES:
            _wall(builder, building, room, side, fixtures, style)
        lamps += _lamps(builder, room)
    return lamps


def leaf_segment(building: Building, opening: Opening, angle: float) -> Array:
    """Return the two ends (2, 2) in metres of a door's leaf on the floor plan, opened by an angle in degrees."""
    room = building.rooms[opening.into]
    low, high = opening.interval
    hinge, tip = (low, high) if opening.hinge == "low" else (high, low)
    into = SIDES[side_at(room, opening.along, opening.level)].inwards
    start = np.array(opening.point(hinge, into * HALF_WALL))
    closed = np.array(opening.point(tip, into * HALF_WALL)) - start
    inwards = np.array(opening.point(0.0, 1.0)) - np.array(opening.point(0.0, 0.0))
    radians = np.radians(angle)
    return np.stack([start, start + np.cos(radians) * closed + np.sin(radians) * into * opening.width * inwards])


def _panel(b: MeshBuilder, x: Point, z: Point, y: float, texture: str, tint: Point) -> None:
    """Add a piece of wall between x[0] < x[1] and z[0] < z[1]."""
    if x[1] - x[0] < 1e-4 or z[1] - z[0] < 1e-4:
        return
    tile = b.textures[texture][1]
    phase = (-x[1] / tile[0], z[0] / tile[1]) if tile else (0.0, 0.0)
    b.panel(x, z, y, texture, tint, phase=phase)


def _wall(b: MeshBuilder, building: Building, room: Room, side: str, fixtures: Fixtures, style: Style) -> None:
    wall, inner = SIDES[side], room.inner()
    middle = wall.plan(*room.centre)[0]
    x, y = wall.plan(middle, wall.level(inner))
    half = (wall.span(inner)[1] - wall.span(inner)[0]) / 2
    # Seen from inside the room, x is the coordinate along the wall from its middle, or its opposite.
    sign = wall.inwards if wall.along == "x" else -wall.inwards
    with b.at(x, y, 0, wall.facing - 90):
        cursor = -half
        for index, opening in sorted(building.openings_in(room, side), key=lambda found: sign * found[1].centre):
            left, right = x = sorted(sign * (end - middle) for end in opening.interval)
            _piece(b, room, (cursor, left), (0, room.height), style)
            _piece(b, room, x, (0, opening.bottom), style)
            _piece(b, room, x, (opening.top, room.height), style)
            if opening.kind == "window":
                _window(b, x, opening, fixtures.blinds[index])
            else:
                _doorway(b, room, x, opening, style)
                if opening.kind in ("leaf", "glass") and opening.into == room.name:
                    hinge_left, angle = (opening.hinge == "low") == (sign > 0), fixtures.door_angles[index]
                    _leaf(b, x, opening, hinge_left, angle, style.leaves[index % len(style.leaves)], style.frame)
            cursor = right
        _piece(b, room, (cursor, half), (0, room.height), style)


def _piece(b: MeshBuilder, room: Room, x: Point, z: Point, style: Style) -> None:
    low = z[0]
    if low < SKIRTING < z[1]:
        _panel(b, x, (low, SKIRTING), 0, "plain", style.skirting)
        low = SKIRTING
    if room.wainscot and low < room.wainscot[1]:
        top = min(room.wainscot[1], z[1])
        _panel(b, x, (low, top), 0, room.wainscot[0], (1, 1, 1))
        low = top
    _panel(b, x, (low, z[1]), 0, room.walls, room.paint)


def _reveal(b: MeshBuilder, x: Point, z: Point, depth: float, texture: str, tint: Point, floor: str = "") -> None:
    """Line the sides of a hole that goes `depth` into the wall; its lower side with `floor` if it is at floor level."""
    (x0, x1), (z0, z1), y = x, z, -depth
    b.quad((x0, y, z0), (x0, 0, z0), (x0, 0, z1), (x0, y, z1), texture, tint)
    b.quad((x1, 0, z0), (x1, y, z0), (x1, y, z1), (x1, 0, z1), texture, tint)
    b.quad((x0, 0, z1), (x1, 0, z1), (x1, y, z1), (x0, y, z1), texture, tint)
    sill = (floor, WHITE) if floor and z0 <= 0 else (texture, tint)
    b.quad((x0, y, z0), (x1, y, z0), (x1, 0, z0), (x0, 0, z0), *sill)


def _window(b: MeshBuilder, x: Point, opening: Opening, blind: float) -> None:
    (left, right), z0, z1 = x, opening.bottom, opening.top
    _reveal(b, x, (z0, z1), OUTER_WALL, "paint", (1, 1, 1))
    width, height = right - left, z1 - z0
    y0, y1 = -0.22, -0.16
    white, bar = (0.9, 0.9, 0.9), 0.05
    b.box((left, y0, z0), (left + bar, y1, z1), "plastic", white)
    b.box((right - bar, y0, z0), (right, y1, z1), "plastic", white)
    b.box((left, y0, z0), (right, y1, z0 + bar), "plastic", white)
    b.box((left, y0, z1 - bar), (right, y1, z1), "plastic", white)
    panes = max(1, round(width / 0.85))
    for i in range(1, panes):
        middle = left + width * i / panes
        b.box((middle - bar * 0.7, y0, z0), (middle + bar * 0.7, y1, z1), "plastic", white)
    if height > 1.7:
        b.box((left, y0, z0 + 0.55), (right, y1, z0 + 0.55 + bar), "plastic", white)
    if z0 > 0.3:
        b.box((left - 0.06, -0.16, z0 - 0.035), (right + 0.06, 0.10, z0 + _GAP), "plain", (0.85, 0.84, 0.82))
    if blind > 0.02:
        bottom = z1 - blind * height
        _panel(b, (left + 0.01, right - 0.01), (bottom, z1), -0.10, "fabric", (0.95, 0.93, 0.86))
        b.box((left + 0.01, -0.115, bottom - 0.03), (right - 0.01, -0.09, bottom), "metal")


def _doorway(b: MeshBuilder, room: Room, x: Point, opening: Opening, style: Style) -> None:
    (left, right), z0, z1 = x, opening.bottom, opening.top
    _reveal(b, x, (z0, z1), HALF_WALL, "plain", style.frame, room.floor)
    if opening.kind == "open" and opening.width > 1.6:
        return
    c, out = _CASING, 0.03
    b.box((left - c, 0, z0), (left, out, z1 + c), "plain", style.frame, skip="back bottom")
    b.box((right, 0, z0), (right + c, out, z1 + c), "plain", style.frame, skip="back bottom")
    b.box((left, 0, z1), (right, out, z1 + c), "plain", style.frame, skip="back left right")
    if opening.kind == "pane":
        b.box((left, 0, z0 - c), (right, out, z0), "plain", style.frame, skip="back left right")
        if opening.rooms[0] == room.name:
            count = max(1, round((right - left) / 0.9))
            for i in range(1, count):
                middle = left + (right - left) * i / count
                b.box((middle - 0.025, -0.085, z0), (middle + 0.025, -0.035, z1), "plain", style.frame)


def _leaf(b: MeshBuilder, x: Point, opening: Opening, hinge_left: bool, angle: float, leaf: Any, frame: Colour) -> None:
    left, right = x
    width = right - left - 0.02
    with b.at(left + 0.01 if hinge_left else right - 0.01, 0, 0, angle if hinge_left else -angle):
        x0, x1 = (0.0, width) if hinge_left else (-width, 0.0)
        z1 = opening.top - 0.01
        if opening.kind == "glass":
            bar = 0.09
            b.box((x0, -0.04, 0.01), (x0 + bar, 0, z1), "metal", frame)
            b.box((x1 - bar, -0.04, 0.01), (x1, 0, z1), "metal", frame)
            b.box((x0 + bar, -0.04, 0.01), (x1 - bar, 0, 0.2), "metal", frame)
            b.box((x0 + bar, -0.04, z1 - bar), (x1 - bar, 0, z1), "metal", frame)
        else:
            b.box((x0, -0.04, 0.01), (x1, 0, z1), *leaf)
        grip = x1 - 0.16 if hinge_left else x0 + 0.04
        b.box((grip, -0.09, 1.02), (grip + 0.12, -0.04, 1.05), "metal", (0.35, 0.35, 0.36))
        b.box((grip, 0, 1.02), (grip + 0.12, 0.05, 1.05), "metal", (0.35, 0.35, 0.36))


def _lamps(b: MeshBuilder, room: Room) -> list[Lamp]:
    kind, nx, ny = room.lamps
    (x0, x1), (y0, y1) = room.inner()
    lamps = []
    for i in range(nx):
        for j in range(ny):
            x, y = x0 + (x1 - x0) * (i + 0.5) / nx, y0 + (y1 - y0) * (j + 0.5) / ny
            if kind == "round":
                z = room.height - 0.12
                ring = np.arange(11) * (2 * np.pi / 10)
                b.prism(x, y, (z, room.height), 0.2, "plain", (0.9, 0.9, 0.9), sides=10, lamp=0.6)
                edge = np.column_stack([x + 0.2 * np.cos(-ring), y + 0.2 * np.sin(-ring), np.full(11, z)])
                for k in range(1, 9, 2):
                    b.quad(edge[0], edge[k], edge[k + 1], edge[min(k + 2, 10)], "plain", lamp=1.0)
                area = 0.125
            else:
                w, d = {"panel": (0.58, 0.58), "tube": (1.25, 0.16)}[kind]
                w, d = (d, w) if y1 - y0 > x1 - x0 else (w, d)
                z = room.height - (0.04 if kind == "panel" else 0.16)
                rim = 0.025
                low, high = (x - w / 2 - rim, y - d / 2 - rim), (x + w / 2 + rim, y + d / 2 + rim)
                b.box((*low, z), (*high, z + 0.05), "metal", (0.7, 0.7, 0.7), skip="bottom")
                b.slab((low[0], high[0]), (high[1], low[1]), z, "plain")
                b.slab((x - w / 2, x + w / 2), (y + d / 2, y - d / 2), z - 0.004, "plain", lamp=1.0)
                if kind == "tube":
                    b.box((x - 0.01, y - 0.01, z + 0.05), (x + 0.01, y + 0.01, room.height), "metal", skip="top")
                area = w * d
            lamps.append(Lamp(x, y, z - 0.02, area, WHITE, room.name))
    return lamps
