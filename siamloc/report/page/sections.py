"""The sections of a report page: headline figures, summary, floor plan, worst queries, training, configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.report.draw.training import training_curves
from siamloc.report.page.gathered import Evaluation, RunFiles
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Content, Markup, fragment, grid, join, key_values, plural, section, tag
from siamloc.report.page.parts import Part, notes_on
from siamloc.report.page.plan import Plan, error_classes
from siamloc.results import REMARKS, rows_by_label
from siamloc.summaries import ALL, errors, middle_recall, rooms
from siamloc.tables import count, number, percent

_LED_TO = {
    None: "the estimated ones",
    "refined": "those by comparison with map frames",
    "tracked": "those between map frames, followed along the sequence",
}
_PICTURES = ("query", "match", "nearest map frame")


def key_figures(evaluation: Evaluation) -> Markup | None:
    """Return the headline numbers of an evaluation; None if none of them was measured."""
    measures, unit = evaluation.results["measures"], evaluation.unit
    absolute, found = evaluation.absolute, evaluation.rooms
    tiles: list[tuple[str, str]] = []
    if absolute is not None:
        finest, estimate = evaluation.finest
        overall = (finest or absolute)["overall"]
        where = " in the surveyed map" if evaluation.truth == "surveyed" else ""
        tiles.append((f"{number(overall['error']['mean'], 2)} {unit}", f"mean error{where}{_comma(estimate or '')}"))
        tiles.append((f"{number(overall['floor']['mean'], 2)} {unit}", "floor: distance to the nearest map frame"))
        if (middle := middle_recall(overall)) is not None:
            tiles.append((percent(middle["recall"]), f"of the queries within {middle['radius']:g} {unit}"))
        if "comparisons" in absolute["overall"]:
            share = absolute["overall"]["comparisons"]["share"]
            tiles.append((percent(share), "of the comparisons of a full search"))
    if found is not None:
        tiles.append((percent(found["overall"]["accuracy"]), "of the rooms correct"))
    if absolute is not None:
        tiles.append((count(absolute["overall"]["queries"]), f"queries, {count(absolute['map_frames'])} map frames"))
    elif found is not None:
        tiles.append((count(found["overall"]["queries"]), "queries"))
    if (mapped := measures.get("mapping")) is not None:
        tiles.append((count(mapped["nodes"]), f"nodes over {count(mapped['frames'])} frames"))
        tiles.append((percent(mapped["unassigned"]["share"]), "of the frames in no node"))
        tiles.append((percent(mapped["purity"]["overall"]), "of the frames in a node of their room"))
    if (chosen := measures.get("buildings")) is not None:
        tiles.append((percent(chosen["overall"]["accuracy"]), "of the buildings correct"))
        tiles.append((count(chosen["overall"]["queries"]), "queries"))
    items = [tag("li", tag("b", value), tag("span", text)) for value, text in tiles]
    return tag("ul.figures", *items) if items else None


def unscored(evaluation: Evaluation) -> Markup | None:
    """Return a note with the number of queries that were located although their true pose is unknown.

    Returns:
        None if every located query has a true pose.
    """
    located = int(evaluation.results.get("tables", {}).get("located", {}).get("rows", 0))
    if not located:
        return None
    many = plural(located, "query", "queries")
    if evaluation.absolute is not None:
        return tag("p.note", f"The true position of {many} is unknown: located.csv holds the estimates.")
    none = "no error is known" if evaluation.rooms is not None else "none is scored"
    text = f"No query has a true position to compare with: {many} were located (see located.csv), and {none}."
    return tag("p.note", text)


def summary(part: Part) -> Markup | None:
    """Return the section with tables of errors and rooms, and notes on what is missing; None without both."""
    evaluation = part.evaluation
    if not evaluation.measured:
        return None
    methods = evaluation.methods
    by_lighting, by_room = (map(grid, [*errors(methods, by), *rooms(methods, by)]) for by in ("lighting", "room"))
    several = len((evaluation.absolute or evaluation.rooms or {}).get("room", {})) > 1
    notes = []
    if evaluation.absolute and evaluation.truth == "surveyed":
        notes.append("Errors are distances to surveyed positions, which are not exact: errors in the surveyed map.")
    if evaluation.absolute:
        notes.append(
            "The floor is the distance to the nearest map frame, which no retrieval can beat; the excess is the rest. "
            "Bars show both, grey and orange, as parts of the mean."
            + (" The smallest mean of each lighting is bold." if len(methods) > 1 else "")
        )
    notes += [
        reason if name in REMARKS else f"{name.replace('_', ' ')} left out: {reason}"
        for name, reason in (evaluation.results.get("skipped") or {}).items()
    ]
    return section(
        "Summary",
        *by_lighting,
        *(tag("p.caption", note) for note in notes),
        tag("details", tag("summary", "By room"), *by_room) if several else None,
        name="summary",
    )


def floor_plan(part: Part) -> Markup | None:
    """Return the section of the interactive plan, which the page's script fills; None if nothing was localized."""
    evaluation, plan = part.evaluation, part.plan
    if plan is None:
        return None
    groups = {ALL: len(plan.rows)}
    every = evaluation.tables["queries"]["lighting"]
    if len(lightings := rows_by_label(every)) > 1:
        shown = plan.queries["lighting"]
        groups |= {label: int((shown == every[rows[0]]).sum()) for label, rows in lightings.items()}
    line = None
    if plan.along is not None:
        line = tag(
            "p.caption",
            f"All frames lie on a line along {plan.along}: the plan shows the estimated position above the "
            f"{evaluation.truth} one, and the map's frames on the diagonal, where both are equal.",
        )
    return fragment(
        "plan.html",
        switch=_lighting_switch(f"lighting-{part.number}", groups),
        number=part.number,
        queries=plural(len(plan.rows), "query", "queries"),
        name=evaluation.name,
        unit=plan.unit,
        classes=join(*_class_boxes(error_classes(plan.queries["error"]))),
        line=line,
        led_to=_LED_TO[plan.estimate],
        truth=evaluation.truth,
        notes=join(*(tag("p.note", note) for note in notes_on(plan, part.decoder))),
    )


