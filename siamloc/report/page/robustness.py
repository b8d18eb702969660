"""The section about robustness: errors against the strength of the disturbance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.page import tables
from siamloc.report.page.markup import Content, Markup, count, number, percent, section, tag
from siamloc.report.page.parts import Part

_TITLES = {"noise": "Noise", "occlusion": "Occlusion", "turn": "Turn on the spot"}
_LEVELS = {"noise": "variance", "occlusion": "columns", "turn": "turned left", "effect": "strength"}


def robustness(part: Part) -> Markup | None:
    """Return curves and a table for each disturbance; None for another task."""
    found = part.evaluation.results["measures"].get("robustness")
    if found is None:
        return None
    return robustness_section("Robustness", found, part.figure("robustness", "errors of disturbed queries"))


def robustness_section(title: str, found: Mapping[str, Any], figure: Markup | None) -> Markup:
    """Return the section about one or several methods.

    Args:
        title: title of the section.
        found: `measures.robustness` of `results.json`.
        figure: the curves.
    """
    unit, radius = found["unit"], found["radius"]
    every = "" if found["every"] == 1 else f", one in {found['every']} of all"
    text = (
        f"{count(found['queries'])} queries{every}, with disturbed images, in a map of {count(found['map_frames'])} "
        "undisturbed frames. Solid lines are mean errors, dashed ones medians; for headings, solid lines refer to "
        "the retrieved frame, dashed ones to the geometrically nearest map frame. The tables give the "
        f"mean error and the share of the queries within {radius:g} {unit}."
    )
    width = f"--table:{90 + 96 * len(found['methods'])}px"
    blocks = (tag("div", tag("h4", _title(kind)), _table(kind, found)) for kind in found["disturbances"])
    return section(
        title, tag("p.caption", text), figure, tag("div.disturbances", *blocks, style=width), name="robustness"
    )


def _title(kind: Mapping[str, Any]) -> str:
    return _TITLES.get(kind["kind"], f"Effect: {kind['name'].replace('_', ' ')}")


def _table(kind: Mapping[str, Any], found: Mapping[str, Any]) -> Markup:
    methods = found["methods"]
    rows = []
    for level in sorted(kind["levels"]):
        cells: list[Content] = []
        for curves in methods.values():
            entry = next(entry for entry in curves[kind["name"]] if entry["level"] == level)
            cells.append(tag("span", number(entry["mean"], 2), tag("small", f" {percent(entry['share'])}")))
        rows.append((_level(kind, level), cells))
    heads = [_LEVELS[kind["kind"]], *(f"{method.replace('_', ' ')} [{found['unit']}]" for method in methods)]
    return tables.grid(heads, rows, "levels")


def _level(kind: Mapping[str, Any], level: float) -> str:
    if kind["kind"] == "occlusion":
        return f"{100 * level:g} %"
    return f"{level:g}°" if kind["kind"] == "turn" else f"{level:g}"
