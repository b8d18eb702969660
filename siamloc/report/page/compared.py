"""The comparison of several evaluations at the top of a page: tables, curves, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.report.draw.curves import robustness_curves
from siamloc.report.draw.errors import compared_curves
from siamloc.report.page.gathered import Evaluation
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Markup, grid, section, tag
from siamloc.report.page.parts import Part
from siamloc.report.page.tasks import robustness_section
from siamloc.results import Columns, finest
from siamloc.summaries import middle_recall
from siamloc.tables import NOTHING, Column, Table, count, percent

_MOST_METHODS = 8

Frames = set[tuple[Any, ...]]


def comparison(parts: list[Part]) -> Markup | None:
    """Return the tables and curves of what several evaluations measured; None if nothing was measured twice."""
    measured = [part for part in parts if part.evaluation.measured]
    disturbed = _robustness({part.method: part.evaluation for part in parts if part.evaluation.kind == "robustness"})
    own = _localization(measured) if len(measured) > 1 else None
    return tag("article.overview", own, disturbed) if own or disturbed else None


def differences(evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Return what makes evaluations hard to compare, one sentence for each that differs from the first.

    Frames are the same if the ends of their paths and their positions (where known) are: the data set's location, the
    order of the frames and the descriptor do not matter.

    Args:
        evaluations: evaluations by title.
    """
    first, *others = evaluations
    found = []
    for title in others:
        one, other = evaluations[first], evaluations[title]
        differing = [_queries(one, other), _maps(one, other)]
        if what := " and ".join(filter(None, differing)):
            found.append(f"Take care when comparing {title} with {first}: they differ in their {what}.")
    return found


def _localization(parts: list[Part]) -> Markup:
    """Return the table of all evaluations and their curves, with warnings if they are not comparable."""
    evaluations = {part.title: part.evaluation for part in parts}
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
    return section(
        "Comparison", grid(_compared(parts)), *(tag("p.note", note) for note in notes), *curves, name="compared"
    )


def _compared(parts: list[Part]) -> Table:
    """Return a table with a row for each evaluation: errors of its finest estimates, over all queries and by lighting.

    Columns in which the evaluations do not differ, such as the protocol, are left out.
    """
    lightings = list(dict.fromkeys(label for part in parts for label in part.evaluation.lightings))
    units = list(dict.fromkeys(part.evaluation.unit for part in parts if part.evaluation.absolute is not None))
    unit = units[0] if len(units) == 1 else ""
    columns = (
        *(Column("run"), Column("map", form="count"), Column("queries", form="count")),
        *(Column("protocol"), Column("unit"), Column("estimate"), Column("mean", unit, 3)),
        *(Column(f"mean, {label}", form=3) for label in lightings),
        *(Column(name, unit, 3) for name in ("median", "95 %", "floor", "excess")),
        *(Column("recall@1"), Column("heading", "deg", 1), Column("room retrieved", form="percent")),
    )
    rows = [_row(part, lightings) for part in parts]
    finer = any(part.evaluation.finest[1] for part in parts)
    hidden = {
        *(["protocol"] if len({row[3] for row in rows}) == 1 else []),
        *(["unit"] if len(units) < 2 else []),
        *([] if finer else ["estimate"]),
    }
    used = [i for i, column in enumerate(columns) if column.name not in hidden]
    shown = tuple(tuple(row[i] for i in used) for row in rows)
    return Table("comparison", tuple(columns[i] for i in used), shown)


