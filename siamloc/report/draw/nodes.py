"""A compact map on the floor plan: frames by node, the graph of the nodes, and the loop closures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from siamloc.errors import DataError, FormatError
from siamloc.report.draw.look import INK, PAPER, Picture, style
from siamloc.report.draw.node_colours import NO_NODE, ink, neighbouring, node_colours

WRONG = "#CC0000"
_WIDTH = 8.0  # inches of the plan
_HEIGHTS = (2.2, 7.0)
_MOST_DOTS = 400
_FLATTEST = 0.02  # below this ratio of the extents, frames are drawn along a line


@dataclass(frozen=True, eq=False)
class NodePlan:
    """Data for a plot of nodes.

    Attributes:
        xy: positions of the frames (n, 2).
        node: (n,) node of each frame, -1 for none.
        places: mean position of each node (k, 2).
        edges: (e, 2) pairs of nodes that the robot moved between.
        closures: (c, 2) frames that close a loop, and the earlier frames that they close it with.
        radius: radius within which a closure counts as right.
        colours: colours of the nodes 0 ... k - 1.
        unit: unit of the positions.
        title: name and quality of the map.
    """

    xy: NDArray[np.float64]
    node: NDArray[np.int64]
    places: NDArray[np.float64]
    edges: NDArray[np.int64]
    closures: NDArray[np.int64]
    radius: float
    colours: dict[int, str]
    unit: str = "m"
    title: str = ""

    @property
    def right(self) -> NDArray[np.bool_]:
        """Which closures join frames within the radius (c,)."""
        ends = self.xy[self.closures]
        return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) <= self.radius

    @property
    def along(self) -> int | None:
        """The axis along which all frames lie, at the resolution of a plot; None for a plan."""
        extent = np.ptp(self.xy, axis=0)
        return int(extent.argmax()) if extent.min() <= _FLATTEST * extent.max() else None


def node_plan(
    measures: Mapping[str, Any],
    frames: Mapping[str, NDArray],
    nodes: Mapping[str, NDArray],
    name: str = "compact map",
) -> NodePlan:
    """Return the data for the plan of a compact map.

    Args:
        measures: `measures.mapping` of `results.json`.
        frames: columns of `frames.csv`: x, y, node, closes_with, sequence.
        nodes: columns of `nodes.csv`: x, y.
        name: name of the map, for the title.

    Raises:
        FormatError: a measure or a column is missing.
    """
    try:
        xy, node, closing = np.column_stack([frames["x"], frames["y"]]), frames["node"], frames["closes_with"]
        places = np.column_stack([nodes["x"], nodes["y"]])
        edges = _passages(node, frames["sequence"])
        radius, unit, title = float(measures["closures"]["radius"]), measures["unit"], _title(measures, name)
    except KeyError as error:
        raise FormatError(
            f"these are not the results of a whole evaluation of a compact map ({error.args[0]} is missing): measure "
            "it with `siamloc evaluate task=mapping`"
        ) from error
    colours = node_colours(neighbouring(xy, node, edges), range(len(places)))
    closures = np.column_stack([np.arange(len(node)), closing])[closing >= 0]
    return NodePlan(xy, node, places, edges, closures, radius, colours, unit, title)


def _passages(node: NDArray[np.int64], sequence: NDArray[np.str_]) -> NDArray[np.int64]:
    """Return the pairs of nodes (e, 2) that the robot moved between; frames in no node are skipped."""
    pairs: set[tuple[int, int]] = set()
    for name in dict.fromkeys(sequence.tolist()):
        passed = node[(sequence == name) & (node >= 0)].tolist()
        pairs.update((min(a, b), max(a, b)) for a, b in pairwise(passed) if a != b)
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


@style()
def nodes_on_plan(plan: NodePlan) -> Picture:
    """Draw frames coloured by node, with the graph of the nodes and the loop closures on top.

    Frames that lie on a line are drawn along it, one row of the plot for each node.

    Raises:
        DataError: no frames or no nodes.
    """
    if not len(plan.node) or not len(plan.places):
        raise DataError("there is nothing to draw: the map has no frames or no nodes")
    if plan.along is not None:
        return _along_line(plan, plan.along)
    width, height = plan_size(plan.xy)
    figure = Picture(figsize=(width + 0.9, height + 1.15))
    axes, known = figure.add_subplot(), plan.node >= 0
    # Thousands of dots are rasterized inside an SVG, which would otherwise be large.
    dots: dict[str, Any] = {"linewidths": 0, "rasterized": len(known) > _MOST_DOTS}
    axes.scatter(plan.xy[~known, 0], plan.xy[~known, 1], s=13, color=NO_NODE, zorder=2, **dots)
    axes.scatter(plan.xy[known, 0], plan.xy[known, 1], s=20, c=frame_colours(plan)[known], zorder=3, **dots)
    add_arcs(axes, plan)
    add_graph(axes, plan)
    dress(axes, plan)
    axes.set_title(plan.title, loc="left")
    handles = _legend(plan)
    columns = len(handles) if len(handles) < 5 else 3
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, columnspacing=1.6)
    return figure


def frame_colours(plan: NodePlan) -> NDArray[np.str_]:
    """Return the colour of each frame's node (n,)."""
    table = np.array([plan.colours[node] for node in range(len(plan.places))] + [NO_NODE])
    return table[plan.node]


