"""Robustness curves: error and share of queries located well against how much their images were disturbed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from siamloc.errors import DataError
from siamloc.report.plots import save, style
from siamloc.results import read_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito 2008
_MARKERS = ("o", "s", "^", "D", "v", "P")
_LABELS = {
    "noise": "variance of the noise",
    "occlusion": "columns behind bars [%]",
    "turn": "turned left by [degrees]",
    "effect": "strength",
}
_PANELS_IN_A_ROW = 4


def draw_all(folder: str | Path, out: str | Path | None = None) -> list[Path]:
    """Draw `robustness.png` from a result folder and return the files.

    Raises:
        FormatError: result files that are missing or not whole.
        DataError: results of another task.
        StorageError: the disk refuses.
    """
    found = read_results(folder)["measures"].get("robustness")
    if found is None:
        raise DataError(f"{folder} holds no robustness curves: measure them with `siamloc evaluate task=robustness`")
    return [save(robustness_curves(found), Path(folder if out is None else out) / "robustness.png")]


def robustness_curves(found: Mapping[str, Any]) -> Figure:
    """Draw two panels for each disturbance: mean and median error above, the share within the radius below.

    Args:
        found: `measures.robustness` of `results.json`.

    Raises:
        DataError: no disturbances or methods.
    """
    from matplotlib.figure import Figure

    kinds, methods, unit = found["disturbances"], found["methods"], found["unit"]
    if not kinds or not methods:
        raise DataError("there is nothing to draw: the results hold no disturbance or no method")
    columns = min(len(kinds), _PANELS_IN_A_ROW)
    blocks = -(-len(kinds) // columns)
    with style():
        figure = Figure(figsize=(2.5 * columns + 1.6, 4.3 * blocks + 0.7))
        panels = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=[1.25, 1] * blocks)
        top = 1.08 * max(entry["mean"] for curves in methods.values() for one in curves.values() for entry in one)
        for place in range(blocks * columns):
            block, column = divmod(place, columns)
            error, share = panels[2 * block, column], panels[2 * block + 1, column]
            if place >= len(kinds):
                error.set_axis_off()
                share.set_axis_off()
                continue
            _draw_one(error, share, kinds[place], methods)
            error.set_ylim(0, top if top > 0 else 1)
            if column:
                error.tick_params(labelleft=False)
                share.tick_params(labelleft=False)
            else:
                error.set_ylabel(f"error [{unit}]")
                share.set_ylabel(f"within {found['radius']:g} {unit} [%]")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        title = f"{found['queries']} queries, {found['map_frames']} map frames"
        figure.legend(handles, labels, loc="outside lower center", ncols=len(methods) + 1, title=title)
        return figure


def _draw_one(error: Any, share: Any, kind: Mapping[str, Any], methods: Mapping[str, Any]) -> None:
    floor = None
    for i, (method, curves) in enumerate(methods.items()):
        entries = sorted(curves[kind["name"]], key=lambda entry: entry["level"])
        levels = [entry["level"] * (100 if kind["kind"] == "occlusion" else 1) for entry in entries]
        main = {"linewidth": 1.9, "zorder": 4} if i == 0 else {"linewidth": 1.3, "zorder": 3}
        look = {**main, "color": _COLOURS[i % len(_COLOURS)], "marker": _MARKERS[i % len(_MARKERS)], "markersize": 4}
        shown = method.replace("_", " ")
        error.plot(levels, [entry["mean"] for entry in entries], label=f"{shown}, mean", **look)
        dashed = {**look, "linestyle": "--", "linewidth": 1.0, "marker": ""}
        error.plot(levels, [entry["median"] for entry in entries], label=f"{shown}, median", **dashed)
        share.plot(levels, [100 * entry["share"] for entry in entries], **look)
        floor = levels, [entry["floor"] for entry in entries]
    if floor is not None:
        error.plot(*floor, color="black", linewidth=1, linestyle=":", label="floor, mean", zorder=2)
    error.set_title(kind["name"].replace("_", " "))
    error.tick_params(labelbottom=False)
    share.set(ylim=(0, 104), xlabel=_LABELS.get(kind["kind"], kind["unit"]))
    for axes in (error, share):
        axes.grid(color="0.92", linewidth=0.6)
        if kind["kind"] == "noise":
            # Deviations, not variances, are what one sees; the published levels would crowd at the left otherwise.
            axes.set_xscale("function", functions=(_root, np.square))
            largest = max(kind["levels"]) or 1.0
            axes.set_xticks([round(largest * part, 6) for part in (0, 0.1, 0.4, 1)])
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlim(0, 1.08 * largest)


def _root(values: Any) -> Any:
    return np.sqrt(np.maximum(values, 0))
