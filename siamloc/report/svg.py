"""Line charts as SVG, drawn by the page's own style sheet, so that they follow its light and dark colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from siamloc.report.markup import Markup, join, tag

DASHES = (None, "7 3", "2 2.5", "7 2.5 2 2.5", "11 3")
# Corners of a mark around its middle, so many times its size; a circle has none.
MARKS: dict[str, tuple[tuple[float, float], ...]] = {
    "circle": (),
    "square": ((-0.95, -0.95), (0.95, -0.95), (0.95, 0.95), (-0.95, 0.95)),
    "triangle": ((0, -1.3), (1.2, 0.9), (-1.2, 0.9)),
    "diamond": ((0, -1.4), (1.4, 0), (0, 1.4), (-1.4, 0)),
    "down": ((0, 1.3), (1.2, -0.9), (-1.2, -0.9)),
    "bar": ((-0.3, -1.6), (0.3, -1.6), (0.3, 1.6), (-0.3, 1.6)),
}
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
        mark: what stands at each point: one of `MARKS`, or nothing.
        joined: whether a stroke joins the points.
    """

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    colour: str
    dash: str | None = None
    note: str = ""
    mark: str | None = None
    joined: bool = True


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes:
        label: its text.
        low: lower limit.
        high: upper limit.
        log: whether it is logarithmic.
        root: whether it goes with the square root; `low` is 0 then.
        at: where its numbers stand; round ones are chosen if there are none.
    """

    label: str
    low: float
    high: float
    log: bool = False
    root: bool = False
    at: tuple[float, ...] = ()

    def share(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where values lie between the limits, as shares of the axis."""
        if self.log:
            values, low, high = np.log(np.maximum(values, 1e-300)), math.log(self.low), math.log(self.high)
        elif self.root:
            values, low, high = np.sqrt(np.maximum(values, 0)), math.sqrt(self.low), math.sqrt(self.high)
        else:
            low, high = self.low, self.high
        return (values - low) / (high - low)

    def ticks(self) -> list[float]:
        """Return round numbers between the limits."""
        if self.at:
            return list(self.at)
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


def chart(
    title: str,
    lines: Sequence[Line],
    x: Axis,
    y: Axis,
    width: int = 460,
    height: int = 280,
    legend: bool = True,
    rule: float | None = None,
) -> Markup:
    """Return a figure: a title, the chart, and a legend with an entry per line unless that stands elsewhere.

    Args:
        title: stands above.
        lines: the first lies lowest.
        x: the axis across.
        y: the axis upwards.
        width: in units of the picture.
        height: in units of the picture.
        legend: whether the figure has one.
        rule: where to draw a vertical line.
    """
    inner = (width - _LEFT - _RIGHT, height - _TOP - _BOTTOM)
    parts = [*_frame(x, y, inner), *(_path(line, x, y, inner) for line in lines)]
    if rule is not None:
        at = f"{_LEFT + inner[0] * float(x.share(np.array(rule))):.1f}"
        parts.insert(0, tag("line.rule", x1=at, x2=at, y1=_TOP, y2=_TOP + inner[1]))
    picture = tag(
        "svg.chart",
        *parts,
        viewBox=f"0 0 {width} {height}",
        role="img",
        aria_label=f"{title}: {y.label} against {x.label}",
    )
    return tag("figure.panel", tag("figcaption", title), picture, legend_of(lines) if legend else None)


def legend_of(lines: Sequence[Line]) -> Markup:
    """Return what the lines mean."""

    def sample(line: Line) -> Markup:
        stroke = tag("path", d="M0 5H26", stroke_dasharray=line.dash, class_=f"line {line.colour}")
        dot = mark(line.mark, 13, 5, line.colour) if line.mark else None
        if not line.joined:
            return tag("svg.sample", dot, viewBox="0 0 26 10", aria_hidden="true")
        return tag("svg.sample", stroke, dot, viewBox="0 0 26 10", aria_hidden="true")

    return tag("ul.legend", *(tag("li", sample(line), f" {line.label} ", tag("small", line.note)) for line in lines))


def mark(kind: str, x: float, y: float, colour: str, size: float = 3.4) -> Markup:
    """Return a mark of one of the `MARKS`, its middle at a place of the picture."""
    corners = MARKS[kind]
    if not corners:
        return tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=f"{size:g}", class_=f"dot {colour}")
    words = " ".join(f"{x + size * across:.1f},{y + size * down:.1f}" for across, down in corners)
    return tag("polygon", points=words, class_=f"dot {colour}")


def _frame(x: Axis, y: Axis, inner: tuple[int, int]) -> list[Markup]:
    columns, rows = inner
    parts = []
    for value in x.ticks():
        at = _LEFT + columns * float(x.share(np.array(value)))
        parts.append(tag("line.grid", x1=f"{at:.1f}", x2=f"{at:.1f}", y1=_TOP, y2=_TOP + rows))
        parts.append(tag("text.tick", f"{value:.6g}", x=f"{at:.1f}", y=_TOP + rows + 16, text_anchor="middle"))
    for value in y.ticks():
        at = _TOP + rows * (1 - float(y.share(np.array(value))))
        parts.append(tag("line.grid", x1=_LEFT, x2=_LEFT + columns, y1=f"{at:.1f}", y2=f"{at:.1f}"))
        parts.append(tag("text.tick", f"{value:.6g}", x=_LEFT - 6, y=f"{at + 3.5:.1f}", text_anchor="end"))
    middle = _TOP + rows / 2
    turned = f"rotate(-90 11 {middle:.1f})"
    parts.append(tag("text.axis", x.label, x=_LEFT + columns / 2, y=_TOP + rows + 34, text_anchor="middle"))
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
    if line.mark is None and np.isfinite(line.y).sum() > 1:
        return path
    marks = [
        mark(line.mark or "circle", c, r, line.colour)
        for c, r in zip(across.tolist(), down.tolist(), strict=True)
        if not math.isnan(r)
    ]
    return join(path if line.joined else None, *marks)
