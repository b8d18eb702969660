"""The sections of a report page, one function each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.report.draw.training import training_curves
from siamloc.report.page import tables
from siamloc.report.page.gathered import ALL, Evaluation, RunFiles
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Content, Markup, count, join, number, percent, plural, section, tag
from siamloc.report.page.parts import Part
from siamloc.report.page.plan import Plan, error_classes
from siamloc.results import FURTHER, REMARKS, Columns

_KNOWN_MEASURES = (
    *("absolute", "room_retrieval", "room_pairs", "hierarchical", "robustness", "calibration", "mapping", "compact"),
    "buildings",
    *(f"absolute_{name}" for name in FURTHER),
)
_LED_TO = {
    None: "the estimated ones",
    "refined": "those by comparison with map frames",
    "tracked": "those between map frames, followed along the sequence",
}
_PICTURES = ("query", "match", "nearest map frame")


def key_figures(evaluation: Evaluation) -> Markup | None:
    """Return the headline numbers; None if none of them was measured."""
    tiles: list[tuple[str, str]] = []
    absolute, rooms, unit = evaluation.absolute, evaluation.rooms, evaluation.unit
    if absolute is not None:
        finest, estimate = evaluation.finest
        overall = (finest or absolute)["overall"]
        tiles.append((f"{number(overall['error']['mean'], 2)} {unit}", f"mean error{_comma(estimate or '')}"))
        tiles.append((f"{number(overall['floor']['mean'], 2)} {unit}", "floor: distance to the nearest map frame"))
        middle = tables.middle_recall(overall)
        if middle is not None:
            tiles.append((percent(middle["recall"]), f"of the queries within {middle['radius']:g} {unit}"))
    if absolute is not None and "comparisons" in absolute["overall"]:
        tiles.append((percent(absolute["overall"]["comparisons"]["share"]), "of the comparisons of a full search"))
    if rooms is not None:
        tiles.append((percent(rooms["overall"]["accuracy"]), "of the rooms correct"))
    if absolute is not None:
        tiles.append((count(absolute["overall"]["queries"]), f"queries, {count(absolute['map_frames'])} map frames"))
    elif rooms is not None:
        tiles.append((count(rooms["overall"]["queries"]), "queries"))
    tiles += _other_figures(evaluation.results["measures"])
    return (
        tag("ul.figures", *(tag("li", tag("b", value), tag("span", text)) for value, text in tiles)) if tiles else None
    )


def _other_figures(measures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the numbers of a compact map, or of a choice between buildings."""
    mapped, chosen = measures.get("mapping"), measures.get("buildings")
    tiles = []
    if mapped is not None:
        tiles.append((count(mapped["nodes"]), f"nodes over {count(mapped['frames'])} frames"))
        tiles.append((percent(mapped["unassigned"]["share"]), "of the frames in no node"))
        tiles.append((percent(mapped["purity"]["overall"]), "of the frames in a node of their room"))
    if chosen is not None:
        tiles.append((percent(chosen["overall"]["accuracy"]), "of the buildings correct"))
        tiles.append((count(chosen["overall"]["queries"]), "queries"))
    return tiles


def unscored(evaluation: Evaluation) -> Markup | None:
    """Return a note on located queries whose true poses are unknown; None if there are none."""
    if not evaluation.located:
        return None
    many = plural(evaluation.located, "query", "queries")
    if evaluation.absolute is not None:
        return tag("p.note", f"The true position of {many} is unknown: located.csv holds the estimates.")
    none = "no error is known" if evaluation.rooms is not None else "none is scored"
    text = f"No query has a true position to compare with: {many} were located (see located.csv), and {none}."
    return tag("p.note", text)


def summary(evaluation: Evaluation) -> Markup | None:
    """Return the summary tables, and notes on what is missing; None if there is nothing to summarize."""
    if evaluation.absolute is None and evaluation.rooms is None:
        return None
    rooms = (evaluation.absolute or evaluation.rooms or {}).get("room", {})
    by_room = tag("details", tag("summary", "By room"), tables.summary(evaluation, "room")) if len(rooms) > 1 else None
    skipped = evaluation.results.get("skipped") or {}
    notes = [
        tag("p.caption", reason if name in REMARKS else f"{name.replace('_', ' ')} left out: {reason}")
        for name, reason in skipped.items()
    ]
    floor = (
        "The floor is the distance to the nearest map frame, which no retrieval can beat; the excess is the rest. "
        "Bars show both, grey and orange, as parts of the mean."
        + (" The smallest mean of each lighting is bold." if len(evaluation.methods) > 1 else "")
    )
    caption = tag("p.caption", floor) if evaluation.absolute else None
    return section("Summary", tables.summary(evaluation), caption, *notes, by_room, name="summary")


