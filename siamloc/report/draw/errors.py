"""Cumulative errors: the share of queries up to each error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.report.draw.look import (
    DASHES,
    FLOOR,
    SERIES,
    Picture,
    error_limits,
    lighting_colours,
    method_look,
    panels,
    require_rows,
    scale_errors,
    style,
)
from siamloc.results import rows_by_label

_MOST_POINTS = 120  # of a curve; more make no visible difference
_SIZE, _LARGE_SIZE = (3.6, 3.2), (4.6, 3.4)  # of a panel in inches: three in a row, and two
_LONG = 22  # characters from which a label gets its own line in the legend

# A curve: its label, the errors, and how it looks.
Curve = tuple[str, NDArray, dict[str, Any]]


@style()
def error_curve(columns: Mapping[str, NDArray], unit: str = "m", name: str = "measured") -> Picture:
    """Draw cumulative error curves: by lighting, then against the baselines under each lighting.

    Args:
        columns: of `queries.csv`: error, floor, lighting, and `baseline_<name>` columns.
        unit: of the errors.
        name: name of what was measured, for the legend.

    Raises:
        DataError: no queries.

    Example:
        >>> columns = {"error": np.array([0.1, 0.4]), "floor": np.zeros(2), "lighting": np.array(["night", "night"])}
        >>> figure = error_curve(columns)
        >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        ['night: 0.25 m', 'floor: 0.00 m']
    """
    require_rows(columns)
    error, floor, groups = columns["error"], columns["floor"], rows_by_label(columns["lighting"])
    curves: list[Curve] = []
    if len(groups) != 1:
        curves.append(("all queries", error, method_look(0)))
    for (label, rows), colour in zip(groups.items(), lighting_colours(groups), strict=True):
        curves.append((label, error[rows], {"color": colour, "zorder": 3}))
    charts = [(f"{name} by lighting" if len(groups) > 1 else name, curves, floor)]
    others = {key.removeprefix("baseline_").replace("_", " "): key for key in columns if key.startswith("baseline_")}
    if others:
        keys = {name: "error", **others}
        for label, rows in (groups or {"all queries": np.arange(len(error))}).items():
            curves = [(method, columns[key][rows], method_look(i)) for i, (method, key) in enumerate(keys.items())]
            charts.append((f"methods, {label}", curves, floor[rows]))
    return _drawn(charts, unit)


@style()
def estimate_curve(columns: Mapping[str, NDArray], estimate: str, unit: str = "m") -> Picture:
    """Draw another estimate of the same queries against the single-frame one, one panel per lighting.

    Args:
        columns: of `queries.csv`: error, floor, lighting, `<estimate>_error`.
        estimate: name of the estimate, such as "filtered".
        unit: of the errors.

    Raises:
        DataError: no queries.
    """
    require_rows(columns)
    error, other, floor = columns["error"], columns[f"{estimate}_error"], columns["floor"]
    groups = rows_by_label(columns["lighting"]) or {"all queries": np.arange(len(error))}
    single = {"color": SERIES[5], "linestyle": DASHES[1], "zorder": 3}
    return _drawn(
        [
            (label, [(estimate, other[rows], method_look(0)), ("single frame", error[rows], single)], floor[rows])
            for label, rows in groups.items()
        ],
        unit,
        shared=True,
    )


@style()
def compared_curves(tables: Mapping[str, Mapping[str, NDArray]], unit: str = "m") -> Picture:
    """Draw several evaluations in one panel for all queries, and one panel per lighting if there are several.

    Args:
        tables: columns of `queries.csv` by the name of the evaluation: error, floor, lighting.
        unit: of all errors.

    Raises:
        DataError: an evaluation without queries.
    """
    require_rows(*tables.values())
    groups = {title: rows_by_label(columns["lighting"]) for title, columns in tables.items()}
    labels = list(dict.fromkeys(label for rows in groups.values() for label in rows))
    chosen: dict[str, dict[str, NDArray]] = {
        "all queries": {title: np.arange(len(columns["error"])) for title, columns in tables.items()}
    }
    for label in labels if len(labels) > 1 else []:
        chosen[label] = {title: rows[label] for title, rows in groups.items() if label in rows}
    charts = []
    looks = {title: _compared_look(i) for i, title in enumerate(tables)}
    for label, members in chosen.items():
        curves = [(title, tables[title]["error"][rows], looks[title]) for title, rows in members.items()]
        floors = [tables[title]["floor"][rows] for title, rows in members.items()]
        same = all(np.array_equal(floors[0], floor) for floor in floors)
        charts.append((label, curves, floors[0] if same else None))
    return _drawn(charts, unit)


def _compared_look(rank: int) -> dict[str, Any]:
    return {"color": SERIES[(0, 5, 3, 2, 1, 4, 6, 7)[rank % 8]], "linestyle": DASHES[rank % len(DASHES)]}


def _drawn(charts: Sequence[tuple[str, Sequence[Curve], NDArray | None]], unit: str, shared: bool = False) -> Picture:
    """Draw a panel for each chart: its title, its curves, and the floor if they share one."""
    figure, every, across = panels(len(charts), *(_LARGE_SIZE if len(charts) in (1, 2, 4) else _SIZE), sharey=True)
    common = [error for _, curves, _ in charts for _, error, _ in curves] if shared else []
    for number, (axes, (title, curves, floor)) in enumerate(zip(every, charts, strict=True)):
        if floor is not None:
            curves = [*curves, ("floor", floor, {**FLOOR, "zorder": 2})]
        alike = len({len(error) for _, error, _ in curves}) == 1
        labels = []
        for label, error, look in curves:
            count = "" if alike else f", n = {len(error):,}"
            labels.append(f"{label}: {error.mean():.2f} {unit}{count}")
            axes.plot(*_cumulative(error), label=labels[-1], **look)
        limits = error_limits(common or [error for _, error, _ in curves])
        scale_errors(axes.xaxis, limits, f"error [{unit}]")
        axes.set(title=title + f", n = {len(curves[0][1]):,}" * alike, ylim=(0, 101.5))
        axes.grid(True)
        if number % across == 0:
            axes.set_ylabel("queries with at most this error [%]")
        columns = 1 if max(map(len, labels)) > _LONG else 2
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.24)}
        axes.legend(**place, ncols=columns, borderpad=0, columnspacing=1.2, fontsize=7.5, handlelength=2.2)
    return figure


def _cumulative(error: NDArray) -> tuple[NDArray, NDArray]:
    """Return the corners of the curve of one line: errors, and the share of queries in percent."""
    ordered = np.sort(error)
    keep = np.unique(np.linspace(0, len(ordered) - 1, min(len(ordered), _MOST_POINTS)).round().astype(np.int64))
    share = 100 * (keep + 1) / len(ordered)  # exact at each kept point
    if len(keep) == len(ordered):
        x, y = np.repeat(ordered, 2), np.concatenate([[0], np.repeat(share, 2)[:-1]])
    else:
        x, y = np.concatenate([ordered[:1], ordered[keep]]), np.concatenate([[0], share])
    beyond = 10 * max(float(ordered[-1]), 1.0)  # to the edge of the plot
    return np.append(np.maximum(x, 1e-9), beyond), np.append(y, 100.0)
