"""Columns of equal length: the form in which tasks return the result for each query."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable, room_names
from siamloc.evaluation.metrics import confusion_matrix, heading_error
from siamloc.maps.error_model import ErrorModel
from siamloc.maps.joining import RefinedPoses
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns, by_label


def query_columns(frames: FrameTable, rooms: NDArray[np.str_]) -> Columns:
    """Return the first columns of `queries.csv` for n queries, and their room names (n,)."""
    return {
        "query": np.arange(len(frames)),
        "path": frames.path,
        "sequence": frames.sequence,
        "lighting": frames.lighting,
        "room": rooms,
    }


def match_columns(known: FrameTable, frames: FrameTable, match: NDArray[np.int64]) -> Columns:
    """Return the columns of the map frame (n,) that each query gets its pose from.

    Args:
        known: frames of the map, all with positions.
        frames: the queries (n).
        match: rows of the map frames (n,).
    """
    rooms = room_names(known, frames)[0]
    return {
        "match": match,
        "match_path": known.path[match],
        "match_room": rooms[match],
        "est_x": known.x[match],
        "est_y": known.y[match],
    }


def right_share(columns: Mapping[str, NDArray], rows: NDArray[np.int64]) -> dict[str, Any]:
    """Return `accuracy` and the counts `correct` and `queries` of some rows of a table.

    Args:
        columns: columns of the table, with `correct`, True for rows whose answer is right.
        rows: indices of the rows, at least one.
    """
    correct = int(columns["correct"][rows].sum())
    return {"accuracy": correct / len(rows), "correct": correct, "queries": len(rows)}


def map_columns(known: FrameTable, queries: FrameTable) -> Columns:
    """Return the columns of `map.csv`: the map's frames, for pictures and to compare runs."""
    rooms = room_names(known, queries)[0]
    return {"path": known.path, "x": known.x, "y": known.y, "theta": known.theta, "room": rooms}


def missing_rooms(known: FrameTable, queries: FrameTable, excluded: NDArray[np.bool_] | None = None) -> str:
    """Return a sentence that names the queries' rooms that the map lacks, and a remedy; empty if the map has all.

    Queries for which the protocol excludes all map frames of their room are named, too.
    """
    in_map, rooms = room_names(known, queries)
    absent, said = ~np.isin(rooms, in_map) & (rooms != ""), list[str]()
    buildings = sorted(set(known.building.tolist()) - {""})
    bare = absent & (queries.building == "") & (len(buildings) > 1)
    if bare.any():
        said.append(
            f"{bare.sum()} of {len(rooms)} queries state no building, and the rooms of the map are those of "
            f"{', '.join(buildings)}: give these queries a building, too"
        )
    if len(lacking := rooms[absent & ~bare]):
        said.append(
            f"{len(lacking)} of {len(rooms)} queries are in rooms that the map lacks ({_listed(lacking)}), and cannot "
            "be found there: add frames of these rooms to the map (protocol.map), or leave those queries out "
            "(protocol.query.rooms)"
        )
    if excluded is not None:
        same = rooms[:, None] == in_map
        barred = rooms[same.any(axis=1) & ~(same & ~excluded).any(axis=1)]
        if len(barred):
            said.append(
                f"{len(barred)} of {len(rooms)} queries may find no map frame of their room, which the protocol "
                f"excludes ({_listed(barred)}), and count as wrong: add frames of another drive to the map"
            )
    return "; ".join(said)


def _listed(rooms: NDArray[np.str_]) -> str:
    return ", ".join(sorted(set(rooms.tolist())))


def confusions(columns: Mapping[str, NDArray], what: str, labels: Sequence[str]) -> dict[str, Any]:
    """Return the confusion matrices of rooms or buildings, as lists of rows.

    Args:
        columns: the true label of each query in the column `what`, and the predicted label in `predicted_<what>`.
        what: "room" or "building".
        labels: all labels, in the order of the rows and columns.

    Returns:
        `counts` of all queries (row = true label, column = predicted label), and those by `lighting`.
    """

    def counts(rows: NDArray[np.int64]) -> Any:
        return confusion_matrix(columns[what][rows], columns[f"predicted_{what}"][rows], labels).tolist()

    found = by_label(columns, counts, "lighting")
    return {"counts": found["overall"], "lighting": found["lighting"]}


def heading_errors(estimated: ArrayLike, frames: FrameTable) -> NDArray[np.float64]:
    """Return the absolute errors of estimated headings (n,), in degrees, from 0 to 180.

    Args:
        estimated: estimated headings (n,) in rad, NaN where unknown.
        frames: the n queries, whose `theta` holds the true headings in rad, NaN where unknown.

    Returns:
        NaN where the estimated or the true heading is unknown.
    """
    theta = np.asarray(estimated, dtype=np.float64)
    known, error = np.isfinite(theta) & np.isfinite(frames.theta), np.full(len(frames), np.nan)
    error[known] = np.degrees(heading_error(theta[known], frames.theta[known]))
    return error


def located_columns(
    known: VisualMap,
    frames: FrameTable,
    found: Retrieval,
    headings: ArrayLike,
    errors: ErrorModel | None = None,
    poses: tuple[str, RefinedPoses] | None = None,
) -> Columns:
    """Return the estimated poses of queries whose true poses are unknown: the columns of `located.csv`.

    Args:
        known: a map of m frames, all with positions.
        frames: the queries (n).
        found: the nearest map frames of each query.
        headings: estimated headings (n,), rad, NaN where unknown; no column if all are unknown.
        errors: the error model, with a threshold for lost queries.
        poses: prefix of the columns' names, and poses finer than the map.

    Raises:
        DataError: a retrieval of too few frames for the error model.
    """
    columns: Columns = {
        **query_columns(frames, room_names(known.frames, frames)[1]),
        **match_columns(known.frames, frames, found.indices[:, 0]),
        "descriptor_distance": found.distances[:, 0],
    }
    if np.isfinite(headings).any():
        columns["est_theta"] = np.asarray(headings, dtype=np.float64)
    if poses is not None:
        name, finer = poses
        columns |= {f"{name}_est_x": finer.xy[:, 0], f"{name}_est_y": finer.xy[:, 1], f"{name}_est_theta": finer.theta}
    if errors is not None:
        expected, lost = errors.judged(found, known.frames.xy, None if poses is None else poses[1])
        assert lost is not None
        columns |= {"error_m": expected, "lost": lost}
    return columns
