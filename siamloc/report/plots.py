"""Pictures of an evaluation, made from its result files alone: floor plan, cumulative error, confusion matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import DataError
from siamloc.files import atomic_path
from siamloc.report.floor_plan import error_along_line, error_on_plan, is_line
from siamloc.results import read_results, read_rows, rows_by_label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LIGHTING_COLOURS = {"cloudy": "#0072B2", "night": "#CC79A7", "sunny": "#E69F00"}  # Okabe and Ito 2008
_OTHER_COLOURS = ("#009E73", "#56B4E9", "#D55E00", "#F0E442")
_BASELINE_STYLES = ("-.", (0, (1, 1.2)), (0, (6, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
_STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "savefig.dpi": 150,
}


def draw_all(folder: str | Path, out: str | Path | None = None) -> list[Path]:
    """Draw every picture that a result folder has the numbers for, and return the files.

    Args:
        folder: what `siamloc.results.write_results` wrote: `queries.csv` and `map.csv` give
            `floor_plan.png` and `error_curve.png`, the measures "room_retrieval" give `confusion.png` and, under
            several lightings, `confusion_by_lighting.png`, the measures "room_pairs" give `pairs.png`.
        out: where the PNG files go; into the folder itself if None.

    Raises:
        FormatError: result files that are missing or not whole.
        StorageError: the disk refuses.
    """
    from siamloc.report import room_plots

    results = read_results(folder)
    measures, tables = results["measures"], results["tables"]
    unit = measures.get("absolute", {}).get("unit", "m")
    target = Path(folder if out is None else out)
    drawn = []
    if {"queries", "map"} <= set(tables):
        columns = read_rows(folder, "queries")
        drawn.append(save(floor_plan(columns, read_rows(folder, "map"), unit), target / "floor_plan.png"))
        drawn.append(save(error_curve(columns, unit), target / "error_curve.png"))
    if "room_retrieval" in measures:
        rooms = measures["room_retrieval"]
        labels, counts = rooms["confusion"]["labels"], np.array(rooms["confusion"]["counts"])
        figure = confusion_matrix(labels, counts, rooms["rooms_missing_in_map"])
        drawn.append(save(figure, target / "confusion.png"))
        by_lighting = {label: np.array(part) for label, part in rooms["confusion"].get("lighting", {}).items()}
        if len(by_lighting) > 1:
            figure = room_plots.confusion_by_lighting(labels, by_lighting)
            drawn.append(save(figure, target / "confusion_by_lighting.png"))
    if "room_pairs" in measures:
        drawn.append(save(room_plots.pair_curves(measures["room_pairs"]), target / "pairs.png"))
    return drawn


def floor_plan(columns: Mapping[str, NDArray], map_columns: Mapping[str, NDArray], unit: str = "m") -> Figure:
    """Draw each query where it truly is, coloured by its error, with a line to where it was taken to be.

    Frames that lie on a line (a corridor without metric poses) are drawn along that line instead.

    Args:
        columns: of `queries.csv`: x, y, est_x, est_y, error, floor, lighting.
        map_columns: of `map.csv`: x, y, room.
        unit: of x and y.

    Raises:
        DataError: no queries or no map frames.
    """
    _require_rows(columns, map_columns)
    with style():
        if is_line(columns, map_columns):
            return error_along_line(columns, map_columns, unit)
        return error_on_plan(columns, map_columns, unit)


def error_curve(columns: Mapping[str, NDArray], unit: str = "m") -> Figure:
    """Draw the share of queries whose error is at most so much: by lighting, beside baselines and the floor.

    Args:
        columns: of `queries.csv`: error, floor, lighting, and `baseline_<name>` columns.
        unit: of the errors.

    Raises:
        DataError: no queries.
    """
    _require_rows(columns)
    with style():
        figure = _figure(6.6, 3.4)
        axes = figure.add_subplot()
        error = columns["error"]
        groups = rows_by_label(columns["lighting"])
        limit = _nice_limit(float(np.percentile(error, 98)), float(columns["floor"].max()))
        if len(groups) != 1:
            _cumulative(axes, error, "all queries", unit, limit, color="black", linewidth=1.8, zorder=4)
        for (label, rows), colour in zip(groups.items(), lighting_colours(groups), strict=True):
            _cumulative(axes, error[rows], label, unit, limit, color=colour, linewidth=1.6, zorder=3)
        for i, name in enumerate(name for name in columns if name.startswith("baseline_")):
            line = _BASELINE_STYLES[i % len(_BASELINE_STYLES)]
            label = name.removeprefix("baseline_").replace("_", " ")
            _cumulative(axes, columns[name], label, unit, limit, color="0.45", linewidth=1.3, linestyle=line, zorder=2)
        _cumulative(axes, columns["floor"], "floor", unit, limit, color="black", linewidth=1, linestyle="--", zorder=2)
        axes.set(
            xlim=(0, limit), ylim=(0, 101.5), xlabel=f"error [{unit}]", ylabel="queries with at most this error [%]"
        )
        axes.grid(color="0.9", linewidth=0.6)
        figure.legend(loc="outside right center", title="mean error, number of queries", alignment="left")
        return figure


def confusion_matrix(labels: Sequence[str], counts: NDArray, missing: Sequence[str] = ()) -> Figure:
    """Draw which room was taken for which: shares of each row as colour and text, counts below.

    Args:
        labels: room names, L of them.
        counts: (L, L), row = true room, column = predicted room.
        missing: rooms that the map lacks, marked as such.

    Raises:
        DataError: no labels, or counts of another shape.
    """
    n = len(labels)
    if not n or np.shape(counts) != (n, n):
        raise DataError(f"a confusion matrix of {n} rooms needs counts of shape ({n}, {n}), got {np.shape(counts)}")
    totals = counts.sum(axis=1)
    with style():
        side = min(max(0.62 * n, 2.4), 12.0)
        figure = _figure(side + 2.9, side + 1.0)
        axes = figure.add_subplot()
        image = draw_matrix(axes, counts, shares_only=n > 16)
        names = [f"{label}\n(not in map)" if label in missing else label for label in labels]
        rows = [f"{label}  (n = {total})" for label, total in zip(labels, totals, strict=True)]
        rows = [f"{row}\n(not in map)" if label in missing else row for row, label in zip(rows, labels, strict=True)]
        axes.set_xticks(range(n), names, rotation=45, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(n), rows)
        axes.set(xlabel="room of the nearest map frame", ylabel="true room of the query")
        bar = figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("share of the true room's queries [%]")
        bar.outline.set_visible(False)  # type: ignore[operator]
        return figure


def draw_matrix(axes: Any, counts: NDArray, shares_only: bool) -> Any:
    """Draw the cells of a confusion matrix and return them as an image.

    Args:
        axes: what to draw on.
        counts: (L, L), row = true room.
        shares_only: whether the counts are left out.
    """
    shares = 100 * counts / np.maximum(counts.sum(axis=1), 1)[:, None]
    image = axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    for row, column in zip(*np.nonzero(counts), strict=True):
        share = shares[row, column]
        text = _percent(share) if shares_only else f"{_percent(share)} %\n{counts[row, column]}"
        colour = "white" if share > 55 else "black"
        axes.text(column, row, text, ha="center", va="center", fontsize=6 if shares_only else 7.5, color=colour)
    edges = np.arange(len(counts) + 1) - 0.5
    axes.set_xticks(edges, minor=True)
    axes.set_yticks(edges, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    return image


def lighting_colours(labels: Sequence[str] | Mapping[str, Any]) -> list[str]:
    """Return a colour for each label, the same one for a lighting in every picture; told apart by the colour-blind."""
    others = [label for label in labels if label not in _LIGHTING_COLOURS]
    spare = {label: _OTHER_COLOURS[i % len(_OTHER_COLOURS)] for i, label in enumerate(others)}
    return [_LIGHTING_COLOURS.get(label) or spare[label] for label in labels]


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG of 150 dots per inch, atomically, and return the path.

    Raises:
        StorageError: the disk refuses.
    """
    path = Path(path)
    with style(), atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return path


