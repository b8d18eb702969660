"""Confusion matrices of rooms or buildings, a single one or one panel per lighting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike, NDArray

from siamloc.report.draw.look import GRID, INK, PAPER, SERIES, SOFT, Picture, panels, style
from siamloc.tables import short_names, width_of

_CELL = 0.52  # inches; room for a share and a count
_LARGEST = 9.0  # largest matrix in inches
_MOST_TEXTS = 40  # rooms; with more, the shares in the cells could not be read


@style()
def confusion(
    labels: Sequence[str], counts: Mapping[str, ArrayLike], missing: Sequence[str] = (), what: str = "room"
) -> Picture:
    """Draw confusion matrices side by side: row shares as shade and text, and counts where there is room.

    Args:
        labels: names of the L rooms, or of the other classes.
        counts: matrices (L, L) by title, row = true room, column = room of the match.
        missing: rooms that the map lacks; they are marked.
        what: kind of the classes, such as "room".

    Example:
        >>> figure = confusion(["kitchen", "office"], {"night": [[3, 1], [0, 4]]})
        >>> figure.axes[0].get_title("left")
        'night\\n87.5 % of 8 right'
    """
    n = len(labels)
    matrices = {title: np.asarray(part) for title, part in counts.items()}
    shown = short_names(labels)
    alone, longest = len(matrices) == 1, max(map(width_of, shown))
    side = float(np.clip((1.0 if alone else 0.8) * _CELL * n, 1.5, _LARGEST if alone else 4.0))
    fits = side / n >= 0.36
    names = [name + "\n(not in map)" * (label in missing) for name, label in zip(shown, labels, strict=True)]
    slanted = 0.055 * longest  # inches, of the names below a matrix: they reach as far to its left
    margin = (0.35 + 0.075 * (longest + (11 if alone else 0)), 0.45 + slanted)
    look: dict[str, Any] = {"sharex": True, "sharey": True, "margin": margin, "ylabel": f"true {what} of the query"}
    width, height = (side + 0.15, side + 0.5) if alone else (side + 0.15 + slanted, side + 0.8)
    figure, every = panels(len(matrices), width, height, **look)
    for axes, (title, part) in zip(every, matrices.items(), strict=True):
        _matrix(axes, part, fits, n <= _MOST_TEXTS)
        total = int(part.sum())
        right = f"{100 * np.trace(part) / total:.1f} % of {total:,} right" if total else "no queries"
        axes.set_title(f"{title}\n{right}")
        axes.set_xticks(range(n), names, rotation=45, ha="right", rotation_mode="anchor")
        rows = [f"{name}  (n = {rows:,})" for name, rows in zip(names, part.sum(axis=1), strict=True)]
        axes.set_yticks(range(n), rows if alone else names)
    figure.supxlabel(f"{what} of the match", fontsize=9)
    return figure


def _matrix(axes: Axes, counts: NDArray, with_counts: bool, with_shares: bool) -> None:
    shares = counts / np.maximum(counts.sum(axis=1), 1)[:, None]
    n = len(counts)
    for row, column in zip(*np.nonzero(counts), strict=True):
        share = float(shares[row, column])
        place: Any = (column - 0.5, row - 0.5)
        axes.add_patch(Rectangle(place, 1, 1, facecolor=SERIES[0], alpha=max(share, 0.02), linewidth=0))
        if not with_shares:
            continue
        words = f"{_percent(100 * share)} %\n{counts[row, column]:,}" if with_counts else _percent(100 * share)
        look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7 if with_counts else 5.5}
        axes.text(column, row, words, color=PAPER if share > 0.55 else INK, linespacing=1.05, **look)
    for i in range(n):
        axes.add_patch(Rectangle((i - 0.5, i - 0.5), 1, 1, fill=False, edgecolor=SOFT, linewidth=0.8))
    axes.grid(False)
    for edge in np.arange(n + 1) - 0.5:
        axes.axhline(edge, color=GRID, linewidth=0.6, zorder=0)
        axes.axvline(edge, color=GRID, linewidth=0.6, zorder=0)
    axes.set(xlim=(-0.5, n - 0.5), ylim=(n - 0.5, -0.5), aspect="equal")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _percent(share: float) -> str:
    """Return a share in percent, with a decimal if rounding would hide that it is not quite 0 or 100.

    Example:
        >>> _percent(93.4), _percent(99.8), _percent(0.2), _percent(100)
        ('93', '99.8', '0.2', '100')
    """
    return f"{share:.0f}" if 1 <= share <= 99 or share == 100 else f"{share:.1f}"
