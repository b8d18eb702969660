"""A compact map on the floor plan: frames by node, the graph of the nodes, and the loop closures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from analytic.mapper.graph import connections
from siamloc.data.occupancy import OccupancyMap
from siamloc.errors import FormatError
from siamloc.report.draw.floor_plan import add_occupancy, along, surroundings
from siamloc.report.draw.look import INK, Picture, panels, style
from siamloc.report.draw.node_colours import NO_NODE, ink, neighbouring, node_colours

WRONG = "#CC0000"
_WIDTH = 8.0  # inches of the plan
_HEIGHTS = (2.2, 7.0)
_MOST_DOTS = 400
_MOST_NUMBERED = 120
_ENTRY, _LINE = 2.3, 0.17  # inches: width of an entry of the legend, height of a line
_SMALL = 0.55  # size of a dot without a name


@dataclass(frozen=True, eq=False)
class NodePlan:
    """Data for a plot of a map's nodes on the floor plan.

    Attributes:
        xy: positions of the frames that have one (n, 2).
        node: (n,) node of each frame, -1 for none.
        places: mean position of each node (k, 2), NaN if none of its frames has one.
        edges: (e, 2) pairs of nodes that the robot moved between.
        closures: (c, 2) a frame that closes a loop, and the earlier frame with which it closes the loop.
        radius: radius within which a closure counts as right.
        colours: colours of the nodes 0 ... k - 1.
        unit: unit of the positions.
        title: name and quality of the map.
        occupancy: the map of the building to draw behind the plan.
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
    occupancy: OccupancyMap | None = None

    @property
    def shown(self) -> NDArray[np.float64]:
        """The lowest and the highest x and y of the plan (2, 2)."""
        return surroundings(self.xy, self.occupancy)

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether each closure joins frames within the radius (c,)."""
        ends = self.xy[self.closures]
        return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) <= self.radius


def node_plan(
    measures: Mapping[str, Any],
    frames: Mapping[str, NDArray],
    nodes: Mapping[str, NDArray],
    name: str = "compact map",
    occupancy: OccupancyMap | None = None,
) -> NodePlan:
    """Return the data for the plan of a compact map, whose frames without a position are left out.

    Args:
        measures: `measures.mapping` of `results.json`.
        frames: columns of `frames.csv`: x, y, node, closes_with, sequence.
        nodes: columns of `nodes.csv`: x, y.
        name: name of the map, for the title.
        occupancy: the map of the building to draw behind the plan.

    Raises:
        FormatError: a measure or a column is missing.
    """
    try:
        xy, node, closing = np.column_stack([frames["x"], frames["y"]]), frames["node"], frames["closes_with"]
        places = np.column_stack([nodes["x"], nodes["y"]])
        edges = connections(node, frames["sequence"])
        radius, unit, title = float(measures["closures"]["radius"]), measures["unit"], _title(measures, name)
    except KeyError as error:
        raise FormatError(
            f"these are not the results of a whole evaluation of a compact map ({error.args[0]} is missing): measure "
            "it with `siamloc evaluate task=mapping`"
        ) from error
    placed = np.isfinite(xy).all(axis=1)
    closures = np.column_stack([np.arange(len(node)), closing])[closing >= 0]
    closures = (np.cumsum(placed) - 1)[closures[placed[closures].all(axis=1)]]
    xy, node = xy[placed], node[placed]
    colours = node_colours(neighbouring(xy, node, edges), range(len(places)))
    return NodePlan(xy, node, places, edges, closures, radius, colours, unit, title, occupancy)


@style()
def nodes_on_plan(plan: NodePlan) -> Picture:
    """Draw frames coloured by node, with the graph of the nodes and the loop closures on top.

    Frames that lie on a line are drawn along it, one row of the plot for each node, without loop closures.
    """
    k = len(plan.places)
    line, frames, places = along(dict(zip("xy", plan.xy.T, strict=True))), plan.xy, plan.places
    handles, size = _legend(plan), plan_size(plan.shown)
    across = min(len(handles) if len(handles) < 5 else 3, int((size[0] + 0.9) / _ENTRY))
    margin = 0.9, 1.15 + _LINE * max(0, -(-len(handles) // across) - 2)
    if line is not None:
        axis = "xy".index(line)
        frames, places = np.column_stack([frames[:, axis], plan.node]), np.column_stack([places[:, axis], range(k)])
        size, margin = (8.0, min(max(0.16 * k + 1.6, 2.6), 8.0)), (0.0, 0.0)
    figure, (axes,) = panels(1, *size, margin=margin)
    known = plan.node >= 0
    colours = [plan.colours[node] for node in range(k)]
    # Thousands of dots are rasterized inside an SVG, which would otherwise be large.
    dots: dict[str, Any] = {"linewidths": 0, "rasterized": len(known) > _MOST_DOTS}
    axes.scatter(frames[~known, 0], frames[~known, 1], s=13, color=NO_NODE, zorder=2, **dots)
    shades = frame_colours(colours, plan.node[known])
    axes.scatter(frames[known, 0], frames[known, 1], s=20, c=shades, zorder=3, **dots)
    if line is None:
        _add_arcs(axes, plan)
        names = list(map(str, range(k))) if k <= _MOST_NUMBERED else [""] * k
        add_graph(axes, places, plan.edges, colours, names, 15 if k <= 40 else 11, points_per_unit(plan.shown, size[0]))
        dress(axes, plan)
    else:
        handles = handles[: 2 if known.all() else 3]
        across = len(handles)
        add_graph(axes, places, plan.edges, colours, [""] * k, 11)
        rows = [*range(0, k, max(1, k // 20)), *([] if known.all() else [-1])]
        axes.set_yticks(rows, ["none" if row < 0 else str(row) for row in rows])
        axes.set(xlabel=f"{line} [{plan.unit}]", ylabel="node")
    axes.set_title(plan.title, loc="left", wrap=True)
    figure.legend(handles=handles, loc="outside lower center", ncols=across, columnspacing=1.6)
    return figure


def frame_colours(colours: Sequence[str], node: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return the colour of each frame (n,): that of its node, or grey for frames in no node (-1)."""
    return np.array([*colours, NO_NODE])[node]


