"""The common look of all plots: style, colours, panels, error axes, and PNG files."""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from foundation.files import atomic_path

# In dark mode the page's style sheet replaces these colours with others. So white that has to stay white, such as a
# number on a dark dot, and the colours of nodes differ from them, if only by an invisible shade.
INK, TEXT, SOFT, GRID, PALE, PAPER = "#1b2229", "#3c4751", "#5c6873", "#e9edf0", "#b9c1c9", "#fefefe"
SERIES = ("#0072b3", "#b0558a", "#d98200", "#009e74", "#3a9bd9", "#c44e00", "#7a5fb5", "#8a7a00")
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1.2, 1.6)), (0, (5, 1.6, 1.2, 1.6)), (0, (9, 2)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
FLOOR: dict[str, Any] = {"color": SOFT, "linestyle": (0, (1.2, 1.6)), "linewidth": 1.2}

_LIGHTINGS = {"cloudy": SERIES[0], "night": SERIES[1], "sunny": SERIES[2]}
_STYLE: dict[str, Any] = {
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), SOFT),
    **dict.fromkeys(("axes.labelcolor", "axes.titlecolor", "text.color"), INK),
    **dict.fromkeys(("xtick.labelcolor", "ytick.labelcolor", "legend.labelcolor"), TEXT),
    "font.size": 9,
    "text.parse_math": False,  # a user's names may hold dollar signs
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.linewidth": 0.7,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "savefig.dpi": 150,
    "svg.fonttype": "none",
    "svg.hashsalt": "siamloc",
}
# Fonts for names in scripts that matplotlib's own font lacks, of Linux, Windows and macOS.
_FURTHER_FONTS = (
    *("Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans SC", "Noto Sans JP", "Noto Sans KR", "WenQuanYi Zen Hei"),
    *("WenQuanYi Micro Hei", "Droid Sans Fallback", "Microsoft YaHei", "SimHei", "Yu Gothic", "Malgun Gothic"),
    *("PingFang SC", "Hiragino Sans", "NanumGothic", "Apple SD Gothic Neo", "Arial Unicode MS"),
    *("Noto Sans Devanagari", "Noto Sans Thai", "Nirmala UI", "Leelawadee UI"),
)
_UNNAMED = re.compile(r"(_child\d+)?")  # the labels that matplotlib gives to what has none


class Picture(Figure):
    """A matplotlib figure that notebooks show automatically, without pyplot or a display."""

    def _repr_png_(self) -> bytes:
        return self.rendered("png", dpi=150)

    def rendered(self, kind: str, **options: Any) -> bytes:
        """Return the figure as bytes of a file of a kind such as "png" or "svg"; equal figures give equal bytes."""
        buffer = io.BytesIO()
        with style():
            self.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else None, **options)
        return buffer.getvalue()


@contextmanager
def style() -> Iterator[None]:
    """Apply the project's look regardless of the user's settings, as a context manager or decorator `@style()`."""
    settings: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_STYLE, "font.family": _fonts()}
    # The backend is the calling program's choice, and reading or setting it here could load one.
    settings = {key: value for key, value in settings.items() if not key.startswith("backend")}
    log = logging.getLogger(font_manager.__name__)

    def only_errors(record: logging.LogRecord) -> bool:  # of this call: drawings in several threads share the logger
        return record.levelno >= logging.ERROR

    with matplotlib.rc_context(settings), warnings.catch_warnings():
        # Letters that no font has are boxes in a PNG; in an SVG the reader's fonts count. Not every font has bold ones.
        warnings.filterwarnings("ignore", r"Glyph \d+ |Matplotlib currently does not support", UserWarning)
        log.addFilter(only_errors)
        try:
            yield
        finally:
            log.removeFilter(only_errors)


@cache
def _fonts() -> list[str]:
    installed = set(font_manager.get_font_names())  # matplotlib logs a warning for each of the others
    return ["sans-serif", *(name for name in _FURTHER_FONTS if name in installed)]


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as a PNG file at 150 dots per inch, atomically, and return the path.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    path = Path(path)
    with style(), atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
    return path


