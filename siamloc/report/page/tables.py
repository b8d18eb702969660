"""The tables of a report: summaries, comparison, and plain grids of numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from siamloc.report.page.gathered import ALL, Evaluation
from siamloc.report.page.markup import NOTHING, Content, Markup, count, join, number, percent, tag


def summary(evaluation: Evaluation, by: str = "lighting") -> Markup:
    """Return a table with a row per method and lighting (or room), and one for all queries.

    Args:
        evaluation: results, with their baselines.
        by: "lighting" or "room".
    """
    methods = evaluation.methods
    first = next(iter(methods.values()))
    # Some queries may have a room but no position, or vice versa.
    groups = sorted({label for part in ("absolute", "room_retrieval") for label in first.get(part, {}).get(by, {})})
    labels = [*groups, ALL] if len(groups) != 1 else groups
    columns = _columns(methods, by)
    longest = max((_value(_group(m.get("absolute"), ALL, by), "error") for m in methods.values()), default=0.0)
    longest = max(
        [longest, *(_value(_group(m.get("absolute"), g, by), "error") for m in methods.values() for g in labels)]
    )
    best = {label: _best(methods, label, by) for label in labels}
    head = tag("tr", tag("th", "method", scope="col"), tag("th", by, scope="col"), *(tag("th.n", c) for c in columns))
    bodies = []
    for name, measures in methods.items():
        rows = []
        for i, label in enumerate(labels):
            method = tag("th", name, scope="rowgroup", rowspan=len(labels)) if i == 0 else None
            cells = list(_cells(methods, measures, label, by, longest, name in best[label]))
            rows.append(
                tag("tr", method, tag("th", label, scope="row"), *cells, class_="all" if label == ALL else None)
            )
        bodies.append(tag("tbody", *rows, data_method=name))
    return scrolling(tag("table", tag("thead", head), *bodies, class_=f"summary by-{by}"))


def comparison(evaluations: Mapping[str, tuple[Evaluation, str]]) -> Markup:
    """Return a table with a row per evaluation, over all queries and with the mean error under each lighting.

    Errors are those of an evaluation's finest estimates.

    Args:
        evaluations: evaluations by title, with the anchor of their part of the page.
    """
    lightings = list(dict.fromkeys(label for e, _ in evaluations.values() for label in e.lightings))
    units = list(dict.fromkeys(e.unit for e, _ in evaluations.values() if e.absolute is not None))
    unit = f" [{units[0]}]" if len(units) == 1 else ""
    protocols = {str(e.results.get("protocol")) for e, _ in evaluations.values()}
    finer = any(e.finest[1] for e, _ in evaluations.values())
    shown = {"protocol": len(protocols) > 1, "unit": len(units) > 1, "estimate": finer}
    heads = [name for name in ("run", "protocol", "map", "queries", "unit", "estimate") if shown.get(name, True)]
    heads += [f"mean{unit}", *(f"mean, {label}" for label in lightings)]
    heads += [f"{name}{unit}" for name in ("median", "95 %", "floor", "excess")]
    heads += ["recall@1", "heading [deg]", "room retrieved"]
    rows = []
    for title, (evaluation, anchor) in evaluations.items():
        absolute, rooms = evaluation.absolute, evaluation.rooms
        finest, estimate = evaluation.finest
        overall = _group(finest, ALL, "lighting")
        cells: list[Content] = []
        if len(protocols) > 1:
            cells.append(str(evaluation.results.get("protocol") or NOTHING).replace("_", " "))
        cells.append(count(absolute["map_frames"]) if absolute else NOTHING)
        cells.append(count((overall or (rooms or {}).get("overall") or {}).get("queries", 0)))
        if len(units) > 1:
            cells.append(evaluation.unit if absolute else NOTHING)
        if finer:
            cells.append(estimate or "single frame")
        cells.append(_length(overall, "error", "mean"))
        cells += [_length(_group(finest, label, "lighting"), "error", "mean") for label in lightings]
        cells += [_length(overall, "error", key) for key in ("median", "p95")]
        cells += [_length(overall, key, "mean") for key in ("floor", "excess")]
        cells.append(_middle_recall(overall, evaluation.unit))
        cells.append(number(((overall or {}).get("heading_error") or {}).get("mean"), 1))
        cells.append(percent(rooms["overall"]["accuracy"]) if rooms else NOTHING)
        link = tag("a", title, href=f"#{anchor}")
        rows.append(tag("tr", tag("th", link, scope="row"), *(tag("td.n", cell) for cell in cells)))
    head = tag("tr", *(tag("th.n" if i else "th", name, scope="col") for i, name in enumerate(heads)))
    return scrolling(tag("table", tag("thead", head), tag("tbody", *rows), class_="comparison"))


def labels_of(part: Mapping[str, Any]) -> list[str]:
    """Return the lightings of some measures, and `ALL` if there are none or several."""
    labels = list(part["lighting"])
    return [*labels, ALL] if len(labels) != 1 else labels


def group_of(part: Mapping[str, Any], label: str) -> Mapping[str, Any]:
    """Return the measures under a lighting, or of all queries for `ALL`."""
    group: Mapping[str, Any] = part["overall"] if label == ALL else part["lighting"][label]
    return group


def middle_recall(group: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return the recall@1 within the middle one of the radii, the headline figure; None if there is none."""
    first = [recall for recall in (group or {}).get("recall", []) if recall["k"] == 1]
    return first[len(first) // 2] if first else None


def key_values(pairs: Sequence[tuple[str, Content]]) -> Markup:
    """Return a table of two columns."""
    rows = (tag("tr", tag("th", key, scope="row"), tag("td", value)) for key, value in pairs)
    return tag("table.pairs", tag("tbody", *rows))


def grid(heads: Sequence[str], rows: Sequence[tuple[str, Sequence[Content]]], name: str) -> Markup:
    """Return a table of numbers with a row for each label; the row of all queries is marked.

    Args:
        heads: column headings, that of the labels first.
        rows: label and the cells of the other columns.
        name: CSS class of the table.
    """
    head = tag("tr", *(tag("th.n" if i else "th", _unbroken(text), scope="col") for i, text in enumerate(heads)))
    body = (
        tag(
            "tr",
            tag("th", label, scope="row"),
            *(tag("td.n", cell) for cell in cells),
            class_="all" if label == ALL else None,
        )
        for label, cells in rows
    )
    return scrolling(tag("table", tag("thead", head), tag("tbody", *body), class_=f"grid {name}"))


def mean_bar(mean: float | None, floor: float | None, longest: float, best: bool = False) -> Markup:
    """Return a mean error with a bar below it: the part explained by the map's floor, and the rest."""
    text = tag("b", number(mean)) if best else number(mean)
    return parts_bar(text, floor or 0.0, mean or 0.0, longest)


def parts_bar(text: Content, part: float, whole: float, longest: float) -> Markup:
    """Return a number with a bar below it that shows one part of it, scaled to the longest bar."""
    if not longest > 0:
        return join(text)
    bits = [
        tag("i.floor", style=f"width:{100 * part / longest:.1f}%"),
        tag("i.excess", style=f"width:{100 * max(whole - part, 0) / longest:.1f}%"),
    ]
    return join(text, tag("span.bar", *bits, aria_hidden="true"))


def scrolling(table: Markup) -> Markup:
    """Return a table that scrolls by itself if the page is too narrow for it."""
    return tag("div.scroll", table, tabindex=0)


def flattened(value: Any, prefix: str = "", most: int = 400) -> list[tuple[str, Content]]:
    """Return nested measures as pairs of a dotted name and its text."""
    pairs: list[tuple[str, Content]] = []
    items = value.items() if isinstance(value, Mapping) else enumerate(value)
    for key, item in items:
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(item, Mapping) or (isinstance(item, list) and any(isinstance(x, (list, Mapping)) for x in item)):
            pairs += flattened(item, name, most)
        elif isinstance(item, list):
            pairs.append((name, ", ".join(_plain_number(x) for x in item[:60]) + (", ..." if len(item) > 60 else "")))
        else:
            pairs.append((name, _plain_number(item)))
    return pairs[:most]


def _columns(methods: Mapping[str, Mapping[str, Any]], by: str) -> list[Content]:
    names: list[Content] = []
    absolute = next((m["absolute"] for m in methods.values() if "absolute" in m), None)
    if absolute is not None:
        unit = absolute["unit"]
        names += [f"{name} [{unit}]" for name in ("mean", "median", "95 %", "floor", "excess")]
        names += [f"recall@1, {radius:g}\u00a0{unit}" for radius in absolute["radii"]]
        if _has(methods, "heading_error"):
            names.append("heading [deg]")
    if any("room_retrieval" in measures for measures in methods.values()):
        names.append("room retrieved")
    if by == "lighting" and any("room_pairs" in measures for measures in methods.values()):
        names += ["pairs, same room", "pairs, different"]
    return [*names, "queries"]


def _cells(
    methods: Mapping[str, Mapping[str, Any]],
    measures: Mapping[str, Any],
    label: str,
    by: str,
    longest: float,
    best: bool,
) -> Iterator[Markup]:
    absolute = next((m["absolute"] for m in methods.values() if "absolute" in m), None)
    group = _group(measures.get("absolute"), label, by)
    if absolute is not None:
        yield _mean_cell(group, longest, best)
        yield tag("td.n", _length(group, "error", "median"))
        yield tag("td.n", _length(group, "error", "p95"))
        yield tag("td.n", _length(group, "floor", "mean"))
        yield tag("td.n", _length(group, "excess", "mean"))
        for radius in absolute["radii"]:
            yield tag("td.n", _recall(group, radius))
        if _has(methods, "heading_error"):
            yield tag("td.n", number(((group or {}).get("heading_error") or {}).get("mean"), 1))
    rooms = _group(measures.get("room_retrieval"), label, by)
    if any("room_retrieval" in m for m in methods.values()):
        yield tag("td.n", percent(rooms["accuracy"]) if rooms else NOTHING)
    if by == "lighting" and any("room_pairs" in m for m in methods.values()):
        pairs = _group(measures.get("room_pairs"), label, by)
        yield tag("td.n", percent(pairs["same"]) if pairs else NOTHING)
        yield tag("td.n", percent(pairs["different"]) if pairs else NOTHING)
    yield tag("td.n", count((group or rooms or {"queries": 0})["queries"]))


def _mean_cell(group: Mapping[str, Any] | None, longest: float, best: bool) -> Markup:
    if group is None:
        return tag("td.n", NOTHING)
    mean, floor = _value(group, "error"), _value(group, "floor")
    return tag("td.n.mean", mean_bar(mean, floor, longest, best))


def _unbroken(text: str) -> str:
    """Return a text whose unit is not separated from its number or name by a line break."""
    return text.replace(" ", "\u00a0") if len(text) < 12 else text


def _group(part: Mapping[str, Any] | None, label: str, by: str) -> Mapping[str, Any] | None:
    if part is None:
        return None
    return part.get("overall") if label == ALL else part.get(by, {}).get(label)


def _best(methods: Mapping[str, Mapping[str, Any]], label: str, by: str) -> list[str]:
    """Return the methods with the smallest mean error, if there are several methods."""
    means = {name: _value(_group(m.get("absolute"), label, by), "error", math.inf) for name, m in methods.items()}
    return [name for name, mean in means.items() if mean == min(means.values())] if len(means) > 1 else []


def _value(group: Mapping[str, Any] | None, key: str, otherwise: float = 0.0) -> float:
    mean = (group or {}).get(key, {}).get("mean")
    return otherwise if mean is None else float(mean)


def _length(group: Mapping[str, Any] | None, key: str, which: str) -> str:
    return number((group or {}).get(key, {}).get(which))


def _middle_recall(group: Mapping[str, Any] | None, unit: str) -> Content:
    found = middle_recall(group)
    return join(percent(found["recall"]), tag("small", f" {found['radius']:g} {unit}")) if found else NOTHING


def _recall(group: Mapping[str, Any] | None, radius: float) -> str:
    found = [item["recall"] for item in (group or {}).get("recall", []) if item["k"] == 1 and item["radius"] == radius]
    return percent(found[0]) if found else NOTHING


def _has(methods: Mapping[str, Mapping[str, Any]], key: str) -> bool:
    return any(key in ((m.get("absolute") or {}).get("overall") or {}) for m in methods.values())


def _plain_number(value: Any) -> str:
    return NOTHING if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
