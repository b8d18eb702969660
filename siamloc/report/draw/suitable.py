"""Select and draw the plots that suit a result, from its measures and tables or from its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from siamloc.data.occupancy import OccupancyMap
from siamloc.report.draw.curves import compact_curves, pair_curves, robustness_curves
from siamloc.report.draw.errors import calibration_curve, error_curve, estimate_curve, node_errors
from siamloc.report.draw.floor_plan import floor_plan
from siamloc.report.draw.growth import animate, read_story
from siamloc.report.draw.look import Picture, save
from siamloc.report.draw.nodes import node_plan, nodes_on_plan
from siamloc.report.draw.rooms import confusion
from siamloc.results import FURTHER, Columns, add_pictures, finest, read_results, read_rows

Made = dict[str, Callable[[], Picture]]

_TABLES = ("queries", "map", "frames", "nodes")
_FROM_MEASURES = {
    "room_pairs": ("pairs", pair_curves),
    "robustness": ("robustness", robustness_curves),
    "compact": ("compact", compact_curves),
}
# Other errors of the same queries in hierarchical results.
_OTHER_SEARCHES = {"baseline_whole map": "error_absolute", "baseline_perfect nodes": "error_perfect_coarse"}


def pictures(
    measures: Mapping[str, Any],
    tables: Mapping[str, Columns],
    name: str = "measured",
    occupancy: OccupancyMap | None = None,
) -> Made:
    """Return a drawing function for each plot that suits a result, by file name; nothing is drawn yet.

    Args:
        measures: measures of the result, as in `results.json` under "measures".
        tables: tables of the result, as returned by `read_rows`: "queries" and "map" for localization, "frames" and
            "nodes" for a compact map.
        name: name of what was measured, for legends and titles.
        occupancy: the map of the building to draw behind plans.

    Returns:
        Those of "floor_plan", "error_curve", "filtered_curve", "interpolated_curve", "refined_curve", "tracked_curve",
        "refined_plan", "tracked_plan", "calibration", "node_errors", "confusion", "confusion_by_lighting", "pairs",
        "robustness", "compact" and "nodes" for which there are numbers, each with a function without arguments that
        returns a matplotlib figure.

    Raises:
        FormatError: for a compact map: measures or columns are missing.

    Example:
        >>> rooms = {"confusion": {"labels": ["kitchen"], "counts": [[2]]}}
        >>> made = pictures({"room_retrieval": rooms}, {})
        >>> list(made), made["confusion"]().axes[0].get_title("left")
        (['confusion'], 'all queries\\n100.0 % of 2 right')
    """
    made: Made = {}
    located = measures.get("absolute") or measures.get("hierarchical")
    if located is not None and {"queries", "map"} <= set(tables) and len(tables["queries"]["error"]):
        made |= _of_localization(measures, tables, located["unit"], name, occupancy)
    if "calibration" in measures:
        unit = (located or {}).get("unit", "m")
        made["calibration"] = partial(calibration_curve, measures["calibration"], unit)
    if "hierarchical" in measures and measures["hierarchical"]["overall"]["error"]["mean"]:
        made["node_errors"] = partial(node_errors, measures["hierarchical"])
    for key, what in (("room_retrieval", "room"), ("buildings", "building")):
        if key in measures:
            made |= _of_confusion(measures[key], what)
    for part, (key, draw) in _FROM_MEASURES.items():
        if part in measures:
            made[key] = partial(draw, measures[part])
    if "mapping" in measures and {"frames", "nodes"} <= set(tables):
        plan = node_plan(measures["mapping"], tables["frames"], tables["nodes"], name, occupancy)
        if len(plan.xy):
            made["nodes"] = partial(nodes_on_plan, plan)
    return made


def save_all(folder: str | Path, layer: str | Path | None = None, occupancy: OccupancyMap | None = None) -> list[Path]:
    """Draw every plot that a result folder holds the numbers for, save them there, and return the files.

    Their names are added to `results.json` first, so that none is left behind when these results are replaced.

    Args:
        folder: result folder of an evaluation, with `results.json` and its tables.
        layer: folder of the coarse layer that was measured; the log of an incremental map, `events.jsonl`, gives
            `growth.gif` if all frames have positions.
        occupancy: the map of the building to draw behind plans.

    Raises:
        FormatError: files that are missing, incomplete, or from different maps.
        StorageError: the disk is full or cannot be written to.
    """
    results, target = read_results(folder), Path(folder)
    tables = {table: read_rows(folder, table) for table in _TABLES if table in results["tables"]}
    name = name_of(results)
    made = pictures(results["measures"], tables, name, occupancy)
    whole = "nodes" in made and np.isfinite([tables["frames"][axis] for axis in "xy"]).all()
    log = None if layer is None or not whole else Path(layer) / "events.jsonl"
    log = log if log is not None and log.is_file() else None
    add_pictures(folder, [*(f"{key}.png" for key in made), *(["growth.gif"] if log is not None else [])])
    drawn = [save(draw(), target / f"{key}.png") for key, draw in made.items()]
    if log is not None:
        plan = node_plan(results["measures"]["mapping"], tables["frames"], tables["nodes"], name, occupancy)
        drawn.append(animate(read_story(log, plan), target / "growth.gif"))
    return drawn


def name_of(results: Mapping[str, Any]) -> str:
    """Return the name of what was measured: of a compact map, or else of the descriptor."""
    layer = results.get("layer") or {}
    if "mapping" in results["measures"] and "name" in layer:
        version = layer.get("version")
        return f"map by {layer['name']}" if version is None else f"incremental map, version {version}"
    chosen = results.get("config", {}).get("descriptor")
    chosen = chosen if isinstance(chosen, Mapping) else {}
    return str(chosen.get("label") or chosen.get("name") or (results.get("descriptor") or {}).get("name", "measured"))


def _of_localization(
    measures: Mapping[str, Any], tables: Mapping[str, Columns], unit: str, name: str, occupancy: OccupancyMap | None
) -> Made:
    queries, known = tables["queries"], tables["map"]
    others = {key: queries[column] for key, column in _OTHER_SEARCHES.items() if column in queries}
    made: Made = {
        "floor_plan": partial(floor_plan, queries, known, unit, occupancy),
        "error_curve": partial(error_curve, {**queries, **others}, unit, name),
    }
    finer, estimate_name = finest(dict(queries))
    if estimate_name is not None:
        made[f"{estimate_name}_plan"] = partial(floor_plan, finer, known, unit, occupancy)
    for estimate in FURTHER:
        if f"absolute_{estimate}" in measures:
            made[f"{estimate}_curve"] = partial(estimate_curve, queries, estimate, unit)
    return made


def _of_confusion(measures: Mapping[str, Any], what: str) -> Made:
    labels, by_lighting = measures["confusion"]["labels"], measures["confusion"].get("lighting", {})
    missing = measures.get("rooms_missing_in_map", [])
    counts = {"confusion": {"all queries": measures["confusion"]["counts"]}}
    counts |= {"confusion_by_lighting": by_lighting} if len(by_lighting) > 1 else {}
    return {key: partial(confusion, labels, part, missing, what) for key, part in counts.items()}
