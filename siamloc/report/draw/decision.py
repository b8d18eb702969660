"""Explain one decision of the incremental mapper with the numbers behind it ([I] figure 6, [T] figure 4.16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from siamloc.errors import FormatError
from siamloc.report.draw.growth import Story
from siamloc.report.draw.look import INK, PAPER, Picture, style
from siamloc.report.draw.node_colours import NO_NODE, ink
from siamloc.report.draw.nodes import WRONG, counted, dress

if TYPE_CHECKING:
    from analytic import Descriptor
    from analytic.descriptors.base import Description
    from analytic.mapper import IncrementalMapper
    from analytic.mapper.closure import Similarity

_TRIED = 60  # maximum number of decisions computed in search of an instructive one
_BRIDGED = 30  # frames between an image and its match from which it counts as a loop closure
_MOST_CANDIDATES = 6
_BREAK = 4  # width of a gap in the curve, in steps of the horizontal axis
_TOLERANCE = 1e-3  # relative; the log has six digits


@dataclass(frozen=True, eq=False)
class Explained:
    """A decision with the numbers behind it.

    Attributes:
        frame: the number of the image that was placed.
        scores: its entry in the log.
        frames: (n,) numbers of the frames compared, in capture order.
        node: (n,) the mapper's name of the node of each frame at the time.
        position: (n,) normalized similarity of the position descriptors.
        orientation: (n,) that of the orientation descriptors; None if they were not compared.
        values: (n,) their product, on which the decision rests.
        labels: (frame,) the node of every earlier frame at the time, -1 for none.
    """

    frame: int
    scores: dict[str, Any]
    frames: NDArray[np.int64]
    node: NDArray[np.int64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64] | None
    values: NDArray[np.float64]
    labels: NDArray[np.int64]

    @property
    def best(self) -> int:
        """The most similar of the compared frames."""
        return int(self.frames[self.values.argmax()])

    @property
    def best_lies_elsewhere(self) -> bool:
        """Whether the most similar image is in another node than the chosen one."""
        return int(self.node[self.values.argmax()]) != self.scores["node"]


def instructive(story: Story, mapper_file: str | Path) -> Explained | None:
    """Choose a decision that shows how the mapper works, and recompute its curve; the choice is deterministic.

    It is a loop closure among several candidate nodes: in version 1 the one whose peak stands out most, in version 2
    one whose most similar image is in another node than the chosen one, if any. The recomputed values must agree with
    the log; None if they agree for no decision, or if no decision chose a node.

    Args:
        story: log of the map.
        mapper_file: `mapper.npz` of the layer.

    Raises:
        FormatError: a file that is missing or incomplete.
    """
    mapper = _loaded(mapper_file, story.descriptor)
    known = _descriptions(mapper)
    version = story.parameters["version"]
    found = None
    ranked = sorted(_closing(story), key=lambda event: _rank(story.events[event], version))
    for event in ranked[:_TRIED]:
        explained = _explained(story, event, mapper, known)
        if explained is None:
            continue
        if version == 1 or explained.best_lies_elsewhere:
            return explained
        found = found or explained
    return found


@style()
def explain(decision: Explained, story: Story) -> Picture:
    """Draw a decision: the similarity to each frame of the candidate nodes, and their places on the plan."""
    figure = Picture(figsize=(12.0, 5.4))
    rows = 1 if decision.orientation is None else 3
    parts: Any = figure.subfigures(1, 2, width_ratios=[1.45, 1])
    left, right = parts
    panels = left.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=[1, 1, 2.6][-rows:])[:, 0]
    if decision.orientation is not None:
        _curve(panels[0], decision.position, decision, story)
        _curve(panels[1], decision.orientation, decision, story)
        panels[0].set_ylabel("position")
        panels[1].set_ylabel("orientation")
    _curve(panels[-1], decision.values, decision, story)
    panels[-1].set_ylabel("similarity" if rows == 1 else "position x orientation")
    _name_runs(panels[0], decision, story)
    if story.parameters["version"] == 1:
        _show_prominence(panels[-1], decision, float(story.parameters["gamma"]))
    else:
        _show_means(panels[-1], decision)
    panels[-1].set_xlabel("frames of the candidate nodes in capture order; gaps: frames of others or of none")
    _plan(right.subplots(), decision, story)
    right.suptitle("the map at that time, its candidate nodes in colour", x=0.1, ha="left", fontsize=10)
    left.suptitle(_verdict(decision, story), x=0.02, ha="left", fontsize=10)
    left.align_ylabels(panels)
    return figure


def _closing(story: Story) -> list[int]:
    """Return the events that put a single frame into a node."""
    return [
        number
        for number, event in enumerate(story.events)
        if event["reason"] == "ASSIGNED" and len(event["frames"]) == 1 and event["scores"].get("match", -1) >= 0
    ]


def _rank(event: Mapping[str, Any], version: int) -> tuple[Any, ...]:
    """Return a sort key that puts instructive decisions first, judged by the log."""
    scores = event["scores"]
    candidates = len(scores["candidates"])
    closes = event["frames"][0] - scores["match"] >= _BRIDGED
    best = -scores["prominence"] / max(scores["least_prominence"], 1e-12) if version == 1 else -candidates
    return (not closes, not 2 <= candidates <= _MOST_CANDIDATES, best, event["frames"][0])


def _explained(
    story: Story, event: int, mapper: IncrementalMapper, known: Mapping[int, Description]
) -> Explained | None:
    """Compare an image again with the frames that its candidates had; None if the result differs from the log."""
    from analytic.descriptors.base import Description

    frame, scores = story.events[event]["frames"][0], story.events[event]["scores"]
    labels = story.labels(event)
    frames = np.flatnonzero(np.isin(labels, scores["candidates"]))
    if frame not in known or not all(int(other) in known for other in frames):
        return None
    others = Description.concatenate([known[int(other)] for other in frames])
    both = _similarity(mapper, known[frame], others, frames, labels)
    position, orientation, values = both, None, both.values
    if others.orientation is not None:
        position = _similarity(mapper, Description(known[frame].position), others, frames, labels)
        orientation = values / position.values
    explained = Explained(frame, scores, frames, labels[frames], position.values, orientation, values, labels)
    logged, node = scores["similarity"], scores["node"]
    same = abs(float(values[both.best(node)]) - logged) <= _TOLERANCE * logged
    return explained if same and int(frames[both.best(node)]) == scores["match"] else None


def _similarity(
    mapper: IncrementalMapper,
    query: Description,
    others: Description,
    frames: NDArray[np.int64],
    labels: NDArray[np.int64],
) -> Similarity:
    """Return the mapper's similarity to frames, with the nodes as they were at the time."""
    from analytic.descriptors.base import Description
    from analytic.mapper.closure import Similarity as Compared
    from analytic.mapper.closure import image_level
    from analytic.mapper.node import Gallery

    if query.orientation is None:
        others = Description(others.position)
    nodes = []
    for node in np.unique(labels[frames]).tolist():
        rows = np.flatnonzero(labels[frames] == node)
        gallery = Gallery(frames[rows], others.take(rows))
        nodes.append(SimpleNamespace(id=node, modes=(SimpleNamespace(gallery=gallery),)))
    found = image_level(mapper.descriptor, query, cast(Any, nodes), mapper.parameters.distance)
    order = np.argsort(found.frames, kind="stable")
    return Compared(found.frames[order], found.values[order], found.nodes[order], found.modes[order])


