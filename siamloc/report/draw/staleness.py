"""Draw where a building has changed since its map was made, and what an update of the map did about it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from siamloc.report.draw.look import INK, PAPER, SERIES, SOFT, Picture, panels, style

if TYPE_CHECKING:
    from siamloc.maps import Update, VisualMap

_CELLS = 24  # squares along the longer side of the plan, at most
_LEAST = 1.0  # side of a square, in the unit of the positions
_MOST = 2.0  # change that has the darkest colour
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
    """Draw on the plan where the building has changed: the mean staleness of the map frames in each square.

    Dots are map frames, and rings those that the last drives contradicted. After updates, the frames that joined the
    map and those that left it are marked as well.

    Args:
        found: a map that was updated, or the updates of a map by several drives, one after the other.
    """
    updates: list[Any] = [one for one in found if hasattr(one, "before")]
    known: Any = updates[-1].before if updates else found[-1]
    frames, stale = known.frames, staleness(known)
    side = max(_LEAST, float(np.ptp(frames.xy, axis=0).max()) / _CELLS)
    extent = np.ptp(frames.xy, axis=0)
    width = 6.4
    figure, (axes,) = panels(1, width, float(np.clip(width * (extent[1] + side) / (extent[0] + side), 2.0, 7.0)))
    passed = np.isfinite(stale)
    corners = np.floor(frames.xy[passed] / side)
    squares, cell = np.unique(corners, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    mean = np.bincount(cell, stale[passed], len(squares)) / np.maximum(np.bincount(cell, minlength=len(squares)), 1)
    shape = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    tiles = PolyCollection(
        list((squares[:, None] + shape) * side),
        array=mean,
        cmap=_COLOURS,
        norm=Normalize(0, _MOST),
        edgecolors=PAPER,
        linewidths=1.0,
        zorder=1,
    )
    axes.add_collection(tiles)
    against = known.history.contradicted > 0
    _dots(axes, frames.xy[~against], "map frame", color=SOFT, s=5, alpha=0.7)
    _dots(axes, frames.xy[against], "contradicted", facecolor=PAPER, edgecolor=INK, s=22, linewidths=1.0)
    title = f"{len(known):,} map frames"
    if updates:
        left = np.concatenate([one.before.frames.xy[one.forgotten] for one in updates])
        joined = np.concatenate([one.drive.xy[one.added] for one in updates])
        _dots(axes, left, "left the map", color=INK, s=30, marker="x", linewidths=1.3)
        _dots(axes, joined, "joined the map", color=SERIES[0], edgecolor=PAPER, s=26, linewidths=0.6)
        title = f"{len(updates[0].before):,} map frames: {len(joined)} joined, {len(left)} left"
    axes.set(title=title, xlabel=f"x [{frames.unit}]", ylabel=f"y [{frames.unit}]", aspect="equal")
    axes.autoscale_view()
    axes.grid(False)
    bar = figure.colorbar(tiles, ax=axes, shrink=0.8, pad=0.02, ticks=[0, 1, 2], extend="max")
    bar.ax.set_yticklabels(["0", "1, usual", "2"])
    bar.set_label("change since the map frames were taken")
    bar.outline.set_visible(False)  # type: ignore[operator]
    figure.legend(loc="outside lower center", ncols=4)
    return figure


def _dots(axes: Any, xy: NDArray[np.float64], label: str, **look: Any) -> None:
    if len(xy):
        axes.scatter(xy[:, 0], xy[:, 1], label=label, zorder=3, **({"linewidths": 0} | look))
