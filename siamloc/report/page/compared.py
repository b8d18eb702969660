"""The comparison of several evaluations at the top of a page: tables, curves, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from siamloc.report.draw.errors import compared_curves
from siamloc.report.page.gathered import Evaluation
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Markup, grid, section, tag
from siamloc.report.page.parts import Part
from siamloc.results import Columns, finest
from siamloc.summaries import measured, middle_recall
from siamloc.tables import NOTHING, Column, Table, count, percent

_SINGLE = "single frame"


def comparison(parts: list[Part]) -> Markup | None:
    """Return the tables, curves and warnings that compare evaluations of poses or rooms; None without two of them."""
    scored = [part for part in parts if part.evaluation.measured]
    if len(scored) < 2:
        return None
    evaluations = {part.title: part.evaluation for part in scored}
    notes = differences(evaluations)
    if len({str(evaluation.results.get("protocol")) for evaluation in evaluations.values()}) > 1:
        text = "These evaluations follow different protocols: their errors must not be compared with each other."
        notes.insert(0, text)
    by_unit: dict[str, dict[str, Columns]] = {}
    for title, evaluation in evaluations.items():
        if evaluation.queries is not None and len(evaluation.queries["error"]):
            by_unit.setdefault(evaluation.unit, {})[title] = finest(evaluation.queries)[0]
    curves = [
        inline(compared_curves(columns, unit), f"compared-{i}", "cumulative errors of all evaluations")
        for i, (unit, columns) in enumerate(by_unit.items())
    ]
    warnings = [tag("p.note", note) for note in notes]
    tables = map(grid, _compared(scored))
    return tag("article.overview", section("Comparison", *tables, *warnings, *curves, name="compared"))


def differences(evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Return a warning for evaluations whose queries or map frames differ from those of the first evaluation.

    Evaluations that differ from it in the same way share a warning. Frames are the same if the ends of their paths are
    the same, and their positions where known. The folder of the data set, the order of the frames and the descriptor do
    not matter.

    Args:
        evaluations: results of two or more evaluations, by the title that the sentences use.
    """
    (first, one), *others = evaluations.items()
    found: dict[str, list[str]] = {}
    for title, other in others:
        table = "rooms" if one.queries is None or other.queries is None else "queries"
        queries = _difference("queries", one.tables.get(table), other.tables.get(table))
        maps = _difference("map frames", one.known, other.known)
        if one.known is None or other.known is None:  # their settings still say which frames were selected
            chosen = [((e.results.get("config") or {}).get("protocol") or {}).get("map") for e in (one, other)]
            maps = "map frames (protocol.map)" if None not in chosen and chosen[0] != chosen[1] else ""
        if queries or maps:
            what = " and ".join(filter(None, [queries, maps]))
            found.setdefault(what, []).append(title)
    return [
        f"Take care when comparing {', '.join(titles)} with {first}: they differ in their {what}."
        for what, titles in found.items()
    ]


def _compared(parts: list[Part]) -> list[Table]:
    """Return the table with a row for each evaluation: errors of its finest estimates, of all queries and by lighting.

    Columns without a value, and those in which the evaluations do not differ, such as the protocol, are left out.
    """
    scored = [part.evaluation.absolute or part.evaluation.rooms or {} for part in parts]
    lightings = list(dict.fromkeys(label for measures in scored for label in measures.get("lighting", {})))
    rows = [((tag("a", part.title, href=f"#{part.anchor}"),), _measures(part, lightings)) for part in parts]
    values = {name: {row[name] for _, row in rows} - {None} for name in ("protocol", "unit", "estimate")}
    values["estimate"].add(_SINGLE)  # another estimate is named even if all evaluations have it
    differing = [name for name, every in values.items() if len(every) > 1]
    unit = "" if "unit" in differing else "".join(values["unit"])
    columns: list[tuple[Column, str]] = [
        *((Column(name, form="count"), name) for name in ("map", "queries")),
        *((Column(name), name) for name in differing),
        (Column("mean", unit, 3), "error.mean"),
        *((Column(f"mean, {label}", unit, 3), f"lighting.{i}.error.mean") for i, label in enumerate(lightings)),
        *((Column(name, unit, 3), f"error.{key}") for name, key in (("median", "median"), ("95 %", "p95"))),
        *((Column(name, unit, 3), f"{name}.mean") for name in ("floor", "excess")),
        *((Column("recall@1"), "recall@1"), (Column("heading", "deg", 1), "heading_error.mean")),
        (Column("room retrieved", form="percent"), "rooms.overall.accuracy"),
    ]
    return measured("comparison", ("run",), columns, rows)


def _measures(part: Part, lightings: list[str]) -> dict[str, Any]:
    """Return the measures of an evaluation for its row in the table of all."""
    evaluation = part.evaluation
    absolute, rooms, (finest_, estimate) = evaluation.absolute, evaluation.rooms, evaluation.finest
    overall: Mapping[str, Any] = (finest_ or {}).get("overall", {})
    recall = middle_recall(overall)
    return {
        **overall,
        "map": (absolute or {}).get("map_frames"),
        "queries": (overall or (rooms or {}).get("overall", {})).get("queries", 0),
        "protocol": str(evaluation.results.get("protocol") or NOTHING).replace("_", " "),
        "unit": evaluation.unit if absolute else None,
        "estimate": estimate or _SINGLE,
        "lighting": [(finest_ or {}).get("lighting", {}).get(label) for label in lightings],
        "recall@1": recall and f"{percent(recall['recall'])}, {recall['radius']:g} {evaluation.unit}",
        "rooms": rooms,
    }


def _difference(what: str, one: Columns | None, other: Columns | None) -> str:
    """Return how the frames of two tables differ; "" if they are the same, or if a table is missing."""
    if one is None or other is None or (first := _frames(one)) == (second := _frames(other)):
        return ""
    return f"{what} ({count(len(second))} and {count(len(first))}, {count(len(first & second))} of them in common)"


def _frames(columns: Columns) -> set[tuple[Any, ...]]:
    """Return what identifies each frame: folder and file name, and position, infinite where unknown."""
    ends = [PurePath(path).parts[-2:] for path in columns["path"].tolist()]
    unknown = np.full(len(ends), np.nan)
    x, y = (np.nan_to_num(np.round(columns.get(axis, unknown), 6), nan=np.inf).tolist() for axis in "xy")
    return set(zip(ends, x, y, strict=True))
