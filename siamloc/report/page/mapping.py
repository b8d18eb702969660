"""The section about a compact map: compactness, purity, and correctness of its loop closures."""

from __future__ import annotations

from siamloc.report.page import tables
from siamloc.report.page.markup import Content, Markup, count, number, percent, section, tag
from siamloc.report.page.parts import Part


def mapping(part: Part) -> Markup | None:
    """Return the measures of a compact map and its plan; None for another task."""
    found = part.evaluation.results["measures"].get("mapping")
    if found is None:
        return None
    lost, closures, unit = found["unassigned"], found["closures"], found["unit"]
    took = found["ms_per_frame"]
    pairs: list[tuple[str, Content]] = [
        ("nodes", f"{count(found['nodes'])} over {count(found['frames'])} frames"),
        ("frames in no node", f"{count(lost['frames'])} ({percent(lost['share'])})"),
        ("silhouette of the positions", _silhouettes(found["silhouette"])),
        ("frames in a node of their room", percent(found["purity"]["overall"])),
        ("moment of inertia", f"{number(found['inertia'], 2)} {unit}²"),
        (
            f"loop closures within {closures['radius']:g} {unit}",
            f"{count(closures['right'])} of {count(closures['closures'])}: precision {percent(closures['precision'])}, "
            f"recall {percent(closures['recall'])}",
        ),
        ("time per frame", f"{number(took['mean'], 1)} ms, median {number(took['median'], 1)} ms"),
    ]
    rooms = found["purity"]["room"]
    pure = [(room, [percent(one["purity"]), count(one["frames"])]) for room, one in rooms.items()]
    return section(
        "Compact map",
        tag(
            "div.beside",
            tag("div", tables.key_values(pairs)),
            tables.grid(["room", "in a node of this room", "frames"], pure, "purity") if pure else None,
        ),
        part.figure("nodes", "the nodes on the floor plan"),
        name="mapping",
    )


def _silhouettes(found: dict[str, float | None]) -> str:
    return f"{number(found['pooled'], 2)} pooled, {number(found['nearest'], 2)} to the nearest node"
