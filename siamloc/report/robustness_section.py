"""The part of a report page about robustness: errors against how much the queries were disturbed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.report import tables
from siamloc.report.curves import method_look
from siamloc.report.gathered import Evaluation
from siamloc.report.markup import Content, Markup, count, number, percent, tag
from siamloc.report.parts import section
from siamloc.report.svg import DASHES, MARKS, Axis, Line, chart, legend_of

_TITLES = {"noise": "Noise", "occlusion": "Occlusion", "turn": "Turn on the spot"}
_AXES = {
    "noise": "variance, images in [0, 1]",
    "occlusion": "columns behind bars [%]",
    "turn": "turned left by [degrees]",
    "effect": "strength",
}
_ROOT_TICKS = (0, 0.1, 0.4, 1)  # of the largest variance: they stand evenly on an axis of square roots
_MOST_METHODS = 8
_BESIDE_CHARTS = 3  # methods whose table fits beside the charts; a wider one stands below


def robustness(evaluation: Evaluation) -> Markup | None:
    """Return curves and a table for each disturbance; None for another task."""
    found = evaluation.results["measures"].get("robustness")
    return None if found is None else _section("Robustness", found, found["methods"])


def compared_robustness(evaluations: Mapping[str, Evaluation]) -> Markup | None:
    """Return the curves of several evaluations in one part; None for fewer than two.

    Disturbances that not all have measured at the same levels are left out.

    Args:
        evaluations: by title.
    """
    found = {title: e.results["measures"].get("robustness") for title, e in evaluations.items()}
    found = {title: one for title, one in found.items() if one is not None}
    if len(found) < 2:
        return None
    first = next(iter(found.values()))
    same = [kind for kind in first["disturbances"] if all(kind in one["disturbances"] for one in found.values())]
    if not same or len({_identity(one) for one in found.values()}) > 1:
        text = "Robustness was measured on different queries, maps or levels in these evaluations, and is not compared."
        return section("Robustness compared", tag("p.note", text), name="robustness")
    methods = {title: next(iter(one["methods"].values())) for title, one in list(found.items())[:_MOST_METHODS]}
    return _section("Robustness compared", {**first, "disturbances": same}, methods)


def _identity(found: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what is the same for equal queries in equal maps; their floor tells buildings and drives apart."""
    entry = next(iter(next(iter(found["methods"].values())).values()))[0]
    return (*(found[key] for key in ("unit", "radius", "queries", "map_frames")), round(entry["floor"], 6))


def _section(title: str, found: Mapping[str, Any], methods: Mapping[str, Any]) -> Markup:
    unit, radius = found["unit"], found["radius"]
    every = "" if found["every"] == 1 else f", one in {found['every']} of all"
    text = (
        f"{count(found['queries'])} queries{every}, with disturbed images, in a map of {count(found['map_frames'])} "
        f"frames that stays as it is. Full lines are mean errors, dashed ones medians. The "
        f"tables give the mean error and the share of the queries within {radius:g} {unit}."
    )
    top = max(entry["mean"] for curves in methods.values() for one in curves.values() for entry in one)
    entries = [_line(name, i, np.zeros(1), np.zeros(1)) for i, name in enumerate(methods)]
    entries.append(Line("floor, mean", np.zeros(1), np.zeros(1), "soft", DASHES[2]))
    return section(
        title,
        tag("p.caption", text),
        legend_of(entries),
        *(_disturbance(kind, found, methods, 1.06 * top if top > 0 else 1.0) for kind in found["disturbances"]),
        name="robustness",
    )


def _disturbance(kind: Mapping[str, Any], found: Mapping[str, Any], methods: Mapping[str, Any], top: float) -> Markup:
    """Return the curves of errors and shares, and their numbers."""
    unit, radius = found["unit"], found["radius"]
    times = 100 if kind["kind"] == "occlusion" else 1
    x = _axis(kind, times)
    errors, shares = [], []
    entries: Sequence[Mapping[str, Any]] = ()
    for i, (method, curves) in enumerate(methods.items()):
        entries = sorted(curves[kind["name"]], key=lambda entry: entry["level"])
        levels = times * _column(entries, "level")
        colour = method_look(i)[0]
        errors.append(Line(f"{method}, median", levels, _column(entries, "median"), colour, DASHES[1]))
        errors.append(_line(method, i, levels, _column(entries, "mean")))
        shares.append(_line(method, i, levels, 100 * _column(entries, "share")))
    errors.insert(0, Line("floor", times * _column(entries, "level"), _column(entries, "floor"), "soft", DASHES[2]))
    title = _TITLES.get(kind["kind"], f"Effect: {kind['name'].replace('_', ' ')}")
    many = len(methods) > _BESIDE_CHARTS
    return tag(
        "div.disturbance.many" if many else "div.disturbance",
        tag("h4", title),
        chart("error", errors, x, Axis(f"error [{unit}]", 0, top), 340, 226, legend=False),
        chart(f"share within {radius:g} {unit}", shares, x, Axis("queries [%]", 0, 100), 340, 226, legend=False),
        _table(kind, found, methods),
        style=f"--table: {76 + 104 * len(methods)}px",  # all tables as wide, so that the charts stand in columns
    )


def _table(kind: Mapping[str, Any], found: Mapping[str, Any], methods: Mapping[str, Any]) -> Markup:
    heads = [_AXES[kind["kind"]].partition(" [")[0].partition(",")[0]]
    heads += [f"{method} [{found['unit']}]" for method in methods]
    rows = []
    for level in sorted(kind["levels"]):
        cells: list[Content] = []
        for curves in methods.values():
            entry = next(entry for entry in curves[kind["name"]] if entry["level"] == level)
            cells.append(tag("span", number(entry["mean"], 2), tag("small", f" {percent(entry['share'])}")))
        rows.append((_level(kind, level), cells))
    return tables.grid(heads, rows, "levels")


def _level(kind: Mapping[str, Any], level: float) -> str:
    if kind["kind"] == "occlusion":
        return f"{100 * level:g} %"
    return f"{level:g}°" if kind["kind"] == "turn" else f"{level:g}"


def _axis(kind: Mapping[str, Any], times: int) -> Axis:
    levels = [times * level for level in kind["levels"]]
    label, low, high = _AXES[kind["kind"]], min(levels), max(levels)
    if kind["kind"] == "noise":
        # Deviations, not variances, are what one sees; the published levels would crowd at the left otherwise.
        high = high or 1.0
        return Axis(label, 0, high, root=True, at=tuple(round(high * share, 6) for share in _ROOT_TICKS))
    low, high = min(low, 0.0), high if high > low else low + 1
    if kind["kind"] == "turn" and high - low >= 90:
        step = 45 if high - low <= 270 else 90
        at = range(int(-(-low // step)) * step, int(high // step) * step + 1, step)
        return Axis(label, low, high, at=tuple(map(float, at)))
    return Axis(label, low, high)


def _line(label: str, rank: int, x: np.ndarray, y: np.ndarray) -> Line:
    return Line(label.replace("_", " "), x, y, method_look(rank)[0], mark=list(MARKS)[rank % len(MARKS)])


def _column(entries: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    return np.array([np.nan if entry[name] is None else entry[name] for entry in entries], dtype=np.float64)
