"""The kinds of things a building file may place, with their usual sizes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """What is true of all things of one kind.

    Attributes:
        size: usual width, depth and height in metres.
        z: usual height of the foot above the floor in metres.
        blocks: a robot cannot drive where it stands.
        moves: it stands elsewhere in every run: how far in metres.
        turns: how far it turns from run to run, in degrees.
        options: further keys of the building file.
    """

    size: tuple[float, float, float]
    z: float = 0.0
    blocks: bool = True
    moves: float = 0.0
    turns: float = 0.0
    options: tuple[str, ...] = ()


def _hung(width: float, height: float, z: float, depth: float = 0.03, options: tuple[str, ...] = ()) -> Kind:
    return Kind((width, depth, height), z, blocks=False, options=options)


KINDS: dict[str, Kind] = {
    "desk": Kind((1.6, 0.8, 0.74), options=("screens", "wood", "drawers")),
    "chair": Kind((0.56, 0.56, 1.0), moves=0.25, turns=60, options=("colour",)),
    "visitor_chair": Kind((0.5, 0.5, 0.85), moves=0.15, turns=20, options=("colour",)),
    "table": Kind((1.4, 0.8, 0.74), options=("wood",)),
    "round_table": Kind((1.1, 1.1, 0.74), options=("wood",)),
    "sofa": Kind((1.7, 0.8, 0.8), options=("colour",)),
    "bench": Kind((1.2, 0.4, 0.45), options=("wood",)),
    "shelf": Kind((1.0, 0.35, 2.0), options=("wood", "content")),
    "cabinet": Kind((1.0, 0.45, 1.9), options=("colour",)),
    "sideboard": Kind((1.2, 0.45, 0.8), options=("colour", "wood")),
    "lockers": Kind((1.2, 0.5, 1.8), options=("colour",)),
    "coat_rack": Kind((0.5, 0.5, 1.75), moves=0.1),
    "bin": Kind((0.32, 0.32, 0.4), moves=0.2, turns=180, options=("colour",)),
    "carton": Kind((0.5, 0.4, 0.4), moves=0.3, turns=40),
    "plant": Kind((0.5, 0.5, 1.5), turns=180),
    "floor_lamp": Kind((0.4, 0.4, 1.7)),
    "copier": Kind((0.7, 0.7, 1.15)),
    "printer_table": Kind((0.8, 0.6, 0.7)),
    "pigeonholes": Kind((1.2, 0.35, 1.5)),
    "vending_machine": Kind((0.85, 0.8, 1.85)),
    "kitchen_counter": Kind((2.4, 0.62, 0.9), options=("wall_units",)),
    "fridge": Kind((0.62, 0.62, 1.75)),
    "stall": Kind((1.0, 1.4, 2.0), options=("colour",)),
    "basins": Kind((1.4, 0.5, 0.85), options=("count",)),
    "urinals": Kind((1.4, 0.35, 1.0)),
    "dryer": _hung(0.28, 0.3, 1.15, 0.18),
    "stairs_up": Kind((1.3, 2.8, 2.4)),
    "stairs_down": Kind((1.3, 2.8, 1.0)),
    "railing": Kind((2.0, 0.08, 1.0)),
    "column": Kind((0.4, 0.4, 2.8)),
    "person": Kind((0.5, 0.4, 1.75), options=("colour",)),
    "poster": _hung(0.6, 0.85, 1.1, options=("picture",)),
    "picture": _hung(0.9, 0.6, 1.35, options=("picture",)),
    "whiteboard": _hung(1.8, 1.1, 0.95, 0.05),
    "notice_board": _hung(1.2, 0.9, 1.1, 0.04),
    "clock": _hung(0.35, 0.35, 2.05),
    "exit_sign": _hung(0.4, 0.2, 2.3, 0.06),
    "room_sign": _hung(0.2, 0.2, 1.45, 0.02),
    "extinguisher": _hung(0.2, 0.55, 0.5, 0.18),
    "blind_door": _hung(0.96, 2.06, 0.0, 0.06, options=("colour", "wood")),
    "elevator": _hung(1.1, 2.1, 0.0, 0.08),
    "radiator": _hung(1.2, 0.55, 0.15, 0.1),
    "mirror": _hung(1.2, 0.8, 1.1),
    "coats": _hung(1.0, 0.9, 0.9, 0.2),
    "shelf_board": _hung(1.0, 0.35, 1.5, 0.28, options=("wood", "content")),
}