def plan_size(
    xy: NDArray[np.float64], width: float = _WIDTH, heights: tuple[float, float] = _HEIGHTS
) -> tuple[float, float]:
    """Return width and height in inches, at most the given ones, of a plan with equal scales."""
    extent = 1.1 * np.maximum(np.ptp(xy, axis=0), 1e-9)
    scale = min(width / extent[0], heights[1] / extent[1])
    return max(scale * extent[0], 3.5), max(scale * extent[1], heights[0])


def points_per_unit(xy: NDArray[np.float64], width: float) -> float:
    """Return the points (72 an inch) that a unit of the positions takes on a plan of a width in inches."""
    return 72 * width / (1.1 * max(float(np.ptp(xy[:, 0])), 1e-9))


def dress(axes: Axes, plan: NodePlan) -> None:
    """Set the limits, equal scales, labels and grid of a plan's axes, and draw the map of the building."""
    add_occupancy(axes, plan.occupancy)
    low, high = plan.shown
    margin = 0.05 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set(xlabel=f"x [{plan.unit}]", ylabel=f"y [{plan.unit}]")
    axes.grid(plan.occupancy is None)  # its lines would cross the walls


def _add_arcs(axes: Axes, plan: NodePlan) -> None:
    """Draw loop closures as thin arcs that bulge to the left by a tenth of their length, wrong ones dashed in red."""
    first, last = (plan.xy[plan.closures[:, end], None] for end in (0, 1))
    t = np.linspace(0, 1, 15)[:, None]
    bulge = 0.4 * (last - first)[..., ::-1] * np.array([-1.0, 1.0])
    arcs, right = first + t * (last - first) + t * (1 - t) * bulge, plan.right
    axes.add_collection(LineCollection(list(arcs[right]), colors=INK, linewidths=0.5, alpha=0.55, zorder=4))
    wrong = LineCollection(list(arcs[~right]), colors=WRONG, linewidths=0.8, linestyles=(0, (4, 2)), zorder=5)
    axes.add_collection(wrong)


