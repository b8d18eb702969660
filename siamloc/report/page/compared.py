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
from siamloc.summaries import measured, middle_recall
from siamloc.tables import NOTHING, Column, Table, count, percent

_MOST_METHODS = 8
_SINGLE = "single frame"

Frames = set[tuple[Any, ...]]


def comparison(parts: list[Part]) -> Markup | None:
    """Return the tables and curves of what several evaluations measured; None if nothing was measured twice."""
    scored = [part for part in parts if part.evaluation.measured]
    disturbed = _robustness({part.method: part.evaluation for part in parts if part.evaluation.kind == "robustness"})
    own = _localization(scored) if len(scored) > 1 else None
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
        "Comparison", *map(grid, _compared(parts)), *(tag("p.note", note) for note in notes), *curves, name="compared"
    )


def _compared(parts: list[Part]) -> list[Table]:
    """Return the table with a row for each evaluation: errors of its finest estimates, of all queries and by lighting.

    Columns without a value, and those in which the evaluations do not differ, such as the protocol, are left out.
    """
    lightings = list(dict.fromkeys(label for part in parts for label in part.evaluation.lightings))
    rows = [((tag("a", part.title, href=f"#{part.anchor}"),), _measures(part, lightings)) for part in parts]
    values = {name: {row[name] for _, row in rows} - {None} for name in ("protocol", "unit", "estimate")}
    values["estimate"].add(_SINGLE)  # anything else has to be said, even of all evaluations
    differing = [name for name, every in values.items() if len(every) > 1]
    unit = "" if "unit" in differing else "".join(values["unit"])
    columns: list[tuple[Column, str]] = [
        *((Column(name, form="count"), name) for name in ("map", "queries")),
        *((Column(name), name) for name in differing),
        (Column("mean", unit, 3), "error.mean"),
        *((Column(f"mean, {label}", form=3), f"lighting.{i}.error.mean") for i, label in enumerate(lightings)),
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