def floor_plan(evaluation: Evaluation, plan: Plan | None, number_: int, notes: Sequence[str]) -> Markup | None:
    """Return the frame of the interactive plan, filled by the page's script; None if nothing was localized."""
    if plan is None:
        return None
    groups = {ALL: len(plan.rows)}
    if len(evaluation.rows_by_lighting) > 1:
        shown = plan.queries["lighting"]
        for label, rows in evaluation.rows_by_lighting.items():
            groups[label] = int((shown == evaluation.queries["lighting"][rows[0]]).sum())  # type: ignore[index]
    switch = _lighting_switch(f"lighting-{number_}", groups)
    buttons = [
        tag("button", text, type="button", data_zoom=what, title=title, aria_label=title)
        for what, text, title in (("in", "+", "zoom in"), ("out", "−", "zoom out"), ("reset", "whole", "whole plan"))
    ]
    canvas = tag(
        "canvas",
        tabindex=0,
        role="img",
        aria_describedby=f"keys-{number_}",
        aria_label=f"floor plan with {plural(len(plan.rows), 'query', 'queries')} of {evaluation.name}",
    )
    keys = tag(
        "p.caption",
        "Grey dots are map frames, coloured dots the true positions of queries, arrows lead to "
        f"{_LED_TO[plan.estimate]}. "
        "Point at a query, or click to pin it. With the plan in focus: ← → along the drive, ↑ ↓ to larger and smaller "
        "errors, + − 0 or the wheel to zoom; drag to move.",
        id=f"keys-{number_}",
    )
    classes = tag(
        "fieldset.classes", tag("legend", f"error [{plan.unit}]"), *_class_boxes(error_classes(plan.queries["error"]))
    )
    figures = [
        tag("figure", tag("canvas"), tag("figcaption", tag("b", what), tag("span")), data_picture=what.split()[0])
        for what in _PICTURES
    ]
    line = None
    if plan.along is not None:
        line = tag(
            "p.caption",
            f"All frames lie on a line along {plan.along}: the plan shows the estimated position above the true one, "
            "and the map's frames on the diagonal, where both are equal.",
        )
    return section(
        "Floor plan",
        tag("div.bar", switch, tag("div.zoom", *buttons)),
        tag("div.stage", canvas),
        classes,
        tag("div.details", tag("p.facts", aria_live="polite"), tag("div.triple", *figures)),
        line,
        keys,
        *(tag("p.note", note) for note in notes),
        tag("noscript", tag("p.caption", "The plan needs JavaScript; the rest of this page does not.")),
        name="plan",
    )


def cumulative(part: Part) -> Markup | None:
    """Return the cumulative error curves; None if nothing was localized."""
    figure = part.figure("error_curve", "cumulative errors")
    return None if figure is None else section("Cumulative errors", figure, name="curves")


def worst(plan: Plan | None, uris: Mapping[str, str]) -> Markup | None:
    """Return the queries with the largest errors as picture triples.

    Args:
        plan: holds the worst queries.
        uris: pictures as data URIs by path; a missing one is replaced by a placeholder.
    """
    if plan is None:
        return None
    rows = plan.worst
    items = [_worst_item(plan, int(row), rank, uris) for rank, row in enumerate(rows, 1)]
    return section(f"Worst {plural(len(rows), 'query', 'queries')}", tag("ol.triples", *items), name="worst")


def further(evaluation: Evaluation) -> Markup | None:
    """Return all measures without a section of their own, as plain tables."""
    others = {k: v for k, v in evaluation.results["measures"].items() if k not in _KNOWN_MEASURES and v}
    if not others:
        return None
    parts = [
        tag("details", tag("summary", name.replace("_", " ")), tables.key_values(tables.flattened(value)))
        for name, value in others.items()
        if isinstance(value, (dict, list))
    ]
    return section("Further measures", *parts, name="further")


