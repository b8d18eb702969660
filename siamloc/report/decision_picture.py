"""One decision of the incremental mapper, drawn ([I] figure 6, [T] figure 4.16)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from siamloc.report.decisions import Explained
from siamloc.report.growth import Story
from siamloc.report.node_colours import NO_NODE, ink
from siamloc.report.plots import style
from siamloc.report.topology import INK, WRONG, counted, dress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BREAK = 4  # steps of the horizontal axis where the curve breaks


def explain(decision: Explained, story: Story) -> Figure:
    """Draw a decision: the similarity to each frame of the candidate nodes, and where all that is on the plan."""
    from matplotlib.figure import Figure

    with style():
        figure = Figure(figsize=(12.0, 5.4))
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


def _places(decision: Explained) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """Return where each frame stands on the axis (n,), and the rows of each run of frames of one node.

    The curve breaks where it is zero for the mapper: where frames of other nodes, or of none, lie between.
    """
    strangers = np.cumsum(~np.isin(decision.labels, decision.scores["candidates"]))
    breaks = np.diff(strangers[decision.frames]) > 0
    where = np.arange(len(decision.frames)) + _BREAK * np.concatenate([[0], np.cumsum(breaks)])
    ends = breaks | (np.diff(decision.node) != 0)
    return where, np.split(np.arange(len(where)), np.flatnonzero(ends) + 1)


def _curve(axes: Any, values: NDArray[np.float64], decision: Explained, story: Story) -> None:
    where, runs = _places(decision)
    for run in runs:
        colour = story.colours[int(decision.node[run[0]])]
        axes.bar(where[run], values[run], width=1.0, color=colour, alpha=0.35, linewidth=0)
        edges = np.concatenate([where[run] - 0.5, where[run[-1:]] + 0.5])
        axes.stairs(values[run], edges, color=colour, linewidth=1.3)
    best = int(np.flatnonzero(decision.frames == decision.best)[0])
    axes.plot(where[best], values[best], "o", ms=5, mfc="white", mec=INK, mew=1.2, zorder=8)
    axes.set_ylim(0, 1.12 * float(values.max()))
    axes.set_xlim(-2, where[-1] + 2)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    axes.grid(axis="y", color="0.93", linewidth=0.6)


def _name_runs(axes: Any, decision: Explained, story: Story) -> None:
    """Write above the curves which node each run belongs to, and below them the number of its first frame."""
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


def _show_prominence(axes: Any, decision: Explained, gamma: float) -> None:
    """Draw how far the peak stands out, and how far it has to (eq. 8)."""
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
    look["bbox"] = {"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
    axes.text(beside + side * 0.02 * where[-1], peak, words.strip(), color=INK, **look)
    if least > 0:
        text = f"needed: {gamma:g} times the mean"
        axes.text(beside + side * 0.02 * where[-1], foot + least, text, color=WRONG, **{**look, "va": "center"})


def _show_means(axes: Any, decision: Explained) -> None:
    """Draw the mean similarity of each candidate, the highest of which decides."""
    from matplotlib.lines import Line2D

    where, runs = _places(decision)
    means = {int(name): value for name, value in decision.scores["mean_similarity"].items()}
    for run in runs:
        name = int(decision.node[run[0]])
        won = name == decision.scores["node"]
        line = {"color": INK, "linewidth": 2.6 if won else 1.4, "linestyle": "-" if won else (0, (2, 1.2)), "zorder": 6}
        axes.plot(where[run[[0, -1]]] + np.array([-0.5, 0.5]), [means[name]] * 2, **line)
    handles = [
        Line2D([], [], color=INK, linewidth=2.6, label="mean of the node, the highest"),
        Line2D([], [], color=INK, linewidth=1.4, linestyle=(0, (2, 1.2)), label="mean of another candidate"),
        Line2D([], [], marker="o", linestyle="none", mfc="white", mec=INK, ms=5, label="most similar image"),
    ]
    axes.legend(handles=handles, loc="best", frameon=True, framealpha=0.85, edgecolor="none")


def _plan(axes: Any, decision: Explained, story: Story) -> None:
    """Draw where the image, its match and the candidate nodes are."""
    from matplotlib.lines import Line2D

    xy = story.plan.xy
    axes.scatter(*xy[: decision.frame].T, s=9, color=NO_NODE, linewidths=0, zorder=2)
    for name in decision.scores["candidates"]:
        members = decision.frames[decision.node == name]
        axes.scatter(*xy[members].T, s=18, color=story.colours[name], linewidths=0, zorder=3)
    match = decision.scores["match"]
    axes.plot(*xy[[decision.frame, match]].T, color=INK, linewidth=1, zorder=4)
    axes.plot(*xy[decision.frame], "*", ms=15, mfc="white", mec=INK, mew=1.2, zorder=5)
    axes.plot(*xy[match], "o", ms=6, mfc="white", mec=INK, mew=1.2, zorder=6)
    dress(axes, story.plan)
    low, high = xy[: decision.frame + 1].min(axis=0), xy[: decision.frame + 1].max(axis=0)
    middle, half = (low + high) / 2, 0.56 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    apart = float(np.linalg.norm(xy[decision.frame] - xy[match]))
    point: dict[str, Any] = {"linestyle": "none", "mec": INK, "mfc": "white"}
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
    """Return the number of a node in the other pictures; of one that is gone, what it was called."""
    number = story.numbers.get(name)
    return f"node {number}" if number is not None else f"({name}, gone)"
