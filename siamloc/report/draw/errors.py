"""Errors of queries: cumulative, true against expected, and by whether the right node was chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import getitem
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from foundation.columns import spread_rows
from siamloc.report.draw.look import (
    DASHES,
    FLOOR,
    GRID,
    INK,
    MARKS,
    SERIES,
    SOFT,
    Picture,
    column,
    legend_entries,
    lighting_colours,
    method_look,
    panels,
    scale_errors,
    shared_legend,
    style,
)
from siamloc.results import rows_by_label

_MOST_POINTS = 120  # of a curve; more make no visible difference
_SIZE, _LARGE_SIZE = (3.6, 3.2), (4.6, 3.4)  # of a panel in inches: three in a row, and two
_LONG = 22  # characters from which a label gets its own line in the legend
_WIDEST, _LINE = 64, 0.17  # characters of a line of the legend below all panels, and its height in inches
_UNDER = 0.48  # inches from a panel to its legend
_LINES = 4  # of the legend below a panel, for which the panel has room

_ALL = "all queries"
_HOLLOW = {"markerfacecolor": "none", "markeredgewidth": 1.8}
# The marks of a row of mean errors, whose sizes keep each visible where they coincide: label, path of the error in a
# group of measures, and look.
_MEANS: tuple[tuple[str, tuple[str, ...], dict[str, Any]], ...] = (
    ("floor", ("floor",), {"color": SOFT, "marker": "|", "markersize": 22, "markeredgewidth": 2.5}),
    ("whole map", ("absolute", "error"), {"color": SERIES[0], "marker": "s", "markersize": 16, **_HOLLOW}),
    ("perfect nodes", ("perfect_coarse", "error"), {"color": SERIES[4], "marker": "D", "markersize": 8.5}),
    ("right node", ("given_right", "error"), {"color": SERIES[3], "marker": "^", "markersize": 7}),
    ("wrong node", ("given_wrong", "error"), {"color": SERIES[5], "marker": "v", "markersize": 4}),
    ("hierarchical", ("error",), {"color": INK, "marker": "o", "markersize": 13, **_HOLLOW}),
)

# A curve: its label, the errors, and how it looks.
Curve = tuple[str, NDArray, dict[str, Any]]


@style()
def error_curve(columns: Mapping[str, NDArray], unit: str = "m", name: str = "measured") -> Picture:
    """Draw cumulative error curves: by lighting, then against the baselines under each lighting.

    Args:
        columns: columns of `queries.csv`: error, floor, lighting, and `baseline_<name>` columns.
        unit: unit of the errors.
        name: name of what was measured, for the legend.

    Example:
        >>> columns = {"error": np.array([0.1, 0.4]), "floor": np.zeros(2), "lighting": np.array(["night", "night"])}
        >>> figure = error_curve(columns)
        >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        ['night: 0.25 m', 'floor: 0.00 m']
    """
    error, floor, groups = columns["error"], columns["floor"], rows_by_label(columns["lighting"])
    curves: list[Curve] = [(_ALL, error, method_look(0))] if len(groups) != 1 else []
    for (label, rows), colour in zip(groups.items(), lighting_colours(groups), strict=True):
        curves.append((label, error[rows], {"color": colour, "zorder": 3}))
    charts = [(f"{name} by lighting" if len(groups) > 1 else name, curves, floor)]
    others = {key.removeprefix("baseline_").replace("_", " "): key for key in columns if key.startswith("baseline_")}
    keys = {name: "error", **others}
    for label, rows in (groups or {_ALL: np.arange(len(error))}).items() if others else ():
        curves = [(method, columns[key][rows], method_look(i)) for i, (method, key) in enumerate(keys.items())]
        charts.append((f"methods, {label}", curves, floor[rows]))
    return _drawn(charts, unit)


@style()
def estimate_curve(columns: Mapping[str, NDArray], estimate: str, unit: str = "m") -> Picture:
    """Draw another estimate of the same queries against the single-frame one, one panel per lighting.

    Args:
        columns: columns of `queries.csv`: error, floor, lighting, `<estimate>_error`.
        estimate: name of the estimate, such as "filtered".
        unit: unit of the errors.
    """
    error, other, floor = columns["error"], columns[f"{estimate}_error"], columns["floor"]
    groups = rows_by_label(columns["lighting"]) or {_ALL: np.arange(len(error))}
    single = {"color": SERIES[5], "linestyle": DASHES[1], "zorder": 3}
    charts = []
    for label, rows in groups.items():
        curves: list[Curve] = [(estimate, other[rows], method_look(0)), ("single frame", error[rows], single)]
        charts.append((label, curves, floor[rows]))
    return _drawn(charts, unit, shared=True)


@style()
def compared_curves(tables: Mapping[str, Mapping[str, NDArray]], unit: str = "m") -> Picture:
    """Draw the cumulative share of queries over their error, one curve for each evaluation.

    There is a panel for all queries, and one for each lighting if there are several.

    Args:
        tables: columns of `queries.csv` by the name of the evaluation, each (queries,): error, floor (the error of the
            nearest map frame) and lighting.
        unit: unit of all errors.
    """
    lightings = {title: rows_by_label(columns["lighting"]) for title, columns in tables.items()}
    labels = list(dict.fromkeys(label for rows in lightings.values() for label in rows))
    order = [SERIES[i] for i in (0, 5, 3, 2, 1, 4, 6, 7)]
    charts = []
    for chart in [_ALL, *(labels if len(labels) > 1 else ())]:
        curves: list[Curve] = []
        floors = []
        for i, (title, columns) in enumerate(tables.items()):
            rows = np.arange(len(columns["error"])) if chart == _ALL else lightings[title].get(chart)
            if rows is not None:
                look = {"color": order[i % len(order)], "linestyle": DASHES[i % len(DASHES)]}
                curves.append((title, columns["error"][rows], look))
                floors.append(columns["floor"][rows])
        same = all(np.array_equal(floors[0], floor) for floor in floors)
        charts.append((chart, curves, floors[0] if same else None))
    return _drawn(charts, unit, below=True)


@style()
def calibration_curve(measures: Mapping[str, Any], unit: str = "m") -> Picture:
    """Draw the true mean error of each tenth of the queries against their expected error.

    Args:
        measures: `measures.calibration` of `results.json`.
        unit: unit of the errors.
    """
    colours = dict(zip(measures["lighting"], lighting_colours(measures["lighting"]), strict=True))
    groups = measures["lighting"] if len(colours) == 1 else {**measures["lighting"], _ALL: measures["overall"]}
    groups = {label: group["curve"] for label, group in groups.items() if group["curve"]}
    figure, (axes,) = panels(1, 4.6, 3.6)
    curves = []
    for i, (label, curve) in enumerate(groups.items()):
        curves += [column(curve, "predicted"), column(curve, "observed")]
        look = method_look(0) | {"marker": MARKS[i % len(MARKS)], "markersize": 5}
        look |= {"linestyle": "-" if label == list(groups)[-1] else "none"}
        axes.plot(*curves[-2:], label=label, **look | ({"color": colours[label]} if label in colours else {}))
    limits = scale_errors(axes.xaxis, curves, f"expected error [{unit}]", lowest=0)
    scale_errors(axes.yaxis, curves, f"true error, mean [{unit}]", lowest=0)
    axes.plot(limits, limits, label="equal", **FLOOR)
    axes.legend(*legend_entries(axes), loc="upper left")
    return figure


@style()
def node_errors(measures: Mapping[str, Any]) -> Picture:
    """Draw the mean errors of hierarchical localization in a row for each lighting, and one for all queries.

    Args:
        measures: `measures.hierarchical` of `results.json`.
    """
    groups = dict(measures["lighting"])
    if len(groups) != 1:
        groups[_ALL] = measures["overall"]
    figure, (axes,) = panels(1, 9.0, 0.36 * len(groups) + 1.2)
    values = [[reduce(getitem, path, group)["mean"] for _, path, _ in _MEANS] for group in groups.values()]
    known = [[value for value in row if value is not None] for row in values]
    for place, row in enumerate(known):
        axes.plot([min(row), max(row)], [place, place], color=GRID, linewidth=4, solid_capstyle="round", zorder=1)
    for i, (label, _, look) in enumerate(_MEANS):
        points = [(row[i], place) for place, row in enumerate(values) if row[i] is not None]
        if points:
            look = {"markeredgewidth": 0, "zorder": 3, **look}
            axes.plot(*zip(*points, strict=True), label=label, linestyle="none", **look)
    scale_errors(axes.xaxis, known, f"mean error [{measures['unit']}]", lowest=0)
    axes.set_yticks(range(len(groups)), list(groups))
    axes.set_ylim(len(groups) - 0.4, -0.6)
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    shared_legend(figure, len(_MEANS))
    return figure


def _drawn(
    charts: Sequence[tuple[str, Sequence[Curve], NDArray | None]],
    unit: str,
    shared: bool = False,
    below: bool = False,
) -> Picture:
    """Draw a panel for each chart: its title, its curves, and the floor if they share one.

    Args:
        charts: the charts.
        unit: unit of the errors.
        shared: give all panels the same limits.
        below: name the curves in one legend below all panels, for names that are long.
    """
    size = _LARGE_SIZE if len(charts) in (1, 2, 4) else _SIZE
    figure, every = panels(len(charts), *size, sharey=True, ylabel="queries with at most this error [%]")
    common = [error for _, curves, _ in charts for _, error, _ in curves] if shared else []
    lines: dict[str, Any] = {}
    tallest = _LINES
    for axes, (title, curves, floor) in zip(every, charts, strict=True):
        if floor is not None:
            curves = [*curves, ("floor", floor, {**FLOOR, "zorder": 2})]
        alike = len({len(error) for _, error, _ in curves}) == 1
        labels = []
        for label, error, look in curves:
            count = "" if alike else f", n = {len(error):,}"
            labels.append(f"{'' if below else f'{label}: '}{error.mean():.2f} {unit}{count}")
            (lines[label],) = axes.plot(*_cumulative(error), label=labels[-1], **look)
        scale_errors(axes.xaxis, common or [error for _, error, _ in curves], f"error [{unit}]")
        axes.set(title=title + f", n = {len(curves[0][1]):,}" * alike, ylim=(0, 101.5))
        columns = 1 if max(map(len, labels)) > _LONG else 2
        tallest = max(tallest, -(-len(labels) // columns))
        under = axes.transAxes + ScaledTranslation(0, -_UNDER, figure.dpi_scale_trans)
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, 0), "bbox_transform": under}
        place |= {"ncols": columns, "borderpad": 0, "columnspacing": 1.2, "fontsize": 7.5, "handlelength": 2.2}
        axes.legend(*legend_entries(axes), **place)
    rows = len({axes.get_position().y0 for axes in every})
    names = [fill(label, _WIDEST) for label in lines] if below else []
    more = (tallest - _LINES) * rows + len("\n".join(names).splitlines())
    figure.set_figheight(figure.get_figheight() + _LINE * more)
    if below:
        figure.legend(list(lines.values()), names, loc="outside lower center", fontsize=7.5, handlelength=2.2)
    return figure


def _cumulative(error: NDArray) -> tuple[NDArray, NDArray]:
    """Return the corners of a cumulative curve: errors, and the share of queries in percent."""
    ordered = np.sort(error)
    keep = spread_rows(len(ordered), _MOST_POINTS)
    share = 100 * (keep + 1) / len(ordered)  # exact at each kept point
    if len(keep) == len(ordered):
        x, y = np.repeat(ordered, 2), np.concatenate([[0], np.repeat(share, 2)[:-1]])
    else:
        x, y = np.concatenate([ordered[:1], ordered[keep]]), np.concatenate([[0], share])
    beyond = 10 * max(float(ordered[-1]), 1.0)  # to the edge of the plot
    return np.append(np.maximum(x, 1e-9), beyond), np.append(y, 100.0)
