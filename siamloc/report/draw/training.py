"""Training curves: each logged metric, epoch by epoch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from siamloc.report.draw.look import DASHES, MARKS, SERIES, Picture, legend_entries, panels, series_1_2_5, style

_NAMES = {
    "accuracy_same": "accuracy, pairs of one room",
    "accuracy_different": "accuracy, pairs of two rooms",
    "distance_same": "distance of pairs of one room",
    "distance_different": "distance of pairs of two rooms",
    "spread": "spread of the descriptors",
    "active": "share that costs anything",
}
_SHARES = ("accuracy", "accuracy_same", "accuracy_different", "active")
_PARTS = {"train": ("training", SERIES[0]), "val": ("validation", SERIES[2])}


@style()
def training_curves(columns: Mapping[str, NDArray[np.float64]]) -> Picture:
    """Draw one panel per logged metric, training and validation together; loss and accuracy come first.

    Args:
        columns: columns of `metrics.csv`: epoch, and names such as "train/loss" and "val/loss"; NaN values leave gaps.

    Example:
        >>> figure = training_curves({"epoch": np.arange(2.0), "train/loss": np.array([0.9, 0.5])})
        >>> [axes.get_title("left") for axes in figure.axes]
        ['loss']
    """
    epoch = columns["epoch"] + 1  # people count epochs from one
    metrics: dict[str, dict[str, NDArray[np.float64]]] = {}
    for name, values in columns.items():
        part, slash, metric = name.partition("/")
        if slash and np.isfinite(values).any():
            metrics.setdefault(metric, {})[part] = values
    order = sorted(metrics, key=lambda name: (name != "loss", name != "accuracy", name))
    figure, every = panels(max(len(order), 1), 3.6, 2.3)
    for axes, metric in zip(every, order, strict=False):
        lines = metrics[metric]
        for i, part in enumerate(sorted(lines, key=lambda name: (name != "train", name != "val", name))):
            what, colour = _PARTS.get(part, (part, SERIES[3 + i % 5]))
            last = lines[part][np.isfinite(lines[part])][-1]
            look: dict[str, Any] = {"color": colour, "marker": MARKS[i], "markersize": 3}
            dash = DASHES[1] if part == "train" else "-"
            axes.plot(epoch, lines[part], label=f"{what}, last {last:.3g}", linestyle=dash, **look)
        values = np.concatenate([line[np.isfinite(line)] for line in lines.values()])
        largest = float(values.max())
        top = 1.0 if metric in _SHARES else series_1_2_5(largest, largest)[-1] if largest > 0 else 1.0
        low, high = float(epoch.min()), float(max(epoch.max(), epoch.min() + 1))
        axes.set(title=_NAMES.get(metric, metric.replace("_", " ")), xlabel="epoch")
        axes.set(xlim=(low - 0.02 * (high - low), high + 0.02 * (high - low)))
        axes.set_ylim(min(0.0, float(values.min())), 1.03 * top)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(*legend_entries(axes), loc="best")
    return figure
