"""True and estimated positions of queries, on the floor plan or along a line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from siamloc.data.occupancy import OccupancyMap
from siamloc.report.draw.look import PALE, PAPER, SOFT, TEXT, Picture, legend_entries, lighting_colours, panels, style
from siamloc.results import rows_by_label, truth
from siamloc.tables import short_names

Table = Mapping[str, NDArray]

_FLATTEST = 0.02  # below this ratio of the extents, frames are drawn along a line
_MOST_ROOM_NAMES = 16
_LARGE = "#e31a1c"  # colour of an error in the legend


@style()
def floor_plan(columns: Table, map_columns: Table, unit: str = "m", occupancy: OccupancyMap | None = None) -> Picture:
    """Draw each query at its true position, coloured by its error, with a line to the estimated position.

    Frames that lie on a line (a corridor without metric poses) are drawn along that line instead.

    Args:
        columns: columns of `queries.csv`: x, y, est_x, est_y, error, floor, lighting.
        map_columns: columns of `map.csv`: x, y, room.
        unit: unit of x and y.
        occupancy: the map of the building to draw behind the plan.
    """
    groups = rows_by_label(columns["lighting"]) or {"": np.arange(len(columns["error"]))}
    axis = along(columns, map_columns)
    if axis is None:
        return _on_plan(columns, map_columns, groups, unit, occupancy)
    return _along_line(columns, map_columns, groups, unit, axis)


def along(*tables: Table) -> str | None:
    """Return the axis, "x" or "y", along which positions lie on a line at the resolution of a plot; None otherwise."""
    extent = {axis: float(np.ptp(np.concatenate([table[axis] for table in tables]))) for axis in ("x", "y")}
    longer = "x" if extent["x"] >= extent["y"] else "y"
    return longer if min(extent.values()) <= _FLATTEST * extent[longer] else None


def surroundings(xy: NDArray[np.float64], occupancy: OccupancyMap | None) -> NDArray[np.float64]:
    """Return the lowest and the highest x and y (2, 2) that a plan of positions (n, 2) shows."""
    return np.array([xy.min(axis=0), xy.max(axis=0)]) if occupancy is None else occupancy.around(xy)


def add_occupancy(axes: Axes, occupancy: OccupancyMap | None) -> None:
    """Draw the map of a building, if there is one, behind everything else; the limits of the axes stay."""
    if occupancy is None:
        return
    x, y, heading = occupancy.origin
    width, height = occupancy.size
    image = AxesImage(axes, extent=(0, width, 0, height), zorder=0)
    image.set_data(occupancy.picture())
    image.set_transform(Affine2D().rotate(heading).translate(x, y) + axes.transData)
    axes.add_artist(image)


def _on_plan(
    columns: Table,
    map_columns: Table,
    groups: Mapping[str, NDArray],
    unit: str,
    occupancy: OccupancyMap | None,
) -> Picture:
    """Draw one plan per lighting with a common colour scale, which ends at the 95th percentile of the errors."""
    every = np.column_stack([np.concatenate([columns[axis], map_columns[axis]]) for axis in "xy"])
    shown = surroundings(every, occupancy)
    width, height = np.maximum(np.ptp(shown, axis=0), 1e-9).tolist()
    # Panels are side by side if the building is tall, stacked if it is wide.
    across = len(groups) if width <= 1.6 * height else 1
    panel = min(11.0 / across, 7.0)
    size = panel, max(min(panel * height / width, 6.5), 1.6)
    shared: dict[str, Any] = {"sharex": True, "sharey": True, "margin": (0.9, 0.9), "ylabel": f"y [{unit}]"}
    figure, plans = panels(len(groups), *size, across=across, **shared)
    # Large errors are dark and stand out; the palest end of the colours would vanish on white.
    colours = ListedColormap(colormaps["YlOrRd"](np.linspace(0.3, 1, 256)))
    top = float(np.percentile(columns["error"], 95)) or 1.0
    shade = ScalarMappable(Normalize(0, top), colours)
    for axes, (label, members) in zip(plans, groups.items(), strict=True):
        add_occupancy(axes, occupancy)
        members = members[np.argsort(columns["error"][members], kind="stable")]
        part = {name: columns[name][members] for name in ("x", "y", "est_x", "est_y", "error")}
        true, estimated = np.column_stack([part["x"], part["y"]]), np.column_stack([part["est_x"], part["est_y"]])
        axes.scatter(map_columns["x"], map_columns["y"], s=5, color=PALE, linewidths=0, zorder=1)
        rgba = shade.to_rgba(part["error"])
        segments = np.stack([true, estimated], axis=1)
        axes.add_collection(LineCollection(list(segments), colors=rgba, linewidths=0.7, alpha=0.5, zorder=2))
        axes.scatter(true[:, 0], true[:, 1], s=9, c=rgba, linewidths=0, zorder=3)
        _name_rooms(axes, map_columns)
        axes.grid(False)
        axes.set_aspect("equal")
        axes.update_datalim(shown)
        axes.margins(0.06)
        mean = f"{len(members):,} queries, mean error {part['error'].mean():.2f} {unit}"
        axes.set_title(f"{label}: " * bool(label) + mean)
    for axes in plans[-across:]:
        axes.set_xlabel(f"x [{unit}]")
    extend = "max" if columns["error"].max() > top else "neither"
    bar = figure.colorbar(shade, ax=plans, extend=extend, shrink=0.85, pad=0.015, aspect=30)
    bar.set_label(f"error [{unit}]")
    bar.outline.set_visible(False)  # type: ignore[operator]
    figure.legend(handles=_legend(truth(columns)), loc="outside lower center", ncols=3)
    return figure


def _along_line(columns: Table, map_columns: Table, groups: Mapping[str, NDArray], unit: str, axis: str) -> Picture:
    """Draw the estimated against the true position along an axis, and the error below."""
    figure, (upper, lower) = panels(2, 6.6, 2.5, across=1, sharex=True, height_ratios=[2.2, 1])
    known = map_columns[axis]
    ends = [min(known.min(), columns[axis].min()), max(known.max(), columns[axis].max())]
    upper.plot(ends, ends, color=PALE, linewidth=0.9, label="right answer", zorder=1)
    for (label, rows), colour in zip(groups.items(), lighting_colours(groups), strict=True):
        rows = rows[np.argsort(columns[axis][rows], kind="stable")]
        place, error = columns[axis][rows], columns["error"][rows]
        text = f"{label}: " * bool(label) + f"{len(rows):,} queries, mean error {error.mean():.2f} {unit}"
        upper.scatter(place, columns[f"est_{axis}"][rows], s=12, color=colour, linewidths=0, label=text, zorder=3)
        lower.vlines(place, 0, error, color=colour, linewidth=1, alpha=0.6)
        lower.scatter(place, error, s=8, color=colour, linewidths=0, zorder=3)
    order = np.argsort(columns[axis], kind="stable")
    lower.plot(columns[axis][order], columns["floor"][order], "--", color=SOFT, linewidth=0.9, label="floor", zorder=4)
    upper.set_ylabel(f"estimated {axis} [{unit}]")
    lower.set(xlabel=f"{truth(columns)} {axis} [{unit}]", ylabel=f"error [{unit}]")
    lower.set_ylim(bottom=0)
    figure.legend(*legend_entries(upper, lower), loc="outside upper center", ncols=3 if len(groups) == 1 else 2)
    return figure


def _name_rooms(axes: Axes, map_columns: Table) -> None:
    rooms = {label: rows for label, rows in rows_by_label(map_columns["room"]).items() if map_columns["room"][rows[0]]}
    if len(rooms) > _MOST_ROOM_NAMES:
        return
    for label, rows in zip(short_names(rooms), rooms.values(), strict=True):
        x, y = map_columns["x"][rows].mean(), map_columns["y"][rows].mean()
        halo = [withStroke(linewidth=2, foreground=PAPER)]
        axes.text(x, y, label, fontsize=6.5, color=TEXT, ha="center", va="center", path_effects=halo, zorder=5)


def _legend(truth: str) -> Sequence[Line2D]:
    point: dict[str, Any] = {"marker": "o", "linestyle": "none", "markeredgewidth": 0, "markersize": 4}
    return [
        Line2D([], [], color=PALE, label="map frame", **point),
        Line2D([], [], color=_LARGE, label=f"query, {truth} position", **point),
        Line2D([], [], color=_LARGE, linewidth=0.8, label="to the estimated position"),
    ]
