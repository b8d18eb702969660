"""Dot plots as SVG: a row for each group, a mark for each value, told apart by colour and form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from siamloc.report.markup import Markup, tag
from siamloc.report.svg import Axis, mark

_LEFT, _RIGHT, _TOP, _BOTTOM, _ROW = 84, 22, 8, 38, 34


@dataclass(frozen=True)
class Dots:
    """What one kind of value looks like: its label, a colour of the style sheet, and one of `svg.MARKS`."""

    label: str
    colour: str
    mark: str


def dot_rows(
    title: str, rows: Sequence[tuple[str, Sequence[float | None]]], kinds: Sequence[Dots], x: Axis, width: int = 1000
) -> Markup:
    """Return a figure: a title, a row of marks for each group, and a legend.

    Args:
        title: stands above.
        rows: label of each group, and its values in the order of the kinds; None has no mark.
        kinds: of values; later ones lie above earlier ones.
        x: the axis of all values.
        width: in units of the picture.
    """
    across, height = width - _LEFT - _RIGHT, _TOP + _ROW * len(rows) + _BOTTOM
    bottom = height - _BOTTOM
    parts = []
    for value in x.ticks():
        place = f"{_LEFT + across * float(x.share(np.array(value))):.1f}"
        parts.append(tag("line.grid", x1=place, x2=place, y1=_TOP, y2=bottom))
        parts.append(tag("text.tick", f"{value:.6g}", x=place, y=bottom + 15, text_anchor="middle"))
    parts.append(tag("text.axis", x.label, x=_LEFT + across / 2, y=bottom + 33, text_anchor="middle"))
    for i, (label, values) in enumerate(rows):
        y = _TOP + _ROW * (i + 0.5)
        parts.append(tag("text.row", label, x=_LEFT - 12, y=f"{y + 4:.1f}", text_anchor="end"))
        places = [
            (_LEFT + across * float(np.clip(x.share(np.array(value)), 0, 1)), value, kind)
            for value, kind in zip(values, kinds, strict=True)
            if value is not None
        ]
        if places:
            ends = [at for at, _, _ in places]
            parts.append(tag("line.rail", x1=f"{min(ends):.1f}", x2=f"{max(ends):.1f}", y1=y, y2=y))
        for at, value, kind in places:
            words = tag("title", f"{label}, {kind.label}: {value:.3f}")
            parts.append(tag("g", words, mark(kind.mark, at, y, kind.colour, 5.2)))
    picture = tag(
        "svg.chart.dots", *parts, viewBox=f"0 0 {width} {height}", role="img", aria_label=f"{title}: {x.label}"
    )
    entries = (
        tag(
            "li",
            tag("svg.sample", mark(kind.mark, 13, 5, kind.colour, 3.6), viewBox="0 0 26 10", aria_hidden="true"),
            f" {kind.label}",
        )
        for kind in kinds
    )
    return tag("figure.panel", tag("figcaption", title), picture, tag("ul.legend", *entries))
