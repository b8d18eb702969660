"""Draw figures in the form of the published ones: lines over one setting, or heat maps over two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import DataError
from siamloc.report.draw.look import DASHES, INK, MARKS, PAPER, SERIES, SOFT, Picture, style
from siamloc.reproduce.panels import names_of, said, shown, title, unit
from siamloc.reproduce.published import Record, grouped
from siamloc.reproduce.recipe_book import axis

_TICKS = 6
_PICKS = {"min": min, "max": max, "mean": np.mean}


@dataclass(frozen=True)
class _Panel:
    figure: Mapping[str, Any]
    title: str
    records: Sequence[Record]
    of_figure: Sequence[Record]
    """Records of all panels of the same figure, which share one scale."""


@style()
def drawn(figures: Sequence[Mapping[str, Any]], records: Sequence[Record]) -> Picture:
    """Draw each panel of a recipe's figure.

    Args:
        figures: what to draw: `measure`, `x`, `series` or `y`, `panels`, `where`, `title`.
        records: measured numbers.

    Raises:
        DataError: nothing was measured.
    """
    panels = [panel for figure in figures for panel in _panels(figure, records)]
    if not panels:
        raise DataError("there is nothing to draw: nothing was measured")
    across = min(4, len(panels))
    high = -(-len(panels) // across)
    picture = Picture(figsize=(max(2.7 * across + 1.0, 5.2), 2.6 * high + 0.9))
    axes = picture.subplots(high, across, squeeze=False).ravel().tolist()
    for one in axes[len(panels) :]:
        one.remove()
    handles: dict[str, Any] = {}
    first = next((names_of(panel.figure, "series") for panel in panels if "y" not in panel.figure), [])
    for one, panel in zip(axes, panels, strict=False):
        one.set_title(panel.title)
        if "y" in panel.figure:
            _field(one, panel)
            continue
        lines = _lines(one, panel)
        if names_of(panel.figure, "series") == first:
            handles |= lines
        else:  # here the same colours mean something else
            one.legend(lines.values(), lines.keys(), fontsize=6.5, loc="best")
    if len(handles) > 1:
        rows = -(-len(handles) // max(2, int(1.6 * across)))
        columns = -(-len(handles) // rows)
        picture.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)
    return picture


def _panels(figure: Mapping[str, Any], records: Sequence[Record]) -> list[_Panel]:
    """Return the panels of a figure with their titles and records."""
    found, split = shown(figure, records), names_of(figure, "panels")
    what = figure.get("title", f"{said(figure['measure'])} {_bracket(figure['measure'])}".rstrip())
    if not found or not split:
        return [_Panel(figure, what, found, found)] if found else []
    named = []
    for key, part in grouped(split, found).items():
        told = ", ".join(title(name, value) for name, value in zip(split, key, strict=True))
        named.append(_Panel(figure, f"{told} {_bracket(figure['measure'])}" if "y" in figure else told, part, found))
    return named


def _lines(axes: Any, panel: _Panel) -> dict[str, Any]:
    figure, (x, x_factor) = panel.figure, _axis(panel.figure["x"])
    names, factor = names_of(figure, "series"), _factor(figure["measure"])
    # If other settings vary as well, the line shows the best of them, as the text refers to it.
    pick: Any = _PICKS[figure.get("best", "mean")]
    handles: dict[str, Any] = {}
    for rank, (key, part) in enumerate(grouped(names, panel.records).items()):
        places = grouped([figure["x"]], part)
        (line,) = axes.plot(
            [x_factor * place for (place,) in places],
            [factor * pick([one.value for one in those]) for those in places.values()],
            color=SERIES[rank % len(SERIES)],
            marker=MARKS[rank % len(MARKS)],
            markersize=4,
            linestyle=DASHES[rank // len(SERIES) % len(DASHES)],
        )
        handles[", ".join(title(name, value) for name, value in zip(names, key, strict=True))] = line
    if figure.get("log"):
        axes.set_xscale("log", base=2)
        every = [x_factor * place for (place,) in grouped([figure["x"]], panel.of_figure)]
        kept = every[:: -(-len(every) // _TICKS)]
        axes.set_xticks(kept, [f"{place:.2g}" for place in kept])
        axes.set_xticks([], minor=True)
    axes.set(xlabel=x, ylabel=f"{said(figure['measure'])} {_bracket(figure['measure'])}".rstrip())
    axes.grid(True)
    low, high = axes.get_ylim()
    if panel.of_figure is not panel.records:  # panels side by side share one scale
        high = factor * max(_drawn_values(panel, names, pick))
    if min(low, *(one.value for one in panel.of_figure)) >= 0 or low > 0:
        axes.set_ylim(0, max(1.03 * high, 1e-9))
    return handles


def _drawn_values(panel: _Panel, names: Sequence[str], pick: Any) -> list[float]:
    """Return the heights of all points in all panels of a figure."""
    keys = [*names_of(panel.figure, "panels"), *names, panel.figure["x"]]
    return [float(pick([one.value for one in part])) for part in grouped(keys, panel.of_figure).values()]


def _field(axes: Any, panel: _Panel) -> None:
    figure, factor = panel.figure, _factor(panel.figure["measure"])
    values = factor * _means(figure, panel.records)
    every = [factor * one.value for one in panel.of_figure]
    low, high = (0.0, 100.0) if unit(figure["measure"]) == "share" else (min(every), max(every))
    timed = unit(figure["measure"]) == "s" and low > 0  # times differ by orders of magnitude
    scaled, low, high = (np.log(values), np.log(low), np.log(high)) if timed else (values, low, high)
    high = high if high > low else low + 1
    axes.imshow(scaled, cmap="Blues", vmin=low, vmax=high, origin="lower", aspect="auto")
    close = np.nanmax(values) - np.nanmin(values) < 0.1 * np.nanmax(np.abs(values))
    for (row, column), value in np.ndenumerate(values):
        dark = np.isfinite(value) and (scaled[row, column] - low) / (high - low) > 0.5
        axes.text(
            *(column, row, _cell(value, bool(close))),
            ha="center",
            va="center",
            fontsize=7,
            color=PAPER if dark else INK if np.isfinite(value) else SOFT,
        )
    for name, set_ticks in (("x", axes.set_xticks), ("y", axes.set_yticks)):
        found = [key for (key,) in grouped([figure[name]], panel.records)]
        set_ticks(range(len(found)), [f"{value:g}" for value in found])
    axes.set(xlabel=_axis(figure["x"])[0], ylabel=_axis(figure["y"])[0])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def _means(figure: Mapping[str, Any], records: Sequence[Record]) -> NDArray[np.float64]:
    """Return the mean of a panel's records at each of its places; NaN if there are none."""
    columns, rows = ([key for (key,) in grouped([figure[name]], records)] for name in ("x", "y"))
    values = np.full((len(rows), len(columns)), np.nan)
    for (row, column), part in grouped([figure["y"], figure["x"]], records).items():
        values[rows.index(row), columns.index(column)] = np.mean([one.value for one in part])
    return values


def _cell(value: float, close: bool) -> str:
    if not np.isfinite(value):
        return "–"
    if abs(value) >= 10:
        return f"{value:.0f}"
    return f"{value:.3f}" if close and value != round(value) else f"{value:.2g}"


def _axis(name: str) -> tuple[str, float]:
    """Return the label of an axis with its unit, and the factor its numbers are multiplied by."""
    about = axis(name)
    label = about.get("says", name.replace("_", " "))
    return (f"{label} [{about['unit']}]" if "unit" in about else label), float(about.get("factor", 1))


def _factor(measure: str) -> float:
    """Return the factor numbers are multiplied by: shares are shown in percent, seconds in milliseconds."""
    return {"share": 100.0, "s": 1000.0}.get(unit(measure), 1.0)


def _bracket(measure: str) -> str:
    found = {"share": "%", "s": "ms", "deg": "°"}.get(unit(measure), unit(measure))
    return f"[{found}]" if found else ""
