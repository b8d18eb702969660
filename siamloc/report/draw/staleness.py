"""Draw where a building has changed since its map was made, and what an update of the map did about it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from siamloc.report.draw.look import INK, PAPER, SERIES, SOFT, Picture, legend_entries, panels, style

if TYPE_CHECKING:
    from siamloc.maps import Update, VisualMap

_CELLS = 24  # squares along the longer side of the plan, at most
_LEAST = 1.0  # side of a square, in the unit of the positions
_MOST = 2.0  # change that has the darkest colour
_AROUND = 1.6  # inches that title, labels and legend take of the height
_LEFT, _JOINED = "left the map", "joined the map"
_COLOURS = LinearSegmentedColormap.from_list("change", ["#eef2f5", "#f6d8a8", "#e08a1e", "#a33b00"])


def staleness(known: VisualMap) -> NDArray[np.float64]:
    """Return how unlike each map frame (n,) its place looked on the last drive that passed it; see `History.change`.

    1 is as unlike as neighbours in the map usually are. A frame that was contradicted counts as twice as unlike at
    least, and one that no drive passed is NaN.
    """
    history = known.history
    return np.where(history.contradicted > 0, np.fmax(history.change, _MOST), history.change)


@style()
def staleness_picture(*found: Update | VisualMap) -> Picture:
    """Draw on a plan of each building where it has changed: the mean staleness of the map frames in each square.

    Dots are map frames, and rings mark those that the last drives contradicted. After updates, dots and crosses show
    the frames that joined the map and those that left it, a frame that did both by a cross.

    Args:
        found: a map that was updated, or the updates of a map by several drives, one after the other.
    """
    updates: list[Any] = [one for one in found if hasattr(one, "before")]
    known: Any = updates[-1].before if updates else found[-1]
    frames, stale, changed = known.frames, staleness(known), _changed(updates)
    buildings, moved = frames.rows_by("building"), dict[str, list[Any]]()
    for (building, _), *xy in changed.values():
        buildings.setdefault(building, np.empty(0, dtype=np.int64))  # one that the map lacked
        moved.setdefault(building, []).append(xy)
    spans = [np.vstack([frames.xy[rows], *moved.get(building, [])]) for building, rows in buildings.items()]
    extent = np.max([np.ptp(span, axis=0) for span in spans], axis=0)
    side = max(_LEAST, float(extent.max()) / _CELLS)
    width = 6.4
    height = float(np.clip(width * (extent[1] + side) / (extent[0] + side) + _AROUND, 3.2, 7.0))
    figure, drawn = panels(len(buildings), width, height, across=2)
    stays = np.array([key not in changed for key in frames.identities()], dtype=bool)
    against = known.history.contradicted > 0
    for axes, (building, rows) in zip(drawn, buildings.items(), strict=True):
        passed = rows[np.isfinite(stale[rows])]
        tiles = _tiles(frames.xy[passed], stale[passed], side)
        axes.add_collection(tiles)
        marks = {label: [xy for key, *xy in changed.values() if key == (building, label)] for label in (_LEFT, _JOINED)}
        _dots(axes, frames.xy[rows[stays[rows]]], "map frame", color=SOFT, s=5, alpha=0.7)
        _dots(axes, marks[_LEFT], _LEFT, color=INK, s=30, marker="x", linewidths=1.3)
        _dots(axes, marks[_JOINED], _JOINED, color=SERIES[0], edgecolor=PAPER, s=26, linewidths=0.6)
        _dots(axes, frames.xy[rows[against[rows]]], "contradicted", facecolor="none", edgecolor=INK, s=60, linewidths=1)
        title = f"{len(rows):,} map frames"
        if updates:
            before, after = ((one.frames.building == building).sum() for one in (updates[0].before, updates[-1].known))
            title = f"{before:,} map frames became {after:,}"
        axes.set(
            title=f"{building}: " * bool(building) + title, xlabel=f"x [{frames.unit}]", ylabel=f"y [{frames.unit}]"
        )
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.grid(False)
    bar = figure.colorbar(tiles, ax=drawn, shrink=0.8, pad=0.02, ticks=[0, 1, 2], extend="max")
    bar.ax.set_yticklabels(["0", "1, usual", "2"])
    bar.set_label("change since the\nmap frames were taken")
    bar.outline.set_visible(False)  # type: ignore[operator]
    once = dict(zip(*reversed(legend_entries(*drawn)), strict=True))
    figure.legend(list(once.values()), list(once), loc="outside lower center", ncols=4)
    return figure


def _changed(updates: list[Any]) -> dict[tuple[str, str], tuple[tuple[str, str], float, float]]:
    """Return what the last update that moved a frame did, by the frame's identity: building and label, x and y."""
    changed = {}
    for one in updates:
        gone, new = one.before.frames.take(one.forgotten), one.drive.take(one.added)
        for table, label in ((gone, _LEFT), (new, _JOINED)):
            for key, building, x, y in zip(table.identities(), table.building.tolist(), table.x, table.y, strict=True):
                changed[key] = (building, label), x, y
    return changed


def _tiles(xy: NDArray[np.float64], stale: NDArray[np.float64], side: float) -> PolyCollection:
    """Return the squares that hold frames (n, 2), with the mean of their staleness (n,)."""
    squares, cell = np.unique(np.floor(xy / side), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    mean = np.bincount(cell, stale, len(squares)) / np.maximum(np.bincount(cell, minlength=len(squares)), 1)
    shape = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return PolyCollection(
        list((squares[:, None] + shape) * side),
        array=mean,
        cmap=_COLOURS,
        norm=Normalize(0, _MOST),
        edgecolors=PAPER,
        linewidths=1.0,
        zorder=1,
    )


def _dots(axes: Any, xy: Any, label: str, **look: Any) -> None:
    """Draw positions (n, 2), if there are any, above those that were drawn before."""
    if len(xy):
        axes.scatter(*np.transpose(xy), label=label, zorder=2 + len(axes.collections), **({"linewidths": 0} | look))
