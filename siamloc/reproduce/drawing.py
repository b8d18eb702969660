"""Figures in the shape of the published ones: lines over a setting, or fields of colour over two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.errors import DataError
from siamloc.report.draw.look import DASHES, MARKS, PAPER, SERIES, TEXT, Picture, style
from siamloc.reproduce.published import Record, measures


@style()
def drawn(figures: Sequence[Mapping[str, Any]], records: Sequence[Record]) -> Picture:
    """Draw each panel of a recipe's figure.

    Args:
        figures: what is drawn: `measure`, `x`, `series` or `y`, `panels`, `where`.
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
    for one, (figure, title, part) in zip(axes, panels, strict=False):
        one.set_title(title)
        if "y" in figure:
            _field(one, figure, part)
        else:
            handles |= _lines(one, figure, part)
    if len(handles) > 1:
        fitting = max(2, int(1.6 * across))
        picture.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=min(fitting, len(handles)))
    return picture


def _panels(figure: Mapping[str, Any], records: Sequence[Record]) -> list[tuple[Mapping[str, Any], str, list[Record]]]:
    """Return the panels of a figure with their titles and records."""
    where = figure.get("where", {})
    names = [figure["x"], *([figure["y"]] if "y" in figure else [])]
    found = [
        one
        for one in records
        if one.measure == figure["measure"]
        and all(one.settings.get(key) == value for key, value in where.items())
        and all(name in one.settings for name in names)
    ]
    split = figure.get("panels")
    if split is None:
        return [(figure, _said(figure["measure"]), found)] if found else []
    split = [split] if isinstance(split, str) else split
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for one in found:
        groups.setdefault(tuple(one.settings.get(name) for name in split), []).append(one)
    return [
        (figure, ", ".join(_title(n, v) for n, v in zip(split, key, strict=True)), part) for key, part in groups.items()
    ]


def _title(name: str, value: Any) -> str:
    if name == "filter":
        return "with the homomorphic filter" if value else "without a filter"
    plain = name in ("descriptor", "distance", "data", "method")
    return str(value).replace("_", " ") if plain else f"{name.replace('_', ' ')} {value}"


def _lines(axes: Any, figure: Mapping[str, Any], records: Sequence[Record]) -> dict[str, Any]:
    x, factor = figure["x"], _factor(figure["measure"])
    series = figure.get("series", "descriptor")
    names = [series] if isinstance(series, str) else list(series)
    handles: dict[str, Any] = {}
    keys = list(dict.fromkeys(tuple(one.settings.get(name) for name in names) for one in records))
    for rank, key in enumerate(keys):
        part = sorted(
            (one for one in records if tuple(one.settings.get(name) for name in names) == key),
            key=lambda one: one.settings[x],
        )
        places = sorted({one.settings[x] for one in part})
        # Where other settings vary too, the line is the best of them, as the text speaks of it.
        pick = min if figure.get("best") == "min" else max if figure.get("best") == "max" else np.mean
        values = [pick([one.value for one in part if one.settings[x] == place]) for place in places]
        (line,) = axes.plot(
            places,
            [factor * value for value in values],
            color=SERIES[rank % len(SERIES)],
            marker=MARKS[rank % len(MARKS)],
            markersize=4,
            linestyle=DASHES[rank // len(SERIES) % len(DASHES)],
        )
        handles[", ".join(_title(n, v) for n, v in zip(names, key, strict=True))] = line
    if figure.get("log"):
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel=x.replace("_", " "), ylabel=f"{_said(figure['measure'])} {_bracket(figure['measure'])}".rstrip())
    axes.grid(True)
    if axes.get_ylim()[0] > 0:
        axes.set_ylim(0, 1.04 * axes.get_ylim()[1])
    return handles


def _field(axes: Any, figure: Mapping[str, Any], records: Sequence[Record]) -> None:
    xs, ys = (sorted({one.settings[figure[name]] for one in records}) for name in ("x", "y"))
    values = np.full((len(ys), len(xs)), np.nan)
    for one in records:
        values[ys.index(one.settings[figure["y"]]), xs.index(one.settings[figure["x"]])] = one.value
    values *= _factor(figure["measure"])
    low, high = (0.0, 100.0) if _unit(figure["measure"]) == "share" else (np.nanmin(values), np.nanmax(values))
    high = high if high > low else low + 1
    axes.imshow(values, cmap="Blues", vmin=low, vmax=high, origin="lower", aspect="auto")
    for row in range(len(ys)):
        for column in range(len(xs)):
            value = values[row, column]
            if np.isfinite(value):
                dark = (value - low) / (high - low) > 0.6
                text = f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"
                axes.text(column, row, text, ha="center", va="center", fontsize=7, color=PAPER if dark else TEXT)
    axes.set_xticks(range(len(xs)), [f"{x:g}" for x in xs])
    axes.set_yticks(range(len(ys)), [f"{y:g}" for y in ys])
    axes.set(xlabel=figure["x"], ylabel=figure["y"])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def _unit(measure: str) -> str:
    return str(measures().get(measure, {}).get("unit", "s" if measure.endswith("seconds") else ""))


def _factor(measure: str) -> float:
    """Return what numbers are drawn times: shares in percent, seconds in milliseconds."""
    return {"share": 100.0, "s": 1000.0}.get(_unit(measure), 1.0)


def _bracket(measure: str) -> str:
    unit = {"share": "%", "1": "", "s": "ms"}.get(_unit(measure), _unit(measure))
    return f"[{unit}]" if unit else ""


def _said(measure: str) -> str:
    return (
        "time"
        if measure == "seconds"
        else measure.removesuffix("_seconds").replace("_", " ") + (" time" if measure.endswith("_seconds") else "")
    )
