"""Tables on the screen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table


def print_summary(methods: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a row per method and lighting: errors, floor, excess, recall@1, room accuracy, and their denominators."""
    first = next(iter(methods.values()))
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("method")
    table.add_column("lighting")
    absolute = first.get("absolute")
    if absolute is not None:
        unit = absolute["unit"]
        radii = absolute["radii"]
        for name in ("mean", "median", "95 %", "floor", "excess"):
            table.add_column(f"{name}\n[{unit}]".replace("[", r"\["), justify="right")
        for radius in radii:
            table.add_column(f"recall@1\n{radius:g} {unit}", justify="right")
        if _any_heading(methods):
            table.add_column("heading\n\\[deg]", justify="right")
        table.add_column("queries", justify="right")
    if "room_retrieval" in first:
        table.add_column("room\nretrieved", justify="right")
    if "room_pairs" in first:
        table.add_column("pairs\nsame", justify="right")
        table.add_column("pairs\ndifferent", justify="right")
    for method, measures in methods.items():
        for lighting in _lightings(measures):
            table.add_row(method, lighting, *_cells(measures, lighting, first, _any_heading(methods)))
    # Without a terminal the width is a guess that would fold the columns.
    console = Console()
    console.print(table) if console.is_terminal else Console(width=160).print(table)
    if absolute is not None:
        print(f"map: {absolute['map_frames']} frames")
        for recall in absolute["overall"]["recall"]:
            if recall["k"] == 1:
                within = f"recall@1 within {recall['radius']:g} {absolute['unit']}"
                print(f"{within}: {recall['answerable']} of {recall['queries']} queries have a map frame that near")
    for method, measures in methods.items():
        overall = measures.get("absolute", {}).get("overall", {})
        told = overall.get("heading_error", {}).get("count", 0)
        if 0 < told < overall["queries"]:
            print(f"heading, {method}: {told} of {overall['queries']} queries, where theta is known on both sides")


def print_hierarchical(method: str, measures: Mapping[str, Any]) -> None:
    """Print a row per lighting: errors of both layers together and taken apart, and the comparisons they took."""
    unit, table = f"\\[{measures['unit']}]", Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("lighting")
    heads = ["mean", "95 %", "floor", "excess", "right\nnode", "wrong\nnode", "perfect\nnodes", "whole\nmap"]
    for name in heads:
        table.add_column(f"{name}\n{unit}" if "\n" not in name else f"{name} {unit}", justify="right")
    heading = "heading_error" in measures["overall"]
    further = ["loss", "node\nfound", "frames\ncompared", "with\nnodes", *(["heading\n\\[deg]"] * heading), "queries"]
    for name in further:
        table.add_column(name, justify="right")
    labels = list(measures["lighting"])
    for label in [*labels, "all"] if len(labels) != 1 else labels:
        group = measures["overall"] if label == "all" else measures["lighting"][label]
        errors = [group["error"]["mean"], group["error"]["p95"], group["floor"]["mean"], group["excess"]["mean"]]
        errors += [
            group[name]["error"]["mean"] for name in ("given_right", "given_wrong", "perfect_coarse", "absolute")
        ]
        compared = group["comparisons"]
        shares = [group["loss"], group["coarse"]["accuracy"], compared["frames_share"], compared["share"]]
        turned = group["heading_error"]["mean"] if "heading_error" in group else float("nan")
        table.add_row(
            label,
            *map(_number, errors),
            *map(_percent, shares),
            *([_number(turned, 1)] * heading),
            str(group["queries"]),
        )
    print(f"hierarchical localization, {method}")
    console = Console()
    console.print(table) if console.is_terminal else Console(width=160).print(table)
    mean = measures["overall"]["comparisons"]["mean"]
    print(f"map: {measures['map_frames']} frames; {mean:.1f} comparisons a query with those of the nodes")


def print_calibration(measures: Mapping[str, Any], unit: str) -> None:
    """Print how well expected errors hold."""
    overall = measures["overall"]
    lost = overall["lost"]
    print(
        f"expected error: {overall['predicted']:.3f} {unit} for {overall['observed']:.3f} {unit} in truth, off by "
        f"{overall['gap']:.3f} {unit} along the calibration curve; lost above {lost['lost_above']:g} {unit}: "
        f"{lost['called']} called, {lost['lost']} in truth, precision {_percent(lost['precision'])}, recall "
        f"{_percent(lost['recall'])}"
    )


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}f}" if value == value else "-"


def _lightings(measures: Mapping[str, Any]) -> list[str]:
    """Return the lightings of all queries: some may have a room and no position, or the other way round."""
    parts = [measures[name]["lighting"] for name in ("absolute", "room_retrieval") if name in measures]
    labels = sorted({label for part in parts for label in part})
    return [*labels, "all"] if len(labels) != 1 else labels


def _any_heading(methods: Mapping[str, Mapping[str, Any]]) -> bool:
    """Say whether a method told headings."""
    return any("heading_error" in measures.get("absolute", {}).get("overall", {}) for measures in methods.values())


def _cells(measures: Mapping[str, Any], lighting: str, first: Mapping[str, Any], with_heading: bool) -> list[str]:
    def group(name: str) -> Mapping[str, Any] | None:
        part = measures.get(name)
        if part is None:
            return None
        return part["overall"] if lighting == "all" else part["lighting"].get(lighting)

    cells: list[str] = []
    absolute = group("absolute")
    if absolute is None and "absolute" in first:
        cells += ["-"] * (6 + len(first["absolute"]["radii"]) + with_heading)
    if absolute is not None:
        error = absolute["error"]
        values = [error["mean"], error["median"], error["p95"], absolute["floor"]["mean"], absolute["excess"]["mean"]]
        cells += [f"{value:.3f}" for value in values]
        cells += [_percent(recall["recall"]) for recall in absolute["recall"] if recall["k"] == 1]
        if with_heading:
            cells.append(f"{absolute['heading_error']['mean']:.1f}" if "heading_error" in absolute else "-")
        cells.append(str(absolute["queries"]))
    if "room_retrieval" in first:
        rooms = group("room_retrieval")
        cells.append(_percent(rooms["accuracy"]) if rooms else "-")
    if "room_pairs" in first:
        pairs = group("room_pairs")
        cells += [_percent(pairs["same"]), _percent(pairs["different"])] if pairs else ["-", "-"]
    return cells


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share == share else "-"
