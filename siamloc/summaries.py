"""Tables of what an evaluation measured, made from the measures in `results.json`, for the console and the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from siamloc.results import DEPTH, FURTHER
from siamloc.tables import Column, Form, Table

ALL = "all"
Measures = Mapping[str, Any]
Path = str | tuple[str, str]
Row = tuple[tuple[str, ...], Measures]

_SPREAD = {"median": "median", "95 %": "p95"}
_DISTURBANCES = {"noise": "noise", "occlusion": "occlusion", "turn": "turn on the spot"}


def tables_of(
    name: str, parts: Measures, baselines: Mapping[str, Measures], costs: Mapping[str, Measures]
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
    return [*errors(methods), *rooms(methods), *pairs(methods), *own, *cost(costs)]


def own_tables(name: str, parts: Measures) -> dict[str, list[Table]]:
    """Return the tables of measures that other methods do not have, by kind, such as "mapping".

    Args:
        name: name of the method.
        parts: measures of the method by kind, as in `Result.parts`.
    """
    unit = next((part["unit"] for part in parts.values() if "unit" in part), "")
    return {
        kind: tables({"name": name, "unit": unit, **parts[kind]}) for kind, tables in _OF_ONE.items() if kind in parts
    }


def methods_of(name: str, parts: Measures, baselines: Mapping[str, Measures]) -> dict[str, Measures]:
    """Return the measures by name: of a method, of its further estimates, and of its baselines.

    Errors are under "absolute", also those of hierarchical localization.
    """
    absolute = parts.get("absolute") or parts.get("hierarchical")
    methods: dict[str, Measures] = {name: parts if absolute is None else {**parts, "absolute": absolute}}
    for further, sign in FURTHER.items():
        if f"absolute_{further}" in parts:
            methods[f"{name} + {sign}"] = {"absolute": parts[f"absolute_{further}"]}
    return {**methods, **baselines}


def groups_of(part: Measures, by: str = "lighting") -> dict[str, Measures]:
    """Return the measures by lighting or by room, and those of all queries last if there are several labels.

    Args:
        part: measures of one kind in `results.json`, such as those under "absolute".
        by: "lighting" or "room".
    """
    groups = {label: part[by][label] for label in sorted(part.get(by, {}))}
    return groups if len(groups) == 1 else {**groups, ALL: part["overall"]}


def errors(methods: Mapping[str, Measures], by: str = "lighting") -> list[Table]:
    """Return the table of localization errors: a row for each method and each lighting (or room).

    Its columns are mean, median and 95th percentile of the position errors; "floor", the mean distance to the
    geometrically nearest map frame; "excess", the mean error beyond it; all of these in the unit of the positions;
    "hit rate", the share of queries whose error does not exceed the distance to that frame; "recall@1" for each radius,
    the share of all queries whose retrieved frame lies within the radius; "heading", the mean heading error in degrees;
    and the number of queries. Columns without numbers are left out, and the list is empty without measured errors.

    Args:
        methods: measures by the name of the method, as `methods_of` returns them; those under "absolute" count.
        by: "lighting" or "room".
    """
    first = next((one["absolute"] for one in methods.values() if "absolute" in one), None)
    if first is None:
        return []
    unit, radii = first["unit"], first["radii"]
    recall = {f"recall@1 {radius:g} {unit}": f"first.{i}" for i, radius in enumerate(radii)}
    columns: list[tuple[Column, Path]] = [
        (Column("mean", unit, 3, part="floor"), "error.mean"),
        *_as(3, {"median": "error.median", "95 %": "error.p95", "floor": "floor.mean", "excess": "excess.mean"}, unit),
        *_as("percent", {"hit rate": "hit_rate.0.rate", **recall}),
        *_as(1, {"heading": "heading_error.mean"}, "deg"),
        *_as("count", {"queries": "queries"}),
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
    return measured("errors", ("method", by), columns, rows, notes=notes)


def rooms(methods: Mapping[str, Measures], by: str = "lighting") -> list[Table]:
    """Return the table of how often methods find the room: a row for each method and each lighting (or room).

    Args:
        methods: measures by the name of the method, as `methods_of` returns them; those under "room_retrieval" count.
        by: "lighting" or "room".
    """
    shares = {
        "room retrieved": "accuracy",
        "room in top 5": "top.5",
        f"mAP@{DEPTH}": "mean_average_precision",
        "chance": "chance",
    }
    columns = [*_as("percent", shares), *_as("count", {"queries": "queries"})]
    return measured("rooms", ("method", by), columns, _rows(methods, "room_retrieval", by))


def pairs(methods: Mapping[str, Measures]) -> list[Table]:
    """Return the table of pairs judged correctly: a row for each method and each lighting of the two images."""
    columns = [
        *_as("percent", {"one room": "same", "two rooms": "different", "all pairs": "overall"}),
        *_as(3, {"AUC": "auc"}),
        *_as("count", {"pairs of one room": "n_same", "of two rooms": "n_different"}),
    ]
    rows = _rows(methods, "room_pairs")
    return measured("pairs", ("method", "lighting"), columns, rows, "pairs judged correctly: one room or two")


def expected_errors(found: Measures) -> list[Table]:
    """Return the table of expected and true errors, and of the queries called lost: a row for each lighting."""
    unit = found["unit"]
    columns = [
        *_as(3, {"expected, mean": "predicted", "true, mean": "observed", "gap": "gap"}, unit),
        *_as("count", {"called lost": "lost.called", "truly lost": "lost.lost"}),
        *_as("percent", {"precision": "lost.precision", "recall": "lost.recall"}),
        *_as("count", {"queries": "queries"}),
    ]
    title = f"expected errors; lost above {found['overall']['lost']['lost_above']:g} {unit}"
    return measured("calibration", ("lighting",), columns, _labelled(found), title)


def nodes(found: Measures) -> list[Table]:
    """Return the table of hierarchical localization: a row for each lighting."""
    unit = found["unit"]
    parts = {"perfect nodes": "perfect_coarse", "right node": "given_right", "wrong node": "given_wrong"}
    columns = [
        *_as(3, {"mean": "error.mean", "whole map": "absolute.error.mean"}, unit),
        *_as("percent", {"loss": "loss"}),
        *_as(3, {name: f"{part}.error.mean" for name, part in parts.items()}, unit),
        *_as("share", {"node found": ("coarse.correct", "coarse.queries")}),
        *_as(1, {"comparisons a query": "comparisons.mean"}),
        *_as("percent", {"frames compared": "comparisons.frames_share", "with nodes": "comparisons.share"}),
    ]
    return measured("nodes", ("lighting",), columns, _labelled(found), f"hierarchical localization, {found['name']}")


def mapping(found: Measures) -> list[Table]:
    """Return the measures of a coarse layer as a list, and the purity of each room."""
    closures = f"loop closures that are right, within {found['closures']['radius']:g} {found['unit']}"
    forms = {"": "with_unassigned", ", without frames in no node": "nearest", ", pooled": "pooled"}
    columns = [
        *_as("count", {"nodes": "nodes"}),
        *_as("share", {"frames in no node": ("unassigned.frames", "frames")}),
        *_as(3, {f"silhouette of points{name}": f"silhouette.{key}" for name, key in forms.items()}),
        *_as(3, {"silhouette of descriptors": "descriptor_silhouette"}),
        *_as(3, {"moment of inertia": "inertia"}, f"{found['unit']}²"),
        *_as("percent", {"purity by room": "purity.overall"}),
        *_as("count", {"frames with a room": "purity.frames"}),
        *_as("share", {closures: ("closures.right", "closures.closures")}),
        *_as("share", {"revisits that are closed": ("closures.closed", "closures.revisits")}),
        *_as("percent", {"F1 of loop closures": "closures.f1"}),
        *_as(3, {f"time per frame, {name}": f"ms_per_frame.{key}" for name, key in _SPREAD.items()}, "ms"),
        *_as("count", {name: f"bytes.{name}" for name in ("representatives", "descriptors")}, "bytes"),
    ]
    per_room = [*_as("percent", {"in a node of this room": "purity"}), *_as("count", {"frames": "frames"})]
    by_room = (((room,), one) for room, one in found["purity"]["room"].items())
    return [
        *measured("mapping", (), columns, [((), found)], f"nodes of a map, {found['name']}", upright=True),
        *measured("purity", ("room",), per_room, by_room),
    ]


def compact(found: Measures) -> list[Table]:
    """Return the table of compact maps: a row for each map and each lighting."""
    unit = found["unit"]
    lengths = {"mean": "error.mean", "median": "error.median", "floor": "floor", "in frames": "error_frames.mean"}
    columns = [
        *_as("count", {"nodes": "nodes"}),
        *_as(3, lengths, unit),
        *_as(3, {"silhouette": "silhouette", "inertia": "inertia"}),
        *_as("short", {"search": "search_ms"}, "ms"),
        *_as(2, {"built in": "build_seconds"}, "s"),
    ]
    lightings = found["lighting"] if len(found["lighting"]) > 1 else {}
    curves = {ALL: found["curves"], **lightings}
    rows = (((one["way"], label), one) for label, several in curves.items() for one in several)
    note = f"map: {found['map_frames']:,} frames, grouped by {found['clustered']}; {found['queries']:,} queries"
    title = f"localization in compact maps, {found['name']}, {found['distance']} distance"
    return measured("compact", ("nodes by", "lighting"), columns, rows, title, [note])


def buildings(found: Measures) -> list[Table]:
    """Return the table of buildings chosen correctly: a row for each lighting, a column for each building."""
    labels = found["confusion"]["labels"]
    right: dict[str, Path] = {f"of {one}": (f"of.{i}.correct", f"of.{i}.queries") for i, one in enumerate(labels)}
    columns = _as("share", {"all": ("correct", "queries"), **right})
    rows = [
        (own, {**group, "of": [group["building"].get(label) for label in labels]}) for own, group in _labelled(found)
    ]
    maps = [
        f"{label} {one['frames']:,} frames"
        + ("" if found.get("build", "none") == "none" else f" in {one['representatives']:,} nodes")
        for label, one in found.get("maps", {}).items()
    ]
    note = [f"maps: {'; '.join(maps)}"] if maps else []
    by = f", {found['distance']} distance" if "distance" in found else ""
    return measured("buildings", ("lighting",), columns, rows, f"building chosen correctly, {found['name']}{by}", note)


def robustness(found: Measures) -> list[Table]:
    """Return a table for each disturbance: a row for each method and level."""
    unit = found["unit"]
    columns = [
        *_as(3, {"mean": "mean", "median": "median", "floor": "floor"}, unit),
        *_as("percent", {"hit rate": "hit_rate", f"within {found['radius']:g} {unit}": "share"}),
        *_as("count", {"queries within": "within"}),
        *_as(1, {"heading": "heading", "by the nearest frame": "heading_nearest"}, "deg"),
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
        made += measured("robustness", ("method", kind["unit"]), columns, rows, title, [note] if kind is last else [])
    return made


def cost(costs: Mapping[str, Measures]) -> list[Table]:
    """Return the table of a query's time and a map frame's memory: a row for each method."""
    steps = ("describe", "rank", "search", "heading")
    times = _as("short", {step: f"{step}_ms" for step in steps}, "ms")
    columns = [*times, *_as("count", {"numbers": "numbers", "bytes": "bytes"})]
    rows = (((method,), taken) for method, taken in costs.items() if taken)
    return measured("cost", ("method",), columns, rows, "cost of a query, and size of a map frame")


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
    """Return the recall@1 within the middle of the radii, the headline figure; None if there is none."""
    first = [recall for recall in (group or {}).get("recall", []) if recall["k"] == 1]
    return first[len(first) // 2] if first else None


def _as(form: Form, paths: Mapping[str, Path], unit: str = "") -> list[tuple[Column, Path]]:
    """Return columns of one form and unit, by their headings."""
    return [(Column(name, unit, form), path) for name, path in paths.items()]


def measured(
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
        labels: headings of the columns that label the rows.
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


def _at(group: Measures, path: Path) -> Any:
    """Return the value at a path such as "error.mean" or "hit_rate.0.rate", or two values; None if missing or NaN."""
    if isinstance(path, tuple):
        both = tuple(_at(group, one) for one in path)
        return None if None in both else both
    value: Any = group
    for key in path.split("."):
        if isinstance(value, list):
            value = value[int(key)] if int(key) < len(value) else None
        else:
            value = (value or {}).get(key)
    return None if value != value else value
