"""Plot compact maps against their parameters: y and omega of the incremental mapper, and the number of clusters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from siamloc.report.draw.look import SERIES, SOFT, Picture, style

Rows = Sequence[Mapping[str, Any]]

_MEASURES = {
    "nodes": ("number of nodes", "{:.0f}", "cividis"),
    "unassigned": ("frames in no node [%]", "{:.0f}", "Greys"),
    "silhouette": ("silhouette, frames in no node\ncounted as one more node", "{:.2f}", "viridis"),
}
_LINES = {
    "spectral": (SERIES[0], "-"),
    "som": (SERIES[2], "--"),
    "sample": (SOFT, ":"),
}
_MARKS = {1: "s", 2: "D"}


@style()
def heat_maps(table: Rows, measures: Sequence[str] = ("nodes", "silhouette", "unassigned")) -> Picture:
    """Draw measures of incremental maps against y and omega, one row of panels for each version ([I] figure 9).

    Args:
        table: rows with version, y, omega and the measures; `unassigned` in percent. A measure may be missing (None).
        measures: some of "nodes", "unassigned", "silhouette"; the highest silhouettes are framed.
    """
    versions, ys, omegas = (sorted({row[key] for row in table}) for key in ("version", "y", "omega"))
    figure = Picture(figsize=(0.62 * len(omegas) * len(measures) + 3.2, 0.42 * len(ys) * len(versions) + 1.6))
    panels = figure.subplots(len(versions), len(measures), squeeze=False, sharex=True, sharey=True)
    for column, measure in enumerate(measures):
        title, pattern, colours = _MEASURES[measure]
        grids = [_grid(table, version, ys, omegas, measure) for version in versions]
        known = np.concatenate([grid[np.isfinite(grid)] for grid in grids])
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        if measure == "unassigned":
            low, high = 0.0, 100.0
        for row, grid in enumerate(grids):
            axes = panels[row, column]
            image = axes.imshow(grid, origin="lower", aspect="auto", cmap=colours, vmin=low, vmax=max(high, low + 1e-9))
            for i, j in zip(*np.nonzero(np.isfinite(grid)), strict=True):
                shade = colormaps[colours]((grid[i, j] - low) / max(high - low, 1e-9))
                dark = np.dot(shade[:3], (0.299, 0.587, 0.114)) < 0.55
                look = {"ha": "center", "va": "center", "fontsize": 7.5, "color": "white" if dark else "black"}
                axes.text(j, i, pattern.format(grid[i, j]), **look)
            if measure == "silhouette" and np.isfinite(grid).any():
                for i, j in np.argwhere(grid == np.nanmax(grid)):
                    _frame(axes, i, j)
            axes.set_xticks(range(len(omegas)), [f"{omega:g}" for omega in omegas])
            axes.set_yticks(range(len(ys)), [f"{y:g}" for y in ys])
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
            if not column:
                axes.set_ylabel(f"version {versions[row]}\ny")
        panels[0, column].set_title(title)
        panels[-1, column].set_xlabel("omega")
        bar = figure.colorbar(image, ax=list(panels[:, column]), shrink=0.7, pad=0.02, aspect=25)
        bar.outline.set_visible(False)
    return figure


@style()
def silhouette_against_clusters(table: Rows, maps: Rows = ()) -> Picture:
    """Draw the silhouette of points against the number of clusters ([I] figures 11, 12), in three forms.

    Args:
        table: rows with method ("spectral", "som", "sample"), nodes, and the three silhouettes: silhouette, nearest,
            pooled.
        maps: incremental maps as single points: rows with version, nodes, the silhouettes, unassigned (percent).
    """
    figure = Picture(figsize=(11.4, 3.9))
    panels = figure.subplots(1, 3, sharex=True)
    panels[1].sharey(panels[0])
    names = (
        ("silhouette", "to the nearest other node,\nframes in no node as one more node"),
        ("nearest", "to the nearest other node,\nwithout the frames in no node"),
        ("pooled", "to all other nodes pooled,\nwithout the frames in no node"),
    )
    for axes, (measure, title) in zip(panels, names, strict=True):
        for method in dict.fromkeys(row["method"] for row in table):
            rows = sorted((row for row in table if row["method"] == method), key=lambda row: row["nodes"])
            colour, line = _LINES.get(method, (SERIES[3], "-."))
            nodes, values = [row["nodes"] for row in rows], [_value(row[measure]) for row in rows]
            axes.plot(nodes, values, color=colour, linestyle=line, marker=".", linewidth=1.6, label=method)
        for row in maps:
            label = f"incremental, version {row['version']} ({row['unassigned']:.0f} % of frames left out)"
            mark = _MARKS.get(row["version"], "o")
            look = {"marker": mark, "markersize": 9, "color": SERIES[5], "markeredgecolor": "black"}
            if row["version"] == 1:
                look["color"] = "white"
            axes.plot(row["nodes"], _value(row[measure]), linestyle="none", label=label, zorder=5, **look)
        axes.set_title(title)
        axes.set_xlabel("number of nodes")
        axes.grid(True)
    panels[0].set_ylabel("average silhouette of points")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _grid(table: Rows, version: Any, ys: Sequence[float], omegas: Sequence[float], measure: str) -> NDArray[np.float64]:
    grid = np.full((len(ys), len(omegas)), np.nan)
    for row in table:
        if row["version"] == version:
            grid[ys.index(row["y"]), omegas.index(row["omega"])] = _value(row[measure])
    return grid


def _frame(axes: Axes, row: int, column: int) -> None:
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, edgecolor=SERIES[5], linewidth=2.2))


def _value(value: float | None) -> float:
    return float("nan") if value is None else float(value)
