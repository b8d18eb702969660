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


def _lightings(measures: Mapping[str, Any]) -> list[str]:
    part = measures.get("absolute") or measures["room_retrieval"]
    labels = list(part["lighting"])
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
