"""Items of homes, workshops and halls, as data: each is a list of parts.

A part is a row of words: its shape, its place, a texture, and the linear colour that multiplies it; a semicolon
separates two parts. Places are shares of the item's size: x and y run from -1 to 1 over its width and depth, z from 0
at its base to 1 at its top.

    box X0 Y0 Z0 X1 Y1 Z1 ...       a box between two corners
    tube X Y Z0 Z1 R0 R1 ...        an upright frustum; its radii, below and above, are shares of half the width
    front X0 X1 Z0 Z1 Y ...         a panel that faces the front, at the depth Y

The texture "wood" is the wood of the item; a texture ending in "#" has a number that is drawn for each item. The colour
is three numbers, or "colour" for the item's own colour, or absent for white.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from siamloc.simulate.furniture import BLACKISH, FRONTS, SEATS, STEEL, Build, Kind, colour_of, wood_of
from siamloc.simulate.layout import Array, Colour, Item, Rng
from siamloc.simulate.mesh import WHITE, MeshBuilder
from siamloc.simulate.prints import NOTICES, POSTERS, SCREENS

_NUMBERED = {"screen#": SCREENS, "poster#": POSTERS, "notices#": NOTICES}
_NUMBERS = {"box": 6, "tube": 6, "front": 5}
_NAMED: dict[str, Colour] = {"black": BLACKISH, "steel": STEEL, "white": (0.88, 0.88, 0.87)}
_MACHINES: tuple[Colour, ...] = (
    (0.08, 0.25, 0.16), (0.10, 0.20, 0.38), (0.45, 0.46, 0.46), (0.55, 0.30, 0.04), (0.40, 0.05, 0.04),
    (0.60, 0.58, 0.50),
)  # fmt: skip


def made_of(parts: str, palette: tuple[Colour, ...] = SEATS) -> Build:
    """Return the `Kind.build` of items that consist of parts.

    Args:
        parts: the parts, with a semicolon between two of them, in the form that the head of this file describes.
        palette: colours from which an item's colour is drawn, unless the building file gives the colour.
    """
    known = [_part(part) for part in parts.split(";")]

    def build(b: MeshBuilder, item: Item, rng: Rng, w: float, d: float, h: float) -> None:
        own = colour_of(item, rng, palette)
        x, y, _ = scale = np.array([w / 2, d / 2, h])
        for shape, place, texture, colour in known:
            if texture in _NUMBERED:
                picture = f"{texture[:-1]}{rng.integers(_NUMBERED[texture])}"
            else:
                picture = wood_of(item) if texture == "wood" else texture
            tint = own if colour == "colour" else colour
            if shape == "box":
                b.box(place[:3] * scale, place[3:] * scale, picture, tint)
            elif shape == "tube":
                z, radius = (place[2] * h, place[3] * h), (place[4] * x, place[5] * x)
                b.prism(place[0] * x, place[1] * y, z, radius, picture, tint)
            else:
                light = (1.0, 1.0, 1.05) if texture == "screen#" else (0.0, 0.0, 0.0)
                across, z = (place[0] * x, place[1] * x), (place[2] * h, place[3] * h)
                b.panel(across, z, place[4] * y, picture, tint, emission=light)

    return build


def _part(row: str) -> tuple[str, Array, str, Any]:
    """Return the shape of a part, the numbers of its place, its texture, and its colour or "colour"."""
    shape, *words = row.split()
    count = _NUMBERS[shape]
    texture, *colour = words[count:]
    if len(colour) == 3:
        tint: Any = tuple(map(float, colour))
    else:
        tint = "colour" if colour == ["colour"] else _NAMED[colour[0]] if colour else WHITE
    return shape, np.array(words[:count], dtype=np.float64), texture, tint


_OWN = ("colour", "wood")


def _kind(size: tuple[float, float, float], parts: str, palette: tuple[Colour, ...] = SEATS, **more: Any) -> Kind:
    return Kind(made_of(parts, palette), size, options=_OWN, **more)


#: The kinds that belong in homes, workshops and halls, with their usual sizes.
THINGS: dict[str, Kind] = {
    "nightstand": _kind((0.45, 0.4, 0.55), """
        box -1 -1 0 1 1 .97 wood; front -.9 .9 .1 .9 1.02 drawers; tube 0 -.2 .97 1.3 .12 .08 metal black;
        tube 0 -.2 1.2 1.6 .55 .35 fabric white"""),
    "dresser": _kind((1.1, 0.48, 0.95), """
        box -1 -1 .06 1 .96 1 wood; front -.98 0 .1 .95 .98 drawers; front 0 .98 .1 .95 .98 drawers;
        box -.6 -.6 1 -.2 -.5 1.4 mirror; tube .5 0 1 1.25 .1 .06 plastic colour; box -.95 -1 0 .95 .9 .06 wood"""),
    "stove": _kind((0.6, 0.6, 0.9), """
        box -1 -1 0 1 .95 .98 plastic white; box -1 -1 .98 1 1 1 plastic .02 .02 .02;
        front -.85 .85 .2 .72 1 plastic black; front -.9 .9 .84 .95 1 metal steel;
        box -.8 .95 .76 .8 1.06 .79 metal"""),
    "washing_machine": _kind((0.6, 0.6, 0.85), """
        box -1 -1 0 1 1 1 plastic white; front -.55 .55 .25 .72 1.01 metal steel;
        front -.42 .42 .31 .66 1.02 plastic black; front -.9 -.3 .85 .95 1.01 plastic steel"""),
    "toilet_bowl": _kind((0.42, 0.68, 0.85), """
        tube 0 .3 0 .48 .6 .95 plastic white; box -.9 -1 .45 .9 -.5 1 plastic white;
        box -.4 -1 0 .4 .3 .45 plastic white"""),
    "shower": _kind((0.9, 0.9, 2.0), """
        box -1 -1 0 1 1 .06 plastic white; box -1 .95 .06 -.9 1 1 metal; box .9 .95 .06 1 1 1 metal;
        box -1 .95 .97 1 1 1 metal; box .2 -1 .06 1 .95 .95 fabric colour; box -.1 -1 .06 0 -.9 1 metal"""),
    "laundry_rack": _kind((1.2, 0.55, 1.05), """
        box -1 -.05 0 -.97 .05 .9 metal; box .97 -.05 0 1 .05 .9 metal; box -1 -1 .9 1 -.95 .92 metal;
        box -1 .95 .9 1 1 .92 metal; box -.8 -.75 .3 -.2 -.7 .95 fabric colour;
        box -.1 -.1 .45 .4 -.05 .95 fabric white; box .1 .6 .35 .8 .65 .95 fabric .3 .12 .1;
        box -1 -1 .88 -.97 1 .92 metal; box .97 -1 .88 1 1 .92 metal; box -1 -.75 .9 1 -.7 .92 metal;
        box -1 -.1 .9 1 -.05 .92 metal; box -1 .6 .9 1 .65 .92 metal"""),
    "toy_chest": _kind((0.8, 0.45, 0.45), """
        box -1 -1 0 1 1 .8 wood colour; box -.6 -.5 .8 -.2 0 1.1 plain .6 .1 .08;
        box .1 -.3 .8 .4 .3 1 plain .1 .25 .6; tube .7 0 .8 1.1 .2 .05 plain .7 .55 .05"""),
    "cot": _kind((1.25, 0.7, 0.95), """
        box -1 -1 .3 1 1 .5 fabric white; box -1 -1 0 -.96 1 1 wood; box .96 -1 0 1 1 1 wood;
        box -1 .92 .85 1 1 .95 wood; box -.7 .92 .3 -.67 1 .9 wood; box -.2 .92 .3 -.17 1 .9 wood;
        box .3 .92 .3 .33 1 .9 wood; box .7 .92 .3 .73 1 .9 wood; box -.2 -.9 .5 .9 .9 .56 fabric colour"""),
    "bunk_bed": _kind((1.0, 2.0, 1.75), """
        box -1 -1 0 -.9 -.95 1 wood; box .9 -1 0 1 -.95 1 wood; box -1 .95 0 -.9 1 1 wood; box .9 .95 0 1 1 1 wood;
        box -1 -1 .14 1 1 .2 wood; box -.95 -.95 .2 .95 .95 .28 fabric colour; box -1 -1 .7 1 1 .76 wood;
        box -.95 -.95 .76 .95 .95 .84 fabric colour"""),
    "piano": _kind((1.45, 0.6, 1.2), """
        box -1 -1 0 1 0 1 wood .25 .2 .18; box -1 0 .5 1 1 .6 wood .25 .2 .18; box -.9 .1 .6 .9 .85 .62 plain white;
        box -.85 .1 .62 .85 .4 .64 plain black; box -1 .8 0 -.9 1 .5 wood .25 .2 .18;
        box .9 .8 0 1 1 .5 wood .25 .2 .18"""),
    "fireplace": _kind((1.4, 0.4, 1.15), """
        box -1 -1 0 -.6 .8 .93 brick; box .6 -1 0 1 .8 .93 brick; box -.6 -1 .6 .6 .8 .93 brick;
        front -.6 .6 0 .6 -.8 plain black; box -1.05 -1 .93 1.05 1 1 marble"""),
    "pouffe": _kind((0.5, 0.5, 0.42), "tube 0 0 0 1 .95 .9 fabric colour", moves=0.2),
    "shoe_rack": _kind((0.8, 0.32, 0.5), """
        box -1 -1 .0 -.96 1 1 wood; box .96 -1 0 1 1 1 wood; box -.96 -1 .1 .96 1 .15 wood;
        box -.96 -1 .5 .96 1 .55 wood; box -.96 -1 .95 .96 1 1 wood; box -.8 -.8 .15 -.4 .9 .35 plastic black;
        box 0 -.8 .15 .35 .9 .33 plastic .3 .15 .06; box -.5 -.8 .55 -.1 .9 .75 plastic colour"""),
    "kitchen_island": _kind((1.5, 0.8, 0.92), """
        box -.96 -.8 0 .96 .8 .95 wood; front -.95 .95 .1 .9 .82 kitchen_fronts; box -1 -1 .95 1 1 1 marble;
        tube .5 .2 1 1.12 .12 .2 plastic colour"""),
    "vase": _kind((0.3, 0.3, 0.75), """
        tube 0 0 0 .55 .5 .9 plastic colour; tube 0 0 .55 1 .2 .9 leaf"""),
    "workbench": _kind((1.8, 0.75, 0.9), """
        box -1 -1 .93 1 1 1 wood; box -1 -1 0 -.92 1 .93 metal colour; box .92 -1 0 1 1 .93 metal colour;
        box .3 -.9 .3 .9 .9 .93 metal colour; front .32 .88 .32 .9 .92 drawers;
        box -.7 .5 1 -.5 1.05 1.2 metal .1 .2 .4; box -.2 -.6 1 .3 0 1.12 metal .4 .05 .04;
        tube .6 -.4 1 1.25 .06 .06 plastic .7 .5 .05; box -.92 -1 .25 .25 .9 .28 metal""", _MACHINES),
    "lathe": _kind((2.0, 0.8, 1.35), """
        box -1 -.8 0 -.45 .8 .55 metal colour; box .5 -.8 0 1 .8 .55 metal colour;
        box -1 -1 .52 1 1 .62 metal colour; box -1 -.6 .62 -.45 .5 1 metal colour;
        box -.45 -.25 .72 -.3 .2 .9 metal; box -.3 -.08 .78 .5 .04 .84 metal;
        box .5 -.4 .62 .85 .3 .88 metal colour; box -.1 -.4 .62 .25 .9 .74 metal steel;
        front -.95 -.5 .75 .95 .52 notices#; box -1 -1 .62 1 -.95 1.05 metal .5 .5 .48""", _MACHINES),
    "drill_press": _kind((0.55, 0.75, 1.8), """
        box -.8 -.9 0 .8 .9 .06 metal colour; tube 0 -.6 .06 .95 .2 .2 metal; box -.8 -.6 .45 .8 .9 .5 metal colour;
        box -.6 -1 .72 .6 .7 1 metal colour; tube 0 .4 .55 .72 .15 .15 metal steel;
        box .6 .2 .78 1 .3 .8 metal black""", _MACHINES),
    "mill": _kind((1.3, 1.1, 2.1), """
        box -.7 -1 0 .7 1 .12 metal colour; box -.5 -1 .12 .5 -.1 1 metal colour;
        box -.45 -.4 .7 .45 .75 .95 metal colour; tube 0 .5 .55 .7 .15 .2 metal steel;
        box -1 -.1 .4 1 .8 .47 metal steel; box -.3 -.1 .12 .3 .6 .4 metal colour;
        box .75 -.2 .6 1 .2 .8 metal .6 .6 .55; front .77 .98 .63 .78 .22 screen# .3 .3 .3;
        box .45 -.05 .74 .75 .05 .78 metal""", _MACHINES),
    "press": _kind((1.4, 1.2, 2.5), """
        box -1 -.9 0 1 .9 .2 metal colour; box -1 -.7 .2 -.7 .7 .85 metal colour;
        box .7 -.7 .2 1 .7 .85 metal colour; box -1 -.9 .78 1 .9 1 metal colour;
        box -.55 -.5 .2 .55 .5 .3 metal steel; box -.5 -.5 .55 .5 .5 .78 metal steel;
        box -1.02 .66 .4 -.7 .72 .45 plain .7 .55 .02""", _MACHINES),
    "conveyor": _kind((2.8, 0.7, 0.85), """
        box -1 -.8 .85 1 .8 .93 plastic black; box -1 -1 .8 1 -.8 1 metal colour; box -1 .8 .8 1 1 1 metal colour;
        box -.9 -.9 0 -.85 .9 .8 metal; box .85 -.9 0 .9 .9 .8 metal; box -.05 -.9 0 0 .9 .8 metal;
        box -.6 -.5 .93 -.3 .5 1.3 plain .42 .29 .16; box .2 -.5 .93 .45 .4 1.2 plain .42 .29 .16""", _MACHINES),
    "pallet_load": _kind((1.2, 0.8, 1.1), """
        box -1 -1 0 1 1 .12 planks; box -.95 -.95 .12 0 0 .6 plain .42 .29 .16;
        box 0 -.95 .12 .95 0 .6 plain .38 .26 .15; box -.95 0 .12 .95 .95 .55 plain .45 .32 .18;
        box -.9 -.9 .6 .6 .5 1 plain colour"""),
    "drum": _kind((0.58, 0.58, 0.9), """
        tube 0 0 0 1 1 1 metal colour; tube 0 0 .32 .36 1.03 1.03 metal colour;
        tube 0 0 .64 .68 1.03 1.03 metal colour""", _MACHINES),
    "gas_bottles": _kind((0.7, 0.35, 1.5), """
        tube -.5 0 0 .85 .36 .36 metal colour; tube -.5 0 .85 1 .3 .1 metal .5 .5 .5;
        tube .45 0 0 .8 .36 .36 metal .3 .04 .04; tube .45 0 .8 .95 .3 .1 metal .5 .5 .5;
        box -1 -1 .5 1 -.3 .56 metal""", _MACHINES),
    "rack": _kind((2.5, 0.9, 2.9), """
        box -1 -1 0 -.96 -.9 1 metal .05 .12 .35; box -1 .9 0 -.96 1 1 metal .05 .12 .35;
        box .96 -1 0 1 -.9 1 metal .05 .12 .35; box .96 .9 0 1 1 1 metal .05 .12 .35;
        box -1 -1 .32 1 1 .35 metal .65 .22 .02; box -1 -1 .66 1 1 .69 metal .65 .22 .02;
        box -.9 -.8 0 -.1 .8 .25 plain .42 .29 .16; box 0 -.8 0 .8 .8 .2 planks;
        box -.85 -.8 .35 -.3 .8 .58 plain colour; box -.2 -.8 .35 .85 .7 .5 plain .38 .26 .15;
        box -.8 -.8 .69 .1 .8 .9 plain .45 .32 .18; tube .5 0 .69 .95 .2 .2 metal colour""", _MACHINES),
    "compressor": _kind((1.3, 0.55, 1.0), """
        box -.9 -.8 .15 .9 .8 .6 metal colour; box -.5 -.6 .6 .3 .6 1 metal black; tube .6 0 .6 .8 .15 .15 metal;
        box -.8 -1 0 -.7 1 .15 plastic black; box .7 -1 0 .8 1 .15 plastic black""", _MACHINES),
    "switch_cabinet": _kind((0.9, 0.4, 2.0), """
        box -1 -1 0 1 1 1 metal .6 .6 .57; front -.95 -.02 .05 .97 1.01 metal .66 .66 .63;
        front .02 .95 .05 .97 1.01 metal .66 .66 .63; front -.6 -.4 .7 .76 1.04 plain .7 .55 .02;
        front .3 .7 .62 .78 1.04 screen# .3 .3 .3"""),
    "forklift": _kind((1.1, 2.3, 2.1), """
        box -.9 -1 .1 .9 -.2 .55 metal colour; box -.9 -.2 .1 .9 .5 .3 metal colour;
        box -.85 .5 .05 -.7 .58 1 metal black; box .7 .5 .05 .85 .58 1 metal black;
        box -.5 .58 .03 -.3 1 .06 metal black; box .3 .58 .03 .5 1 .06 metal black;
        box -.85 -.7 .95 .85 .5 1 metal black; box -.85 -.7 .55 -.75 -.6 .95 metal black;
        box .75 -.7 .55 .85 -.6 .95 metal black; box -1 -.9 0 -.7 -.6 .25 plastic black;
        box .7 -.9 0 1 -.6 .25 plastic black; box -1 .1 0 -.7 .4 .25 plastic black;
        box .7 .1 0 1 .4 .25 plastic black; box -.85 .5 .03 .85 .58 .12 metal black""",
        ((0.65, 0.32, 0.02), (0.6, 0.06, 0.03), (0.55, 0.5, 0.05)), moves=0.4),
    "ladder": _kind((0.5, 0.25, 2.2), """
        box -1 -1 0 -.85 -.6 1 metal; box .85 -1 0 1 -.6 1 metal; box -.85 -1 .15 .85 -.7 .18 metal;
        box -.85 -1 .32 .85 -.7 .35 metal; box -.85 -1 .49 .85 -.7 .52 metal; box -.85 -1 .66 .85 -.7 .69 metal;
        box -.85 -1 .83 .85 -.7 .86 metal"""),
    "trolley": _kind((0.9, 0.55, 0.95), """
        box -1 -1 .15 1 1 .2 metal colour; box -1 -1 .75 1 1 .8 metal colour; box -1 -1 .0 -.94 -.9 1 metal;
        box .94 -1 0 1 -.9 .8 metal; box -1 .9 0 -.94 1 1 metal; box .94 .9 0 1 1 .8 metal;
        box -.6 -.6 .2 .3 .6 .55 plain .42 .29 .16; box .1 -.5 .8 .7 .3 .95 metal .4 .05 .04""",
        _MACHINES, moves=0.4, turns=40),
    "reception": _kind((2.6, 0.9, 1.1), """
        box -1 .3 0 1 .9 .93 wood; box -1 .2 .93 1 1 1 marble; box -1 -.9 .6 1 .3 .65 wood;
        box -1 -.9 0 -.95 .3 .65 wood; box .95 -.9 0 1 .3 .65 wood; box .2 -.4 .65 .5 -.3 1.05 plastic black;
        front -.3 .3 .4 .7 .92 sign0"""),
    "seat_row": _kind((2.2, 0.6, 0.85), """
        box -1 -.1 .3 1 .1 .45 metal; box -.9 -.8 0 -.85 .8 .3 metal; box .85 -.8 0 .9 .8 .3 metal;
        box -1 -.8 .45 -.36 1 .52 fabric colour; box -.32 -.8 .45 .32 1 .52 fabric colour;
        box .36 -.8 .45 1 1 .52 fabric colour; box -1 -1 .48 -.36 -.8 1 fabric colour;
        box -.32 -1 .48 .32 -.8 1 fabric colour; box .36 -1 .48 1 -.8 1 fabric colour"""),
    "banner": _kind((0.85, 0.4, 2.0), """
        box -1 -.6 0 1 .6 .04 metal; box -.95 -.1 .04 .95 0 1 plain white; front -.95 .95 .04 1 .04 poster#"""),
    "kiosk": _kind((0.65, 0.5, 1.6), """
        box -1 -1 0 1 1 .05 metal; box -.8 -.6 .05 .8 .6 1 metal colour; front -.7 .7 .55 .95 .64 screen# .3 .3 .3;
        front -.5 .5 .35 .45 .64 plastic black"""),
    "display_case": _kind((1.2, 0.6, 1.8), """
        box -1 -1 0 1 1 .45 wood; box -1 -1 .95 1 1 1 wood; box -1 -1 .45 -.96 -.92 .95 metal;
        box .96 -1 .45 1 -.92 .95 metal; box -1 .92 .45 -.96 1 .95 metal; box .96 .92 .45 1 1 .95 metal;
        tube -.4 0 .45 .7 .2 .05 metal .7 .5 .1; tube .3 .1 .45 .65 .1 .25 plastic colour"""),
    "planter": _kind((1.5, 0.5, 0.55), """
        box -1 -1 0 1 1 .9 wood; box -.95 -.9 .9 .95 .9 .95 plain .08 .05 .03; tube -.6 0 .9 2.2 .15 .3 leaf;
        tube 0 0 .9 1.9 .2 .35 leaf; tube .6 0 .9 2.4 .12 .28 leaf"""),
    "statue": _kind((0.7, 0.7, 2.1), """
        box -1 -1 0 1 1 .35 marble; tube 0 0 .35 .75 .6 .35 marble colour; tube 0 0 .75 .85 .5 .3 marble colour;
        tube 0 0 .85 1 .2 .25 marble colour""", ((0.7, 0.7, 0.68), (0.12, 0.1, 0.06), (0.3, 0.32, 0.3))),
    "stage": _kind((3.2, 2.0, 0.45), """
        box -1 -1 .9 1 1 1 planks; box -.98 -.98 0 .98 .96 .9 plain black; box -.75 -.6 1 -.6 -.4 3.5 plastic black;
        box .6 -.6 1 .75 -.4 3.5 plastic black"""),
    "table_tennis": _kind((2.74, 1.52, 0.76), """
        box -1 -1 .95 1 1 1 plain .03 .12 .2; box -.01 -1.1 1 .01 1.1 1.2 fabric black;
        box -.8 -.9 0 -.75 .9 .95 metal black; box .75 -.9 0 .8 .9 .95 metal black"""),
    "stacked_chairs": _kind((0.55, 0.55, 1.5), """
        box -.9 -.9 .3 .9 .9 .34 plastic colour; box -.9 -.9 .38 .9 .9 .42 plastic colour;
        box -.9 -.9 .46 .9 .9 .5 plastic colour; box -.9 -.9 .54 .9 .9 .58 plastic colour;
        box -.9 -1 .3 .9 -.9 1 plastic colour; box -.9 -.9 0 -.8 .9 .3 metal; box .8 -.9 0 .9 .9 .3 metal""",
        moves=0.3),
    "goal": _kind((3.0, 0.9, 2.0), """
        box -1 .8 0 -.94 1 1 plain .7 .1 .08; box .94 .8 0 1 1 1 plain .7 .1 .08;
        box -1 .8 .96 1 1 1 plain .7 .1 .08; box -.98 -1 0 -.96 .8 .05 metal; box .96 -1 0 .98 .8 .05 metal"""),
    "curtain": _kind((0.4, 0.14, 2.1), """
        box -1 -.2 0 -.6 1 1 fabric colour; box -.6 -.8 0 -.2 .4 1 fabric colour;
        box -.2 -.2 0 .2 1 1 fabric colour; box .2 -.8 0 .6 .4 1 fabric colour; box .6 -.2 0 1 1 1 fabric colour;
        box -1 -1 .97 1 0 1 metal""",
        z=0.08, blocks=False),
    "tool_board": _kind((1.5, 0.1, 0.9), """
        box -1 -1 0 1 -.6 1 wood; box -.9 -.6 .5 -.85 0 .95 metal; box -.95 -.6 .85 -.8 .2 .95 metal;
        box -.7 -.6 .4 -.66 0 .9 metal black; box -.5 -.6 .3 -.46 0 .9 metal .4 .05 .04;
        box -.3 -.6 .35 -.1 -.2 .8 metal steel; box .1 -.6 .4 .14 0 .95 metal;
        box .3 -.6 .5 .34 0 .95 metal .05 .1 .4; box .5 -.6 .3 .7 0 .5 plastic .6 .4 .02;
        box .8 -.6 .2 .84 0 .9 metal""", z=1.1, blocks=False),
    "pipes": _kind((3.0, 0.25, 0.5), """
        box -1 -.6 0 1 .2 .22 metal colour; box -1 -.4 .4 1 .4 .56 metal .45 .2 .08;
        box -1 -.8 .75 1 .8 1 metal steel; box -.8 -1 0 -.76 1 1 metal black; box .76 -1 0 .8 1 1 metal black""",
        _MACHINES, z=2.35, blocks=False),
    "downpipe": _kind((0.3, 0.2, 2.3), """
        tube -.4 0 0 1 .35 .35 metal colour; tube .5 0 0 1 .22 .22 metal .45 .2 .08;
        box -1 -1 .5 1 0 .52 metal black""", _MACHINES, z=0.02, blocks=False),
    "cables": _kind((2.6, 0.16, 0.16), """
        box -1 -1 0 1 1 .15 metal; box -1 -.8 .15 1 -.5 .5 plastic black;
        box -1 -.4 .15 1 -.1 .45 plastic .5 .1 .05; box -1 0 .15 1 .3 .5 plastic .1 .2 .5;
        box -1 .4 .15 1 .7 .6 plastic black""", z=2.2, blocks=False),
    "flag": _kind((0.9, 0.05, 2.2), """
        box -1 -1 0 1 .5 1 fabric colour; front -.7 .7 .55 .85 .6 poster#""", FRONTS + SEATS, z=2.0, blocks=False),
    "big_screen": _kind((3.0, 0.12, 1.7), """
        box -1 -1 0 1 .9 1 plastic black; front -.97 .97 .03 .97 1 screen# .3 .3 .3""", z=2.1, blocks=False),
}  # fmt: skip