def _descriptions(mapper: IncrementalMapper) -> dict[int, Description]:
    """Return the descriptors that the map holds, by frame."""
    return {
        int(frame): mode.gallery.shown.take([row])
        for node in mapper.nodes
        for mode in node.modes
        for row, frame in enumerate(mode.gallery.frames)
    }


def _loaded(path: str | Path, identity: dict[str, Any]) -> IncrementalMapper:
    from analytic import DESCRIPTORS, AnalyticError
    from analytic.mapper import IncrementalMapper

    descriptor = None if identity.get("name") in DESCRIPTORS else _vectors(identity)
    try:
        return IncrementalMapper.load(path, descriptor)
    except AnalyticError as error:
        raise FormatError(str(error)) from error


def _vectors(made_by: dict[str, Any]) -> Descriptor:
    """Return a descriptor that only compares vectors made elsewhere, such as by a network."""
    from analytic import Descriptor

    class Vectors(Descriptor):
        """Stands for a descriptor that is not available."""

        name = "vectors"
        circular = made_by.get("circular", True)

        @property
        def identity(self) -> dict[str, Any]:
            """Identity of the descriptor that made the vectors."""
            return made_by

        def describe(self, batch: Any) -> Description:
            """Not available: the original descriptor is missing."""
            raise NotImplementedError

    return Vectors()