def training(run: RunFiles, number_: int) -> Markup | None:
    """Return the training curves; None if nothing was trained."""
    if run.curves is None:
        return None
    figure = inline(training_curves(run.curves), f"training-{number_}", f"training curves of {run.title}")
    epochs = plural(len(run.curves["epoch"]), "epoch")
    return section(f"Training, {epochs}", figure, name="training")


def configuration(run: RunFiles) -> Markup:
    """Return configuration and versions, collapsed."""
    parts: list[Markup] = []
    if run.settings is not None:
        parts.append(tag("details", tag("summary", "Trained with"), tag("pre", _yaml(run.settings))))
    for evaluation in run.evaluations:
        results, which = evaluation.results, f", {evaluation.title}" if len(run.evaluations) > 1 else ""
        facts: list[tuple[str, Content]] = [("measured", results.get("created"))]
        facts += [(name, str(version)) for name, version in results.get("versions", {}).items()]
        config = tag("pre", _yaml(results["config"]))
        parts.append(tag("details", tag("summary", f"Measured with{which}"), config, tables.key_values(facts)))
    return section("Configuration and versions", *parts, name="configuration")


def _lighting_switch(name: str, groups: Mapping[str, int]) -> Markup | None:
    """Return buttons that choose a lighting for the plan; None if there is no choice.

    Args:
        name: name of the switch, unique on the page.
        groups: number of queries of each lighting, and of all.
    """
    if len(groups) < 2:
        return None
    radios = [
        tag(
            "label",
            tag("input", type="radio", name=name, value=label, checked=label == ALL),
            tag("span", label, " ", tag("small", count(rows))),
        )
        for label, rows in groups.items()
    ]
    return tag("fieldset.switch", tag("legend", "lighting"), *radios)


def _class_boxes(limits: Sequence[float]) -> list[Markup]:
    texts = [f"≤ {limit:g}" for limit in limits] + [f"> {limits[-1]:g}"]
    return [
        tag(
            "label",
            tag("input", type="checkbox", checked=True, value=i),
            tag("i.swatch", aria_hidden="true", data_class=i),
            tag("span", text, " ", tag("small")),
        )
        for i, text in enumerate(texts)
    ]


def _worst_item(plan: Plan, row: int, rank: int, uris: Mapping[str, str]) -> Markup:
    columns, known = plan.queries, plan.known
    match, nearest = int(columns["match"][row]), int(plan.nearest[row])
    lines = [_place(columns, row), _place(known, match), _place(known, nearest)]
    apart = np.hypot(known["x"][match] - columns["x"][row], known["y"][match] - columns["y"][row])
    distances = [apart, columns["floor"][row]]
    lines[1] = f"{number(float(distances[0]), 2)} {plan.unit} away{_comma(lines[1])}"
    lines[2] = f"{number(float(distances[1]), 2)} {plan.unit} away{_comma(lines[2])}"
    pictures = [
        tag("figure", _image(uris.get(path), what, path), tag("figcaption", tag("b", what), tag("span", text)))
        for what, text, path in zip(_PICTURES, lines, plan.triple(row), strict=True)
    ]
    facts = [str(columns["lighting"][row]), str(columns["room"][row])]
    if "heading_error" in columns and np.isfinite(columns["heading_error"][row]):
        facts.append(f"heading {number(float(columns['heading_error'][row]), 1)}° off")
    error = tag("b", f"{number(float(columns['error'][row]), 2)} {plan.unit}")
    button = tag("button", "show on the plan", type="button", data_query=row)
    head = tag("div.head", tag("span.rank", rank), error, tag("span", " · ".join(filter(None, facts))), button)
    return tag("li", head, tag("div.triple", *pictures))


def _image(uri: str | None, what: str, path: str) -> Markup:
    if uri is None:
        return tag("div.missing", "no picture", title=path)
    return tag("img", src=uri, alt=what, title=path)


def _place(columns: Columns, row: int) -> str:
    return str(columns["room"][row])


def _comma(text: str) -> str:
    return f", {text}" if text else ""


def _yaml(config: Any) -> Markup:
    import yaml

    text = yaml.safe_dump(config, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return join(text if config else "not recorded")
