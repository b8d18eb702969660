"""Animate the growth of an incremental map from its log ([I] figures 13-15)."""

from __future__ import annotations

import io
from bisect import bisect_right
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb, to_rgba_array
from matplotlib.figure import Figure
from numpy.typing import NDArray

from foundation.files import atomic_path, parsed_json
from siamloc.errors import FormatError
from siamloc.report.draw.look import INK, style
from siamloc.report.draw.node_colours import NO_NODE, POOL, ink, neighbouring, node_colours
from siamloc.report.draw.nodes import NodePlan, counted, dress, plan_size, spread_out

PICTURES = 80
_EACH, _LAST = 110, 4000  # milliseconds that each picture and the last one are shown
_DOTS_PER_INCH = 110
_SIZE = (7.6, (2.4, 5.4))
_NODE_POINTS = 12
_MOST_NUMBERED = 60
_NUMBER: dict[str, Any] = {
    "ha": "center", "va": "center_baseline", "fontsize": 6.5, "fontweight": "bold", "zorder": 8,
}  # fmt: skip
_NEWS = "#9A3B00"
_FLASH = 3  # number of pictures for which a change of the map is announced


@dataclass(frozen=True, eq=False)
class Story:
    """The log of an incremental map, and the final map.

    Attributes:
        plan: the final map.
        events: one per line of the log, without the header.
        parameters: parameters of the mapper.
        descriptor: identity of the descriptor of the frames.
        ids: the mapper's name of each node of the plan (k,).
        colours: colour of every node that ever existed, by the mapper's name; those that remain have the plan's.
    """

    plan: NodePlan
    events: tuple[dict[str, Any], ...]
    parameters: dict[str, Any]
    descriptor: dict[str, Any]
    ids: tuple[int, ...]
    colours: dict[int, str]

    @property
    def numbers(self) -> dict[int, int]:
        """The plan's number of each remaining node, by the mapper's name."""
        return {name: number for number, name in enumerate(self.ids)}

    def labels(self, events: int) -> NDArray[np.int64]:
        """Return the mapper's name of the node of each frame (n,), -1 for none, after the first `events` events."""
        from analytic.mapper import replay

        return replay(self.events[:events])


def read_story(log: str | Path, plan: NodePlan) -> Story:
    """Read the log of an incremental map.

    Args:
        log: `events.jsonl` of its layer.
        plan: plan from its evaluation.

    Raises:
        FormatError: a log that is missing or incomplete, or of another map than the plan.
    """
    from analytic import AnalyticError

    log = Path(log)
    try:
        header, *events = [parsed_json(line) for line in log.read_text(encoding="utf-8").splitlines() if line]
        story = Story(plan, tuple(events), dict(header["parameters"]), dict(header["descriptor"]), (), {})
        final = story.labels(len(events))
    except (OSError, ValueError, KeyError, TypeError, AnalyticError) as error:
        raise FormatError(f"{log} is not the whole log of an incremental map ({error}): build the map again") from error
    story = replace(story, ids=_ids(final, plan, log))
    members = _ever(story)
    fixed = {name: plan.colours[number] for name, number in story.numbers.items()}
    xy = np.concatenate([plan.xy[frames] for frames in members.values()])
    owners = np.repeat(list(members), [len(frames) for frames in members.values()])
    colours = node_colours(neighbouring(xy, owners), sorted(members), fixed)
    return replace(story, colours=colours)


def _ids(final: NDArray[np.int64], plan: NodePlan, log: Path) -> tuple[int, ...]:
    """Return the mapper's name of each node of the plan, in the order of the plan's numbers."""
    if len(final) == len(plan.node):
        pairs = sorted(set(zip(plan.node.tolist(), final.tolist(), strict=True)) - {(-1, -1)})
        names = tuple(name for _, name in pairs)
        if [number for number, _ in pairs] == list(range(len(plan.places))) and len(set(names) - {-1}) == len(names):
            return names
    raise FormatError(f"{log} is of another map than the evaluation: evaluate again")


