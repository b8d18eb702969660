"""Plot the errors of refined poses against the spacing of the map, with a panel for each lighting."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from siamloc.report.draw.look import save, style

_STEP = 0.15  # metres between the frames of a drive
_LINES = (
    ("without training", "retrieval", "nearest frame", {"color": "0.45", "marker": "^", "linestyle": "--"}),
    ("between frames by HOG", "mean", "between frames by HOG", {"color": "0.45", "marker": "v", "linestyle": ":"}),
    ("without training", "mean", "compared, without training", {"color": "#56B4E9", "marker": "o"}),
    ("fine-tuned on three drives", "mean", "compared, fine-tuned", {"color": "#0072B2", "marker": "s", "linewidth": 2}),
    ("fine-tuned on three drives", "followed", "fine-tuned and followed", {"color": "#D55E00", "marker": "D"}),
)


def draw(rows: Mapping[str, Sequence[Mapping[str, Any]]], path: Path) -> Path:
    """Draw mean errors over the seeds, on logarithmic axes, and return the file.

    Args:
        rows: figures by map spacing and lighting, for each way and seed.
        path: path of the PNG.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator, StrMethodFormatter

    first = next(iter(rows.values()))[0]
    lights = list(next(iter(first.values())))
    with style():
        figure = Figure(figsize=(10.2, 3.7))
        for axes, light in zip(figure.subplots(1, len(lights), sharey=True), lights, strict=True):
            for name, key, label, look in _LINES:
                if name not in rows:
                    continue
                spacing = [_STEP * int(every) for every in first]
                values = [statistics.mean(row[every][light][key] for row in rows[name]) for every in first]
                axes.plot(spacing, values, label=label, clip_on=False, **{"markersize": 4.5, "linewidth": 1.3, **look})
            axes.set(xscale="log", yscale="log", title=light, xlabel="spacing of the map [m]", xticks=spacing)
            axes.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5])
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axis.set_minor_locator(NullLocator())
            axes.grid(color="0.92", linewidth=0.6)
        figure.axes[0].set_ylabel("mean error [m]")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        return save(figure, path)