def _places(decision: Explained) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """Return the place of each frame on the axis (n,), and the rows of each run of frames of one node.

    The curve has gaps where the mapper takes it as zero: at frames of other nodes or of none.
    """
    strangers = np.cumsum(~np.isin(decision.labels, decision.scores["candidates"]))
    breaks = np.diff(strangers[decision.frames]) > 0
    where = np.arange(len(decision.frames)) + _BREAK * np.concatenate([[0], np.cumsum(breaks)])
    ends = breaks | (np.diff(decision.node) != 0)
    return where, np.split(np.arange(len(where)), np.flatnonzero(ends) + 1)


def _curve(axes: Axes, values: NDArray[np.float64], decision: Explained, story: Story) -> None:
    where, runs = _places(decision)
    for run in runs:
        colour = story.colours[int(decision.node[run[0]])]
        axes.bar(where[run], values[run], width=1.0, color=colour, alpha=0.35, linewidth=0)
        edges = np.concatenate([where[run] - 0.5, where[run[-1:]] + 0.5])
        axes.stairs(values[run], edges, color=colour, linewidth=1.3)
    best = int(np.flatnonzero(decision.frames == decision.best)[0])
    axes.plot(where[best], values[best], "o", ms=5, mfc=PAPER, mec=INK, mew=1.2, zorder=8)
    axes.set_ylim(0, 1.12 * float(values.max()))
    axes.set_xlim(-2, where[-1] + 2)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    axes.grid(True, axis="y")


def _name_runs(axes: Axes, decision: Explained, story: Story) -> None:
    """Write the node of each run above the curves, and the number of its first frame below them."""
    where, runs = _places(decision)
    width = float(where[-1] + 1)
    shown = [run for run in runs if len(run) >= 0.04 * width]
    for run in shown:
        name = int(decision.node[run[0]])
        colour = story.colours[name]
        number = story.numbers.get(name)
        text = "gone" if number is None else f"node {number}" if len(run) >= 0.1 * width else str(number)
        look: dict[str, Any] = {"color": ink(colour), "fontweight": "bold", "fontsize": 8, "ha": "center"}
        look["bbox"] = {"boxstyle": "round,pad=0.25", "facecolor": colour, "linewidth": 0}
        middle = 0.5 * (where[run[0]] + where[run[-1]])
        axes.annotate(text, (middle, 1.1), xycoords=("data", "axes fraction"), annotation_clip=False, **look)
    axes.set_xticks([where[run[0]] for run in shown], [str(decision.frames[run[0]]) for run in shown])


def _show_prominence(axes: Axes, decision: Explained, gamma: float) -> None:
    """Draw the prominence of the peak, and the required prominence (eq. 8)."""
    where, _ = _places(decision)
    best = int(np.flatnonzero(decision.frames == decision.best)[0])
    peak, height = float(decision.values[best]), decision.scores["prominence"]
    least = decision.scores["least_prominence"]
    x, foot = where[best], peak - height
    side = 1 if x < 0.6 * where[-1] else -1
    beside = x + side * 0.035 * where[-1]
    axes.annotate("", (beside, foot), (beside, peak), arrowprops={"arrowstyle": "<->", "color": INK, "lw": 1.3})
    axes.plot([x, beside], [peak, peak], color=INK, linewidth=0.7, linestyle=":")
    axes.plot([x, beside], [foot, foot], color=INK, linewidth=0.7, linestyle=":")
    axes.plot([beside - 0.012 * where[-1], beside + 0.012 * where[-1]], [foot + least] * 2, color=WRONG, linewidth=2)
    words = f"prominence: {gamma * height / least:.1f} times the mean\n" if least > 0 else "the only peak\n"
    look: dict[str, Any] = {"fontsize": 8.5, "va": "top", "ha": "left" if side > 0 else "right", "zorder": 9}
    look["bbox"] = {"boxstyle": "square,pad=0.1", "facecolor": PAPER, "alpha": 0.8, "linewidth": 0}
    axes.text(beside + side * 0.02 * where[-1], peak, words.strip(), color=INK, **look)
    if least > 0:
        text = f"needed: {gamma:g} times the mean"
        axes.text(beside + side * 0.02 * where[-1], foot + least, text, color=WRONG, **{**look, "va": "center"})


