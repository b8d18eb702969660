"""Results of a sweep: a measure against one setting, with a line for each combination of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.errors import ConfigError, DataError, hint
from siamloc.report.draw.look import DASHES, INK, MARKS, SERIES, Picture, style

_LOG_FROM = 8  # ratio of the largest to the smallest setting from which the axis is logarithmic
_MOST_ACROSS = 3  # legend entries per row


@style()
def swept_curves(
    rows: Sequence[Mapping[str, Any]],
    settings: Sequence[str],
    by: str,
    against: str | None = None,
    *,
    highest: bool = False,
) -> Picture:
    """Draw a measure against a setting, with the best value marked.

    Args:
        rows: for each training or evaluation, its settings and the measure; NaN if unknown.
        settings: names of the settings that differ.
        by: name of the measure.
        against: the setting on the x axis; if None, the first numeric one other than a seed, or else the first.
        highest: whether the highest value is the best.

    Raises:
        ConfigError: a setting that does not differ.
        DataError: no setting differs, or the measure is unknown for all rows.

    Example:
        >>> rows = [{"bins": 8, "error": 0.4}, {"bins": 16, "error": 0.3}]
        >>> swept_curves(rows, ["bins"], "error").axes[0].get_xlabel()
        'bins'
    """
    usable = [row for row in rows if np.isfinite(row[by])]
    if not settings or not usable:
        what = f"{by} is not known of any" if settings else "there is no setting in which they differ"
        raise DataError(f"there is nothing to draw: {what}")
    if against is not None and against not in settings:
        raise ConfigError(f"{against!r} does not differ: {hint(against, settings)}")
    against = _first(rows, settings) if against is None else against
    numeric = _is_numeric(rows, against)
    values: list[Any] = sorted({row[against] if numeric else _shown(row[against]) for row in usable})
    places = {_shown(value): value if numeric else number for number, value in enumerate(values)}
    others = [name for name in settings if name != against]
    lines: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in usable:
        lines.setdefault(tuple(_shown(row[name]) for name in others), []).append(row)
    figure = Picture(figsize=(6.4, 4.0 + 0.2 * (len(lines) // _MOST_ACROSS)))
    axes = figure.subplots()
    for i, (combination, members) in enumerate(sorted(lines.items())):
        points = sorted((places[_shown(row[against])], row[by]) for row in members)
        label = ", ".join(f"{name}={value}" for name, value in zip(others, combination, strict=True))
        look: dict[str, Any] = {"color": SERIES[i % len(SERIES)], "marker": MARKS[i % len(MARKS)], "markersize": 4}
        axes.plot(*zip(*points, strict=True), linestyle=DASHES[i // len(SERIES) % len(DASHES)], label=label, **look)
    best = (max if highest else min)(usable, key=lambda row: row[by])
    ring: dict[str, Any] = {"marker": "o", "markersize": 10, "markerfacecolor": "none", "markeredgecolor": INK}
    axes.plot([places[_shown(best[against])]], [best[by]], linestyle="none", label=f"best: {best[by]:.4g}", **ring)
    if numeric and min(values) > 0 and max(values) >= _LOG_FROM * min(values):
        axes.set_xscale("log")
        axes.set_xticks([], minor=True)
    if not numeric or len(values) <= 12:
        axes.set_xticks(list(places.values()), [_shown(value) for value in values])
    better = "higher" if highest else "lower"
    axes.set(xlabel=against, ylabel=f"{by} ({better} is better)")
    axes.grid(True)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=_MOST_ACROSS)
    return figure


def _first(rows: Sequence[Mapping[str, Any]], settings: Sequence[str]) -> str:
    """Return the first numeric setting, seeds last; the first of all if none is numeric."""
    numeric = [name for name in settings if _is_numeric(rows, name)]
    return min(numeric, key=lambda name: name.endswith("seed")) if numeric else settings[0]


def _is_numeric(rows: Sequence[Mapping[str, Any]], name: str) -> bool:
    return all(isinstance(row[name], int | float) and not isinstance(row[name], bool) for row in rows)


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
