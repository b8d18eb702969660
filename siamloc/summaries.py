"""Tables of what an evaluation measured, made from the measures in `results.json`, for the console and the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from siamloc.results import FURTHER
from siamloc.tables import Column, Table

ALL = "all"
Measures = Mapping[str, Any]
Path = str | tuple[str, str]
Row = tuple[tuple[str, ...], Measures]

_DISTURBANCES = {"noise": "noise", "occlusion": "occlusion", "turn": "turn on the spot"}


def tables_of(
    name: str, parts: Measures, baselines: Mapping[str, Measures], costs: Mapping[str, Measures] | None = None
) -> list[Table]:
    """Return all tables of a result.

    Args:
        name: name of the method.
        parts: measures of the method by kind, as in `Result.parts`.
        baselines: measures of the other methods, by name.
        costs: time and memory of the methods, by name.
    """
    methods = methods_of(name, parts, baselines)
    own = [table for tables in own_tables(name, parts).values() for table in tables]
    return [*errors(methods), *rooms(methods), *pairs(methods), *own, *cost(costs or {})]


def own_tables(name: str, parts: Measures) -> dict[str, list[Table]]:
    """Return the tables of what is measured for one method only, by kind, such as "mapping"."""
    unit = next((part["unit"] for part in parts.values() if "unit" in part), "")
    return {
        kind: tables({"name": name, "unit": unit, **parts[kind]}) for kind, tables in _OF_ONE.items() if kind in parts
    }


def methods_of(name: str, parts: Measures, baselines: Mapping[str, Measures]) -> dict[str, Measures]:
    """Return the measures of a method, of its further estimates and of its baselines by name, its own first.

    Errors are under "absolute", also those of hierarchical localization.
    """
    absolute = parts.get("absolute") or parts.get("hierarchical")
    methods: dict[str, Measures] = {name: parts if absolute is None else {**parts, "absolute": absolute}}
    for further, sign in FURTHER.items():
        if f"absolute_{further}" in parts:
            methods[f"{name} + {sign}"] = {"absolute": parts[f"absolute_{further}"]}
    return {**methods, **baselines}


def groups_of(part: Measures, by: str = "lighting") -> dict[str, Measures]:
    """Return the measures by lighting or by room, and last those of all queries, unless there is one label only."""
    groups = {label: part[by][label] for label in sorted(part.get(by, {}))}
    return groups if len(groups) == 1 else {**groups, ALL: part["overall"]}


def errors(methods: Mapping[str, Measures], by: str = "lighting") -> list[Table]:
    """Return the table of errors and recalls: a row for each method and each lighting (or room)."""
    first = next((one["absolute"] for one in methods.values() if "absolute" in one), None)
    if first is None:
        return []
    unit, radii = first["unit"], first["radii"]
    columns: list[tuple[Column, Path]] = [
        (Column("mean", unit, 3, part="floor"), "error.mean"),
        (Column("median", unit, 3), "error.median"),
        (Column("95 %", unit, 3), "error.p95"),
        (Column("floor", unit, 3), "floor.mean"),
        (Column("excess", unit, 3), "excess.mean"),
        (Column("hit rate", form="percent"), "hit_rate.0.rate"),  # not of finer poses
        *((Column(f"recall@1 {radius:g} {unit}", form="percent"), f"first.{i}") for i, radius in enumerate(radii)),
        (Column("heading", "deg", 1), "heading_error.mean"),
        (Column("queries", form="count"), "queries"),
    ]
    notes = [f"map: {first['map_frames']:,} frames"]
    recalls = [one for one in first["overall"]["recall"] if one["k"] == 1]
    if recalls:
        near = ", ".join(
            f"{one['answerable']:,} of {one['queries']:,} within {one['radius']:g} {unit}" for one in recalls
        )
        notes.append(f"queries that have a map frame that near: {near}")
    for method, measures in methods.items():
        overall = measures.get("absolute", {}).get("overall", {})
        known = overall.get("heading_error", {}).get("count", 0)
        if 0 < known < overall["queries"]:
            notes.append(
                f"heading, {method}: {known} of {overall['queries']} queries, where theta is known on both sides"
            )
    rows = [
        (labels, {**group, "first": [one["recall"] for one in group["recall"] if one["k"] == 1]})
        for labels, group in _rows(methods, "absolute", by)
    ]
    return _made("errors", ("method", by), columns, rows, notes=notes)


def rooms(methods: Mapping[str, Measures], by: str = "lighting") -> list[Table]:
    """Return the table of how often methods find the room: a row for each method and each lighting (or room)."""
    columns: list[tuple[Column, Path]] = [
        (Column("room retrieved", form="percent"), "accuracy"),
        (Column("room in top 5", form="percent"), "top.5"),
        (Column("mAP", form="percent"), "mean_average_precision"),
        (Column("chance", form="percent"), "chance"),
        (Column("queries", form="count"), "queries"),
    ]
    return _made("rooms", ("method", by), columns, _rows(methods, "room_retrieval", by))


def pairs(methods: Mapping[str, Measures]) -> list[Table]:
    """Return the table of pairs judged correctly: a row for each method and each lighting of the two images."""
    columns: list[tuple[Column, Path]] = [
        (Column("one room", form="percent"), "same"),
        (Column("two rooms", form="percent"), "different"),
        (Column("all pairs", form="percent"), "overall"),
        (Column("AUC", form=3), "auc"),
        (Column("pairs of one room", form="count"), "n_same"),
        (Column("of two rooms", form="count"), "n_different"),
    ]
    rows = _rows(methods, "room_pairs")
    return _made("pairs", ("method", "lighting"), columns, rows, "pairs judged correctly: one room or two")


def expected_errors(found: Measures) -> list[Table]:
    """Return the table of expected and true errors, and of the queries called lost: a row for each lighting."""
    unit = found["unit"]
    columns: list[tuple[Column, Path]] = [
        (Column("expected, mean", unit, 3), "predicted"),
        (Column("true, mean", unit, 3), "observed"),
        (Column("gap", unit, 3), "gap"),
        (Column("called lost", form="count"), "lost.called"),
        (Column("truly lost", form="count"), "lost.lost"),
        (Column("precision", form="percent"), "lost.precision"),
        (Column("recall", form="percent"), "lost.recall"),
        (Column("queries", form="count"), "queries"),
    ]
    title = f"expected errors; lost above {found['overall']['lost']['lost_above']:g} {unit}"
    return _made("calibration", ("lighting",), columns, _labelled(found), title)


def nodes(found: Measures) -> list[Table]:
    """Return the table of hierarchical localization: a row for each lighting."""
    unit = found["unit"]
    columns: list[tuple[Column, Path]] = [
        (Column("mean", unit, 3), "error.mean"),
        (Column("whole map", unit, 3), "absolute.error.mean"),
        (Column("loss", form="percent"), "loss"),
        (Column("perfect nodes", unit, 3), "perfect_coarse.error.mean"),
        (Column("right node", unit, 3), "given_right.error.mean"),
        (Column("wrong node", unit, 3), "given_wrong.error.mean"),
        (Column("node found", form="share"), ("coarse.correct", "coarse.queries")),
        (Column("comparisons a query", form=1), "comparisons.mean"),
        (Column("frames compared", form="percent"), "comparisons.frames_share"),
        (Column("with nodes", form="percent"), "comparisons.share"),
    ]
    return _made("nodes", ("lighting",), columns, _labelled(found), f"hierarchical localization, {found['name']}")


def mapping(found: Measures) -> list[Table]:
    """Return the measures of a coarse layer as a list, and the purity of each room."""
    within = f"within {found['closures']['radius']:g} {found['unit']}"
    columns: list[tuple[Column, Path]] = [
        (Column("nodes", form="count"), "nodes"),
        (Column("frames in no node", form="share"), ("unassigned.frames", "frames")),
        (Column("silhouette of points, to the nearest node", form=3), "silhouette.nearest"),
        (Column("silhouette of points, pooled", form=3), "silhouette.pooled"),
        (Column("silhouette of descriptors", form=3), "descriptor_silhouette"),
        (Column("moment of inertia", f"{found['unit']}²", 3), "inertia"),
        (Column("purity by room", form="percent"), "purity.overall"),
        (Column("frames with a room", form="count"), "purity.frames"),
        (Column(f"loop closures that are right, {within}", form="share"), ("closures.right", "closures.closures")),
        (Column("revisits that are closed", form="share"), ("closures.closed", "closures.revisits")),
        (Column("F1 of loop closures", form="percent"), "closures.f1"),
        (Column("time per frame, median", "ms", 3), "ms_per_frame.median"),
        (Column("time per frame, 95 %", "ms", 3), "ms_per_frame.p95"),
        (Column("representatives", "bytes", "count"), "bytes.representatives"),
        (Column("descriptors", "bytes", "count"), "bytes.descriptors"),
    ]
    per_room: list[tuple[Column, Path]] = [
        (Column("in a node of this room", form="percent"), "purity"),
        (Column("frames", form="count"), "frames"),
    ]
    by_room = (((room,), one) for room, one in found["purity"]["room"].items())
    return [
        *_made("mapping", (), columns, [((), found)], f"nodes of a map, {found['name']}", upright=True),
        *_made("purity", ("room",), per_room, by_room),
    ]


def compact(found: Measures) -> list[Table]:
    """Return the table of compact maps: a row for each map and each lighting."""
    unit = found["unit"]
    columns: list[tuple[Column, Path]] = [
        (Column("nodes", form="count"), "nodes"),
        (Column("mean", unit, 3), "error.mean"),
        (Column("median", unit, 3), "error.median"),
        (Column("floor", unit, 3), "floor"),
        (Column("in frames", unit, 3), "error_frames.mean"),
        (Column("silhouette", form=3), "silhouette"),
        (Column("inertia", form=3), "inertia"),
        (Column("search", "ms", "short"), "search_ms"),
        (Column("built in", "s", 2), "build_seconds"),
    ]
    lightings = found["lighting"] if len(found["lighting"]) > 1 else {}
    curves = {ALL: found["curves"], **lightings}
    rows = (((one["way"], label), one) for label, several in curves.items() for one in several)
    note = f"map: {found['map_frames']:,} frames, grouped by {found['clustered']}; {found['queries']:,} queries"
    title = f"localization in compact maps, {found['name']}, {found['distance']} distance"
    return _made("compact", ("nodes by", "lighting"), columns, rows, title, [note])


def buildings(found: Measures) -> list[Table]:
    """Return the table of buildings chosen correctly: a row for each lighting, a column for each building."""
    labels = found["confusion"]["labels"]
    columns: list[tuple[Column, Path]] = [
        (Column("all", form="share"), ("correct", "queries")),
        *((Column(f"of {label}", form="share"), f"of.{i}") for i, label in enumerate(labels)),
    ]
    rows = [
        (own, {**group, "of": [_counts(group["building"].get(label)) for label in labels]})
        for own, group in _labelled(found)
    ]
    maps = [
        f"{label} {one['frames']:,} frames"
        + ("" if found.get("build", "none") == "none" else f" in {one['representatives']:,} nodes")
        for label, one in found.get("maps", {}).items()
    ]
    note = [f"maps: {'; '.join(maps)}"] if maps else []
    by = f", {found['distance']} distance" if "distance" in found else ""
    return _made("buildings", ("lighting",), columns, rows, f"building chosen correctly, {found['name']}{by}", note)


def robustness(found: Measures) -> list[Table]:
    """Return a table for each disturbance: a row for each method and level."""
    unit = found["unit"]
    columns: list[tuple[Column, Path]] = [
        (Column("mean", unit, 3), "mean"),
        (Column("median", unit, 3), "median"),
        (Column("floor", unit, 3), "floor"),
        (Column("hit rate", form="percent"), "hit_rate"),
        (Column(f"within {found['radius']:g} {unit}", form="percent"), "share"),
        (Column("queries within", form="count"), "within"),
        (Column("heading", "deg", 1), "heading"),
        (Column("by the nearest frame", "deg", 1), "heading_nearest"),
    ]
    made, last = [], found["disturbances"][-1]
    note = f"queries: {found['queries']:,} (one in {found['every']}), map: {found['map_frames']:,} frames"
    for kind in found["disturbances"]:
        rows = (
            ((method, f"{entry['level']:g}"), entry)
            for method, by_name in found["methods"].items()
            for entry in sorted(by_name[kind["name"]], key=lambda entry: entry["level"])
        )
        title = _DISTURBANCES.get(kind["kind"], f"effect: {kind['name'].replace('_', ' ')}")
        made += _made("robustness", ("method", kind["unit"]), columns, rows, title, [note] if kind is last else [])
    return made


def cost(costs: Mapping[str, Measures]) -> list[Table]:
    """Return the table of the time a query takes and of the memory a map frame takes: a row for each method."""
    steps = ("describe", "rank", "search", "heading")
    columns: list[tuple[Column, Path]] = [
        *((Column(step, "ms", "short"), f"{step}_ms") for step in steps),
        (Column("numbers", form="count"), "numbers"),
        (Column("bytes", form="count"), "bytes"),
    ]
    rows = (((method,), taken) for method, taken in costs.items() if taken)
    return _made("cost", ("method",), columns, rows, "cost of a query, and size of a map frame")


_OF_ONE: dict[str, Callable[[Measures], list[Table]]] = {
    "calibration": expected_errors,
    "hierarchical": nodes,
    "mapping": mapping,
    "compact": compact,
    "buildings": buildings,
    "robustness": robustness,
}
"""The tables of the measures that a result has for one method only."""


def middle_recall(group: Measures | None) -> Measures | None:
    """Return the recall@1 within the middle one of the radii, the headline figure; None if there is none."""
    first = [recall for recall in (group or {}).get("recall", []) if recall["k"] == 1]
    return first[len(first) // 2] if first else None


def _made(
    name: str,
    labels: Sequence[str],
    columns: Sequence[tuple[Column, Path]],
    rows: Iterable[Row],
    title: str = "",
    notes: Sequence[str] = (),
    upright: bool = False,
) -> list[Table]:
    """Return a table of measures, without the columns that have no value; no table if there are no rows.

    Args:
        name: name of the table.
        labels: headings of the labels.
        columns: columns, each with the path of its values in the measures of a row; two paths for the form "share".
        rows: the labels and the measures of each row.
        title: title of the table.
        notes: notes below the table.
        upright: see `Table`.
    """
    every = [(own, [_at(group, path) for _, path in columns]) for own, group in rows]
    if not every:
        return []
    used = [i for i in range(len(columns)) if any(values[i] is not None for _, values in every)]
    return [
        Table(
            name,
            (*map(Column, labels), *(columns[i][0] for i in used)),
            tuple((*own, *(values[i] for i in used)) for own, values in every),
            title,
            tuple(notes),
            upright,
        )
    ]


def _rows(methods: Mapping[str, Measures], part: str, by: str = "lighting") -> list[Row]:
    """Return the measures of each method that has some part, by method and label."""
    measured = {method: groups_of(one[part], by) for method, one in methods.items() if part in one}
    return [((method, label), group) for method, groups in measured.items() for label, group in groups.items()]


def _labelled(part: Measures) -> list[Row]:
    return [((label,), group) for label, group in groups_of(part).items()]


def _counts(group: Measures | None) -> tuple[int, int] | None:
    return None if group is None else (group["correct"], group["queries"])


def _at(group: Measures, path: Path) -> Any:
    """Return the value at a path such as "error.mean" or "hit_rate.0.rate", or two values; None if missing or NaN."""
    if isinstance(path, tuple):
        return tuple(_at(group, one) for one in path)
    value: Any = group
    for key in path.split("."):
        if isinstance(value, list):
            value = value[int(key)] if int(key) < len(value) else None
        else:
            value = (value or {}).get(key)
    return None if value != value else value
