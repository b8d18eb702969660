"""Expected errors against true ones: calibration of the error estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from siamloc.report.draw.look import (
    FLOOR,
    MARKS,
    Picture,
    column,
    error_limits,
    lighting_colours,
    method_look,
    scale_errors,
    style,
)


@style()
def calibration_curve(found: Mapping[str, Any], unit: str = "m") -> Picture:
    """Draw the true mean error of each tenth of the queries against their expected error.

    Args:
        found: `measures.calibration` of `results.json`.
        unit: of the errors.
    """
    groups = {**found["lighting"], "all queries": found["overall"]}
    if len(found["lighting"]) == 1:
        groups.pop("all queries")
    groups = {label: group for label, group in groups.items() if group["curve"]}
    colours = dict(zip(found["lighting"], lighting_colours(found["lighting"]), strict=True))
    figure = Picture(figsize=(4.6, 3.6))
    axes = figure.add_subplot()
    curves = []
    for i, (label, group) in enumerate(groups.items()):
        expected, true = column(group["curve"], "predicted"), column(group["curve"], "observed")
        curves += [expected, true]
        last = label == list(groups)[-1]
        look = method_look(0) | {"marker": MARKS[i % len(MARKS)], "markersize": 5, "linestyle": "-" if last else "none"}
        if label in colours:
            look["color"] = colours[label]
        axes.plot(expected, true, label=label, **look)
    limits = error_limits(curves, lowest=0)
    for axis, label in ((axes.xaxis, "expected error"), (axes.yaxis, "true error, mean")):
        scale_errors(axis, limits, f"{label} [{unit}]")
    axes.plot(limits or (0, 1), limits or (0, 1), label="equal", **FLOOR)
    axes.grid(True)
    axes.legend(loc="upper left")
    return figure
