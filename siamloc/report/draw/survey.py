"""Draw a survey: the path by odometry, the surveyed path with its loops, and a film of the drive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from foundation.files import write_json, write_text
from siamloc.data.manifest import manifest_of
from siamloc.data.moves import composed, relative
from siamloc.report.draw.film import DOTS_PER_INCH, moments, picture_of, write_film
from siamloc.report.draw.look import INK, SERIES, SOFT, Picture, legend_entries, panels, save, series_look, style

if TYPE_CHECKING:
    from siamloc.maps import Survey

# Neither has a colour of a drive.
_LOOP: dict[str, Any] = {"color": SOFT, "linewidth": 0.6, "alpha": 0.35}
_REFUSED: dict[str, Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (4, 2))}
_BEHIND = 12  # frames of the path that are drawn boldly behind the robot


def save_survey(found: Survey, folder: str | Path, settings: Mapping[str, Any]) -> None:
    """Write surveyed.csv (a manifest of the frames), survey.json (measures and settings), survey.png and survey.gif.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    folder = Path(folder)
    write_text(folder / "surveyed.csv", manifest_of(found.frames, folder))
    write_json(folder / "survey.json", {"schema": 1, "settings": dict(settings), **found.report()})
    save(survey_picture(found), folder / "survey.png")
    survey_film(found, folder / "survey.gif")


@style()
def survey_picture(found: Survey) -> Picture:
    """Draw the path by odometry, if there is any, beside the surveyed path with its loops.

    Each drive has a colour. Loops that are used are thin and grey; those that contradict the rest are dashed in black.
    """
    wheels = np.isfinite(found.frames.odometry).all(axis=1).any()
    drives = list(found.frames.rows_by("sequence").items())
    xy = found.frames.xy
    shown = np.concatenate([xy, *([_turned(found, rows) for _, rows in drives] if wheels else [])])
    height = 5.2 * float(np.clip(np.ptp(shown[:, 1]) / max(np.ptp(shown[:, 0]), 1e-9), 0.4, 1.2))
    figure, drawn = panels(1 + int(wheels), 5.2, height, margin=(0.2, 0.9), across=2, sharex=True, sharey=True)
    if wheels:
        for number, (_, rows) in enumerate(drives):
            drawn[0].plot(*_turned(found, rows).T, linewidth=1.3, **_look(number))
        drawn[0].set_title("by odometry")
    axes = drawn[-1]
    _add_loops(axes, found)
    for number, (name, rows) in enumerate(drives):
        axes.plot(*xy[rows].T, linewidth=1.6, label=name or "drive", **_look(number))
        axes.plot(*xy[rows[0]], "o", color=_look(number)["color"], markersize=6, markeredgecolor="white")
    counts = found.loops.counts()
    axes.set_title(f"surveyed: {counts['accepted']} loops used{found.doubt}".replace("; ", "\n"))
    for one in drawn:
        one.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    handles, labels = legend_entries(axes)
    handles.append(axes.plot([], [], **_LOOP)[0])
    labels.append("loop")
    if counts["contradicted"]:
        handles.append(axes.plot([], [], **_REFUSED)[0])
        labels.append("loop refused as contradicting")
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    figure.draw_without_rendering()  # the layout of panels with equal axes is only right the second time
    return figure


def survey_film(found: Survey, path: str | Path) -> Path:
    """Write a GIF of about 80 pictures: the robot drives along the surveyed path, and loops appear as they close.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    return write_film(_driven(found), path, [*SERIES, SOFT])


@style()
def _driven(found: Survey) -> list[NDArray[np.uint8]]:
    xy, loops = found.frames.xy, found.loops.take(found.loops.accepted)
    extent = np.ptp(xy, axis=0)
    width = 6.4
    height = float(np.clip(width * extent[1] / max(extent[0], 1e-9), 2.4, 6.4))
    figure = Figure(figsize=(width, height + 0.8), dpi=DOTS_PER_INCH)
    canvas, axes = FigureCanvasAgg(figure), figure.subplots()
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    margin = 0.05 * extent.max()
    axes.set(xlim=(xy[:, 0].min() - margin, xy[:, 0].max() + margin))
    axes.set(ylim=(xy[:, 1].min() - margin, xy[:, 1].max() + margin))
    closed = LineCollection([], **_LOOP)
    axes.add_collection(closed)
    drive = found.graph.drive
    paths = [axes.plot([], [], linewidth=1.2, **_look(number))[0] for number in range(int(drive.max()) + 1)]
    (robot,) = axes.plot([], [], "o", color=INK, markersize=7)
    (tail,) = axes.plot([], [], color=INK, linewidth=2.2)
    pictures: list[NDArray[np.uint8]] = []
    for last in moments(len(xy) - 1):
        here = loops.second <= last
        closed.set_segments(list(np.stack([xy[loops.first[here]], xy[loops.second[here]]], axis=1)))
        for number, line in enumerate(paths):
            rows = np.flatnonzero((drive == number) & (np.arange(len(xy)) <= last))
            line.set_data(*xy[rows].T)
        behind = np.flatnonzero(drive[: last + 1] == drive[last])[-_BEHIND:]
        tail.set_data(*xy[behind].T)
        robot.set_data(*xy[[last]].T)
        axes.set_title(f"{last + 1} frames, {int(here.sum())} loops")
        pictures.append(picture_of(canvas))
    return pictures


def _add_loops(axes: Axes, found: Survey) -> None:
    xy = found.frames.xy
    contradicted = np.array([reason.name == "CONTRADICTED" for reason in found.loops.reason.tolist()], dtype=bool)
    for rows, options in ((found.loops.accepted, _LOOP), (contradicted, _REFUSED)):
        ends = np.stack([xy[found.loops.first[rows]], xy[found.loops.second[rows]]], axis=1)
        axes.add_collection(LineCollection(list(ends), **options))


def _turned(found: Survey, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return positions by odometry (k, 2), moved and turned so that they begin as the surveyed drive does."""
    known = rows[np.isfinite(found.frames.odometry[rows]).all(axis=1)]
    if not len(known):
        return np.empty((0, 2))
    first = np.full(len(known), known[0])
    begin = np.column_stack([found.frames.xy, found.frames.theta])[first]
    return composed(begin, relative(found.frames.odometry, first, known))[:, :2]


def _look(number: int) -> dict[str, Any]:
    """Return colour and dash of the path of a drive."""
    return {**series_look(number), "marker": ""}
