"""Several buildings in one evaluation: their positions have no common origin, so they are moved apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.maps.visual_map import VisualMap

_GAP = 10.0  # least distance between two buildings, in the unit of the positions, beside the size of a building


def side_by_side(known: VisualMap, *tables: FrameTable) -> tuple[VisualMap, list[FrameTable], str]:
    """Move the buildings of a map and its queries along x, until frames of two are farther apart than any two of one.

    The building of the map's first frame stays; all stay if fewer than two are named.

    Args:
        known: the map. Its digest stays, so that nodes over it and what was learned on it still fit.
        *tables: frames to compare with the map's.

    Returns:
        The map, the tables, and a sentence about what was moved; empty if nothing was.
    """
    xy, building = (
        np.concatenate([getattr(table, name) for table in (known.frames, *tables)]) for name in ("xy", "building")
    )
    placed = np.isfinite(xy).all(axis=1)
    spans = {name: xy[placed & (building == name)] for name in dict.fromkeys(building[placed].tolist())}
    if len(spans.keys() - {""}) < 2:
        return known, list(tables), ""
    gap = _GAP + max(float(np.linalg.norm(np.ptp(span, axis=0))) for span in spans.values())
    offsets, end = dict[str, float](), -np.inf
    for name, span in spans.items():
        offsets[name] = float(np.ceil(end + gap - span[:, 0].min())) if offsets else 0.0
        end = span[:, 0].max() + offsets[name]

    def moved(table: FrameTable) -> FrameTable:
        return table.with_columns(x=table.x + [offsets.get(name, 0.0) for name in table.building.tolist()])

    there = replace(known, frames=moved(known.frames))
    vars(there)["digest"] = known.digest
    listed = ", ".join(f"{name or '(unnamed)'} by {offset:g}" for name, offset in offsets.items() if offset)
    said = (
        f"the positions of different buildings have no common origin, so x is moved in {listed} {known.unit}: a match "
        f"in another building has an error of at least {gap:.0f} {known.unit}, which counts in means"
    )
    return there, [moved(table) for table in tables], said
