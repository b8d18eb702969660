"""Which of several buildings a query is in, by the building whose map is nearest ([C] 5.3.3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import DataError
from siamloc.evaluation.metrics import confusion_matrix
from siamloc.evaluation.result import Result
from siamloc.results import Columns, rows_by_label


def evaluate_buildings(
    frames: FrameTable, labels: Sequence[str], apart: ArrayLike, nearest: ArrayLike, names: Sequence[ArrayLike]
) -> Result:
    """Take the building of the nearest representative for each query's building; of equally near ones the first.

    Args:
        frames: n queries, each in one of the buildings.
        labels: names of B buildings, B at least 2.
        apart: distance of each query's descriptor to the nearest representative of each building (n, B).
        nearest: row of that representative in its map (n, B).
        names: of the representatives of each building.

    Raises:
        DataError: fewer than two buildings, one that stands twice, no queries, queries whose building is unknown or
            has no map, or distances that do not fit.
    """
    known, distance = tuple(map(str, labels)), np.asarray(apart, dtype=np.float64)
    rows = np.asarray(nearest, dtype=np.int64)
    if len(known) < 2 or len(set(known)) < len(known):
        raise DataError(f"choosing a building needs maps of at least two different ones, got {', '.join(known)}")
    if not len(frames):
        raise DataError("there are no queries to evaluate")
    if distance.shape != (len(frames), len(known)) or rows.shape != distance.shape:
        raise DataError(
            f"{len(frames)} queries and {len(known)} buildings need distances of shape {(len(frames), len(known))}, "
            f"got {distance.shape} and rows of {rows.shape}"
        )
    lost = np.flatnonzero(~np.isin(frames.building, known))
    if len(lost):
        first = str(frames.building[lost[0]]) or "(unknown)"
        raise DataError(
            f"{len(lost)} of {len(frames)} queries are in a building that has no map, the first in {first!r}: the "
            f"maps are of {', '.join(known)}"
        )
    every = np.arange(len(frames))
    chosen = distance.argmin(axis=1)
    others = distance.copy()
    others[every, chosen] = np.inf
    columns: Columns = {
        "query": every,
        "path": frames.path,
        "sequence": frames.sequence,
        "lighting": frames.lighting,
        "room": frames.room,
        "building": frames.building,
        "predicted_building": np.array(known)[chosen],
        "correct": np.array(known)[chosen] == frames.building,
        "match": rows[every, chosen],
        "match_name": np.array(
            [str(np.asarray(names[b])[row]) for b, row in zip(chosen, rows[every, chosen], strict=True)], dtype=np.str_
        ),
        "descriptor_distance": distance[every, chosen],
        "next_distance": others.min(axis=1),
    }
    for number, label in enumerate(known):
        columns[f"distance_{label}"] = distance[:, number]
    return Result(
        name="buildings",
        parts={"buildings": measures_of(columns, known)},
        tables={"queries": columns},
        denominators={"queries": len(frames), "maps": len(known)},
    )


def measures_of(columns: Columns, labels: Sequence[str]) -> dict[str, Any]:
    """Return the measures that follow from the columns alone.

    Returns:
        The groups "overall" and "lighting" (by label), each with `accuracy`, `correct`, `queries` and the same by
        true `building`; and `confusion` with the `labels`, the `counts` of all queries (row = true building, column =
        building of the nearest map) and those by `lighting`.
    """
    true, predicted = columns["building"], columns["predicted_building"]

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        parts = {label: rows[true[rows] == label] for label in labels}
        by_building = {label: _share(columns, part) for label, part in parts.items() if len(part)}
        return {**_share(columns, rows), "building": by_building}

    def confused(rows: NDArray[np.int64]) -> list[list[int]]:
        counts: list[list[int]] = confusion_matrix(true[rows], predicted[rows], labels).tolist()
        return counts

    every, by_lighting = np.arange(len(true)), rows_by_label(columns["lighting"])
    return {
        "overall": group(every),
        "lighting": {label: group(rows) for label, rows in by_lighting.items()},
        "confusion": {
            "labels": list(labels),
            "counts": confused(every),
            "lighting": {label: confused(rows) for label, rows in by_lighting.items()},
        },
    }


def _share(columns: Columns, rows: NDArray[np.int64]) -> dict[str, Any]:
    hits = int(columns["correct"][rows].sum())
    return {"accuracy": hits / len(rows) if len(rows) else math.nan, "correct": hits, "queries": len(rows)}
