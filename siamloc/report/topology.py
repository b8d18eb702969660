"""Pictures of a compact map, made from its files alone: the plan by node, how it grew, one decision explained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import DataError, FormatError
from siamloc.report.node_colours import NO_NODE, ink, neighbouring, node_colours
from siamloc.report.plots import save, style
from siamloc.results import read_results, read_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#1A1A1A"
WRONG = "#CC0000"
_WIDTH = 8.0  # inches of the plan
_HEIGHTS = (2.2, 7.0)
_FLATTEST = 0.02  # extents in a smaller ratio than this are drawn along a line


@dataclass(frozen=True, eq=False)
class NodePlan:
    """What a picture of nodes shows.

    Attributes:
        xy: positions of the frames (n, 2).
        node: (n,) of each frame, -1 for none.
        places: mean position of each node (k, 2).
        edges: (e, 2) nodes that the robot went between.
        closures: (c, 2) frames that close a loop, and the earlier frames that they close it with.
        radius: within which a closure is right.
        colours: of the nodes 0 ... k - 1.
        unit: of positions.
        title: what the map is, and how good.
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
        """The axis along which all frames lie, as far as a picture could show; None for a plan."""
        extent = np.ptp(self.xy, axis=0)
        return int(extent.argmax()) if extent.min() <= _FLATTEST * extent.max() else None


def draw_all(results_folder: str | Path, layer_folder: str | Path) -> list[Path]:
    """Draw every picture that the files of a compact map have the numbers for, and return the files.

    Args:
        results_folder: what `siamloc evaluate task=mapping` wrote; the pictures go there: `nodes.png`, and of an
            incremental map `growth.gif` and, if some decision can be explained, `decision.png`.
        layer_folder: of the layer: `events.jsonl` and `mapper.npz` of an incremental map.

    Raises:
        FormatError: files that are missing, not whole, or of different maps.
        StorageError: the disk refuses.
    """
    from siamloc.report import decision_picture, decisions, growth

    target, layer = Path(results_folder), Path(layer_folder)
    plan = read_plan(target)
    drawn = [save(nodes_on_plan(plan), target / "nodes.png")]
    log = layer / "events.jsonl"
    if not log.is_file():
        return drawn
    story = growth.read_story(log, plan, read_results(target)["layer"].get("ids", []))
    drawn.append(growth.animate(story, target / "growth.gif"))
    explained = decisions.instructive(story, layer / "mapper.npz")
    if explained is not None:
        drawn.append(save(decision_picture.explain(explained, story), target / "decision.png"))
    return drawn


def read_plan(results_folder: str | Path) -> NodePlan:
    """Read what `nodes.png` shows from the files of an evaluation.

    Raises:
        FormatError: files that are missing, not whole, or no evaluation of a compact map.
    """
    results = read_results(results_folder)
    try:
        measures, edges = results["measures"]["mapping"], results["edges"]
        frames, nodes = read_rows(results_folder, "frames"), read_rows(results_folder, "nodes")
        xy, node = np.column_stack([frames["x"], frames["y"]]), frames["node"]
        closing = frames["closes_with"]
        places = np.column_stack([nodes["x"], nodes["y"]])
        radius, unit = float(measures["closures"]["radius"]), measures["unit"]
        title = _title(results["layer"], measures)
    except KeyError as error:
        raise FormatError(
            f"{results_folder} holds no whole evaluation of a compact map ({error.args[0]} is missing): give the "
            "folder that `siamloc evaluate task=mapping` wrote"
        ) from error
    pairs = np.array(edges, dtype=np.int64).reshape(-1, 2)
    colours = node_colours(neighbouring(xy, node, pairs), range(len(places)))
    closures = np.column_stack([np.arange(len(node)), closing])[closing >= 0]
    return NodePlan(xy, node, places, pairs, closures, radius, colours, unit, title)


def nodes_on_plan(plan: NodePlan) -> Figure:
    """Draw frames coloured by node, with the graph of the nodes and the loop closures on top.

    Frames that lie on a line are drawn along it, one line of the picture for each node.

    Raises:
        DataError: no frames or no nodes.
    """
    from matplotlib.figure import Figure

    if not len(plan.node) or not len(plan.places):
        raise DataError("there is nothing to draw: the map has no frames or no nodes")
    with style():
        if plan.along is not None:
            return _along_line(plan, plan.along)
        width, height = plan_size(plan.xy)
        figure = Figure(figsize=(width + 0.9, height + 1.15))
        axes, known = figure.add_subplot(), plan.node >= 0
        axes.scatter(plan.xy[~known, 0], plan.xy[~known, 1], s=13, color=NO_NODE, linewidths=0, zorder=2)
        axes.scatter(plan.xy[known, 0], plan.xy[known, 1], s=20, c=frame_colours(plan)[known], linewidths=0, zorder=3)
        add_arcs(axes, plan)
        add_graph(axes, plan)
        dress(axes, plan)
        axes.set_title(plan.title, loc="left")
        handles = _legend(plan)
        columns = len(handles) if len(handles) < 5 else 3
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, columnspacing=1.6)
        return figure