def plan_size(xy: NDArray[np.float64], width: float = _WIDTH, heights: tuple[float, float] = _HEIGHTS) -> list[float]:
    """Return width and height in inches of a plan with equal scales and at most the given size."""
    extent = 1.1 * np.maximum(np.ptp(xy, axis=0), 1e-9)
    scale = min(width / extent[0], heights[1] / extent[1])
    return [max(scale * extent[0], 3.5), max(scale * extent[1], heights[0])]


def dress(axes: Axes, plan: NodePlan) -> None:
    """Set the limits, equal scales, labels and grid of a plan."""
    low, high = plan.xy.min(axis=0), plan.xy.max(axis=0)
    margin = 0.05 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set(xlabel=f"x [{plan.unit}]", ylabel=f"y [{plan.unit}]")
    axes.grid(True)


def add_arcs(axes: Axes, plan: NodePlan) -> None:
    """Draw loop closures as thin arcs, wrong ones dashed in red on top."""
    arcs, right = _arcs(plan.xy[plan.closures]), plan.right
    axes.add_collection(LineCollection(list(arcs[right]), colors=INK, linewidths=0.5, alpha=0.55, zorder=4))
    wrong = LineCollection(list(arcs[~right]), colors=WRONG, linewidths=0.8, linestyles=(0, (4, 2)), zorder=5)
    axes.add_collection(wrong)


def add_graph(axes: Axes, plan: NodePlan) -> None:
    """Draw nodes as numbered dots and their connections as lines; dots that would overlap are moved apart."""
    k = len(plan.places)
    points = 15.0 if k <= 40 else 11.0 if k <= 120 else 6.0
    width, _ = plan_size(plan.xy)
    per_unit = 72 * width / (1.1 * max(float(np.ptp(plan.xy[:, 0])), 1e-9))
    places = spread_out(plan.places, 1.1 * points / per_unit)
    segments = [places[list(edge)] for edge in plan.edges]
    axes.add_collection(LineCollection(segments, colors=INK, linewidths=1.2, alpha=0.85, zorder=6))
    colours = [plan.colours[node] for node in range(k)]
    axes.scatter(places[:, 0], places[:, 1], s=points**2, c=colours, edgecolors=INK, linewidths=1.1, zorder=7)
    if points < 10:
        return
    for node, (x, y) in enumerate(places):
        look: dict[str, Any] = {
            "color": ink(colours[node]),
            "fontsize": 0.5 * points,
            "fontweight": "bold",
            "zorder": 8,
        }
        axes.text(x, y, str(node), ha="center", va="center_baseline", **look)


