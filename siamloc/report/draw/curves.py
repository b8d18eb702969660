"""Measures drawn against a setting: nodes of a compact map, a threshold, a disturbance, or a swept setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator

from foundation.ordering import by_numbers
from siamloc.errors import ConfigError, DataError, hint
from siamloc.report.draw.look import (
    DASHES,
    FLOOR,
    INK,
    SERIES,
    SOFT,
    Picture,
    column,
    method_look,
    panels,
    series_look,
    shared_legend,
    style,
)

WAYS = {"spectral": "spectral clustering", "som": "self-organizing map", "sample": "plain sampling"}

_PAIRS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("same", "pairs of one room", {"color": SERIES[0], "linestyle": DASHES[1]}),
    ("different", "pairs of two rooms", {"color": SERIES[5], "linestyle": DASHES[2]}),
    ("overall", "all pairs", {"color": INK, "linewidth": 2.0}),
)
_STRENGTHS = {
    "noise": "variance of the noise",
    "occlusion": "columns behind bars [%]",
    "turn": "turned left by [degrees]",
    "effect": "strength",
}
_DISTURBANCES_ACROSS = 4
_NOISE_TICKS = (0, 0.1, 0.4, 1)  # of the largest variance: evenly spaced on a square-root axis
_LOG_FROM = 8  # ratio of the largest to the smallest setting from which the axis is logarithmic
_LINES_ACROSS = 3  # legend entries per row
_LETTERS_ACROSS = 80  # in a row of names, or of a legend


@style()
def compact_curves(measures: Mapping[str, Any]) -> Picture:
    """Draw three panels against the number of nodes: errors, silhouettes, and search time.

    As in [C] figures 6-8, 16-18, 20 and 21.

    Args:
        measures: `measures.compact` of `results.json`.
    """
    curves, unit = measures["curves"], measures["unit"]
    figure, (errors, shape, took) = panels(3, 3.2, 3.9, width_ratios=[1.5, 1, 1])
    top = 0.0
    ways = list(dict.fromkeys(one["way"] for one in curves))
    for i, way in enumerate(ways):
        entries = sorted((one for one in curves if one["way"] == way), key=lambda one: one["nodes"])
        nodes, look = column(entries, "nodes"), series_look(i)
        fine: dict[str, Any] = {"color": look["color"], "linestyle": DASHES[1], "linewidth": 1.1}
        for key, words, drawn in (("error", "position of the node", look), ("error_frames", "best frame in it", fine)):
            mean = column([one[key] for one in entries], "mean")
            errors.plot(nodes, mean, label=f"{WAYS[way]}: to the {words}", **drawn)
            top = max(top, float(np.nanmax(mean)))
        shape.plot(nodes, column(entries, "silhouette"), **look)
        shape.plot(nodes, column(entries, "descriptor_silhouette"), **fine)
        took.plot(nodes, 1000 * column(entries, "search_ms"), **look)
        floor = {**FLOOR, "color": look["color"]}
        errors.plot(nodes, column(entries, "floor"), label=f"{WAYS[way]}: floor, to the nearest node", **floor)
    errors.set(title="mean error", ylabel=f"[{unit}]", ylim=(0, 1.06 * top or 1))
    shape.set(title="silhouette", ylabel="full: positions, dashed: descriptors")
    took.set(title="time of a search", ylabel="[µs a query]", ylim=(0, None))
    for axes in (errors, shape, took):
        axes.set_xlabel("nodes")
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, steps=[1, 2, 5, 10]))
    shared_legend(figure, len(ways))
    return figure


@style()
def pair_curves(measures: Mapping[str, Any]) -> Picture:
    """Draw the share of pairs judged correctly against the threshold: for all pairs, and for each lighting.

    Args:
        measures: `measures.room_pairs` of `results.json`.
    """
    groups = {"all pairs": {**measures["overall"], "curve": measures["curve"]}}
    by_lighting = {label: group for label, group in measures["lighting"].items() if "curve" in group}
    groups |= by_lighting if len(by_lighting) > 1 else {}
    shared: dict[str, Any] = {"sharex": True, "sharey": True, "margin": (0.3, 0.6), "ylabel": "judged right [%]"}
    width = 3.0 if len(groups) > 1 else 4.6  # room for the legend
    figure, every = panels(len(groups), width, 2.3, **shared)
    for axes, (label, group) in zip(every, groups.items(), strict=True):
        for name, words, look in _PAIRS:
            axes.plot(column(group["curve"], "threshold"), 100 * column(group["curve"], name), label=words, **look)
        axes.axvline(measures["threshold"], color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        auc = "" if group.get("auc") is None else f", AUC {group['auc']:.3f}"
        axes.set(title=f"{label}{auc}", xlim=(0, 1), ylim=(0, 101.5))
    figure.supxlabel("threshold of the dissimilarity", fontsize=9)
    shared_legend(figure, len(_PAIRS), "outside upper center")
    return figure


@style()
def robustness_curves(measures: Mapping[str, Any]) -> Picture:
    """Draw panels for each disturbance: mean and median error, the share within the radius, and heading errors.

    Heading errors are those of the retrieved frame and, dashed, of the geometrically nearest frame; they have a panel
    if any are known.

    Args:
        measures: `measures.robustness` of `results.json`.
    """
    kinds, methods, unit = measures["disturbances"], measures["methods"], measures["unit"]
    entries = [entry for curves in methods.values() for one in curves.values() for entry in one]
    names = [f"error [{unit}]", f"within {measures['radius']:g} {unit} [%]", "heading [deg]\ndashed: nearest"]
    keys = (("mean", "median"), ("share",), ("heading", "heading_nearest"))
    tops = [1.06 * np.nan_to_num([column(entries, key) for key in row]).max() for row in keys]
    tops[1] = 104
    high = 3 if tops[2] > 0 else 2
    columns = min(len(kinds), _DISTURBANCES_ACROSS)
    blocks = -(-len(kinds) // columns)
    size = 2.5, (4.0 if high == 2 else 5.6) / high
    ratios = ([1.25] + [1] * (high - 1)) * blocks
    figure = Picture(figsize=(size[0] * columns + 0.9, size[1] * high * blocks + 0.9))
    every = figure.subplots(high * blocks, columns, squeeze=False, height_ratios=ratios)
    for place, kind in enumerate(kinds):
        block, at = divmod(place, columns)
        stack: list[Axes] = every[high * block : high * (block + 1), at].tolist()
        _disturbance(stack, kind, methods)
        for axes, label, top in zip(stack, names, tops, strict=False):
            axes.set_ylim(0, top or 1)
            axes.set_ylabel(label if not at else "")
            axes.tick_params(labelleft=not at)
    for axes in every[-high:, (len(kinds) - 1) % columns + 1 :].ravel():
        axes.remove()
    shared_legend(figure, min(2 * len(methods) + 1, 5))
    return figure


def _disturbance(stack: Sequence[Axes], kind: Mapping[str, Any], methods: Mapping[str, Any]) -> None:
    levels, floor = np.empty(0), np.empty(0)
    for i, (method, curves) in enumerate(methods.items()):
        entries = sorted(curves[kind["name"]], key=lambda entry: entry["level"])
        levels = column(entries, "level") * (100 if kind["kind"] == "occlusion" else 1)
        look: dict[str, Any] = series_look(i) | method_look(i) | {"linestyle": "-"}
        dashed = {**look, "linestyle": DASHES[1], "linewidth": 1.0, "marker": "", "alpha": 0.8}
        shown = method.replace("_", " ")
        stack[0].plot(levels, column(entries, "mean"), label=f"{shown}, mean", **look)
        stack[0].plot(levels, column(entries, "median"), label=f"{shown}, median", **dashed)
        stack[1].plot(levels, 100 * column(entries, "share"), **look)
        for key, line in (("heading", look), ("heading_nearest", dashed)) if len(stack) > 2 else ():
            if np.isfinite(column(entries, key)).any():
                stack[2].plot(levels, column(entries, key), **line)
        floor = column(entries, "floor")
    stack[0].plot(levels, floor, label="floor, mean", zorder=2, **FLOOR)
    name = kind["name"].replace("_", " ")
    stack[0].set_title(name if kind["kind"] != "effect" else f"effect: {name}")
    largest = max(kind["levels"])
    for axes in stack:
        axes.tick_params(labelbottom=axes is stack[-1])
        axes.grid(True)
        if kind["kind"] == "turn" and largest >= 90:
            axes.xaxis.set_major_locator(MultipleLocator(45 if largest <= 270 else 90))
        if kind["kind"] == "noise":
            # The eye sees deviations, not variances; the published levels would otherwise crowd on the left.
            axes.set_xscale("function", functions=(_root, np.square))
            axes.set_xticks([round((largest or 1.0) * part, 6) for part in _NOISE_TICKS])
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlim(0, 1.08 * (largest or 1.0))
    stack[-1].set_xlabel(_STRENGTHS.get(kind["kind"], kind.get("unit", "level")))


def _root(values: Any) -> Any:
    return np.sqrt(np.maximum(values, 0))


@style()
def swept_curves(
    rows: Sequence[Mapping[str, Any]],
    settings: Sequence[str],
    by: str,
    against: str | None = None,
    *,
    highest: bool = False,
    unit: str = "",
) -> Picture:
    """Draw a measure of a sweep against a setting, with a line for each combination of the other settings.

    Against a setting that holds names there are points without lines, and settings that follow from the name, such as
    the distance of a descriptor, are left out.

    Args:
        rows: for each training or evaluation, its settings and the measure; NaN if unknown.
        settings: names of the settings that differ, keys of `rows`.
        by: name of the measure, a key of `rows`, such as "error".
        against: the setting on the x axis; if None, the first numeric setting other than a seed, or else the first.
        highest: whether the highest value is the best.
        unit: unit of the measure; "" if it has none.

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
    numbers = [name for name in settings if all(type(row[name]) in (int, float) for row in rows)]
    if against is None:
        against = min(numbers or settings[:1], key=lambda name: name.endswith("seed"))
    elif against not in settings:
        raise ConfigError(f"{against!r} does not differ: {hint(against, settings)}")
    numeric = against in numbers
    shown = {row[against] if numeric else _shown(row[against]) for row in usable}
    values: list[Any] = sorted(shown, key=None if numeric else by_numbers)
    places = {_shown(value): value if numeric else number for number, value in enumerate(values)}
    others = [name for name in settings if name != against and (numeric or not _follows(usable, name, against))]
    lines: dict[str, list[tuple[Any, float]]] = {}
    for row in sorted(usable, key=lambda row: [by_numbers(_shown(row[name])) for name in others]):
        known = [name for name in others if row[name] is not None] or others  # a line without a name has no entry
        label = fill(", ".join(f"{name}={_shown(row[name])}" for name in known), _LETTERS_ACROSS)
        lines.setdefault(label, []).append((places[_shown(row[against])], row[by]))
    across = int(np.clip(_LETTERS_ACROSS // (max(map(len, lines)) + 6), 1, _LINES_ACROSS))
    tall = sum(len(label.splitlines()) for label in lines)
    longest = max(map(len, places))
    turned = not numeric and (longest + 2) * len(places) > _LETTERS_ACROSS
    size = max(6.4, 0.24 * len(places) + 1) if turned else 6.4, 4.0 + 0.055 * longest * turned
    figure, (axes,) = panels(1, size[0], size[1] + 0.2 * (tall // across))
    for i, (label, points) in enumerate(lines.items()):
        look = {**series_look(i), **({} if numeric else {"linestyle": "none", "markersize": 5})}
        axes.plot(*zip(*sorted(points), strict=True), label=label, **look)
    best = (max if highest else min)(row[by] for row in usable)
    ringed = [places[_shown(row[against])] for row in usable if row[by] == best]
    ring: dict[str, Any] = {"marker": "o", "markersize": 10, "markerfacecolor": "none", "markeredgecolor": INK}
    axes.plot(ringed, [best] * len(ringed), linestyle="none", label=f"best: {best:.4g}", **ring)
    if numeric and min(values) > 0 and max(values) >= _LOG_FROM * min(values):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_xticks([], minor=True)
    if not numeric or len(values) <= 12:
        words: dict[str, Any] = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"} if turned else {}
        axes.set_xticks(list(places.values()), [_shown(value) for value in values], **words)
    measure = f"{by} [{unit}]" if unit else by
    axes.set(xlabel=against, ylabel=f"{measure} ({'higher' if highest else 'lower'} is better)")
    shared_legend(figure, across)
    return figure


def _follows(rows: Sequence[Mapping[str, Any]], name: str, other: str) -> bool:
    """Whether a setting has only one value for each value of another one."""
    pairs = {(_shown(row[other]), _shown(row[name])) for row in rows}
    return len(pairs) == len({of for of, _ in pairs})


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