def frame_colours(plan: NodePlan) -> NDArray[np.str_]:
    """Return the colour of each frame (n,), that of its node."""
    table = np.array([plan.colours[node] for node in range(len(plan.places))] + [NO_NODE])
    return table[plan.node]


def plan_size(xy: NDArray[np.float64], width: float = _WIDTH, heights: tuple[float, float] = _HEIGHTS) -> list[float]:
    """Return width and height in inches of a plan in equal scale that is not larger than asked."""
    extent = 1.1 * np.maximum(np.ptp(xy, axis=0), 1e-9)
    scale = min(width / extent[0], heights[1] / extent[1])
    return [max(scale * extent[0], 3.5), max(scale * extent[1], heights[0])]


def dress(axes: Any, plan: NodePlan) -> None:
    """Give a plan its limits, equal scale, labels and a quiet look."""
    low, high = plan.xy.min(axis=0), plan.xy.max(axis=0)
    margin = 0.05 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set(xlabel=f"x [{plan.unit}]", ylabel=f"y [{plan.unit}]")
    axes.grid(color="0.94", linewidth=0.6)


def add_arcs(axes: Any, plan: NodePlan) -> None:
    """Draw loop closures as thin arcs, wrong ones dashed in red on top."""
    from matplotlib.collections import LineCollection

    arcs, right = _arcs(plan.xy[plan.closures]), plan.right
    axes.add_collection(LineCollection(list(arcs[right]), colors=INK, linewidths=0.5, alpha=0.55, zorder=4))
    wrong = LineCollection(list(arcs[~right]), colors=WRONG, linewidths=0.8, linestyles=(0, (4, 2)), zorder=5)
    axes.add_collection(wrong)


def add_graph(axes: Any, plan: NodePlan) -> None:
    """Draw nodes as numbered dots, and the ways between them as lines; dots that would overlap stand side by side."""
    from matplotlib.collections import LineCollection

    k = len(plan.places)
    points = 15.0 if k <= 40 else 11.0 if k <= 120 else 6.0
    width, _ = plan_size(plan.xy)
    per_unit = 72 * width / (1.1 * max(float(np.ptp(plan.xy[:, 0])), 1e-9))
    places = spread_out(plan.places, 1.1 * points / per_unit)
    segments = [places[list(edge)] for edge in plan.edges]
    axes.add_collection(LineCollection(segments, colors=INK, linewidths=1.2, alpha=0.85, zorder=6))
    colours = [plan.colours[node] for node in range(k)]
    axes.scatter(*places.T, s=points**2, c=colours, edgecolors=INK, linewidths=1.1, zorder=7)
    if points < 10:
        return
    for node, (x, y) in enumerate(places):
        look = {"color": ink(colours[node]), "fontsize": 0.5 * points, "fontweight": "bold", "zorder": 8}
        axes.text(x, y, str(node), ha="center", va="center_baseline", **look)


def spread_out(points: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Return points (k, 2) moved apart as little as it takes for any two to be `least` apart; NaN stay as they are."""
    moved = np.array(points, dtype=np.float64)
    for _ in range(100):
        apart = moved[:, None] - moved[None]
        distance = np.linalg.norm(apart, axis=2)
        a, b = np.nonzero(np.triu(distance < least, 1))
        if not len(a):
            break
        # Points that coincide part along x.
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


def _along_line(plan: NodePlan, axis: int) -> Figure:
    from matplotlib.figure import Figure

    k = len(plan.places)
    figure = Figure(figsize=(8.0, min(max(0.16 * k + 1.6, 2.6), 8.0)))
    axes = figure.add_subplot()
    known = plan.node >= 0
    axes.scatter(plan.xy[~known, axis], plan.node[~known], s=12, color=NO_NODE, linewidths=0, zorder=2)
    axes.scatter(plan.xy[known, axis], plan.node[known], s=16, c=frame_colours(plan)[known], linewidths=0, zorder=3)
    for a, b in plan.edges:
        axes.plot(plan.places[[a, b], axis], [a, b], color=INK, linewidth=0.9, zorder=4)
    axes.scatter(plan.places[:, axis], range(k), s=40, color="white", edgecolors=INK, linewidths=1, zorder=5)
    rows = [-1, *range(0, k, max(1, k // 20))] if (~known).any() else list(range(0, k, max(1, k // 20)))
    axes.set_yticks(rows, ["none" if row < 0 else str(row) for row in rows])
    axes.set(xlabel=f"{'xy'[axis]} [{plan.unit}]", ylabel="node")
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_title(plan.title, loc="left")
    figure.legend(handles=_legend(plan)[:3], loc="outside lower center", ncols=3)
    return figure


def _legend(plan: NodePlan) -> list[Any]:
    from matplotlib.lines import Line2D

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


def _title(layer: Mapping[str, Any], measures: Mapping[str, Any]) -> str:
    name = str(layer["name"])
    name = f"incremental map, version {layer['version']}" if "version" in layer else f"map by {name}"
    silhouette = measures["silhouette"]["pooled"]
    purity = measures["purity"]["overall"]
    parts = [name, counted(measures["nodes"], "node")]
    parts += [] if silhouette is None else [f"silhouette {silhouette:.2f} (pooled)"]
    parts += [] if purity is None else [f"{100 * purity:.0f} % of frames in a node of their room"]
    return ", ".join(parts)