def spread_out(points: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Return points (k, 2) moved apart just enough for any two to be `least` apart; NaN points stay unchanged."""
    moved = np.array(points, dtype=np.float64)
    for _ in range(100):
        apart = moved[:, None] - moved[None]
        distance = np.linalg.norm(apart, axis=2)
        a, b = np.nonzero(np.triu(distance < least, 1))
        if not len(a):
            break
        # Coinciding points separate along x.
        way = np.where(distance[a, b, None] > 0, apart[a, b], np.array([1.0, 0.0]))
        way = way / np.linalg.norm(way, axis=1, keepdims=True) * (1.02 * least - distance[a, b, None]) / 2
        np.add.at(moved, a, way)
        np.add.at(moved, b, -way)
    return moved


def _arcs(ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return arcs (c, 15, 2) between pairs of points (c, 2, 2), bulging to the left by a fifth of their length."""
    first, last = ends[:, None, 0], ends[:, None, 1]
    along = last - first
    bulge = 0.4 * along[..., ::-1] * np.array([-1.0, 1.0])
    t = np.linspace(0, 1, 15)[None, :, None]
    return first + t * along + t * (1 - t) * bulge


def _along_line(plan: NodePlan, axis: int) -> Picture:
    k = len(plan.places)
    figure = Picture(figsize=(8.0, min(max(0.16 * k + 1.6, 2.6), 8.0)))
    axes = figure.add_subplot()
    known = plan.node >= 0
    axes.scatter(plan.xy[~known, axis], plan.node[~known], s=12, color=NO_NODE, linewidths=0, zorder=2)
    axes.scatter(plan.xy[known, axis], plan.node[known], s=16, c=frame_colours(plan)[known], linewidths=0, zorder=3)
    for a, b in plan.edges:
        axes.plot(plan.places[[a, b], axis], [a, b], color=INK, linewidth=0.9, zorder=4)
    axes.scatter(plan.places[:, axis], range(k), s=40, color=PAPER, edgecolors=INK, linewidths=1, zorder=5)
    rows = [-1, *range(0, k, max(1, k // 20))] if (~known).any() else list(range(0, k, max(1, k // 20)))
    axes.set_yticks(rows, ["none" if row < 0 else str(row) for row in rows])
    axes.set(xlabel=f"{'xy'[axis]} [{plan.unit}]", ylabel="node")
    axes.grid(True)
    axes.set_title(plan.title, loc="left")
    figure.legend(handles=_legend(plan)[:3], loc="outside lower center", ncols=3)
    return figure


def _legend(plan: NodePlan) -> list[Any]:
    lost, n = int((plan.node < 0).sum()), len(plan.node)
    right = int(plan.right.sum())
    wrong = len(plan.closures) - right
    dot: dict[str, Any] = {"marker": "o", "linestyle": "none"}
    handles = [
        Line2D([], [], **dot, markersize=8, color=plan.colours[0], markeredgecolor=INK,
               label=f"{counted(len(plan.places), 'node')}, {counted(n - lost, 'frame')}"),
        Line2D([], [], color=INK, linewidth=1.4, label=counted(len(plan.edges), "way", " between nodes")),
    ]  # fmt: skip
    if lost:
        label = f"{counted(lost, 'frame')} in no node ({100 * lost / n:.1f} %)"
        handles.insert(1, Line2D([], [], **dot, markersize=4.5, color=NO_NODE, markeredgewidth=0, label=label))
    if right:
        label = counted(right, "loop closure", f" within {plan.radius:g} {plan.unit}")
        handles.append(Line2D([], [], color=INK, linewidth=0.6, alpha=0.7, label=label))
    if wrong:
        label = counted(wrong, "loop closure", f" beyond {plan.radius:g} {plan.unit}")
        handles.append(Line2D([], [], color=WRONG, linewidth=0.9, linestyle=(0, (4, 2)), label=label))
    return handles


def counted(number: int, word: str, rest: str = "") -> str:
    """Return "1 node", "2 nodes"."""
    return f"{number} {word}{'s' if number != 1 else ''}{rest}"


def _title(measures: Mapping[str, Any], name: str) -> str:
    silhouette = measures["silhouette"]["pooled"]
    purity = measures["purity"]["overall"]
    parts = [counted(measures["nodes"], "node")]
    parts += [] if silhouette is None else [f"silhouette {silhouette:.2f} (pooled)"]
    parts += [] if purity is None else [f"{100 * purity:.0f} % of frames in a node of their room"]
    return f"{name}\n{', '.join(parts)}"