def _show_means(axes: Axes, decision: Explained) -> None:
    """Draw the mean similarity of each candidate; the highest one decides."""
    where, runs = _places(decision)
    means = {int(name): value for name, value in decision.scores["mean_similarity"].items()}
    for run in runs:
        name = int(decision.node[run[0]])
        won = name == decision.scores["node"]
        line: dict[str, Any] = {
            "color": INK,
            "linewidth": 2.6 if won else 1.4,
            "linestyle": "-" if won else (0, (2, 1.2)),
            "zorder": 6,
        }
        axes.plot(where[run[[0, -1]]] + np.array([-0.5, 0.5]), [means[name]] * 2, **line)
    handles = [
        Line2D([], [], color=INK, linewidth=2.6, label="mean of the node, the highest"),
        Line2D([], [], color=INK, linewidth=1.4, linestyle=(0, (2, 1.2)), label="mean of another candidate"),
        Line2D([], [], marker="o", linestyle="none", mfc=PAPER, mec=INK, ms=5, label="most similar image"),
    ]
    axes.legend(handles=handles, loc="best", frameon=True, framealpha=0.85, edgecolor="none")


def _plan(axes: Axes, decision: Explained, story: Story) -> None:
    """Draw where the image, its match and the candidate nodes are."""
    xy = story.plan.xy
    axes.scatter(xy[: decision.frame, 0], xy[: decision.frame, 1], s=9, color=NO_NODE, linewidths=0, zorder=2)
    for name in decision.scores["candidates"]:
        members = decision.frames[decision.node == name]
        axes.scatter(xy[members, 0], xy[members, 1], s=18, color=story.colours[name], linewidths=0, zorder=3)
    match = decision.scores["match"]
    axes.plot(*xy[[decision.frame, match]].T, color=INK, linewidth=1, zorder=4)
    axes.plot(*xy[decision.frame], "*", ms=15, mfc=PAPER, mec=INK, mew=1.2, zorder=5)
    axes.plot(*xy[match], "o", ms=6, mfc=PAPER, mec=INK, mew=1.2, zorder=6)
    dress(axes, story.plan)
    low, high = xy[: decision.frame + 1].min(axis=0), xy[: decision.frame + 1].max(axis=0)
    middle, half = (low + high) / 2, 0.56 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    apart = float(np.linalg.norm(xy[decision.frame] - xy[match]))
    point: dict[str, Any] = {"linestyle": "none", "mec": INK, "mfc": PAPER}
    nearest = f"most similar in the node: image {match}, {apart:.2f} {story.plan.unit} away"
    handles = [
        Line2D([], [], marker="*", ms=11, label=f"image {decision.frame}", **point),
        Line2D([], [], marker="o", ms=6, label=nearest, **point),
    ]
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, -0.13), ncols=1)


def _verdict(decision: Explained, story: Story) -> str:
    candidates = [_name(name, story) for name in decision.scores["candidates"]]
    chosen = _name(decision.scores["node"], story)
    listed = ", ".join(candidates)
    return (
        f"image {decision.frame}: {counted(len(candidates), 'candidate node')} ({listed}), "
        f"closes the loop with {chosen} (version {story.parameters['version']})"
    )


def _name(name: int, story: Story) -> str:
    """Return the number of a node in the other plots; for one that is gone, its name in the mapper."""
    number = story.numbers.get(name)
    return f"node {number}" if number is not None else f"({name}, gone)"