def style() -> AbstractContextManager[None]:
    """Return a context in which figures have the project's look, whatever the user's own settings are."""
    import matplotlib

    settings: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_STYLE}
    # The backend belongs to the program that draws, and reading or setting it here could load one.
    return matplotlib.rc_context({key: value for key, value in settings.items() if not key.startswith("backend")})


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def _cumulative(axes: Any, error: NDArray, label: str, unit: str, limit: float, **look: Any) -> None:
    ordered = np.sort(error)
    share = 100 * np.arange(len(ordered) + 1) / len(ordered)
    text = f"{label}: {ordered.mean():.2f} {unit}, {len(ordered)}"
    # The curve starts at the first query's error and goes on to the edge of the picture.
    edges, steps = np.concatenate([[0], ordered, [max(limit, ordered[-1])]]), np.append(share, share[-1])
    axes.step(edges, steps, where="post", label=text, **look)


def _nice_limit(*values: float) -> float:
    """Return the smallest of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten that is not below any of the values."""
    largest = max(*values, 1e-3)
    power = 10 ** np.floor(np.log10(largest))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= largest * 0.999))


def _percent(share: float) -> str:
    """Return a share in percent, with a decimal where rounding would hide that it is not 0 or not 100."""
    return f"{share:.0f}" if 1 <= share <= 99 or share == 100 else f"{share:.1f}"


def _require_rows(*tables: Mapping[str, NDArray]) -> None:
    for columns in tables:
        if not len(next(iter(columns.values()))):
            raise DataError("there is nothing to draw: the table has no rows")
