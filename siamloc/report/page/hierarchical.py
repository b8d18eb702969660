"""The section about hierarchical localization: what the coarse layer costs, and what it saves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.draw.errors import mean
from siamloc.report.page import tables
from siamloc.report.page.gathered import Evaluation
from siamloc.report.page.markup import NOTHING, Content, Markup, count, number, percent, section, tag
from siamloc.report.page.parts import Part


def hierarchical(part: Part) -> Markup | None:
    """Return the table by lighting and the plot of the errors; None for another task."""
    found = part.evaluation.results["measures"].get("hierarchical")
    if found is None:
        return None
    unit = found["unit"]
    groups = {label: tables.group_of(found, label) for label in tables.labels_of(found)}
    heads = ["lighting", f"mean [{unit}]", f"95 % [{unit}]", f"whole map [{unit}]", "loss", "node found"]
    heads += [f"right node [{unit}]", f"wrong node [{unit}]", f"perfect nodes [{unit}]", f"floor [{unit}]"]
    heads += ["comparisons a query", "of the whole search", "queries"]
    longest = max((mean(group, ("error",)) or 0.0 for group in groups.values()), default=0.0)
    rows = [(label, _cells(group, longest, found["map_frames"])) for label, group in groups.items()]
    return section(
        "Nodes first, then the frames in them",
        tables.grid(heads, rows, "hierarchical"),
        tag("p.caption", _caption(part.evaluation, found)),
        part.figure("node_errors", "mean errors with the right node and with a wrong one"),
        name="hierarchical",
    )


def _cells(group: Mapping[str, Any], longest: float, map_frames: int) -> list[Content]:
    compared = group["comparisons"]
    cells: list[Content] = [tables.mean_bar(mean(group, ("error",)), mean(group, ("floor",)), longest)]
    cells += [number(group["error"]["p95"]), number(mean(group, ("absolute", "error")))]
    loss = group["loss"]
    cells.append(NOTHING if loss is None else f"{100 * loss:+.1f} %".replace("-", "−"))
    cells.append(percent(group["coarse"]["accuracy"]))
    for name in ("given_right", "given_wrong"):
        cells.append(tag("span", number(mean(group, (name, "error"))), tag("small", f" n = {group[name]['queries']}")))
    cells += [number(mean(group, ("perfect_coarse", "error"))), number(mean(group, ("floor",)))]
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
        "that the nearest map frame belongs to is among those searched; right and wrong node refer to this. Perfect "
        "nodes means always searching the right one; the loss is relative to a search of the whole map, of which the "
        "bar of the comparisons shows the share: grey for frames, orange for nodes."
    )
