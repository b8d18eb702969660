"""Animate the growth of an incremental map from its log ([I] figures 13-15)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analytic import AnalyticError
from analytic.mapper import replay
from analytic.mapper.graph import edges
from foundation.files import parsed_json
from siamloc.errors import FormatError
from siamloc.report.draw.film import DOTS_PER_INCH, moments, picture_of, write_film
from siamloc.report.draw.look import INK, style
from siamloc.report.draw.node_colours import NO_NODE, POOL, neighbouring, node_colours
from siamloc.report.draw.nodes import NodePlan, add_graph, counted, dress, frame_colours, plan_size, points_per_unit

_SIZE = (7.6, (2.4, 5.4))
_NODE_POINTS = 12
_MOST_NUMBERED = 60
_NEWS = "#9A3B00"
_CHANGES = {"NEW_NODE": ("new node", ""), "NODES_MERGED": ("two nodes merged", "into ")}
_FLASH = 3  # number of pictures for which a change of the map is announced


@dataclass(frozen=True, eq=False)
class Story:
    """How an incremental map grew: the events of its log, and the final map.

    Attributes:
        plan: nodes and frames of the final map.
        events: one per line of the log, without the header.
        ids: the mapper's name of each node of the plan (k,).
        colours: colour of every node that ever existed, by the mapper's name; nodes of the plan have its colours.
    """

    plan: NodePlan
    events: tuple[dict[str, Any], ...]
    ids: tuple[int, ...]
    colours: dict[int, str]

    @property
    def numbers(self) -> dict[int, int]:
        """The number in the plan of each node that remains, by the mapper's name."""
        return {name: number for number, name in enumerate(self.ids)}


def read_story(log: str | Path, plan: NodePlan) -> Story:
    """Read the log of an incremental map.

    Args:
        log: `events.jsonl` in the folder of the layer.
        plan: plan of the layer, from an evaluation.

    Raises:
        FormatError: a log that is missing or incomplete, or of another map than the plan.
    """
    log = Path(log)
    try:
        _, *events = [parsed_json(line) for line in log.read_text(encoding="utf-8").splitlines() if line]
        final = replay(events)
    except (OSError, ValueError, KeyError, TypeError, AnalyticError) as error:
        raise FormatError(f"{log} is not the whole log of an incremental map ({error}): build the map again") from error
    ids = _ids(final, plan, log)
    members = {name: np.flatnonzero(final == name) for name in ids}
    for change in (change for event in events for change in event["changes"]):
        if change["reason"] == "NEW_NODE":  # a node that is gone has the frames of its creation
            members.setdefault(int(change["node"]), np.array(change["frames"], dtype=np.int64))
    xy = np.concatenate([plan.xy[frames] for frames in members.values()])
    owners = np.repeat(list(members), [len(frames) for frames in members.values()])
    fixed = {name: plan.colours[number] for number, name in enumerate(ids)}
    return Story(plan, tuple(events), ids, node_colours(neighbouring(xy, owners), sorted(members), fixed))


def _ids(final: NDArray[np.int64], plan: NodePlan, log: Path) -> tuple[int, ...]:
    """Return the mapper's name of each node of the plan, in the order of the plan's numbers."""
    if len(final) == len(plan.node):
        pairs = sorted(set(zip(plan.node.tolist(), final.tolist(), strict=True)) - {(-1, -1)})
        names = tuple(name for _, name in pairs)
        if [number for number, _ in pairs] == list(range(len(plan.places))) and len(set(names) - {-1}) == len(names):
            return names
    raise FormatError(f"{log} is of another map than the evaluation: evaluate again")


def animate(story: Story, path: str | Path) -> Path:
    """Write the growing map as a GIF of about PICTURES pictures, with a pause on the last, and return its path.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    return write_film(_drawn(story), path, [*POOL, NO_NODE, _NEWS])


@style()
def _drawn(story: Story) -> list[NDArray[np.uint8]]:
    """Return the pictures (H, W, 3): the map at some moments above the curves of its size up to then."""
    width, height = plan_size(story.plan.shown, *_SIZE)
    figure = Figure(figsize=(width + 0.6, height + 1.6), dpi=DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    axes, strip = figure.subplots(2, 1, height_ratios=[height, 0.85])
    (nodes,) = strip.plot([], [], color=INK, linewidth=1.5, drawstyle="steps-post")
    strip.set(xlim=(0, len(story.plan.node)), ylim=(0, 1.15 * max(len(story.colours), 1)))
    strip.set(xlabel="frames", ylabel="nodes")
    area = strip.twinx()
    (lost,) = area.plot([], [], color="0.6", linewidth=1.2)
    area.set(ylim=(0, 105), yticks=[0, 50, 100])
    area.set_ylabel("in no node [%]", color="0.45")
    area.tick_params(colors="0.45")
    area.spines["right"].set(visible=True, color="0.7")
    pictures: list[NDArray[np.uint8]] = []
    curves: list[tuple[int, int, float]] = []
    shown = moments(len(story.events))
    for number, events in enumerate(shown):
        labels = replay(story.events[:events])  # the mapper's name of the node of each frame, -1 for none
        axes.clear()
        _draw_map(axes, story, labels, story.events[events - 1]["frames"][-1])
        count = len(np.unique(labels[labels >= 0]))
        axes.set_title(f"frame {len(labels)} of {len(story.plan.xy)}: {counted(count, 'node')}", loc="left")
        news = _news(story, shown[max(0, number - _FLASH)] if number else 0, events)
        axes.set_title(news, loc="right", color=_NEWS)
        curves.append((len(labels), count, 100 * float((labels < 0).mean())))
        taken, counts, shares = zip(*curves, strict=True)
        nodes.set_data(taken, counts)
        lost.set_data(taken, shares)
        if not pictures:
            canvas.draw()
            figure.set_layout_engine("none")  # the layout is fixed, so that nothing jumps
        pictures.append(picture_of(canvas))
    return pictures


def _draw_map(axes: Axes, story: Story, labels: NDArray[np.int64], last: int) -> None:
    """Draw the map when its first frames (n,) had these nodes, by the mapper's names, and the robot at a frame."""
    xy, present = story.plan.xy[: len(labels)], np.unique(labels[labels >= 0])
    node = np.where(labels >= 0, np.searchsorted(present, labels), -1)
    colours = [story.colours[name] for name in present.tolist()]
    axes.scatter(xy[:, 0], xy[:, 1], s=14, c=frame_colours(colours, node), linewidths=0, zorder=3)
    axes.plot(*xy[last], "o", ms=11, mfc="none", mec=INK, mew=1.6, zorder=9)
    places = np.array([xy[labels == name].mean(axis=0) for name in present]).reshape(-1, 2)
    few = len(story.colours) <= _MOST_NUMBERED
    names = [str(story.numbers.get(name, "")) if few else "" for name in present.tolist()]
    scale = points_per_unit(story.plan.shown, plan_size(story.plan.shown, *_SIZE)[0])
    add_graph(axes, places, list(edges(node)), colours, names, _NODE_POINTS, scale)
    dress(axes, story.plan)
    axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _news(story: Story, before: int, events: int) -> str:
    """Return the latest change of the map between two numbers of events, in words."""
    for event in reversed(story.events[before:events]):
        for change in reversed(event["changes"]):
            if change["reason"] in _CHANGES:
                words, joint = _CHANGES[change["reason"]]
                number = story.numbers.get(change["node"])
                return words if number is None else f"{words} {joint}{number}"
    return ""
