"""The two tables of robustness: "answers" for each query, and "robustness" for each method, disturbance and level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.columns import Rows
from siamloc.data.frames import FrameTable, room_names
from siamloc.evaluation.columns import heading_errors
from siamloc.evaluation.metrics import error_floor, localization_error, recall_from_ranks, summarize
from siamloc.results import Columns


@dataclass(frozen=True, eq=False)
class Answer(Rows):
    """Answers of a descriptor for a batch of images.

    Attributes:
        nearest: rows of the most similar map frames (B,).
        heading: headings from these map frames (B,), rad; NaN where there is none.
        heading_nearest: headings from the geometrically nearest map frames (B,), rad ([T] 3.5.3-3.5.4).
    """

    nearest: NDArray[np.int64]
    heading: NDArray[np.float64]
    heading_nearest: NDArray[np.float64]


def answers(
    method: str,
    known: FrameTable,
    queries: FrameTable,
    found: Mapping[tuple[str, float], Answer],
    by_room: bool = False,
    excluded: NDArray[np.bool_] | None = None,
) -> Columns:
    """Return a row for each query, disturbance and level: the columns of `answers.csv`.

    Args:
        method: name of the descriptor.
        known: m map frames with positions.
        queries: n frames with positions.
        found: the answers for all queries (n,), by name of the disturbance and level.
        by_room: judge by rooms instead of positions: the error is 1 in a wrong room.
        excluded: (n, m) map frames that a query was not compared with; the error floor leaves them out, too.

    Raises:
        DataError: frames without positions.
    """
    known_rooms, rooms = room_names(known, queries)
    if by_room:
        findable = known_rooms[None, :] == rooms[:, None]
        floor = (~(findable if excluded is None else findable & ~excluded).any(axis=1)).astype(float)
    else:
        floor = error_floor(known.xy, queries.xy, excluded)
    parts = []
    for (name, level), answer in found.items():
        row = answer.nearest
        error = (known_rooms[row] != rooms).astype(float) if by_room else localization_error(known.xy[row], queries.xy)
        parts.append(
            {
                "method": np.full(len(queries), method),
                "disturbance": np.full(len(queries), name),
                "level": np.full(len(queries), float(level)),
                "path": queries.path,
                "lighting": queries.lighting,
                "room": queries.room,
                "match_path": known.path[row],
                "error": error,
                "floor": np.minimum(floor, error),
                "heading_error": heading_errors(answer.heading, queries),
                "heading_error_nearest": heading_errors(answer.heading_nearest, queries),
            }
        )
    return concatenated(parts)


def curves(columns: Mapping[str, NDArray], radius: float, map_frames: int) -> Columns:
    """Return a row for each method, disturbance and level, from the rows of `answers`: columns of `robustness.csv`.

    Args:
        columns: the columns that `answers` returned.
        radius: not negative; an error equal to it counts as within.
        map_frames: number of frames in the map.

    Returns:
        method, disturbance, level, queries, map_frames; mean, median, p95 of the errors, floor (mean), excess (mean);
        hit_rate, the share of queries whose answer is the geometrically nearest map frame; heading and heading_nearest,
        mean errors in degrees of the headings from the most similar and from the geometrically nearest map frame, NaN
        if no heading is known; radius, within (queries), share (of all queries), answerable (queries with a map frame
        within the radius).
    """
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, key in enumerate(zip(*(columns[name].tolist() for name in ("method", "disturbance", "level")), strict=True)):
        groups.setdefault(key, []).append(i)
    rows: list[dict[str, Any]] = []
    for (method, name, level), group in groups.items():
        error, floor = columns["error"][group], columns["floor"][group]
        errors = summarize(error)
        near = recall_from_ranks((error <= radius).astype(np.int64), floor, radius, 1)
        rows.append(
            {
                "method": method,
                "disturbance": name,
                "level": level,
                "queries": len(error),
                "map_frames": int(map_frames),
                **{key: errors[key] for key in ("mean", "median", "p95")},
                "floor": float(floor.mean()),
                "excess": float((error - floor).mean()),
                "hit_rate": float((error - floor <= 1e-9).mean()),
                "heading": _mean(columns["heading_error"][group]),
                "heading_nearest": _mean(columns["heading_error_nearest"][group]),
                "radius": float(radius),
                "within": near.hits,
                "share": near.recall,
                "answerable": near.answerable,
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def measures(
    table: Mapping[str, NDArray], disturbances: Sequence[Mapping[str, Any]], unit: str, every: int
) -> dict[str, Any]:
    """Return the measures for `results.json`, from the rows of `curves`.

    Args:
        table: the columns that `curves` returned.
        disturbances: name, kind and levels of each disturbance, from `Disturbance.plain`.
        unit: unit of the errors.
        every: number of queries of which one was used.

    Returns:
        unit, every, radius, queries, map_frames, `disturbances` (name, kind, unit, levels), and `methods`: by method
        and disturbance, a list with an entry for each level.
    """
    shared = ("queries", "map_frames", "radius")
    own = [name for name in table if name not in ("method", "disturbance", *shared)]
    methods: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for i, (method, name) in enumerate(zip(table["method"].tolist(), table["disturbance"].tolist(), strict=True)):
        entry = {key: table[key][i].item() for key in own}
        methods.setdefault(method, {}).setdefault(name, []).append(entry)
    return {
        "unit": unit,
        "every": every,
        **{key: table[key][0].item() for key in shared},
        "disturbances": list(disturbances),
        "methods": methods,
    }


def concatenated(parts: Sequence[Mapping[str, NDArray]]) -> Columns:
    """Concatenate tables with the same columns, row after row."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean of the known values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