def animate(story: Story, path: str | Path) -> Path:
    """Write the growing map as a GIF of about PICTURES pictures, the last one held, and return its path.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    path = Path(path)
    pictures = _indexed(_drawn(story))
    stays = [_EACH] * (len(pictures) - 1) + [_LAST]
    buffer = io.BytesIO()
    pictures[0].save(buffer, "GIF", save_all=True, append_images=pictures[1:], duration=stays, loop=0, disposal=1)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())
    return path


def moments(events: int) -> list[int]:
    """Return the numbers of events after which pictures are drawn, including the first and the last."""
    return sorted({round(float(k)) for k in np.linspace(1, events, PICTURES)})


def _ever(story: Story) -> dict[int, NDArray[np.int64]]:
    """Return the final frames of every node that ever existed, or those of its creation if it is gone."""
    final = story.labels(len(story.events))
    members = {name: np.flatnonzero(final == name) for name in story.ids}
    for event in story.events:
        for change in event["changes"]:
            if change["reason"] == "NEW_NODE":
                members.setdefault(int(change["node"]), np.array(change["frames"], dtype=np.int64))
    return members


@style()
def _drawn(story: Story) -> list[NDArray[np.uint8]]:
    pictures = []
    width, height = plan_size(story.plan.xy, *_SIZE)
    figure = Figure(figsize=(width + 0.6, height + 1.6), dpi=_DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    stage = _Stage(figure, story, height)
    canvas.draw()
    figure.set_layout_engine("none")  # the layout is fixed, so that nothing jumps
    for events in moments(len(story.events)):
        stage.show(events)
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return pictures


class _Stage:
    """The changing parts of the animation: frames, nodes, the robot, the counts."""

    def __init__(self, figure: Any, story: Story, height: float) -> None:
        self.story, plan = story, story.plan
        self.ends = np.cumsum([len(event["frames"]) for event in story.events]).tolist()
        self.axes, strip = figure.subplots(2, 1, height_ratios=[height, 0.85])
        self.frames = self.axes.scatter(*plan.xy.T, s=14, c=[NO_NODE] * len(plan.xy), linewidths=0, zorder=3)
        (self.robot,) = self.axes.plot([], [], "o", ms=11, mfc="none", mec=INK, mew=1.6, zorder=9)
        self.few = len(story.colours) <= _MOST_NUMBERED
        self.ways = LineCollection([], colors=INK, linewidths=1.1, alpha=0.85, zorder=6)
        self.axes.add_collection(self.ways, autolim=False)
        self.dots = self.axes.scatter([], [], edgecolors=INK, linewidths=1, zorder=7)
        self.names = {
            name: self.axes.text(0, 0, str(number), color=ink(story.colours[name]), visible=False, **_NUMBER)
            for name, number in (story.numbers if self.few else {}).items()
        }
        width, _ = plan_size(plan.xy, *_SIZE)
        self.dot = 1.15 * _NODE_POINTS / 72 * 1.1 * float(np.ptp(plan.xy[:, 0])) / width  # in units of the plan
        dress(self.axes, plan)
        self.axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        self.axes.spines[:].set_visible(False)
        self.axes.set_title(" ", loc="left")
        self.axes.set_title(" ", loc="right")
        self.taken: list[int] = []
        self.counts: list[int] = []
        self.lost: list[float] = []
        (self.line,) = strip.plot([], [], color=INK, linewidth=1.5, drawstyle="steps-post")
        self.area = strip.twinx()
        (self.grey,) = self.area.plot([], [], color="0.6", linewidth=1.2)
        strip.set(xlim=(0, len(plan.node)), ylim=(0, 1.15 * max(len(story.colours), 1)), xlabel="frames")
        strip.set_ylabel("nodes")
        self.area.set_ylim(0, 105)
        self.area.set_yticks([0, 50, 100])
        self.area.set_ylabel("in no node [%]", color="0.45")
        self.area.tick_params(colors="0.45")
        self.area.spines["right"].set(visible=True, color="0.7")

    def show(self, events: int) -> None:
        """Show the map after the first `events` events."""
        story, labels = self.story, self.story.labels(events)
        taken, xy = len(labels), self.story.plan.xy
        present = sorted(set(labels[labels >= 0].tolist()))
        colours = [story.colours.get(int(name), NO_NODE) for name in labels]
        faces = np.zeros((len(xy), 4))
        faces[:taken] = to_rgba_array(colours)
        self.frames.set_facecolors(faces)
        last = story.events[events - 1]["frames"][-1]
        self.robot.set_data([xy[last, 0]], [xy[last, 1]])
        self._draw_graph(labels, present)
        self.axes.set_title(f"frame {taken} of {len(xy)}: {counted(len(present), 'node')}", loc="left")
        self.axes.set_title(self._change(events), loc="right", color=_NEWS)
        self.taken.append(taken)
        self.counts.append(len(present))
        self.lost.append(100 * float((labels < 0).mean()))
        self.line.set_data(self.taken, self.counts)
        self.grey.set_data(self.taken, self.lost)

    def _draw_graph(self, labels: NDArray[np.int64], present: list[int]) -> None:
        from analytic.mapper.graph import edges

        xy = self.story.plan.xy[: len(labels)]
        means = np.array([xy[labels == name].mean(axis=0) for name in present]).reshape(-1, 2)
        places = dict(zip(present, spread_out(means, self.dot if self.few else 0), strict=True))
        self.ways.set_segments([[places[a], places[b]] for a, b in edges(labels)])
        self.dots.set_offsets(np.array([places[name] for name in present]).reshape(-1, 2))
        self.dots.set_facecolors([self.story.colours[name] for name in present])
        numbered = [self.few and name in self.story.numbers for name in present]
        self.dots.set_sizes([_NODE_POINTS**2 if big else 0.3 * _NODE_POINTS**2 for big in numbered])
        for name, text in self.names.items():
            text.set_visible(name in places)
            if name in places:
                text.set_position(places[name])

    def _change(self, events: int) -> str:
        """Return the latest change of the map during the last few pictures."""
        shown = moments(len(self.story.events))
        before = shown[max(0, bisect_right(shown, events) - 1 - _FLASH)]
        for event in reversed(self.story.events[before if before < events else 0 : events]):
            for change in reversed(event["changes"]):
                number = self.story.numbers.get(change["node"])
                name = f" {number}" if number is not None else ""
                if change["reason"] == "NEW_NODE":
                    return f"new node{name}"
                if change["reason"] == "NODES_MERGED":
                    return f"two nodes merged into{name}" if name else "two nodes merged"
        return ""


def _indexed(pictures: list[NDArray[np.uint8]]) -> list[Any]:
    """Return pictures in one common palette, for small files, steady colours, and exact colours of nodes."""
    from PIL import Image

    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette().ravel().tolist())
    none = Image.Dither.NONE
    return [Image.fromarray(picture).quantize(palette=palette, dither=none) for picture in pictures]


def _palette() -> NDArray[np.uint8]:
    """Return the colours used, and shades between each of them and white and ink (n, 3)."""
    white, ink_colour = np.ones(3), np.array(to_rgb(INK))
    colours = [white, *(white * grey for grey in np.linspace(0, 1, 24)[1:-1])]
    for drawn in (*POOL, NO_NODE, _NEWS):
        colour = np.array(to_rgb(drawn))
        colours += [colour, *(colour + share * (white - colour) for share in (0.25, 0.5, 0.75))]
        colours += [colour + share * (ink_colour - colour) for share in (0.33, 0.67)]
    return np.round(255 * np.array(colours)).astype(np.uint8)