def panels(
    count: int,
    width: float,
    height: float,
    *,
    across: int = 3,
    margin: tuple[float, float] = (0.0, 0.0),
    ylabel: str = "",
    **options: Any,
) -> tuple[Picture, list[Axes]]:
    """Return a figure with panels in rows, and the axes of the panels, which have a grid.

    Args:
        count: number of panels, at least one.
        width: width of each panel in inches.
        height: height of each panel in inches.
        across: maximum number of panels per row; four become two by two.
        margin: extra width and height of the figure in inches, for what surrounds the panels.
        ylabel: label of the vertical axis of the first panel of each row.
        options: further arguments of `Figure.subplots`, such as `sharey`.
    """
    columns = 2 if count == 4 and across == 3 else min(count, across)
    rows = -(-count // columns)
    figure = Picture(figsize=(columns * width + margin[0], rows * height + margin[1]))
    every: list[Axes] = figure.subplots(rows, columns, squeeze=False, **options).ravel().tolist()
    for axes in every[count:]:
        axes.remove()
    for axes in every[max(count - columns, 0) : count]:
        axes.tick_params(labelbottom=True)  # also if the panel below is missing
    for axes in every[:count:columns]:
        axes.set_ylabel(ylabel)
    for axes in every[:count]:
        axes.grid(True)
    return figure, every[:count]


def shared_legend(
    figure: Picture,
    columns: int,
    place: Literal["outside upper center", "outside lower center"] = "outside lower center",
) -> None:
    """Add one legend with the lines of the first panel for all panels.

    Args:
        figure: figure with at least one panel.
        columns: number of columns of the legend.
        place: "outside upper center", above all panels, or "outside lower center", below all of them.
    """
    figure.legend(*legend_entries(figure.axes[0]), loc=place, ncols=columns)


def legend_entries(*panels: Axes) -> tuple[list[Any], list[str]]:
    """Return the lines and collections with a label in some panels, and their labels, for a legend.

    Matplotlib itself leaves out labels that begin with an underscore, as a user's names may.
    """
    drawn = [one for axes in panels for one in axes.get_children() if isinstance(one, Line2D | Collection)]
    named = [one for one in drawn if not _UNNAMED.fullmatch(str(one.get_label()))]
    return named, [str(one.get_label()) for one in named]


def lighting_colours(labels: Sequence[str] | Mapping[str, Any]) -> list[str]:
    """Return a colour for each label; a lighting has the same colour in every plot.

    Example:
        >>> lighting_colours(["cloudy", "dusk", "night"])
        ['#0072b3', '#009e74', '#b0558a']
    """
    others = [label for label in labels if label not in _LIGHTINGS]
    return [_LIGHTINGS.get(label) or SERIES[3 + others.index(label) % 5] for label in labels]


def method_look(rank: int) -> dict[str, Any]:
    """Return the line style of a method by its rank: rank 0 is bold, the others differ in colour and dash."""
    if rank == 0:
        return {"color": INK, "linewidth": 2.0, "zorder": 4}
    return {"color": SERIES[(rank + 2) % 8], "linestyle": DASHES[rank % len(DASHES)], "zorder": 3}


def series_look(rank: int) -> dict[str, Any]:
    """Return the colour, marks and dash of the line of a rank, among lines of equal importance."""
    dash = DASHES[rank // len(SERIES) % len(DASHES)]
    return {"color": SERIES[rank % 8], "marker": MARKS[rank % 8], "markersize": 4, "linestyle": dash}


def series_1_2_5(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times a power of ten from `low` (rounded up) to the first not below `high`.

    Example:
        >>> series_1_2_5(0.03, 0.6)
        [0.05, 0.1, 0.2, 0.5, 1.0]
    """
    low = max(low, 1e-12)
    powers = range(math.floor(math.log10(low)), math.floor(math.log10(max(low, high))) + 2)
    values = [float(f"{step}e{power}") for power in powers for step in (1, 2, 5)]
    series = [value for value in values if value >= low * (1 - 1e-9)]
    return series[: 1 + sum(value < high * (1 - 1e-9) for value in series)]


def scale_errors(
    axis: Any, errors: Sequence[NDArray | Sequence[float]], label: str, lowest: float = 5
) -> tuple[float, float]:
    """Turn an axis into an error axis, logarithmic with round numbers, and return its limits.

    The axis begins at the smallest errors shown and ends at the largest error. It goes from 0 to 1 if no error is above
    zero.

    Args:
        axis: `axes.xaxis` or `axes.yaxis`.
        errors: the errors of each line.
        label: label of the axis.
        lowest: lowest percentile of a line's errors that is shown.
    """
    name, axes = axis.axis_name, axis.axes
    axes.set(**{f"{name}label": label})
    largest = max(float(np.max(error)) for error in errors)
    if largest <= 0:
        axes.set(**{f"{name}lim": (0, 1)})
        return 0, 1
    low = min(float(np.percentile(error, lowest)) for error in errors)
    # Errors of zero have no place on the axis: their share is where the curve begins.
    low = min(max(low, largest / 1000), largest / 10)
    low = [value for value in series_1_2_5(low / 10, low) if value <= low * (1 + 1e-9)][-1]
    ticks = series_1_2_5(low, largest)
    limits = low, ticks[-1]
    if len(ticks) > 9:
        ticks = [value for value in ticks if math.isclose(10 ** round(math.log10(value)), value)]
    axes.set(**{f"{name}scale": "log", f"{name}lim": limits})
    axis.set_ticks(ticks, [f"{value:g}" for value in ticks])
    axis.set_ticks([], minor=True)
    return limits


def column(entries: Sequence[Mapping[str, Any]], name: str) -> NDArray[np.float64]:
    """Return the measure of a name in several entries (n,); NaN if unknown."""
    return np.array([entry[name] for entry in entries], dtype=np.float64)
