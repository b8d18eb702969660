"""Confusion of buildings: which one was taken for which, a panel for each lighting."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from siamloc.errors import DataError
from siamloc.report.plots import save, style
from siamloc.results import read_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_all(folder: str | Path, out: str | Path | None = None) -> list[Path]:
    """Draw `confusion.png` from a result folder and return the files.

    Raises:
        FormatError: result files that are missing or not whole.
        DataError: results of another task.
        StorageError: the disk refuses.
    """
    found = read_results(folder)["measures"].get("buildings")
    if found is None:
        raise DataError(f"{folder} holds no choice of buildings: measure it with `siamloc evaluate task=buildings`")
    return [save(confusion(found), Path(folder if out is None else out) / "confusion.png")]


def confusion(found: Mapping[str, Any]) -> Figure:
    """Draw true building against chosen building: shares of each row as colour and text, counts below.

    Args:
        found: `measures.buildings` of `results.json`.
    """
    from matplotlib.figure import Figure

    labels, matrices = found["confusion"]["labels"], dict(found["confusion"]["lighting"])
    if len(matrices) != 1:
        matrices["all"] = found["confusion"]["counts"]
    n = len(labels)
    side = max(0.7 * n, 1.5)
    with style():
        figure = Figure(figsize=((side + 0.25) * len(matrices) + 2.6, side + 1.5))
        panels = figure.subplots(1, len(matrices), sharey=True, squeeze=False)[0]
        for axes, (name, counts) in zip(panels, matrices.items(), strict=True):
            image = _panel(axes, np.array(counts), labels)
            axes.set_title(f"{name} (n = {int(np.sum(counts))})")
        panels[0].set_yticks(range(n), labels)
        panels[0].set_ylabel("true building of the query")
        figure.supxlabel("building of the nearest map", fontsize=9)
        bar = figure.colorbar(image, ax=panels, shrink=0.9, pad=0.02)
        bar.set_label("share of the true\nbuilding's queries [%]")
        bar.outline.set_visible(False)  # type: ignore[operator]
        return figure


def _panel(axes: Any, counts: np.ndarray, labels: list[str]) -> Any:
    n = len(labels)
    shares = 100 * counts / np.maximum(counts.sum(axis=1), 1)[:, None]
    image = axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    for row, column in zip(*np.nonzero(counts), strict=True):
        colour = "white" if shares[row, column] > 55 else "black"
        text = f"{shares[row, column]:.1f} %\n{counts[row, column]}"
        axes.text(column, row, text, ha="center", va="center", fontsize=7.5, color=colour)
    axes.set_xticks(range(n), labels, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_xticks(np.arange(n + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(n + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    return image
