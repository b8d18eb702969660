"""Robustness curves: error and share of well-located queries against the strength of the disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
_HEADINGS = ("heading", "heading_nearest")
_NOISE_TICKS = (0, 0.1, 0.4, 1)  # of the largest variance: evenly spaced on a square-root axis


@style()
def robustness_curves(found: Mapping[str, Any]) -> Picture:
    """Draw panels for each disturbance: mean and median error, the share within the radius, and heading errors.

    Headings are computed against the retrieved frame and, dashed, against the geometrically nearest one; they have a
    panel if any are known.

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
    entries = [entry for curves in methods.values() for one in curves.values() for entry in one]
    top = 1.06 * max(float(np.nanmax(column(entries, which))) for which in ("mean", "median"))
    turned = [value for key in _HEADINGS for value in _known(entries, key)]
    names = [
        f"error [{unit}]",
        f"within {found['radius']:g} {unit} [%]",
        *(["heading [deg]\ndashed: nearest"] if turned else []),
    ]
    high = len(names)
    figure = Picture(figsize=(2.5 * columns + 0.9, (4.0 if high == 2 else 5.6) * blocks + 0.9))
    panels = figure.subplots(high * blocks, columns, squeeze=False, height_ratios=([1.25] + [1] * (high - 1)) * blocks)
    for place in range(blocks * columns):
        block, at = divmod(place, columns)
        stack: list[Axes] = panels[high * block : high * (block + 1), at].tolist()
        if place >= len(kinds):
            for axes in stack:
                axes.remove()
            continue
        _disturbance(stack, kinds[place], methods)
        stack[0].set_ylim(0, top if top > 0 else 1)
        if turned:
            stack[2].set_ylim(0, 1.06 * max(turned) if max(turned) > 0 else 1)
        for axes, label in zip(stack, names, strict=True):
            if at:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel(label)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 5))
    return figure


def _known(entries: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    """Return the known values of a measure."""
    found: list[float] = [one[name] for one in entries if one.get(name) is not None and np.isfinite(one[name])]
    return found


def _disturbance(stack: Sequence[Axes], kind: Mapping[str, Any], methods: Mapping[str, Any]) -> None:
    error, share = stack[:2]
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
        if len(stack) > 2:
            for key, lines in zip(_HEADINGS, (look, dashed), strict=True):
                if _known(entries, key):
                    stack[2].plot(levels, column(entries, key), **lines)
        floor = column(entries, "floor")
    error.plot(levels, floor, label="floor, mean", zorder=2, **FLOOR)
    name = kind["name"].replace("_", " ")
    error.set_title(name if kind["kind"] != "effect" else f"effect: {name}")
    for axes in stack[:-1]:
        axes.tick_params(labelbottom=False)
    share.set_ylim(0, 104)
    stack[-1].set_xlabel(_LABELS.get(kind["kind"], kind.get("unit", "level")))
    for axes in stack:
        axes.grid(True)
        if kind["kind"] == "turn" and max(kind["levels"]) >= 90:
            axes.xaxis.set_major_locator(MultipleLocator(45 if max(kind["levels"]) <= 270 else 90))
        if kind["kind"] == "noise":
            # The eye sees deviations, not variances; the published levels would otherwise crowd on the left.
            axes.set_xscale("function", functions=(_root, np.square))
            largest = max(kind["levels"]) or 1.0
            axes.set_xticks([round(largest * part, 6) for part in _NOISE_TICKS])
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlim(0, 1.08 * largest)


def _root(values: Any) -> Any:
    return np.sqrt(np.maximum(values, 0))
