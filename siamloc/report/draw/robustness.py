"""Robustness curves: error and share of queries located well against how much their images were disturbed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from siamloc.errors import DataError
from siamloc.report.draw.look import DASHES, FLOOR, MARKS, Picture, column, method_look, style

_LABELS = {
    "noise": "variance of the noise",
    "occlusion": "columns behind bars [%]",
    "turn": "turned left by [degrees]",
    "effect": "strength",
}
_PANELS_IN_A_ROW = 4
_NOISE_TICKS = (0, 0.1, 0.4, 1)  # of the largest variance: they stand evenly on an axis of square roots


@style()
def robustness_curves(found: Mapping[str, Any]) -> Picture:
    """Draw two panels for each disturbance: mean and median error above, the share within the radius below.

    Args:
        found: `measures.robustness` of `results.json`.

    Raises:
        DataError: no disturbances or methods.
    """
    kinds, methods, unit = found["disturbances"], found["methods"], found["unit"]
    if not kinds or not methods:
        raise DataError("there is nothing to draw: the results hold no disturbance or no method")
    columns = min(len(kinds), _PANELS_IN_A_ROW)
    blocks = -(-len(kinds) // columns)
    figure = Picture(figsize=(2.5 * columns + 0.9, 4.0 * blocks + 0.9))
    panels = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=[1.25, 1] * blocks)
    entries = [entry for curves in methods.values() for one in curves.values() for entry in one]
    top = 1.06 * max(float(np.nanmax(column(entries, which))) for which in ("mean", "median"))
    for place in range(blocks * columns):
        block, at = divmod(place, columns)
        error, share = panels[2 * block, at], panels[2 * block + 1, at]
        if place >= len(kinds):
            error.remove()
            share.remove()
            continue
        _disturbance(error, share, kinds[place], methods)
        error.set_ylim(0, top if top > 0 else 1)
        if at:
            error.tick_params(labelleft=False)
            share.tick_params(labelleft=False)
        else:
            error.set_ylabel(f"error [{unit}]")
            share.set_ylabel(f"within {found['radius']:g} {unit} [%]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 5))
    return figure


def _disturbance(error: Axes, share: Axes, kind: Mapping[str, Any], methods: Mapping[str, Any]) -> None:
    levels, floor = np.empty(0), np.empty(0)
    for i, (method, curves) in enumerate(methods.items()):
        entries = sorted(curves[kind["name"]], key=lambda entry: entry["level"])
        levels = column(entries, "level") * (100 if kind["kind"] == "occlusion" else 1)
        look: dict[str, Any] = {**method_look(i), "linestyle": "-", "marker": MARKS[i % len(MARKS)], "markersize": 4}
        dashed = {**look, "linestyle": DASHES[1], "linewidth": 1.0, "marker": "", "alpha": 0.8}
        shown = method.replace("_", " ")
        error.plot(levels, column(entries, "mean"), label=f"{shown}, mean", **look)
        error.plot(levels, column(entries, "median"), label=f"{shown}, median", **dashed)
        share.plot(levels, 100 * column(entries, "share"), **look)
        floor = column(entries, "floor")
    error.plot(levels, floor, label="floor, mean", zorder=2, **FLOOR)
    name = kind["name"].replace("_", " ")
    error.set_title(name if kind["kind"] != "effect" else f"effect: {name}")
    error.tick_params(labelbottom=False)
    share.set(ylim=(0, 104), xlabel=_LABELS.get(kind["kind"], kind.get("unit", "level")))
    for axes in (error, share):
        axes.grid(True)
        if kind["kind"] == "turn" and max(kind["levels"]) >= 90:
            axes.xaxis.set_major_locator(MultipleLocator(45 if max(kind["levels"]) <= 270 else 90))
        if kind["kind"] == "noise":
            # Deviations, not variances, are what one sees; the published levels would crowd at the left otherwise.
            axes.set_xscale("function", functions=(_root, np.square))
            largest = max(kind["levels"]) or 1.0
            axes.set_xticks([round(largest * part, 6) for part in _NOISE_TICKS])
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlim(0, 1.08 * largest)


def _root(values: Any) -> Any:
    return np.sqrt(np.maximum(values, 0))