def add_graph(
    axes: Axes,
    places: NDArray[np.float64],
    edges: ArrayLike,
    colours: Sequence[str],
    names: Sequence[str],
    points: float,
    scale: float | None = None,
) -> None:
    """Draw nodes as dots with their names, and the ways between nodes as lines.

    Args:
        axes: matplotlib axes of the plan, to which the graph is added.
        places: positions of the nodes (k, 2).
        edges: pairs of nodes (e, 2).
        colours: colour of each node (k,).
        names: name of each node (k,); a dot without a name is smaller.
        points: diameter of a dot with a name, in points.
        scale: points per unit of the positions; dots that would overlap are moved apart. None leaves them in place.
    """
    sizes = np.where([bool(name) for name in names], points, _SMALL * points)
    if scale is not None:
        places = spread_out(places, 1.1 * float(sizes.max(initial=0)) / scale)
    segments = list(places[np.array(edges, dtype=np.int64).reshape(-1, 2)])
    axes.add_collection(LineCollection(segments, colors=INK, linewidths=1.2, alpha=0.85, zorder=6), autolim=False)
    axes.scatter(places[:, 0], places[:, 1], s=sizes**2, c=list(colours), edgecolors=INK, linewidths=1.1, zorder=7)
    look: dict[str, Any] = {"fontsize": 0.5 * points, "fontweight": "bold", "ha": "center", "va": "center_baseline"}
    for (x, y), name, colour in zip(places, names, colours, strict=True):
        if np.isfinite(x):
            axes.text(x, y, name, color=ink(colour), zorder=8, **look)


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


def _legend(plan: NodePlan) -> list[Any]:
    lost, n, right = int((plan.node < 0).sum()), len(plan.node), int(plan.right.sum())
    wrong = len(plan.closures) - right
    within = f"{plan.radius:g} {plan.unit}"
    dot: dict[str, Any] = {"marker": "o", "linestyle": "none"}
    node = dot | {"markersize": 8, "color": plan.colours[0], "markeredgecolor": INK}
    grey = dot | {"markersize": 4.5, "color": NO_NODE, "markeredgewidth": 0}
    dashed = {"color": WRONG, "linewidth": 0.9, "linestyle": (0, (4, 2))}
    entries: list[tuple[int, str, dict[str, Any]]] = [
        (1, f"{counted(len(plan.places), 'node')}, {counted(n - lost, 'frame')}", node),
        (lost, f"{counted(lost, 'frame')} in no node ({100 * lost / n:.1f} %)", grey),
        (1, f"{counted(len(plan.edges), 'way')} between nodes", {"color": INK, "linewidth": 1.4}),
        (right, f"{counted(right, 'loop closure')} within {within}", {"color": INK, "linewidth": 0.6, "alpha": 0.7}),
        (wrong, f"{counted(wrong, 'loop closure')} beyond {within}", dashed),
    ]
    return [Line2D([], [], label=label, **look) for number, label, look in entries if number]


def counted(number: int, word: str) -> str:
    """Return a number with its noun: "1 node", "2 nodes"."""
    return f"{number} {word}{'s' if number != 1 else ''}"


def _title(measures: Mapping[str, Any], name: str) -> str:
    silhouette, purity = measures["silhouette"]["with_unassigned"], measures["purity"]["overall"]
    lines = [name, counted(measures["nodes"], "node")]
    lines[1] += "" if purity is None else f", {100 * purity:.0f} % of frames in a node of their room"
    more = "; frames in no node count as one more" if measures["unassigned"]["frames"] else ""
    scale = f"(1: compact and far apart, 0: touching){more}"
    return "\n".join([*lines, *([] if silhouette is None else [f"silhouette {silhouette:.2f} {scale}"])])
