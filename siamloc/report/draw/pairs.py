"""Pairs of images judged by their distance: the share judged correctly at each threshold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.draw.look import DASHES, INK, SERIES, SOFT, Picture, column, panels, style

_CURVES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("same", "pairs of one room", {"color": SERIES[0], "linestyle": DASHES[1]}),
    ("different", "pairs of two rooms", {"color": SERIES[5], "linestyle": DASHES[2]}),
    ("overall", "all pairs", {"color": INK, "linewidth": 2.0}),
)


@style()
def pair_curves(found: Mapping[str, Any]) -> Picture:
    """Draw the share of pairs judged correctly against the threshold: all pairs, and those of each lighting.

    Args:
        found: `measures.room_pairs` of `results.json`.
    """
    groups = {"all pairs": {**found["overall"], "curve": found["curve"]}}
    by_lighting = {label: group for label, group in found["lighting"].items() if "curve" in group}
    groups = {**groups, **by_lighting} if len(by_lighting) > 1 else groups
    figure, every, across = panels(len(groups), 3.0, 2.3, sharex=True, sharey=True, margin=(0.3, 0.6))
    for place, (axes, (label, group)) in enumerate(zip(every, groups.items(), strict=True)):
        for name, words, look in _CURVES:
            shares = 100 * column(group["curve"], name)
            axes.plot([point["threshold"] for point in group["curve"]], shares, label=words, **look)
        axes.axvline(found["threshold"], color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        auc = "" if group.get("auc") is None else f", AUC {group['auc']:.3f}"
        axes.set(title=f"{label}{auc}", xlim=(0, 1), ylim=(0, 101.5))
        axes.grid(True)
        if place % across == 0:
            axes.set_ylabel("judged right [%]")
    figure.supxlabel("threshold of the dissimilarity", fontsize=9)
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(_CURVES))
    return figure
