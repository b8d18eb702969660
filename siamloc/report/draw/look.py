"""The common look of all plots: style, colours, panels, error axes, and PNG files."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from foundation.files import atomic_path
from siamloc.errors import DataError

# In dark mode the page's style sheet replaces these colours with others. So white that has to stay white, such as a
# number on a dark dot, and the colours of nodes differ from them, if only by an invisible shade.
INK, TEXT, SOFT, GRID, PALE, PAPER = "#1b2229", "#3c4751", "#5c6873", "#e9edf0", "#b9c1c9", "#fefefe"
SERIES = ("#0072b3", "#b0558a", "#d98200", "#009e74", "#3a9bd9", "#c44e00", "#7a5fb5", "#8a7a00")
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1.2, 1.6)), (0, (5, 1.6, 1.2, 1.6)), (0, (9, 2)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
FLOOR: dict[str, Any] = {"color": SOFT, "linestyle": (0, (1.2, 1.6)), "linewidth": 1.2}

_LIGHTINGS = {"cloudy": SERIES[0], "night": SERIES[1], "sunny": SERIES[2]}
_STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.7,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": TEXT,
    "ytick.labelcolor": TEXT,
    "text.color": INK,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.labelcolor": TEXT,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "savefig.dpi": 150,
    "svg.fonttype": "none",
    "svg.hashsalt": "siamloc",
}


class Picture(Figure):
    """A figure that notebooks show automatically, without pyplot or a display."""

    def _repr_png_(self) -> bytes:
        return self.rendered("png", dpi=150)

    def rendered(self, kind: str, **options: Any) -> bytes:
        """Return the figure as file contents, such as "png" or "svg"; reproducible."""
        buffer = io.BytesIO()
        with style():
            self.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else None, **options)
        return buffer.getvalue()


@contextmanager
def style() -> Iterator[None]:
    """Apply the project's look regardless of the user's settings, as a context manager or decorator `@style()`."""
    settings: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_STYLE}
    # The backend is the calling program's choice, and reading or setting it here could load one.
    with matplotlib.rc_context({key: value for key, value in settings.items() if not key.startswith("backend")}):
        yield


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
    count: int, width: float, height: float, across: int = 3, margin: tuple[float, float] = (0.0, 0.0), **shared: Any
) -> tuple[Picture, list[Axes], int]:
    """Return a figure with `count` panels in rows, their axes, and the number of panels per row.

    Args:
        count: number of panels, at least one.
        width: width of each panel in inches.
        height: height of each panel in inches.
        across: maximum number of panels per row; four become two by two.
        margin: extra width and height of the figure in inches, for what surrounds the panels.
        shared: `sharex`, `sharey`.
    """
    columns = 2 if count == 4 and across == 3 else min(count, across)
    rows = -(-count // columns)
    figure = Picture(figsize=(columns * width + margin[0], rows * height + margin[1]))
    every: list[Axes] = figure.subplots(rows, columns, squeeze=False, **shared).ravel().tolist()
    for axes in every[count:]:
        axes.remove()
    for axes in every[max(count - columns, 0) : count]:
        axes.tick_params(labelbottom=True)  # also if the panel below is missing
    return figure, every[:count], columns


def lighting_colours(labels: Sequence[str] | Mapping[str, Any]) -> list[str]:
    """Return a colour for each label; a lighting has the same one in every plot.

    Example:
        >>> lighting_colours(["cloudy", "dusk", "night"])
        ['#0072b3', '#009e74', '#b0558a']
    """
    others = [label for label in labels if label not in _LIGHTINGS]
    return [_LIGHTINGS.get(label) or SERIES[3 + others.index(label) % 5] for label in labels]


def method_look(rank: int) -> dict[str, Any]:
    """Return the line style of a method: the measured one stands out, the others differ in colour and dash."""
    if rank == 0:
        return {"color": INK, "linewidth": 2.0, "zorder": 4}
    return {"color": SERIES[(rank + 2) % 8], "linestyle": DASHES[rank % len(DASHES)], "zorder": 3}


def series_1_2_5(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times a power of ten from `low` (rounded up) to the first not below `high`.

    Example:
        >>> series_1_2_5(0.03, 0.6)
        [0.05, 0.1, 0.2, 0.5, 1.0]
    """
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


def error_limits(errors: Sequence[ArrayLike], lowest: float = 5) -> tuple[float, float] | None:
    """Return the limits of a logarithmic axis, from the smallest errors shown to the largest error.

    None if no error is above zero.

    Args:
        errors: the errors of each line.
        lowest: lowest percentile of a line's errors that is shown.
    """
    columns = [np.asarray(error, dtype=np.float64) for error in errors]
    largest = max(float(error.max()) for error in columns)
    if largest <= 0:
        return None
    low = min(float(np.percentile(error, lowest)) for error in columns)
    # Errors of zero have no place on the axis: their share is where the curve begins.
    low = min(max(low, largest / 1000), largest / 10)
    below = [value for value in series_1_2_5(low / 10, low) if value <= low * (1 + 1e-9)]
    return below[-1], series_1_2_5(largest, largest)[-1]


def scale_errors(axis: Any, limits: tuple[float, float] | None, label: str) -> None:
    """Turn an axis into an error axis: logarithmic with round numbers, or from 0 to 1 if there are no limits.

    Args:
        axis: `axes.xaxis` or `axes.yaxis`.
        limits: as returned by `error_limits`.
        label: label of the axis.
    """
    name = axis.axis_name
    axes = axis.axes
    if limits is None:
        axes.set(**{f"{name}lim": (0, 1), f"{name}label": label})
        return
    low, high = limits
    ticks = [value for value in series_1_2_5(low, high) if value <= high * (1 + 1e-9)]
    if len(ticks) > 9:
        ticks = [value for value in ticks if math.isclose(10 ** round(math.log10(value)), value)]
    axes.set(**{f"{name}scale": "log", f"{name}lim": limits, f"{name}label": label})
    axis.set_ticks(ticks, [f"{value:g}" for value in ticks])
    axis.set_ticks([], minor=True)


def percent(share: float) -> str:
    """Return a share in percent, with a decimal if rounding would hide that it is not quite 0 or 100.

    Example:
        >>> percent(93.4), percent(99.8), percent(0.2), percent(100)
        ('93', '99.8', '0.2', '100')
    """
    return f"{share:.0f}" if 1 <= share <= 99 or share == 100 else f"{share:.1f}"


def column(entries: Sequence[Mapping[str, Any]], name: str) -> NDArray[np.float64]:
    """Return a measure of several entries (n,), NaN if unknown."""
    return np.array([np.nan if entry[name] is None else entry[name] for entry in entries], dtype=np.float64)


def require_rows(*tables: Mapping[str, NDArray]) -> None:
    """Check that there is something to draw.

    Raises:
        DataError: a table without rows.
    """
    for columns in tables:
        if not len(next(iter(columns.values()))):
            raise DataError("there is nothing to draw: the table has no rows")
