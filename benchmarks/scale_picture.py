"""Plot time and memory of searches against the size of the map, on logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from siamloc.report.draw.look import save, style

_LOOKS: Mapping[str, Mapping[str, Any]] = {
    "exact": {"color": "#0072B2", "marker": "o", "linewidth": 2},
    "hierarchical": {"color": "#D55E00", "marker": "s", "linewidth": 2},
    "faiss flat": {"color": "0.45", "marker": "^", "linestyle": "--"},
    "faiss IVF": {"color": "0.45", "marker": "v", "linestyle": "-."},
    "faiss HNSW": {"color": "0.45", "marker": "D", "linestyle": ":"},
}
_LABELS = {"hierarchical": "hierarchical, 3 nodes", "faiss IVF": "faiss IVF, 3 lists"}
_PANELS = (
    ("batch_ms", "time, 1,000 queries at once", "ms per query"),
    ("single_ms", "time, one query alone", "ms per query"),
    ("memory_mb", "memory beyond the map, at most", "MB"),
)
_LEAST = 0.1  # MB, the smallest value drawn


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw one panel for each measure and return the file.

    Args:
        rows: rows with method, frames, batch_ms, single_ms, memory_mb, map_mb.
        path: path of the PNG.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter, NullLocator

    with style():
        figure = Figure(figsize=(10.2, 3.7))
        for axes, (key, title, unit) in zip(figure.subplots(1, 3), _PANELS, strict=True):
            for method in dict.fromkeys(row["method"] for row in rows):
                mine = [row for row in rows if row["method"] == method]
                least = _LEAST if key == "memory_mb" else 0
                sizes, values = [row["frames"] for row in mine], [max(row[key], least) for row in mine]
                look = {"markersize": 4.5, "linewidth": 1.3, **_LOOKS.get(method, {})}
                axes.plot(sizes, values, label=_LABELS.get(method, method), clip_on=False, **look)
            if key == "memory_mb":
                own = sorted({(row["frames"], row["map_mb"]) for row in rows})
                axes.plot(*zip(*own, strict=True), color="black", linewidth=1, alpha=0.6, label="the map's descriptors")
                axes.set_ylim(_LEAST, 3 * max(row["memory_mb"] for row in rows))
            axes.set(xscale="log", yscale="log", title=title, xlabel="frames of the map", ylabel=unit)
            axes.grid(color="0.92", linewidth=0.6)
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
            axes.yaxis.set_major_formatter("{x:,.10g}")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_minor_locator(NullLocator())
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        return save(figure, path)
