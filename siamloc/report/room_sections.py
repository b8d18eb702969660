"""Parts of a report page about rooms: which was taken for which, and pairs of images judged by their distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from siamloc.report import tables
from siamloc.report.gathered import ALL, Evaluation
from siamloc.report.markup import Markup, count, number, percent, plural, tag
from siamloc.report.parts import lighting_switch, section, under
from siamloc.report.svg import DASHES, Axis, Line, chart, legend_of

_MOST_CELLS = 40  # rooms; a matrix of more would be wider than any screen
_CURVES = (
    ("same", "pairs of one room", "k0", DASHES[1]),
    ("different", "pairs of two rooms", "k5", DASHES[2]),
    ("overall", "all pairs", "ink", None),
)


def confusion(evaluation: Evaluation, number_: int) -> Markup | None:
    """Return the confusion matrices, one for each lighting and one of all; None where rooms were not looked for."""
    rooms = evaluation.rooms
    if rooms is None:
        return None
    matrices = {ALL: rooms["confusion"]["counts"], **rooms["confusion"].get("lighting", {})}
    if len(matrices) == 2:
        matrices = {ALL: matrices[ALL]}  # one lighting: its matrix is that of all
    groups = {label: int(np.sum(counts)) for label, counts in matrices.items()}
    parts = [under(label, *_matrix(rooms, counts, label)) for label, counts in matrices.items()]
    switch = lighting_switch(f"lighting-rooms-{number_}", groups)
    bar = None if switch is None else tag("div.bar", switch)
    return section("Rooms taken for each other", bar, *parts, name="rooms")


def pairs(evaluation: Evaluation) -> Markup | None:
    """Return how well pairs of one room are told from pairs of two; None where pairs were not judged."""
    found = evaluation.results["measures"].get("room_pairs")
    if found is None:
        return None
    groups = {**found["lighting"], ALL: found["overall"]} if len(found["lighting"]) != 1 else found["lighting"]
    rows = []
    for label, group in groups.items():
        shares = [percent(group[name]) for name in ("same", "different", "overall")]
        counts = [count(group["n_same"]), count(group["n_different"])]
        rows.append((label, [*shares, number(group.get("auc")), *counts]))
    heads = ["lighting", "one room", "two rooms", "all pairs", "AUC", "pairs of one room", "of two rooms"]
    curves = {"all pairs": found["curve"]} | {
        label: group["curve"] for label, group in found["lighting"].items() if "curve" in group
    }
    if len(curves) == 2:
        curves.pop("all pairs")
    lines = {title: _curve(points) for title, points in curves.items()}
    x, y = Axis("threshold of the dissimilarity", 0, 1), Axis("judged right [%]", 0, 100)
    charts = [
        chart(title, drawn, x, y, 340, 230, legend=False, rule=found["threshold"]) for title, drawn in lines.items()
    ]
    text = (
        f"The dissimilarity of a pair is its distance divided by {found['margin']:g}, and 1 at most; a pair below "
        f"{found['threshold']:g}, where the vertical lines stand, is taken for one room. The AUC needs no threshold: "
        "it is the share of couples in which the pair of one room is the less dissimilar one."
    )
    return section(
        "Pairs of images: one room or two",
        tables.grid(heads, rows, "pair-shares"),
        tag("p.caption", text),
        legend_of(next(iter(lines.values()))),
        tag("div.panels.three", *charts),
        name="pair-curves",
    )


def _matrix(rooms: Mapping[str, Any], counts: Sequence[Sequence[int]], label: str) -> list[Markup]:
    """Return a matrix with its caption."""
    right, total = int(np.trace(counts)), int(np.sum(counts))
    where = "" if label == ALL else f" under the lighting {label}"
    text = f"{count(right)} of {count(total)} queries ({percent(right / total if total else None)}) in the right room"
    caption = tag("p.caption", f"{text}{where}. A row is a true room, shares are of its queries.")
    labels = rooms["confusion"]["labels"]
    if len(labels) > _MOST_CELLS:
        return [_mistakes(labels, counts), caption]
    return [_table(labels, counts, rooms.get("rooms_missing_in_map", [])), caption]


def _table(labels: Sequence[str], counts: Sequence[Sequence[int]], missing: Sequence[str]) -> Markup:
    head = tag("tr", tag("td.corner", "true room ↓ taken for →"), *(tag("th", label, scope="col") for label in labels))
    rows = []
    for label, row in zip(labels, counts, strict=True):
        total = sum(row)
        note = tag("small", plural(total, "query", "queries") + (", not in the map" if label in missing else ""))
        cells = [_cell(label, other, value, total) for other, value in zip(labels, row, strict=True)]
        rows.append(tag("tr", tag("th", label, note, scope="row"), *cells))
    return tables.scrolling(tag("table", tag("thead", head), tag("tbody", *rows), class_="confusion"))


def _cell(label: str, other: str, value: int, total: int) -> Markup:
    share = value / total if total else 0.0
    names = ["deep" if share > 0.55 else "", "right" if other == label else ""]
    return tag(
        "td",
        *([tag("b", _whole_percent(share)), tag("small", count(value))] if value else []),
        style=f"--s:{share:.3f}" if value else None,
        class_=" ".join(filter(None, names)) or None,
        title=f"{label} taken for {other}: {value} of {total}" if value else None,
    )


def _mistakes(labels: Sequence[str], counts: Sequence[Sequence[int]]) -> Markup:
    """Return the most frequent mistakes among very many rooms."""
    wrong = [
        (value, labels[i], labels[j]) for i, row in enumerate(counts) for j, value in enumerate(row) if i != j and value
    ]
    wrong.sort(key=lambda item: (-item[0], item[1], item[2]))
    rows = [(f"{true} taken for {taken}", plural(value, "query", "queries")) for value, true, taken in wrong[:30]]
    return tables.key_values(rows or [(f"{len(labels)} rooms", "no mistakes")])


def _whole_percent(share: float) -> str:
    """Return a share in percent, with a decimal where rounding would hide that it is not 0 or not 100."""
    return f"{100 * share:.0f} %" if 0.01 <= share <= 0.99 or share == 1 else f"{100 * share:.1f} %"


def _curve(points: Sequence[Mapping[str, float | None]]) -> list[Line]:
    def column(name: str) -> np.ndarray:
        return np.array([np.nan if point[name] is None else point[name] for point in points], dtype=np.float64)

    return [Line(label, column("threshold"), 100 * column(name), colour, dash) for name, label, colour, dash in _CURVES]
