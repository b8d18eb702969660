"""The section about localization in compact maps: error against the number of nodes."""

from __future__ import annotations

from siamloc.report.draw.curves import WAYS
from siamloc.report.page import tables
from siamloc.report.page.markup import Content, Markup, count, number, section, tag
from siamloc.report.page.parts import Part


def compact(part: Part) -> Markup | None:
    """Return curves, and a table row for each compact map; None for another task."""
    found = part.evaluation.results["measures"].get("compact")
    if found is None:
        return None
    unit = found["unit"]
    text = (
        f"{count(found['queries'])} queries in maps made of {count(found['map_frames'])} frames, by "
        f"{found['distance']} distance, nodes by {found['clustered']}. A query is located at the node whose "
        "mean descriptor is most similar to its "
        "own or, with the frames kept, at the most similar frame inside that node. With plain sampling, one "
        "frame stands for each run of frames."
    )
    rows: list[tuple[str, list[Content]]] = []
    for one in found["curves"]:
        errors = [one["error"]["mean"], one["error"]["median"], one["floor"], one["error_frames"]["mean"]]
        cells: list[Content] = [count(one["nodes"]), *(number(value, 2) for value in errors)]
        cells += [number(one["silhouette"], 2), number(1000 * one["search_ms"], 1), number(one["build_seconds"], 2)]
        rows.append((WAYS[one["way"]], cells))
    heads = [
        *("", "nodes", f"error [{unit}]", f"median [{unit}]", f"floor [{unit}]", f"in frames [{unit}]"),
        *("silhouette", "search [µs]", "built in [s]"),
    ]
    return section(
        "Compact maps",
        tag("p.caption", text),
        part.figure("compact", "error against the number of nodes"),
        tables.grid(heads, rows, "compact"),
        name="compact",
    )
