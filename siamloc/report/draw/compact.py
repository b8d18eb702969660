"""Compact maps: error, compactness and time against the number of nodes ([C] figures 6-8, 16-18, 20, 21)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from siamloc.errors import DataError
from siamloc.report.draw.look import DASHES, FLOOR, MARKS, SERIES, Picture, column, style

WAYS = {"spectral": "spectral clustering", "som": "self-organizing map", "sample": "plain sampling"}


@style()
def compact_curves(found: Mapping[str, Any]) -> Picture:
    """Draw three panels against the number of nodes: errors, silhouettes, and search time.

    Args:
        found: `measures.compact` of `results.json`.

    Raises:
        DataError: no compact map.
    """
    curves, unit = found["curves"], found["unit"]
    ways = list(dict.fromkeys(one["way"] for one in curves))
    if not curves:
        raise DataError("there is nothing to draw: the results hold no compact map")
    figure = Picture(figsize=(9.6, 3.9))
    errors, shape, took = figure.subplots(1, 3, width_ratios=[1.5, 1, 1])
    for i, way in enumerate(ways):
        entries = sorted((one for one in curves if one["way"] == way), key=lambda one: one["nodes"])
        nodes, colour = column(entries, "nodes"), SERIES[i]
        look: dict[str, Any] = {"color": colour, "marker": MARKS[i], "markersize": 4}
        fine: dict[str, Any] = {"color": colour, "linestyle": DASHES[1], "linewidth": 1.1}
        shown = WAYS[way]
        mean = column([one["error"] for one in entries], "mean")
        errors.plot(nodes, mean, label=f"{shown}: to the position of the node", **look)
        inside = column([one["error_frames"] for one in entries], "mean")
        errors.plot(nodes, inside, label=f"{shown}: to the best frame in it", **fine)
        shape.plot(nodes, column(entries, "silhouette"), **look)
        shape.plot(nodes, column(entries, "descriptor_silhouette"), **fine)
        took.plot(nodes, 1000 * column(entries, "search_ms"), **look)
        errors.plot(nodes, column(entries, "floor"), label="floor: nearest node" if not i else None, **FLOOR)
    top = max(float(np.nanmax(column([one[key] for one in curves], "mean"))) for key in ("error", "error_frames"))
    errors.set(title="mean error", ylabel=f"[{unit}]", ylim=(0, 1.06 * top if top > 0 else 1))
    shape.set(title="silhouette", ylabel="full: positions, dashed: descriptors")
    took.set(title="time of a search", ylabel="[µs a query]", ylim=(0, None))
    for axes in (errors, shape, took):
        axes.set_xlabel("nodes")
        axes.grid(True)
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
