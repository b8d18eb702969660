"""Results as text, as returned by `Result.table()`, shown in notebooks and printed by the commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from io import StringIO
from typing import TYPE_CHECKING, Any

from siamloc.results import FURTHER, REMARKS

if TYPE_CHECKING:
    from rich.table import Table

Measures = Mapping[str, Any]


def text_of(
    name: str,
    parts: Measures,
    baselines: Mapping[str, Measures],
    skipped: Mapping[str, str],
    located: int = 0,
    costs: Mapping[str, Measures] | None = None,
) -> str:
    """Return a result's tables, the numbers behind them, and what could not be measured.

    Args:
        name: name of the method.
        parts: measures of the method by kind, as in `Result.parts`.
        baselines: measures of the other methods, by name.
        skipped: what could not be measured, with the reason.
        located: number of queries that were located without a score.
        costs: time and memory of the methods, by name.
    """
    lines: list[str] = []
    if "absolute" in parts or "room_retrieval" in parts:
        lines += _localization(name, parts, baselines)
    unit = parts[next(iter(parts))].get("unit", "") if parts else ""
    for part, write in _WRITERS.items():
        if part in parts:
            lines += write(name, {"unit": unit, **parts[part]})
    lines += [_cost(method, taken) for method, taken in (costs or {}).items()]
    lines += [reason if what in REMARKS else f"{what} left out: {reason}" for what, reason in skipped.items()]
    if located:
        lines.append(f"located without a score: {located} queries, in located.csv")
    return "\n".join(lines)


def _localization(name: str, first: Measures, baselines: Mapping[str, Measures]) -> list[str]:
    """Return the tables of errors and of rooms, a row per method and lighting, and their denominators."""
    methods: dict[str, Measures] = {name: first}
    for further, sign in FURTHER.items():
        if f"absolute_{further}" in first:
            methods[f"{name} + {sign}"] = {"absolute": first[f"absolute_{further}"]}
    methods |= baselines
    absolute, lines = first.get("absolute"), []
    if absolute is not None:
        lines.append(_text(_errors(methods, absolute)))
    if "room_retrieval" in first:
        lines += [""] * bool(lines) + [_text(_rooms(methods, "room_pairs" in first))]
    if absolute is not None:
        lines.append(f"map: {absolute['map_frames']} frames")
        for recall in absolute["overall"]["recall"]:
            if recall["k"] == 1:
                within = f"recall@1 within {recall['radius']:g} {absolute['unit']}"
                lines.append(
                    f"{within}: {recall['answerable']} of {recall['queries']} queries have a map frame that near"
                )
    for method, measures in methods.items():
        overall = measures.get("absolute", {}).get("overall", {})
        count = overall.get("heading_error", {}).get("count", 0)
        if 0 < count < overall["queries"]:
            lines.append(
                f"heading, {method}: {count} of {overall['queries']} queries, where theta is known on both sides"
            )
    return lines


def _errors(methods: Mapping[str, Measures], absolute: Measures) -> Table:
    """Return the errors, floor and recall of methods, a row for each lighting."""
    unit = absolute["unit"]
    headings = any("heading_error" in one.get("absolute", {}).get("overall", {}) for one in methods.values())
    table = _table("method", "lighting")
    for head in ("mean", "median", "95 %", "floor", "excess"):
        _number_column(table, f"{head}\n[{unit}]")
    recalls = [f"recall@1\n{radius:g} {unit}" for radius in absolute["radii"]]
    for head in ("hit\nrate", *recalls, *["heading\n[deg]"] * headings, "queries"):
        _number_column(table, head)
    for method, lighting, group in _groups(methods, "absolute"):
        error = group["error"]
        cells = [_number(value) for value in (error["mean"], error["median"], error["p95"])]
        cells += [_number(group["floor"]["mean"]), _number(group["excess"]["mean"])]
        cells.append(_percent(group["hit_rate"][0]["rate"] if "hit_rate" in group else None))  # not of finer poses
        cells += [_percent(recall["recall"]) for recall in group["recall"] if recall["k"] == 1]
        cells += [_number(group.get("heading_error", {}).get("mean"), 1)] * headings
        table.add_row(method, lighting, *cells, str(group["queries"]))
    return table


def _rooms(methods: Mapping[str, Measures], judged: bool) -> Table:
    """Return how often methods find the room, a row for each lighting, and with `judged` how well they judge pairs."""
    table = _table("method", "lighting")
    pairs = ["pairs\nsame", "pairs\ndifferent"] * judged
    for head in ("room\nretrieved", "room in\ntop 5", "mAP", "chance", *pairs, "queries"):
        _number_column(table, head)
    for method, lighting, group in _groups(methods, "room_retrieval"):
        shares = [group["accuracy"], group["top"]["5"], group["mean_average_precision"], group["chance"]]
        if judged:
            of_pairs = methods[method].get("room_pairs")
            own = (
                (of_pairs["overall"] if lighting == "all" else of_pairs["lighting"].get(lighting)) if of_pairs else None
            )
            shares += [own["same"], own["different"]] if own else [None, None]
        table.add_row(method, lighting, *map(_percent, shares), str(group["queries"]))
    return table


def _groups(methods: Mapping[str, Measures], part: str) -> Iterator[tuple[str, str, Measures]]:
    """Yield each method that measured a part, each lighting of its queries, and the measures of both."""
    for method, measures in methods.items():
        if part in measures:
            for lighting in _lightings(measures[part]):
                found = measures[part]
                yield method, lighting, found["overall"] if lighting == "all" else found["lighting"][lighting]


def _cost(name: str, taken: Measures) -> str:
    steps = ("describe", "rank", "search", "heading")
    ms = [f"{taken[f'{step}_ms']:.3g} ms to {step}" for step in steps if taken.get(f"{step}_ms") is not None]
    return f"cost of a query, {name}: {', '.join(ms)}; a map frame: {taken['numbers']} numbers, {taken['bytes']} bytes"


def _calibration(name: str, measures: Measures) -> list[str]:
    overall = measures["overall"]
    lost = overall["lost"]
    return [
        f"expected error: {_number(overall['predicted'])} for {_number(overall['observed'])} in truth, off by "
        f"{_number(overall['gap'])} along the calibration curve; lost above {lost['lost_above']:g} {measures['unit']}: "
        f"{lost['called']} called, {lost['lost']} in truth, precision {_percent(lost['precision'])}, recall "
        f"{_percent(lost['recall'])}"
    ]


def _hierarchical(name: str, measures: Measures) -> list[str]:
    """Return a row per lighting: errors of both layers together and separately, and the number of comparisons."""
    table, unit = _table("lighting"), measures["unit"]
    heads = ["mean", "95 %", "floor", "excess", "right\nnode", "wrong\nnode", "perfect\nnodes", "whole\nmap"]
    for head in heads:
        _number_column(table, f"{head}\n[{unit}]" if "\n" not in head else f"{head} [{unit}]")
    heading = "heading_error" in measures["overall"]
    for head in ["loss", "node\nfound", "frames\ncompared", "with\nnodes", *["heading\n[deg]"] * heading, "queries"]:
        _number_column(table, head)
    for label in _lightings(measures):
        group = measures["overall"] if label == "all" else measures["lighting"][label]
        errors = [group["error"]["mean"], group["error"]["p95"], group["floor"]["mean"], group["excess"]["mean"]]
        apart = ("given_right", "given_wrong", "perfect_coarse", "absolute")
        errors += [group[one]["error"]["mean"] for one in apart]
        compared = group["comparisons"]
        shares = [group["loss"], group["coarse"]["accuracy"], compared["frames_share"], compared["share"]]
        turned = group.get("heading_error", {}).get("mean")
        cells = [*map(_number, errors), *map(_percent, shares), *[_number(turned, 1)] * heading, str(group["queries"])]
        table.add_row(label, *cells)
    mean = measures["overall"]["comparisons"]["mean"]
    return [
        f"hierarchical localization, {name}",
        _text(table),
        f"map: {measures['map_frames']} frames; {mean:.1f} comparisons a query with those of the nodes",
    ]


def _mapping(name: str, measures: Measures) -> list[str]:
    closures, purity, unit = measures["closures"], measures["purity"], measures["unit"]
    nearest, pooled = (_number(measures["silhouette"][mode]) for mode in ("nearest", "pooled"))
    ms = measures["ms_per_frame"]
    unassigned = measures["unassigned"]
    table = _table()
    for what, value in {
        "layer": name,
        "nodes": f"{measures['nodes']} over {measures['frames']} frames",
        "frames in no node": f"{unassigned['frames']} ({_percent(unassigned['share'])})",
        "silhouette of points": f"{nearest} to the nearest cluster, {pooled} pooled",
        "silhouette of descriptors": _number(measures["descriptor_silhouette"]),
        "moment of inertia": f"{_number(measures['inertia'])} {unit}^2",
        "purity by room": f"{_percent(purity['overall'])} of {purity['frames']} frames",
        "loop closures": f"precision {_percent(closures['precision'])} of {closures['closures']}, recall "
        f"{_percent(closures['recall'])} of {closures['revisits']}, F1 {_percent(closures['f1'])}, within "
        f"{closures['radius']:g} {unit}",
        "time per frame": f"{_number(ms['median'])} ms median, {_number(ms['p95'])} ms 95 %",
        "bytes": f"{measures['bytes']['representatives']} of {measures['bytes']['descriptors']}",
    }.items():
        table.add_row(what, value)
    return [_text(table)]


def _compact(name: str, measures: Measures) -> list[str]:
    """Return a row for each compact map and lighting: both errors, compactness of the nodes, and times."""
    unit = measures["unit"]
    table = _table("nodes by", "lighting")
    _number_column(table, "nodes")
    for head in ("mean", "median", "floor", "in frames"):
        _number_column(table, f"{head}\n[{unit}]")
    for head in ("silhouette", "inertia", "search\n[µs]", "built\nin [s]"):
        _number_column(table, head)
    lightings = {"all": measures["curves"], **measures["lighting"]}
    for lighting, curves in lightings.items() if len(lightings) > 2 else [("all", measures["curves"])]:
        for one in curves:
            errors = [one["error"]["mean"], one["error"]["median"], one["floor"], one["error_frames"]["mean"]]
            compactness = [_number(one["silhouette"]), _number(one["inertia"])]
            times = [_number(1000 * one["search_ms"], 1), _number(one["build_seconds"], 2)]
            cells = [str(one["nodes"]), *map(_number, errors), *compactness, *times]
            table.add_row(one["way"], lighting, *cells)
    made_of = f"{measures['map_frames']} frames, grouped by {measures['clustered']}"
    title = f"localization in compact maps, {name}, {measures['distance']} distance"
    return [title, _text(table), f"map: {made_of}; {measures['queries']} queries"]


def _buildings(name: str, measures: Measures) -> list[str]:
    labels, maps = measures["confusion"]["labels"], measures["maps"]
    table = _table("lighting")
    for head in (*(f"of {label}" for label in labels), "all", "queries"):
        _number_column(table, head)
    for lighting in _lightings(measures):
        group = measures["overall"] if lighting == "all" else measures["lighting"][lighting]
        shares = [_counted(group["building"].get(label)) for label in labels]
        table.add_row(lighting, *shares, _counted(group), str(group["queries"]))
    listed = [
        f"{label} {one['frames']} frames"
        + (f" in {one['representatives']} nodes" if measures["build"] != "none" else "")
        for label, one in maps.items()
    ]
    title = f"building chosen correctly, {name}, {measures['distance']} distance"
    return [title, _text(table), f"maps: {'; '.join(listed)}"]


def _robustness(name: str, measures: Measures) -> list[str]:
    unit = measures["unit"]
    table = _table("method", "disturbance", "level")
    entries = [one for by_name in measures["methods"].values() for levels in by_name.values() for one in levels]
    turned = [key for key in ("heading", "heading_nearest") if any(_number(one.get(key)) != "-" for one in entries)]
    says = {"heading": "heading\n[deg]", "heading_nearest": "by the nearest\nframe [deg]"}
    for head in (f"mean [{unit}]", f"median [{unit}]", f"floor [{unit}]", "hit rate"):
        _number_column(table, head)
    for head in (f"within {measures['radius']:g} {unit}", *(says[key] for key in turned)):
        _number_column(table, head)
    for method, by_name in measures["methods"].items():
        for disturbance, levels in by_name.items():
            for entry in levels:
                share = f"{_percent(entry['share'])} ({entry['within']})"
                cells = [_number(entry[key]) for key in ("mean", "median", "floor")]
                cells += [_percent(entry.get("hit_rate")), share, *(_number(entry.get(key), 1) for key in turned)]
                table.add_row(method, disturbance, f"{entry['level']:g}", *cells)
    counted = f"queries: {measures['queries']} (one in {measures['every']}), map: {measures['map_frames']} frames"
    return [_text(table), counted]


_WRITERS: dict[str, Callable[[str, Measures], list[str]]] = {
    "calibration": _calibration,
    "hierarchical": _hierarchical,
    "mapping": _mapping,
    "compact": _compact,
    "buildings": _buildings,
    "robustness": _robustness,
}


def _lightings(part: Measures) -> list[str]:
    labels = sorted(part["lighting"])
    return [*labels, "all"] if len(labels) != 1 else labels


def _table(*heads: str) -> Table:
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False, show_header=bool(heads))
    for head in heads:
        table.add_column(head)
    return table


def _number_column(table: Table, head: str) -> None:
    table.add_column(head.replace("[", "\\["), justify="right")


def _text(table: Table) -> str:
    from rich.console import Console

    # As wide as the table needs: wrapping is left to the display.
    out = StringIO()
    Console(file=out, width=250, color_system=None, force_jupyter=False).print(table)
    return "\n".join(line.rstrip() for line in out.getvalue().rstrip("\n").split("\n"))


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None or value != value else f"{value:.{digits}f}"


def _percent(share: float | None) -> str:
    return "-" if share is None or share != share else f"{100 * share:.1f} %"


def _counted(group: Measures | None) -> str:
    return "-" if group is None else f"{_percent(group['accuracy'])} ({group['correct']}/{group['queries']})"
