"""Sections about further estimates: by the sequence filter, between map frames, and of the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.page import tables
from siamloc.report.page.gathered import Evaluation
from siamloc.report.page.markup import NOTHING, Content, Markup, count, number, percent, plural, section, tag
from siamloc.report.page.parts import Part

_TITLES = {
    "filtered": "Sequence filter",
    "interpolated": "Interpolation between map frames",
    "refined": "Compared with map frames",
    "tracked": "Between map frames, followed along the sequence",
}


def further_estimate(part: Part, name: str) -> Markup | None:
    """Return what another estimate of the same queries gains over the single-frame one; None if there is none.

    Args:
        part: part of the page.
        name: one of `siamloc.results.FURTHER`.
    """
    evaluation = part.evaluation
    found, absolute = evaluation.results["measures"].get(f"absolute_{name}"), evaluation.absolute
    if found is None or absolute is None:
        return None
    unit, radius = absolute["unit"], _middle(absolute["radii"])
    heads = ["lighting"]
    for what in ("mean", "median", "95 %"):
        heads += [f"{what} [{unit}]", f"{name} [{unit}]"]
    heads += ["mean, change", f"within {radius:g} {unit}", name, f"floor [{unit}]", "queries"]
    rows = []
    for label in tables.labels_of(absolute):
        before, after = (tables.group_of(part, label) for part in (absolute, found))
        cells: list[Content] = []
        for key in ("mean", "median", "p95"):
            cells += [number(before["error"][key]), tag("b", number(after["error"][key]))]
        cells.append(_change(before["error"]["mean"], after["error"]["mean"]))
        cells += [percent(_within(group, radius)) for group in (before, after)]
        cells += [number(before["floor"]["mean"]), count(before["queries"])]
        rows.append((label, cells))
    return section(
        _TITLES[name],
        tables.grid(heads, rows, "estimate"),
        tag("p.caption", _caption(evaluation, name)),
        part.figure(f"{name}_curve", f"cumulative errors, {name} and of single frames"),
        name=f"estimate {name}",
    )


def expected_errors(part: Part) -> Markup | None:
    """Return how accurate the expected errors are, as a calibration curve; None if there are none."""
    evaluation = part.evaluation
    found = evaluation.results["measures"].get("calibration")
    if found is None:
        return None
    unit = evaluation.unit
    threshold = found["overall"]["lost"]["lost_above"]
    heads = ["lighting", f"expected, mean [{unit}]", f"true, mean [{unit}]", f"gap [{unit}]", "called lost"]
    heads += ["truly lost", "precision", "recall", "queries"]
    rows = []
    for label in tables.labels_of(found):
        group = tables.group_of(found, label)
        lost = group["lost"]
        cells = [number(group[key]) for key in ("predicted", "observed", "gap")]
        cells += [count(lost["called"]), count(lost["lost"]), percent(lost["precision"]), percent(lost["recall"])]
        rows.append((label, [*cells, count(group["queries"])]))
    sequences = ((evaluation.results.get("estimates") or {}).get("error_model") or {}).get("sequences", [])
    learned = f" The model was learned on {', '.join(sequences)}." if sequences else ""
    text = (
        "Each point is a tenth of the queries of its kind: their expected error and their true error. On the dotted "
        "line both are equal; the gap is the mean distance from it. A query is called lost if its expected error is "
        f"above {threshold:g} {unit}, or if it shows nothing of what the map shows; it is truly lost if its error is "
        "above that value."
        f"{learned}"
    )
    return section(
        "Expected errors",
        tag("div.beside", part.figure("calibration", "calibration"), tables.grid(heads, rows, "calibration")),
        tag("p.caption", text),
        name="expected",
    )


def _caption(evaluation: Evaluation, name: str) -> str:
    made = evaluation.results.get("estimates") or {}
    if name == "interpolated":
        settings = made.get("interpolation") or {}
        of = plural(settings["neighbours"], "map frame") if "neighbours" in settings else "map frames"
        return (
            f"The position is the mean of the {of} that look most similar and belong to one place, weighted by "
            "similarity; it can be closer than the nearest map frame, so errors below the floor are possible."
        )
    if name == "refined":
        settings = made.get("refinement") or {}
        of = plural(settings["neighbours"], "map frame") if "neighbours" in settings else "map frames"
        return (
            f"The network compares the query with the {of} that look most similar, and estimates where it was taken "
            "relative to each. The position is the one on which the most certain answers agree; it can be closer than "
            "the nearest map frame, so errors below the floor are common."
        )
    if name == "tracked":
        settings = made.get("tracking") or {}
        if "radius" in settings:
            return (
                "The position is the mean of where the robot may be according to the sequence filter, within "
                f"{settings['radius']:g} {evaluation.unit} of the most probable map frame."
            )
        moved = f", {settings['step']:.2f} {evaluation.unit} between two queries" if "step" in settings else ""
        return (
            f"The poses are tracked along each sequence: the robot is assumed to keep moving as before{moved}, and a "
            "pose that does not fit must be confirmed by those that follow. Only earlier frames are used, never later "
            "ones."
        )
    text = (
        "The filter follows the robot through each sequence and weighs what it sees by where it can have driven; "
        "only earlier frames are used, never later ones."
    )
    settings = made.get("filter") or {}
    if "temperature" in settings:
        tuned = settings.get("tuned")
        how = f"chosen on {plural(tuned['queries'], 'validation frame')}" if tuned else "learned from the map"
        text += (
            f" Temperature {settings['temperature']:.3g} ({how}), probability of being anywhere "
            f"{settings['kidnapping']:g}, {settings['step']:.2f} {evaluation.unit} driven between two queries."
        )
    return text


def _middle(radii: list[float]) -> float:
    return sorted(radii)[len(radii) // 2]


def _within(group: Mapping[str, Any], radius: float) -> float | None:
    return next((item["recall"] for item in group["recall"] if item["k"] == 1 and item["radius"] == radius), None)


def _change(before: float | None, after: float | None) -> str:
    if not before or after is None:
        return NOTHING
    return f"{100 * (after / before - 1):+.1f} %".replace("-", "−")
