"""The items in a building: all kinds by name, and how they become quads."""

from __future__ import annotations

from collections.abc import Iterable

from siamloc.simulate.fittings import FITTINGS
from siamloc.simulate.furniture import FURNITURE
from siamloc.simulate.layout import Building, Item, seeded
from siamloc.simulate.mesh import MeshBuilder

#: Every kind that a building file may place.
KINDS = FURNITURE | FITTINGS


def add_items(builder: MeshBuilder, building: Building, items: Iterable[Item]) -> None:
    """Add items to a mesh; an item's details depend on its position in the list and its look, not on the run."""
    for number, item in enumerate(items):
        builder.room = building.room_index(item.room)
        with builder.at(item.x, item.y, item.z, item.facing - 90):
            look = int(item.options.get("look", 0))
            KINDS[item.kind].build(builder, item, seeded(building.seed, building.name, "item", number, look))
