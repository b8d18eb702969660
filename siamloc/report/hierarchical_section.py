"""The part of a report page about hierarchical localization: what the coarse layer costs, and what it saves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from siamloc.report import tables
from siamloc.report.curves import error_axis
from siamloc.report.dots import Dots, dot_rows
from siamloc.report.gathered import ALL, Evaluation
from siamloc.report.markup import NOTHING, Content, Markup, count, number, percent, tag
from siamloc.report.parts import section

# Label, what holds the error, colour and mark.
_ERRORS = (
    ("floor", ("floor",), "soft", "bar"),
    ("whole map", ("absolute", "error"), "k0", "square"),
    ("perfect nodes", ("perfect_coarse", "error"), "k4", "diamond"),
    ("right node", ("given_right", "error"), "k3", "triangle"),
    ("wrong node", ("given_wrong", "error"), "k5", "down"),
    ("hierarchical", ("error",), "ink", "circle"),
)


def hierarchical(evaluation: Evaluation) -> Markup | None:
    """Return the table by lighting and the picture of the errors; None for another task."""
    found = evaluation.results["measures"].get("hierarchical")
    if found is None:
        return None
    unit = found["unit"]
    labels = list(found["lighting"])
    groups = {label: found["lighting"][label] for label in labels}
    if len(labels) != 1:
        groups[ALL] = found["overall"]
    heads = ["lighting", f"mean [{unit}]", f"95 % [{unit}]", f"whole map [{unit}]", "loss", "node found"]
    heads += [f"right node [{unit}]", f"wrong node [{unit}]", f"perfect nodes [{unit}]", f"floor [{unit}]"]
    heads += ["comparisons a query", "of the whole search", "queries"]
    longest = max((_mean(group, ("error",)) or 0.0 for group in groups.values()), default=0.0)
    rows = [(label, _cells(group, longest, found["map_frames"])) for label, group in groups.items()]
    return section(
        "Nodes first, then the frames in them",
        tables.grid(heads, rows, "hierarchical"),
        tag("p.caption", _caption(evaluation, found)),
        _picture(groups, unit),
        name="hierarchical",
    )


def _cells(group: Mapping[str, Any], longest: float, map_frames: int) -> list[Content]:
    compared = group["comparisons"]
    cells: list[Content] = [tables.mean_bar(_mean(group, ("error",)), _mean(group, ("floor",)), longest)]
    cells += [number(group["error"]["p95"]), number(_mean(group, ("absolute", "error")))]
    loss = group["loss"]
    cells.append(NOTHING if loss is None else f"{100 * loss:+.1f} %".replace("-", "−"))
    cells.append(percent(group["coarse"]["accuracy"]))
    for name in ("given_right", "given_wrong"):
        cells.append(tag("span", number(_mean(group, (name, "error"))), tag("small", f" n = {group[name]['queries']}")))
    cells += [number(_mean(group, ("perfect_coarse", "error"))), number(_mean(group, ("floor",)))]
    frames = (compared["frames_share"] or 0.0) * map_frames
    cells.append(tables.parts_bar(number(compared["mean"], 1), frames, compared["mean"] or 0.0, map_frames))
    return [*cells, percent(compared["share"]), count(group["queries"])]


def _caption(evaluation: Evaluation, found: Mapping[str, Any]) -> str:
    layer = evaluation.results.get("layer") or {}
    settings = (evaluation.results.get("config") or {}).get("task") or {}
    nodes = evaluation.results["denominators"].get("nodes")
    what = f"{nodes} {layer['name']} nodes" if nodes and "name" in layer else "The nodes"
    tried = f", the best {settings['candidates']} of them searched" if "candidates" in settings else ""
    return (
        f"{what} over {count(found['map_frames'])} map frames{tried}. Errors are means. A node is found if the one "
        "that the nearest map frame belongs to is among those searched: right and wrong node split the queries so. "
        "Perfect nodes would always be searched in the right one; the loss is against a search in the whole map, of "
        "which the bar of the comparisons is a share: grey for frames, orange for nodes."
    )


def _picture(groups: Mapping[str, Mapping[str, Any]], unit: str) -> Markup | None:
    rows: list[tuple[str, Sequence[float | None]]] = [
        (label, [_mean(group, path) for _, path, _, _ in _ERRORS]) for label, group in groups.items()
    ]
    values = [[value for value in row if value is not None] for _, row in rows]
    if not any(values):
        return None
    axis = error_axis(values, unit, lowest=0)
    dots = [Dots(label, colour, mark) for label, _, colour, mark in _ERRORS]
    return tag("div.panels.wide", dot_rows("mean errors", rows, dots, axis))


def _mean(group: Mapping[str, Any], path: Sequence[str]) -> float | None:
    value: Any = group
    for key in path:
        value = value[key]
    mean = value["mean"]
    return None if mean is None else float(mean)
