"""Placing every item of a building with the builder of its kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from zlib import crc32

import numpy as np

from siamloc.simulate import decoration, fittings, furniture
from siamloc.simulate.layout import Building, Item
from siamloc.simulate.mesh import MeshBuilder

BUILDERS: dict[str, Callable[[MeshBuilder, Item, np.random.Generator], None]] = {
    "desk": furniture.desk,
    "chair": furniture.chair,
    "visitor_chair": furniture.visitor_chair,
    "table": furniture.table,
    "round_table": furniture.round_table,
    "sofa": furniture.sofa,
    "bench": furniture.bench,
    "shelf": furniture.shelf,
    "shelf_board": furniture.shelf_board,
    "cabinet": furniture.cabinet,
    "sideboard": furniture.sideboard,
    "lockers": furniture.lockers,
    "coat_rack": fittings.coat_rack,
    "bin": fittings.waste_bin,
    "carton": fittings.carton,
    "plant": fittings.plant,
    "floor_lamp": fittings.floor_lamp,
    "copier": fittings.copier,
    "printer_table": fittings.printer_table,
    "pigeonholes": fittings.pigeonholes,
    "vending_machine": fittings.vending_machine,
    "kitchen_counter": fittings.kitchen_counter,
    "fridge": fittings.fridge,
    "stall": fittings.stall,
    "basins": fittings.basins,
    "urinals": fittings.urinals,
    "dryer": fittings.dryer,
    "stairs_up": fittings.stairs_up,
    "stairs_down": fittings.stairs_down,
    "railing": fittings.railing,
    "column": fittings.column,
    "person": fittings.person,
    "poster": decoration.poster,
    "picture": decoration.poster,
    "whiteboard": decoration.whiteboard,
    "notice_board": decoration.notice_board,
    "clock": decoration.clock,
    "exit_sign": decoration.exit_sign,
    "room_sign": decoration.room_sign,
    "extinguisher": decoration.extinguisher,
    "blind_door": decoration.blind_door,
    "elevator": decoration.elevator,
    "radiator": decoration.radiator,
    "mirror": decoration.mirror,
    "coats": decoration.coats,
}


def seeded(*keys: int | str) -> np.random.Generator:
    """Return a generator that depends on all the keys and on nothing else."""
    words = [crc32(key.encode()) if isinstance(key, str) else int(key) & 0xFFFFFFFF for key in keys]
    return np.random.default_rng(np.random.SeedSequence(words))


def add_items(builder: MeshBuilder, building: Building, items: Iterable[Item]) -> None:
    """Add the items; what is drawn about one depends on its place in the building and its own look, not on the run."""
    for number, item in enumerate(items):
        builder.room = building.room_index(item.room)
        with builder.at(item.x, item.y, item.z, item.facing - 90):
            look = int(item.options.get("look", 0))
            BUILDERS[item.kind](builder, item, seeded(building.seed, building.name, "item", number, look))
