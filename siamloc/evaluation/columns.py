"""Columns of equal length: the form in which tasks return the result for each query."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import DataError
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns


def room_names(*tables: FrameTable) -> list[NDArray[np.str_]]:
    """Return unique names of each table's rooms, with the building only if there are several."""
    buildings = {building for table in tables for building in np.unique(table.building).tolist()}
    return [table.room if len(buildings) <= 1 else table.place for table in tables]


def map_columns(known: FrameTable, queries: FrameTable) -> Columns:
    """Return the columns of `map.csv` for a map's frames, used for pictures and to compare runs."""
    rooms = room_names(known, queries)[0]
    return {"path": known.path, "x": known.x, "y": known.y, "theta": known.theta, "room": rooms}


def missing_rooms(known: FrameTable, queries: FrameTable) -> str:
    """Return a sentence that names the queries' rooms that the map lacks, and a remedy; empty if the map has all."""
    in_map, rooms = room_names(known, queries)
    missing = sorted(set(rooms.tolist()) - set(in_map.tolist()) - {""})
    if not missing:
        return ""
    count = int(np.isin(rooms, missing).sum())
    return (
        f"{count} of {len(rooms)} queries are in rooms that the map lacks ({', '.join(missing)}), and cannot be found "
        "there: add frames of these rooms to the map (protocol.map), or leave those queries out (protocol.query.rooms)"
    )


def check_retrieval(found: Retrieval, frames: FrameTable) -> None:
    """Check that a retrieval has one row for each query.

    Raises:
        DataError: the retrieval has fewer or more rows than there are queries.
    """
    if len(found) != len(frames):
        raise DataError(f"the retrieval must be that of the {len(frames)} queries, got one of {len(found)}")


def retrieve(
    visual_map: VisualMap, descriptors: ArrayLike | None, frames: FrameTable, k: int, retrieval: Retrieval | None
) -> Retrieval:
    """Return the given retrieval, or search the map for the descriptors.

    Raises:
        DataError: no queries, not one descriptor or result for each, or neither descriptors nor a retrieval.
    """
    if not len(frames):
        raise DataError("there are no queries to evaluate")
    if retrieval is not None:
        check_retrieval(retrieval, frames)
        return retrieval
    if descriptors is None:
        raise DataError("queries need descriptors or a retrieval to be evaluated: give one of the two")
    values = np.asarray(descriptors)
    if values.ndim != 2 or len(values) != len(frames):
        raise DataError(f"{len(frames)} queries need descriptors of shape ({len(frames)}, D), got {values.shape}")
    return visual_map.search(values, k)
