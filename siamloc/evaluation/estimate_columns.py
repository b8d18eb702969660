"""Columns and measures of further estimates of each query: filtered, refined, or for queries without a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import DataError
from siamloc.evaluation.columns import check_retrieval, room_names
from siamloc.evaluation.metrics import heading_error, localization_error, recall_from_ranks, summarize
from siamloc.maps.error_model import ErrorModel
from siamloc.maps.refinement import RefinedPoses
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns, rows_by_label


def estimate_columns(
    name: str, estimated_xy: ArrayLike, frames: FrameTable, headings: ArrayLike | None = None
) -> Columns:
    """Return the columns of a further estimate of each query.

    Args:
        name: prefix of the columns' names.
        estimated_xy: (n, 2).
        frames: the queries (n), all with positions.
        headings: estimated headings (n,), rad, NaN where unknown.

    Returns:
        `<name>_est_x`, `<name>_est_y`, `<name>_error`; with headings also `<name>_est_theta` and
        `<name>_heading_error` in degrees, NaN if one of the two headings is unknown.

    Raises:
        DataError: arrays that do not match each other, or unknown positions.
    """
    xy = np.asarray(estimated_xy, dtype=np.float64)
    error = localization_error(xy, frames.xy)
    columns: Columns = {f"{name}_est_x": xy[:, 0], f"{name}_est_y": xy[:, 1], f"{name}_error": error}
    if headings is None:
        return columns
    theta = np.asarray(headings, dtype=np.float64)
    if theta.shape != (len(frames),):
        raise DataError(f"{len(frames)} queries need as many headings, got shape {theta.shape}")
    known = np.isfinite(theta) & np.isfinite(frames.theta)
    off = np.full(len(frames), np.nan)
    off[known] = np.degrees(heading_error(theta[known], frames.theta[known]))
    return {**columns, f"{name}_est_theta": theta, f"{name}_heading_error": off}


def measures_of(
    columns: Mapping[str, NDArray], name: str, radii: Sequence[float], map_frames: int, unit: str
) -> dict[str, Any]:
    """Return the measures of a further estimate, from the columns of `queries.csv`.

    Returns:
        The measures of `siamloc.evaluation.absolute.measures_of`, but with the recall only for the estimate itself
        (k = 1). The excess is relative to the nearest map frame, and negative if an estimate between frames is nearer.
        `inside` is the share of true positions inside the 90 % ellipse, if the estimate has one.
    """

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        error, floor = columns[f"{name}_error"][rows], columns["floor"][rows]
        within = {radius: (error <= radius).astype(np.int64) for radius in radii}
        found = {
            "queries": len(rows),
            "error": summarize(error),
            "floor": summarize(floor),
            "excess": summarize(error - floor),
            "recall": [dict(vars(recall_from_ranks(within[radius], floor, radius, 1))) for radius in radii],
        }
        if f"{name}_inside" in columns:
            inside = columns[f"{name}_inside"][rows]
            found["inside"] = float(np.nanmean(inside)) if np.isfinite(inside).any() else float("nan")
        turned = columns[f"{name}_heading_error"][rows] if f"{name}_heading_error" in columns else np.empty(0)
        turned = turned[np.isfinite(turned)]
        return {**found, "heading_error": summarize(turned)} if len(turned) else found

    return {
        "unit": unit,
        "map_frames": int(map_frames),
        "radii": list(radii),
        "ks": [1],
        "overall": group(np.arange(len(columns["error"]))),
        "lighting": {label: group(rows) for label, rows in rows_by_label(columns["lighting"]).items()},
        "room": {label: group(rows) for label, rows in rows_by_label(columns["room"]).items()},
    }


def located_columns(
    known: VisualMap,
    frames: FrameTable,
    found: Retrieval,
    headings: ArrayLike | None = None,
    errors: ErrorModel | None = None,
    poses: tuple[str, RefinedPoses] | None = None,
) -> Columns:
    """Return the estimated poses of queries whose true poses are unknown: the columns of `located.csv`.

    Args:
        known: a map of m frames, all with positions.
        frames: the queries (n).
        found: the nearest map frames of each query.
        headings: estimated headings (n,), rad.
        errors: the error model, with a threshold for lost queries.
        poses: prefix of the columns' names, and poses finer than the map.

    Raises:
        DataError: a retrieval of other queries, or of too few frames for the error model.
    """
    check_retrieval(found, frames)
    match = found.indices[:, 0]
    known_rooms, rooms = room_names(known.frames, frames)
    columns: Columns = {
        "query": np.arange(len(frames)),
        "path": frames.path,
        "sequence": frames.sequence,
        "lighting": frames.lighting,
        "room": rooms,
        "match": match,
        "match_path": known.frames.path[match],
        "match_room": known_rooms[match],
        "est_x": known.frames.x[match],
        "est_y": known.frames.y[match],
        "descriptor_distance": found.distances[:, 0],
    }
    if headings is not None:
        columns["est_theta"] = np.asarray(headings, dtype=np.float64)
    if poses is not None:
        name, finer = poses
        columns |= {f"{name}_est_x": finer.xy[:, 0], f"{name}_est_y": finer.xy[:, 1], f"{name}_est_theta": finer.theta}
    if errors is not None:
        expected, lost = errors.judged(found, known.frames.xy, None if poses is None else poses[1])
        assert lost is not None
        columns |= {"error_m": expected, "lost": lost}
    return columns