def cumulative(part: Part) -> Markup | None:
    """Return the section with the cumulative error curves; None if nothing was localized."""
    figure = part.figure("error_curve", "cumulative errors")
    return None if figure is None else section("Cumulative errors", figure, name="curves")


def worst(part: Part) -> Markup | None:
    """Return the section of the queries with the largest errors: query, match and right answer as pictures."""
    if part.plan is None:
        return None
    rows = part.plan.worst.tolist()
    items = [_worst_item(part.plan, row, rank, part.decoder.large) for rank, row in enumerate(rows, 1)]
    return section(f"Worst {plural(len(rows), 'query', 'queries')}", tag("ol.triples", *items), name="worst")


def training(run: RunFiles, number_: int) -> Markup | None:
    """Return the section with the training curves of a run; None if nothing was trained."""
    if run.curves is None:
        return None
    figure = inline(training_curves(run.curves), f"training-{number_}", f"training curves of {run.title}")
    epochs = plural(len(run.curves["epoch"]), "epoch")
    return section(f"Training, {epochs}", figure, name="training")


def configuration(run: RunFiles) -> Markup:
    """Return the section with configuration and versions, collapsed."""
    parts: list[Markup] = []
    if run.settings is not None:
        parts.append(tag("details", tag("summary", "Trained with"), tag("pre", _yaml(run.settings))))
    for evaluation in run.evaluations:
        results, which = evaluation.results, f", {evaluation.title}" if len(run.evaluations) > 1 else ""
        facts: list[tuple[str, Content]] = [("measured", results.get("created"))]
        facts += [(name, str(version)) for name, version in results.get("versions", {}).items()]
        config = tag("pre", _yaml(results["config"]))
        parts.append(tag("details", tag("summary", f"Measured with{which}"), config, key_values(facts)))
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
    apart = np.hypot(known["x"][match] - columns["x"][row], known["y"][match] - columns["y"][row])
    lines = [
        str(columns["room"][row]),
        *(
            f"{number(float(away), 2)} {plan.unit} away{_comma(str(known['room'][frame]))}"
            for away, frame in ((apart, match), (columns["floor"][row], nearest))
        ),
    ]
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


def _comma(text: str) -> str:
    return f", {text}" if text else ""


def _yaml(config: Any) -> Markup:
    import yaml

    text = yaml.safe_dump(config, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return join(text if config else "not recorded")
