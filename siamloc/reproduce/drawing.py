"""Draw measured numbers as the published figures do: lines over one setting, or a heat map over two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.errors import DataError
from siamloc.report.draw.look import INK, PAPER, SOFT, Picture, panels, series_look, style
from siamloc.reproduce.claims import PICKS
from siamloc.reproduce.published import Record, grouped, measures
from siamloc.reproduce.study_book import axis

Figure = Mapping[str, Any]

_TICKS = 6
_LEGENDS: tuple[Any, ...] = ("outside lower center", "outside upper center", "outside right lower")
_SHOWN = {"share": ("%", 100.0), "s": ("ms", 1000.0), "deg": ("°", 1.0)}
"""Units on the axes, by the unit of a measure, and the factor of its numbers."""


@style()
def drawn(figures: Sequence[Figure], records: Sequence[Record]) -> Picture:
    """Draw each panel of a study's figure.

    Args:
        figures: settings of each panel: `measure`, `x`, `series` or `y`, `panels`, `where` (null for a setting that a
            record must lack), `title`.
        records: measured numbers.

    Raises:
        DataError: nothing was measured.
    """
    parts = [(figure, *panel) for figure in figures for panel in _panels(figure, records)]
    if not parts:
        raise DataError("there is nothing to draw: nothing was measured")
    across = min(4, len(parts))
    picture, every = panels(len(parts), 2.7, 2.6, across=4, margin=(max(1.0, 5.2 - 2.7 * across), 0.9))
    legends: dict[str, dict[str, Any]] = {}  # the same colours mean something else where other settings vary
    several = len({figure["measure"] for figure in figures if "y" in figure}) > 1
    for axes, (figure, title, part, every_part) in zip(every, parts, strict=True):
        axes.set_title(f"{said(figure['measure'])}, {title}" if "y" in figure and several else title)
        if "y" in figure:
            _field(axes, figure, part, every_part)
        else:
            legends.setdefault(repr(names_of(figure, "series")), {}).update(_lines(axes, figure, part, every_part))
    for handles, where in zip(legends.values(), _LEGENDS, strict=False):
        rows = -(-len(handles) // max(2, int(1.6 * across)))
        columns = 1 if "right" in where else -(-len(handles) // rows)
        if len(handles) > 1:
            picture.legend(list(handles.values()), list(handles), loc=where, ncols=columns)
    return picture


def names_of(figure: Figure, key: str) -> list[str]:
    """Return the names of the settings, if any, that distinguish the lines or the panels of a figure.

    Args:
        figure: settings of a panel, as for `drawn`.
        key: "series" for the lines, "panels" for the panels.
    """
    named = figure.get(key, "descriptor" if key == "series" and "y" not in figure else [])
    return [named] if isinstance(named, str) else list(named)


def shown(figure: Figure, records: Sequence[Record]) -> list[Record]:
    """Return the records of a panel's measure that have all the settings of the panel's axes and lines."""
    lines = [figure["y"]] if "y" in figure else names_of(figure, "series")
    needed = {figure["x"], *names_of(figure, "panels"), *lines}
    where = figure.get("where", {}).items()
    return [
        one
        for one in records
        if one.measure == figure["measure"]
        and needed <= set(one.settings)
        and all(one.settings.get(name) == value for name, value in where)
    ]


def titled(names: Sequence[str], values: Sequence[Any]) -> str:
    """Return a label of settings with their values, such as "k1 8, homomorphic filter"; values of None are left out."""
    return ", ".join(_title(name, value) for name, value in zip(names, values, strict=True) if value is not None)


def _title(name: str, value: Any) -> str:
    if name == "filter":
        return "homomorphic filter" if value else "no filter"
    about = axis(name)
    if "factor" in about:
        value = round(about["factor"] * value, 6)
    written = f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
    if name in ("descriptor", "distance", "data", "method"):
        return written
    ending = f" {about['unit']}" if "factor" in about else ""
    return f"{about.get('short', name.replace('_', ' '))} {written}{ending}"


def unit(measure: str) -> str:
    """Return the unit of a measure; "" if it has none."""
    found = str(measures().get(measure, {}).get("unit", "s" if measure.endswith("seconds") else "1"))
    return "" if found == "1" else found


def said(measure: str) -> str:
    """Return the label of a measure for an axis, such as "time" for "seconds"."""
    return " ".join("time" if word == "seconds" else word for word in measure.split("_"))


def _panels(figure: Figure, records: Sequence[Record]) -> list[tuple[str, list[Record], list[Record]]]:
    """Return the title and the records of each panel of a figure, and the records of all its panels."""
    found, split = shown(figure, records), names_of(figure, "panels")
    bracket, _ = _scale(figure["measure"])
    if not found or not split:
        return [(figure.get("title", f"{said(figure['measure'])} {bracket}".rstrip()), found, found)] if found else []
    ending = f" {bracket}" if "y" in figure else ""
    return [(titled(split, key) + ending, part, found) for key, part in grouped(split, found).items()]


def _lines(axes: Any, figure: Figure, records: list[Record], of_figure: list[Record]) -> dict[str, Any]:
    """Draw a line for each of the series, on the scale of all panels, and return the lines by label."""
    x, x_factor = _axis(figure["x"])
    names, (bracket, factor) = names_of(figure, "series"), _scale(figure["measure"])
    # If other settings vary as well, the line shows the best of them, as the text refers to it.
    pick = PICKS[figure.get("best", "mean")]
    handles: dict[str, Any] = {}
    for rank, (key, part) in enumerate(grouped(names, records).items()):
        places = grouped([figure["x"]], part)
        heights = [factor * pick([one.value for one in those]) for those in places.values()]
        (line,) = axes.plot([x_factor * place for (place,) in places], heights, **series_look(rank))
        handles[titled(names, key)] = line
    if figure.get("log"):
        axes.set_xscale("log", base=2)
        every = [x_factor * place for (place,) in grouped([figure["x"]], of_figure)]
        kept = every[:: -(-len(every) // _TICKS)]
        axes.set_xticks(kept, [f"{place:.2g}" for place in kept])
        axes.set_xticks([], minor=True)
    axes.set(xlabel=x, ylabel=f"{said(figure['measure'])} {bracket}".rstrip())
    low, high = axes.get_ylim()
    if of_figure is not records:  # panels side by side share one scale
        points = grouped([*names_of(figure, "panels"), *names, figure["x"]], of_figure).values()
        high = factor * max(pick([one.value for one in point]) for point in points)
    if min(low, *(one.value for one in of_figure)) >= 0 or low > 0:
        axes.set_ylim(0, max(1.03 * high, 1e-9))
    return handles


def _field(axes: Any, figure: Figure, records: list[Record], of_figure: list[Record]) -> None:
    """Draw a heat map of means, on the scale of all panels."""
    _, factor = _scale(figure["measure"])
    columns, rows = ([key for (key,) in grouped([figure[name]], records)] for name in "xy")
    values = np.full((len(rows), len(columns)), np.nan)
    for (row, column), part in grouped([figure["y"], figure["x"]], records).items():
        values[rows.index(row), columns.index(column)] = factor * np.mean([one.value for one in part])
    every = [factor * one.value for one in of_figure]
    low, high = (0.0, 100.0) if unit(figure["measure"]) == "share" else (min(every), max(every))
    scaled = values
    if unit(figure["measure"]) == "s" and low > 0:  # times differ by orders of magnitude
        scaled, low, high = np.log(values), np.log(low), np.log(high)
    high = high if high > low else low + 1
    axes.imshow(scaled, cmap="Blues", vmin=low, vmax=high, origin="lower", aspect="auto")
    close = bool(np.nanmax(values) - np.nanmin(values) < 0.1 * np.nanmax(np.abs(values)))
    for (row, column), value in np.ndenumerate(values):
        dark = np.isfinite(value) and (scaled[row, column] - low) / (high - low) > 0.5
        colour = PAPER if dark else INK if np.isfinite(value) else SOFT
        axes.text(column, row, _cell(value, close), ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(len(columns)), [f"{value:g}" for value in columns])
    axes.set_yticks(range(len(rows)), [f"{value:g}" for value in rows])
    axes.set(xlabel=_axis(figure["x"])[0], ylabel=_axis(figure["y"])[0])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


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


def _scale(measure: str) -> tuple[str, float]:
    """Return the unit that a measure is drawn in, in brackets, and the factor its numbers are multiplied by."""
    drawn_in, factor = _SHOWN.get(unit(measure), (unit(measure), 1.0))
    return f"[{drawn_in}]" if drawn_in else "", factor
