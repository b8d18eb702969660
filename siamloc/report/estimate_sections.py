"""Parts of a report page about further estimates: by the sequence filter, between map frames, and of the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from siamloc.report import tables
from siamloc.report.curves import error_axis, estimate_curves, lighting_colours
from siamloc.report.gathered import ALL, Evaluation
from siamloc.report.markup import NOTHING, Content, Markup, count, number, percent, plural, tag
from siamloc.report.parts import section
from siamloc.report.svg import DASHES, MARKS, Axis, Line, chart

_TITLES = {"filtered": "Sequence filter", "interpolated": "Interpolation between map frames"}


def further_estimate(evaluation: Evaluation, name: str) -> Markup | None:
    """Return what another estimate of the same queries gains over the single-frame one; None where there is none.

    Args:
        evaluation: with its queries.
        name: "filtered" or "interpolated".
    """
    found, absolute = evaluation.results["measures"].get(f"absolute_{name}"), evaluation.absolute
    if found is None or absolute is None:
        return None
    unit, radius = absolute["unit"], _middle(absolute["radii"])
    heads = ["lighting"]
    for what in ("mean", "median", "95 %"):
        heads += [f"{what} [{unit}]", f"{name} [{unit}]"]
    heads += ["mean, change", f"within {radius:g} {unit}", name, f"floor [{unit}]", "queries"]
    rows = []
    for label in _labels(absolute):
        before, after = (_group(part, label) for part in (absolute, found))
        cells: list[Content] = []
        for key in ("mean", "median", "p95"):
            cells += [number(before["error"][key]), tag("b", number(after["error"][key]))]
        cells.append(_change(before["error"]["mean"], after["error"]["mean"]))
        cells += [percent(_within(group, radius)) for group in (before, after)]
        cells += [number(before["floor"]["mean"]), count(before["queries"])]
        rows.append((label, cells))
    text = _caption(evaluation, name)
    curves = estimate_curves(evaluation, name) if evaluation.queries is not None else None
    return section(
        _TITLES[name], tables.grid(heads, rows, "estimate"), tag("p.caption", text), curves, name=f"estimate {name}"
    )


def expected_errors(evaluation: Evaluation) -> Markup | None:
    """Return how well expected errors hold, as a calibration curve; None where none were expected."""
    found = evaluation.results["measures"].get("calibration")
    if found is None:
        return None
    unit = evaluation.unit
    threshold = found["overall"]["lost"]["lost_above"]
    heads = ["lighting", f"expected, mean [{unit}]", f"true, mean [{unit}]", f"gap [{unit}]", "called lost"]
    heads += ["lost in truth", "precision", "recall", "queries"]
    rows = []
    for label in _labels(found):
        group = _group(found, label)
        lost = group["lost"]
        cells = [number(group[key]) for key in ("predicted", "observed", "gap")]
        cells += [count(lost["called"]), count(lost["lost"]), percent(lost["precision"]), percent(lost["recall"])]
        rows.append((label, [*cells, count(group["queries"])]))
    sequences = ((evaluation.results.get("estimates") or {}).get("error_model") or {}).get("sequences", [])
    learned = f" The model was learned on {', '.join(sequences)}." if sequences else ""
    text = (
        "Each point stands for a tenth of the queries of its kind: how far off they were expected to be, and were. On "
        "the dotted line both are equal; the gap is the mean distance from it. A query is called lost where more than "
        f"{threshold:g} {unit} are expected; it is lost in truth where its error is larger than that.{learned}"
    )
    return section(
        "Expected errors",
        tag("div.beside", _calibration(evaluation, found), tag("div", tables.grid(heads, rows, "calibration"))),
        tag("p.caption", text),
        name="expected",
    )


def _calibration(evaluation: Evaluation, found: Mapping[str, Any]) -> Markup:
    unit = evaluation.unit
    labels = [label for label in _labels(found) if _group(found, label)["curve"]]
    colours = dict(zip(found["lighting"], lighting_colours(found["lighting"]), strict=True))
    kinds = list(MARKS)
    lines = []
    for i, label in enumerate(labels):
        curve = _group(found, label)["curve"]
        x, y = (np.array([point[key] for point in curve], dtype=np.float64) for key in ("predicted", "observed"))
        name = "all queries" if label == ALL else label
        lines.append(
            Line(name, x, y, colours.get(label, "ink"), mark=kinds[i % len(kinds)], joined=label == labels[-1])
        )
    both = error_axis([values for line in lines for values in (line.x, line.y)], unit, lowest=0)
    ends = np.array([both.low, both.high])
    lines.insert(0, Line("equal", ends, ends, "soft", DASHES[2]))
    log = ", logarithmic" if both.log else ""
    x_axis = Axis(f"expected error [{unit}]{log}", both.low, both.high, both.log)
    y_axis = Axis(f"true error, mean [{unit}]", both.low, both.high, both.log)
    return chart("calibration", lines, x_axis, y_axis, 400, 290)


def _caption(evaluation: Evaluation, name: str) -> str:
    made = evaluation.results.get("estimates") or {}
    if name == "interpolated":
        settings = made.get("interpolation") or {}
        of = plural(settings["neighbours"], "map frame") if "neighbours" in settings else "map frames"
        return (
            f"The position lies between the {of} that look most alike and belong to one place, weighted by how alike "
            "they look; it can be nearer than the nearest map frame, so that errors below the floor are possible."
        )
    text = (
        "The filter follows the robot through each sequence and weighs what it sees by where it can have driven; it "
        "uses earlier frames and never later ones."
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


def _labels(part: Mapping[str, Any]) -> list[str]:
    labels = list(part["lighting"])
    return [*labels, ALL] if len(labels) != 1 else labels


def _group(part: Mapping[str, Any], label: str) -> Mapping[str, Any]:
    group: Mapping[str, Any] = part["overall"] if label == ALL else part["lighting"][label]
    return group


def _middle(radii: list[float]) -> float:
    return sorted(radii)[len(radii) // 2]


def _within(group: Mapping[str, Any], radius: float) -> float | None:
    return next((item["recall"] for item in group["recall"] if item["k"] == 1 and item["radius"] == radius), None)


def _change(before: float | None, after: float | None) -> str:
    if not before or after is None:
        return NOTHING
    return f"{100 * (after / before - 1):+.1f} %".replace("-", "−")
