"""A contact sheet and a floor plan, which preview what a simulation will look like."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import atomic_path
from foundation.settings import Thousand
from siamloc.data.names import LIGHTINGS
from siamloc.simulate.buildings import load_building
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import Array, Building, Item
from siamloc.simulate.months import aged
from siamloc.simulate.plan import clearance, obstacles
from siamloc.simulate.rendering import render
from siamloc.simulate.run import Run, draw_run
from siamloc.simulate.scene import build_scene
from siamloc.simulate.shell import leaf_segment
from siamloc.simulate.trajectory import GRIDS, Track

_STAYS, _NEW, _GONE = ("#d8cbb3", "#8d7f66"), ("#f08a4b", "#b4501c"), "#b0352a"  # faces and edges of furniture
_COLOURS = {"cloudy": "#5b8fd6", "night": "#3b3b6d", "sunny": "#e8a013"}


def write_preview(building: Building, runs: list[Run], folder: Path) -> tuple[Path, ...]:
    """Write `contact_sheet.png` and `floor_plan.png` of some runs and return their paths."""
    first = {(run.lighting, run.hour, run.month): run for run in reversed(runs)}
    drives = sorted(first.values(), key=lambda run: (LIGHTINGS.index(run.lighting), runs.index(run)))
    figures = {"contact_sheet.png": contact_sheet(building, drives), "floor_plan.png": floor_plan(building, runs)}
    for name, figure in figures.items():
        with atomic_path(folder / name) as temporary:
            figure.savefig(temporary, format="png")
    return tuple(folder / name for name in figures)


def viewpoints(building: Building, track: Track) -> Array:
    """Return the row of one frame of the track for each room code: well inside the room, away from walls."""
    segments, _ = obstacles(building)
    rows = []
    for code in building.codes:
        inside = np.flatnonzero(np.array(track.codes) == code)
        if len(inside):
            points = track.poses[inside, :2]
            centre = points.mean(axis=0)
            score = np.minimum(clearance(points, segments), 0.8) - 0.15 * np.linalg.norm(points - centre, axis=1)
            rows.append(inside[int(np.argmax(score))])
    return np.array(rows)


@typed
def panoramas(count: Thousand = 6, building: str = "freiburg_like") -> NDArray[np.uint8]:
    """Render a few panoramas of a building's rooms, for demonstrations: (B, 3, 128, 512), uint8, RGB."""
    loaded, run = load_building(building, 0), Run()
    track = draw_run(loaded, run).track
    poses = track.poses[viewpoints(loaded, track)[:count]]
    return np.ascontiguousarray(render(build_scene(loaded, run), poses).transpose(0, 3, 1, 2))


def contact_sheet(building: Building, runs: list[Run]) -> Any:
    """Return a matplotlib figure with one panorama for each room (rows) and lighting (columns)."""
    from matplotlib.figure import Figure

    first = draw_run(building, runs[0]).track
    rows = viewpoints(building, first)
    width = 5.6 if len(runs) < 4 else 3.6
    figure = Figure(figsize=(width * len(runs), 0.29 * width * len(rows) + 0.3), dpi=110, layout="constrained")
    axes = np.atleast_2d(figure.subplots(len(rows), len(runs), squeeze=False))
    for column, run in enumerate(runs):
        scene = build_scene(building, run)
        pictures = render(scene, first.poses[rows], "panorama")
        for axis, row, picture in zip(axes[:, column], rows, pictures, strict=True):
            axis.imshow(picture, interpolation="lanczos")
            axis.set(xticks=[], yticks=[])
            if column == 0:
                axis.set_ylabel(first.codes[row], fontsize=10)
        hour, minutes = divmod(round(scene.state.light.hour * 60) % 1440, 60)
        month = f", month {run.month}" if run.month else ""
        axes[0, column].set_title(f"{run.lighting} ({hour:02d}:{minutes:02d}){month}", fontsize=11)
    return figure


def floor_plan(building: Building, runs: list[Run]) -> Any:
    """Return a matplotlib figure of the plan: walls, doors, windows, furniture, room codes and the runs' paths.

    It shows the furniture of the last month; furniture that has changed since the first is highlighted, or dotted
    where it has gone.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon, Rectangle

    month = max(run.month for run in runs)
    first, (building, _) = building, aged(building, month)
    (x0, x1), (y0, y1) = building.bounds
    figure = Figure(figsize=(0.62 * (x1 - x0) + 1, 0.62 * (y1 - y0) + 1), dpi=110, layout="constrained")
    axis = figure.subplots()
    for room in building.rooms.values():
        size = (room.x[1] - room.x[0], room.y[1] - room.y[0])
        axis.add_patch(Rectangle((room.x[0], room.y[0]), *size, facecolor="#f4f1ea", edgecolor="none"))
        axis.annotate(room.code, (room.x[0] + 0.15, room.y[1] - 0.15), va="top", fontsize=9, weight="bold", zorder=5)
    was, now = (_by_number(one) for one in (first, building))
    for key in was.keys() - now.keys():
        axis.add_patch(Polygon(was[key].footprint(), fill=False, edgecolor=_GONE, linewidth=0.9, linestyle=":"))
    for key, item in now.items():
        face, edge = _STAYS if key in was else _NEW
        if KINDS[item.kind].blocks or key not in was:
            axis.add_patch(Polygon(item.footprint(), facecolor=face, edgecolor=edge, linewidth=0.6))
    segments, names = obstacles(building)
    for segment, name in zip(segments, names, strict=True):
        if "wall" in name:
            axis.plot(*segment.T, color="#333333", linewidth=2.2, solid_capstyle="round")
    for opening in building.openings:
        if opening.kind in ("window", "pane"):
            ends = np.array([opening.point(end, 0.0) for end in opening.interval])
            axis.plot(*ends.T, color="#4bb0e0", linewidth=4)
        elif opening.kind in ("leaf", "glass"):
            axis.plot(*leaf_segment(building, opening, 90).T, color="#a0522d", linewidth=1.6)
    for run in runs:
        line = draw_run(building, run).track.poses[:, :2].T
        style = {"marker": ".", "linestyle": "none"} if run.path in GRIDS else {"linewidth": 0.9}
        axis.plot(*line, color=_COLOURS[run.lighting], alpha=0.8, label=f"{run.lighting} runs", **style)
    handles, labels = axis.get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    axis.legend(shown.values(), shown, loc="lower right", fontsize=9)
    title = f"{building.name}, seed {building.seed}" + (f", month {month}: changed since month 0" if month else "")
    axis.set(aspect="equal", xlabel="x in m", ylabel="y in m", title=title)
    return figure


def _by_number(building: Building) -> dict[tuple[Any, ...], Item]:
    """Return the items of a building by what shows whether they are still the same, in the same place."""
    return {
        (item.options.get("number", position), item.x, item.y): item for position, item in enumerate(building.items)
    }
