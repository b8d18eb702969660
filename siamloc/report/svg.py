"""Line charts as SVG, drawn by the page's own style sheet, so that they follow its light and dark colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from siamloc.report.markup import Markup, join, tag

DASHES = (None, "7 3", "2 2.5", "7 2.5 2 2.5", "11 3")
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 12, 10, 38


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a chart.

    Attributes:
        label: stands in the legend.
        x: (n,).
        y: (n,); NaN leaves a gap.
        colour: name of a colour of the style sheet: "k0" ... "k7", "ink" or "soft".
        dash: of the stroke.
        note: stands behind the label.
    """

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    colour: str
    dash: str | None = None
    note: str = ""


@dataclass(frozen=True)
class Axis:
    """An axis: its text, limits, and whether it is logarithmic."""

    label: str
    low: float
    high: float
    log: bool = False

    def share(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where values lie between the limits, as shares of the axis."""
        if self.log:
            values, low, high = np.log(np.maximum(values, 1e-300)), math.log(self.low), math.log(self.high)
        else:
            low, high = self.low, self.high
        return (values - low) / (high - low)

    def ticks(self) -> list[float]:
        """Return round numbers between the limits."""
        if self.log:
            found = [
                v for v in series_1_2_5(self.low, self.high) if self.low * (1 - 1e-9) <= v <= self.high * (1 + 1e-9)
            ]
            return found if len(found) <= 10 else [v for v in found if math.isclose(10 ** round(math.log10(v)), v)]
        step = next(v for v in series_1_2_5((self.high - self.low) / 6, self.high - self.low) if v > 0)
        first = math.ceil(self.low / step - 1e-9)
        return [i * step for i in range(first, math.floor(self.high / step + 1e-9) + 1)]


def series_1_2_5(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times a power of ten from `low` (rounded up) to the first not below `high`."""
    low = max(low, 1e-12)
    found = []
    for power in range(math.floor(math.log10(low)), 320):
        for step in (1, 2, 5):
            value = float(f"{step}e{power}")
            if value >= low * (1 - 1e-9):
                found.append(value)
                if value >= high * (1 - 1e-9):
                    return found
    return found


def chart(title: str, lines: Sequence[Line], x: Axis, y: Axis, width: int = 460, height: int = 280) -> Markup:
    """Return a figure: a title, the chart, and a legend with a row per line."""
    inner = (width - _LEFT - _RIGHT, height - _TOP - _BOTTOM)
    parts = [*_frame(x, y, inner), *(_path(line, x, y, inner) for line in lines)]
    picture = tag(
        "svg.chart",
        *parts,
        viewBox=f"0 0 {width} {height}",
        role="img",
        aria_label=f"{title}: {y.label} against {x.label}",
    )
    return tag("figure.panel", tag("figcaption", title), picture, _legend(lines))


def _frame(x: Axis, y: Axis, inner: tuple[int, int]) -> list[Markup]:
    columns, rows = inner
    parts = []
    for value in x.ticks():
        at = _LEFT + columns * float(x.share(np.array(value)))
        parts.append(tag("line.grid", x1=f"{at:.1f}", x2=f"{at:.1f}", y1=_TOP, y2=_TOP + rows))
        parts.append(tag("text.tick", f"{value:.6g}", x=f"{at:.1f}", y=_TOP + rows + 14, text_anchor="middle"))
    for value in y.ticks():
        at = _TOP + rows * (1 - float(y.share(np.array(value))))
        parts.append(tag("line.grid", x1=_LEFT, x2=_LEFT + columns, y1=f"{at:.1f}", y2=f"{at:.1f}"))
        parts.append(tag("text.tick", f"{value:.6g}", x=_LEFT - 6, y=f"{at + 3.5:.1f}", text_anchor="end"))
    middle = _TOP + rows / 2
    turned = f"rotate(-90 11 {middle:.1f})"
    parts.append(tag("text.axis", x.label, x=_LEFT + columns / 2, y=_TOP + rows + 32, text_anchor="middle"))
    parts.append(tag("text.axis", y.label, x=11, y=f"{middle:.1f}", text_anchor="middle", transform=turned))
    return parts


def _path(line: Line, x: Axis, y: Axis, inner: tuple[int, int]) -> Markup:
    across = _LEFT + inner[0] * np.clip(x.share(line.x), 0, 1)
    down = _TOP + inner[1] * (1 - np.clip(y.share(line.y), -0.02, 1.02))
    words, pen = [], "M"
    for column, row in zip(across.tolist(), down.tolist(), strict=True):
        if math.isnan(row):
            pen = "M"
            continue
        words.append(f"{pen}{column:.1f} {row:.1f}")
        pen = "L"
    path = tag("path", d="".join(words), stroke_dasharray=line.dash, class_=f"line {line.colour}")
    if np.isfinite(line.y).sum() > 1:
        return path
    dots = [
        tag("circle", cx=f"{c:.1f}", cy=f"{r:.1f}", r=3, class_=f"dot {line.colour}")
        for c, r in zip(across.tolist(), down.tolist(), strict=True)
        if not math.isnan(r)
    ]
    return join(path, *dots)


def _legend(lines: Sequence[Line]) -> Markup:
    def sample(line: Line) -> Markup:
        stroke = tag("path", d="M0 5H26", stroke_dasharray=line.dash, class_=f"line {line.colour}")
        return tag("svg.sample", stroke, viewBox="0 0 26 10", aria_hidden="true")

    return tag("ul.legend", *(tag("li", sample(line), f" {line.label} ", tag("small", line.note)) for line in lines))
