"""The comparison of several evaluations at the top of a page: tables, curves, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.comparable import doubts
from siamloc.report.draw.errors import compared_curves
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Markup, grid, section, tag
from siamloc.report.page.parts import Part
from siamloc.results import Columns, finest
from siamloc.summaries import measured, middle_recall
from siamloc.tables import NOTHING, Column, Table, percent

_SINGLE = "single frame"


def comparison(parts: list[Part]) -> Markup | None:
    """Return the tables, curves and warnings that compare evaluations of poses or rooms; None without two of them."""
    scored = [part for part in parts if part.evaluation.measured]
    if len(scored) < 2:
        return None
    evaluations = {part.title: part.evaluation for part in scored}
    notes = doubts({title: (evaluation.results, evaluation.tables) for title, evaluation in evaluations.items()})
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