def _row(part: Part, lightings: list[str]) -> list[Any]:
    """Return the row of an evaluation in the table of all."""
    evaluation = part.evaluation
    absolute, rooms, (finest_, estimate) = evaluation.absolute, evaluation.rooms, evaluation.finest
    overall: Mapping[str, Any] = (finest_ or {}).get("overall", {})
    by_lighting = (finest_ or {}).get("lighting", {})
    queries = (overall or (rooms or {}).get("overall", {})).get("queries", 0)
    recall = middle_recall(overall)

    def mean(group: Mapping[str, Any], key: str = "error", which: str = "mean") -> float | None:
        return group.get(key, {}).get(which)

    return [
        tag("a", part.title, href=f"#{part.anchor}"),
        (absolute or {}).get("map_frames"),
        queries,
        str(evaluation.results.get("protocol") or NOTHING).replace("_", " "),
        evaluation.unit if absolute else None,
        estimate or "single frame",
        mean(overall),
        *(mean(by_lighting.get(label, {})) for label in lightings),
        *(mean(overall, which=which) for which in ("median", "p95")),
        *(mean(overall, key) for key in ("floor", "excess")),
        recall and f"{percent(recall['recall'])}, {recall['radius']:g} {evaluation.unit}",
        mean(overall, "heading_error"),
        rooms and rooms["overall"]["accuracy"],
    ]


def _robustness(evaluations: Mapping[str, Evaluation]) -> Markup | None:
    """Return the curves of several evaluations in one section; None for fewer than two.

    Disturbances that were not measured at the same levels in all of them are left out.
    """
    found = {title: evaluation.results["measures"]["robustness"] for title, evaluation in evaluations.items()}
    if len(found) < 2:
        return None
    first = next(iter(found.values()))
    same = [kind for kind in first["disturbances"] if all(kind in one["disturbances"] for one in found.values())]
    if not same or len({_basis(one) for one in found.values()}) > 1:
        text = "Robustness is not compared: these evaluations measured it on different queries, maps or levels."
        return section("Robustness compared", tag("p.note", text), name="robustness")
    methods = {title: next(iter(one["methods"].values())) for title, one in list(found.items())[:_MOST_METHODS]}
    together = {**first, "disturbances": same, "methods": methods}
    figure = inline(robustness_curves(together), "compared-robustness", "errors of disturbed queries")
    return robustness_section("Robustness compared", together, figure)


def _basis(found: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return values that agree for equal queries in equal maps; the floor differs between buildings and drives."""
    entry = next(iter(next(iter(found["methods"].values())).values()))[0]
    return (*(found[key] for key in ("unit", "radius", "queries", "map_frames")), round(entry["floor"], 6))


def _difference(what: str, one: Frames, other: Frames) -> str:
    """Return how two sets of frames differ; "" if they are the same."""
    if one == other:
        return ""
    return f"{what} ({count(len(other))} and {count(len(one))}, {count(len(one & other))} of them in common)"


def _queries(one: Evaluation, other: Evaluation) -> str:
    if one.queries is not None and other.queries is not None:
        return _difference("queries", _frames(one.queries), _frames(other.queries))
    rooms = [evaluation.tables.get("rooms") for evaluation in (one, other)]
    return _difference("queries", _frames(rooms[0]), _frames(rooms[1])) if rooms[0] and rooms[1] else ""


def _maps(one: Evaluation, other: Evaluation) -> str:
    if one.known is not None and other.known is not None:
        return _difference("map frames", _frames(one.known), _frames(other.known))
    # Results without a map's frames still record which frames were selected.
    chosen = [((e.results.get("config") or {}).get("protocol") or {}).get("map") for e in (one, other)]
    return "map frames (protocol.map)" if None not in chosen and chosen[0] != chosen[1] else ""


def _frames(columns: Columns) -> Frames:
    """Return the identity of frames: folder and file name, and position."""
    ends = [PurePath(path).parts[-2:] for path in columns["path"].tolist()]
    places = zip(_rounded(columns, "x"), _rounded(columns, "y"), strict=True)
    return {(*end, *place) for end, place in zip(ends, places, strict=True)}


def _rounded(columns: Columns, name: str) -> list[float | None]:
    values: NDArray[np.float64] = columns.get(name, np.full(len(columns["path"]), np.nan))
    return [None if value != value else value for value in np.round(values, 6).tolist()]
