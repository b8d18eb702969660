"""Pictures of room retrieval by lighting: confusion matrices side by side, and pairs judged at every threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import DataError
from siamloc.report.plots import draw_matrix, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PANELS_IN_A_ROW = 3
_CURVES = (  # Okabe and Ito 2008
    ("same", "pairs of one room", "#0072B2", "--"),
    ("different", "pairs of two rooms", "#D55E00", ":"),
    ("overall", "all pairs", "black", "-"),
)


def confusion_by_lighting(labels: Sequence[str], counts: Mapping[str, NDArray]) -> Figure:
    """Draw a confusion matrix for each lighting, shares of each row as colour and text.

    Args:
        labels: room names, L of them.
        counts: by lighting (L, L), row = true room, column = predicted room.

    Raises:
        DataError: no lightings or labels, or counts of another shape.
    """
    from matplotlib.figure import Figure

    n = len(labels)
    if not n or not counts or any(np.shape(part) != (n, n) for part in counts.values()):
        shapes = [np.shape(part) for part in counts.values()]
        raise DataError(f"confusion matrices of {n} rooms need counts of shape ({n}, {n}) by lighting, got {shapes}")
    rows, columns = _shape(len(counts))
    side = min(max(0.34 * n, 2.0), 6.0)
    with style():
        figure = Figure(figsize=(columns * side + 2.4, rows * (side + 0.75) + 0.5))
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        image: Any = None
        for axes, (label, part) in zip(panels, counts.items(), strict=False):
            image = draw_matrix(axes, part, shares_only=True)
            total = int(part.sum())
            right = f": {100 * np.trace(part) / total:.1f} % of {total}" if total else ": no queries"
            axes.set_title(f"{label}{right}")
            axes.set_xticks(range(n), labels, rotation=45, ha="right", rotation_mode="anchor")
            axes.set_yticks(range(n), labels)
        _trim(panels, len(counts), columns)
        figure.supxlabel("room of the nearest map frame", fontsize=9)
        figure.supylabel("true room of the query", fontsize=9)
        bar = figure.colorbar(image, ax=list(panels), shrink=0.8, pad=0.02)
        bar.set_label("share of the true room's queries [%]")
        bar.outline.set_visible(False)  # type: ignore[operator]
        return figure


def pair_curves(found: Mapping[str, Any]) -> Figure:
    """Draw the share of pairs judged rightly against the threshold: all pairs, and those of each lighting.

    Args:
        found: `measures.room_pairs` of `results.json`.
    """
    from matplotlib.figure import Figure

    groups = {"all pairs": {**found["overall"], "curve": found["curve"]}}
    by_lighting = {label: group for label, group in found["lighting"].items() if "curve" in group}
    groups = {**groups, **by_lighting} if len(by_lighting) > 1 else groups
    rows, columns = _shape(len(groups))
    with style():
        figure = Figure(figsize=(2.7 * columns + 0.4, 2.3 * rows + 0.7))
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, (label, group) in zip(panels, groups.items(), strict=False):
            thresholds = [point["threshold"] for point in group["curve"]]
            for name, words, colour, line in _CURVES:
                share = np.array([point[name] for point in group["curve"]], dtype=np.float64)
                axes.plot(thresholds, 100 * share, color=colour, linestyle=line, linewidth=1.5, label=words)
            axes.axvline(found["threshold"], color="0.6", linewidth=0.9)
            auc = "" if group["auc"] is None else f", AUC {group['auc']:.3f}"
            axes.set_title(f"{label}{auc}")
            axes.set(xlim=(0, 1), ylim=(0, 101.5))
            axes.grid(color="0.92", linewidth=0.6)
        _trim(panels, len(groups), columns)
        figure.supxlabel("threshold of the dissimilarity", fontsize=9)
        figure.supylabel("judged right [%]", fontsize=9)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=len(_CURVES))
        return figure


def _shape(panels: int) -> tuple[int, int]:
    columns = min(panels, _PANELS_IN_A_ROW)
    return -(-panels // columns), columns


def _trim(panels: NDArray[Any], used: int, columns: int) -> None:
    """Hide panels that nothing is drawn in, and name the ticks of the lowest of each column that is."""
    for axes in panels[used:]:
        axes.set_axis_off()
    for axes in panels[max(used - columns, 0) : used]:
        axes.tick_params(labelbottom=True)  # also where the panel below is empty
