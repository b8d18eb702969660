"""Hierarchical localization: mean errors by kind of query, from the floor to a wrong node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.draw.look import GRID, INK, SERIES, SOFT, Picture, error_limits, scale_errors, style

# Label, path of the mean in a group, and the marker.
_ERRORS: tuple[tuple[str, tuple[str, ...], dict[str, Any]], ...] = (
    ("floor", ("floor",), {"color": SOFT, "marker": "|", "markersize": 11, "markeredgewidth": 2.5}),
    ("whole map", ("absolute", "error"), {"color": SERIES[0], "marker": "s"}),
    ("perfect nodes", ("perfect_coarse", "error"), {"color": SERIES[4], "marker": "D"}),
    ("right node", ("given_right", "error"), {"color": SERIES[3], "marker": "^"}),
    ("wrong node", ("given_wrong", "error"), {"color": SERIES[5], "marker": "v"}),
    ("hierarchical", ("error",), {"color": INK, "marker": "o", "markersize": 8}),
)


@style()
def node_errors(found: Mapping[str, Any]) -> Picture:
    """Draw a row of mean errors for each lighting, and one for all queries.

    Args:
        found: `measures.hierarchical` of `results.json`.
    """
    groups = dict(found["lighting"])
    if len(groups) != 1:
        groups["all queries"] = found["overall"]
    figure = Picture(figsize=(9.0, 0.36 * len(groups) + 1.2))
    axes = figure.add_subplot()
    values = {label: [mean(group, path) for _, path, _ in _ERRORS] for label, group in groups.items()}
    known = [[value for value in row if value is not None] for row in values.values()]
    for place, row in enumerate(known):
        axes.plot([min(row), max(row)], [place, place], color=GRID, linewidth=4, solid_capstyle="round", zorder=1)
    for i, (label, _, look) in enumerate(_ERRORS):
        points = [(row[i], place) for place, row in enumerate(values.values()) if row[i] is not None]
        x, y = zip(*points, strict=True) if points else ((), ())
        axes.plot(x, y, label=label, linestyle="none", **{"markersize": 7, "markeredgewidth": 0, "zorder": 3, **look})
    scale_errors(axes.xaxis, error_limits(known, lowest=0), f"mean error [{found['unit']}]")
    axes.set_yticks(range(len(groups)), list(groups))
    axes.set_ylim(len(groups) - 0.4, -0.6)
    axes.grid(True, axis="x")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    figure.legend(loc="outside lower center", ncols=len(_ERRORS))
    return figure


def mean(group: Mapping[str, Any], path: tuple[str, ...]) -> float | None:
    """Return a mean of a group of measures, such as ("given_right", "error"); None if there is none."""
    value: Any = group
    for key in path:
        value = value[key]
    return None if value["mean"] is None else float(value["mean"])
