"""Absolute localization: a query gets the pose of the map frame with the nearest descriptor ([T] 5.3.5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable, room_names
from siamloc.errors import DataError
from siamloc.evaluation.columns import heading_errors, map_columns, match_columns, query_columns
from siamloc.evaluation.metrics import (
    error_floor,
    first_rank_within,
    localization_error,
    one_percent,
    recall_from_ranks,
    summarize,
)
from siamloc.evaluation.offsets import implausible_offsets
from siamloc.evaluation.result import Result
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns, by_label, rows_by_label


def evaluate_absolute(
    visual_map: VisualMap,
    frames: FrameTable,
    found: Retrieval,
    radii: Sequence[float] = (0.5, 1.0),
    ks: Sequence[int] = (1, 5, 10, 20),
    headings: ArrayLike | None = None,
    excluded: NDArray[np.bool_] | None = None,
) -> Result:
    """Locate queries in a map and compare the results with their true poses.

    The table "queries" has a row for each query; its column `first_rank_within_<radius>` is the rank of the first
    retrieved frame within that radius, 0 if there is none. The table "map" has the data for pictures.

    Args:
        visual_map: a map of m frames, all with positions.
        frames: the queries (n), all with positions, n at least 1.
        found: the nearest map frames of each query, at least `neighbours(ks, m)`.
        radii: radii of the recall, in units of x and y.
        ks: numbers of retrieved frames for the recall; the recall for 1 % of the map is always measured, too.
        headings: estimated headings of the queries (n,), rad, NaN where unknown; evaluated where the true one is known.
        excluded: (n, m) map frames that a query was not compared with; the error floor leaves them out, too.
    """
    known, radii = visual_map.frames, list(map(float, radii))
    about = {"unit": visual_map.unit, "map_frames": len(known), "radii": radii, "ks": list(ks)}
    k = most_neighbours(neighbours(ks, len(known)), len(known), excluded)
    columns = {**_columns(known, frames, found, excluded), **_heading_columns("", headings, frames)}
    for radius in radii:
        columns[rank_column(radius)] = first_rank_within(found.indices[:, :k], known.xy, frames.xy, radius)
    counts = {
        by: {label: len(rows) for label, rows in rows_by_label(columns[by]).items()} for by in ("lighting", "room")
    }
    aside = list(implausible_offsets(known, frames, found.indices[:, 0]))
    matched, own = known.building[found.indices[:, 0]], frames.building
    if elsewhere := int(((matched != own) & (matched != "") & (own != "")).sum()):
        aside.append(f"{elsewhere} of {len(frames)} queries are matched in another building than theirs.")
    return Result(
        name="absolute",
        parts={"absolute": pose_measures(columns, about)},
        tables={"queries": columns, "map": map_columns(known, frames)},
        denominators={"queries": len(frames), "map_frames": len(known), **counts},
        skipped={"positions": " ".join(aside)} if aside else {},
    )


def with_baseline(result: Result, name: str, baseline: Result) -> Result:
    """Add the errors of another method on the same queries to a result, as the column `baseline_<name>`."""
    columns = {**result.tables["queries"], f"baseline_{name}": baseline.tables["queries"]["error"]}
    result = result.with_part("absolute", pose_measures(columns, result.parts["absolute"]), columns)
    return replace(result, baselines={**result.baselines, name: baseline})


def neighbours(ks: Sequence[int], map_frames: int) -> int:
    """Return how many nearest map frames of each query a search must return to compute the recalls.

    Args:
        ks: the K of recall@K.
        map_frames: number of frames in the map; recall@1% is computed as well.
    """
    return min(max(*ks, one_percent(map_frames)), map_frames)


def most_neighbours(k: int, map_frames: int, excluded: NDArray[np.bool_] | None) -> int:
    """Return the number of neighbours, at most k, that every query can have in a map without its excluded frames.

    Raises:
        DataError: all map frames are excluded for a query.
    """
    most = map_frames if excluded is None else int((~excluded).sum(axis=1).min(initial=map_frames))
    if most < 1:
        raise DataError("a query is too near to every map frame to be compared with any: exclude less")
    return min(k, most)


def pose_measures(
    columns: Mapping[str, NDArray],
    about: Mapping[str, Any],
    further: Callable[[NDArray[np.int64]], dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Return all measures of localization, pooled over queries, from the columns of `queries.csv`.

    Args:
        columns: columns of `queries.csv`.
        about: `unit` of x and y, `map_frames`, and the `radii` and `ks` of the recall; other keys are ignored.
        further: returns more measures of a group, from the rows of its queries.

    Returns:
        unit, map_frames, radii, ks, the groups "overall", "lighting" (by label) and "room" (by label), and
        "room_by_lighting" ([T] table 5.15): `queries`, `error` and `floor` by room and lighting. A group holds
        `queries`; `error`, `floor` and `excess` (error - floor) as summaries; `hit_rate`, a list of `tolerance`,
        `rate`, `hits` and `queries`, for the tolerance 0 and each of the radii; `recall`, a list of `metrics.Recall` as
        dictionaries, one per radius and k; `recall_at_one_percent`, one per radius; `baselines` by name; and
        `heading_error` in degrees if headings were estimated and the true headings are known. Queries without a label
        count as "(unlabelled)" if others have one.
    """

    radii, ks, map_frames = about["radii"], about["ks"], about["map_frames"]

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        numbers = {name: column[rows] for name, column in columns.items() if column.dtype.kind in "iuf"}
        floor = numbers["floor"]
        ranks = {radius: numbers[rank_column(radius)] for radius in radii}
        return {
            "queries": len(rows),
            **{name: summarize(numbers[name]) for name in ("error", "floor", "excess")},
            "hit_rate": [_hit_rate(numbers["excess"], one) for one in dict.fromkeys((0.0, *radii))],
            "recall": _recalls(ranks, floor, ks),
            "recall_at_one_percent": _recalls(ranks, floor, [one_percent(map_frames)]),
            "baselines": {
                name.removeprefix("baseline_"): {"error": summarize(error)}
                for name, error in numbers.items()
                if name.startswith("baseline_")
            },
            **_heading(numbers.get("heading_error")),
            **({} if further is None else further(rows)),
        }

    return {
        **{key: about[key] for key in ("unit", "map_frames", "radii", "ks")},
        **by_label(columns, group, "lighting", "room"),
        "room_by_lighting": _room_by_lighting(columns),
    }


def estimate_measures(columns: Mapping[str, NDArray], name: str, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the measures of a further estimate of each query, from the columns of `queries.csv`.

    Args:
        columns: columns of `queries.csv`, with those of the estimate, such as `filtered_error`.
        name: name of the estimate, a key of `siamloc.results.FURTHER`, such as "filtered".
        about: unit, map_frames, radii and ks of the evaluation, which the measures repeat.

    Returns:
        The measures of `pose_measures`, but with the recall only for the estimate itself (k = 1). The excess is
        relative to the nearest map frame, and negative if an estimate between frames is nearer. `inside` is the share
        of true positions inside the 90 % ellipse, if the estimate has one.
    """

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        error, floor = columns[f"{name}_error"][rows], columns["floor"][rows]
        found = {
            "queries": len(rows),
            "error": summarize(error),
            "floor": summarize(floor),
            "excess": summarize(error - floor),
            "recall": _recalls({radius: (error <= radius).astype(np.int64) for radius in about["radii"]}, floor, [1]),
        }
        if f"{name}_inside" in columns:
            inside = columns[f"{name}_inside"][rows]
            found["inside"] = float(np.nanmean(inside)) if np.isfinite(inside).any() else float("nan")
        turned = columns.get(f"{name}_heading_error")
        return {**found, **_heading(None if turned is None else turned[rows])}

    return {
        **{key: about[key] for key in ("unit", "map_frames", "radii")},
        "ks": [1],
        **by_label(columns, group, "lighting", "room"),
    }


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
        `<name>_est_x`, `<name>_est_y`, `<name>_error`; with any known headings also `<name>_est_theta` and
        `<name>_heading_error` in degrees, NaN if one of the two headings is unknown.

    Raises:
        DataError: unknown positions.
    """
    xy = np.asarray(estimated_xy, dtype=np.float64)
    return {
        **{f"{name}_est_x": xy[:, 0], f"{name}_est_y": xy[:, 1], f"{name}_error": localization_error(xy, frames.xy)},
        **_heading_columns(f"{name}_", headings, frames),
    }


def _heading_columns(prefix: str, headings: ArrayLike | None, frames: FrameTable) -> Columns:
    """Return the columns of estimated headings (n,), NaN where unknown; none if all are unknown."""
    theta = np.asarray(np.nan if headings is None else headings, dtype=np.float64)
    if not np.isfinite(theta).any():
        return {}
    return {f"{prefix}est_theta": theta, f"{prefix}heading_error": heading_errors(theta, frames)}


def _room_by_lighting(columns: Mapping[str, NDArray]) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for room, inside in rows_by_label(columns["room"]).items():
        for lighting, rows in rows_by_label(columns["lighting"][inside]).items():
            both = {name: summarize(columns[name][inside][rows]) for name in ("error", "floor")}
            found.setdefault(room, {})[lighting] = {"queries": len(rows), **both}
    return found


def rank_column(radius: float) -> str:
    """Return the name of the column with the rank of the first retrieved frame within a radius, in the unit of x."""
    return f"first_rank_within_{float(radius)!r}"


def _columns(known: FrameTable, frames: FrameTable, found: Retrieval, excluded: NDArray[np.bool_] | None) -> Columns:
    match = found.indices[:, 0]
    error = localization_error(known.xy[match], frames.xy)
    # The floor is at most the error; the minimum guards against rounding, so that the excess is never negative.
    floor = np.minimum(error_floor(known.xy, frames.xy, excluded), error)
    return {
        **query_columns(frames, room_names(known, frames)[1]),
        "x": frames.x,
        "y": frames.y,
        "theta": frames.theta,
        **({"deviation": frames.deviation} if np.isfinite(frames.deviation).any() else {}),
        **match_columns(known, frames, match),
        "error": error,
        "floor": floor,
        "excess": error - floor,
        "descriptor_distance": found.distances[:, 0],
    }


def _recalls(ranks: Mapping[float, NDArray], floor: NDArray, ks: Sequence[int]) -> list[dict[str, Any]]:
    """Return the recall for each radius and k; `ranks` holds the first rank within each radius."""
    return [dict(vars(recall_from_ranks(rank, floor, radius, k))) for radius, rank in ranks.items() for k in ks]


def _hit_rate(excess: NDArray[np.float64], tolerance: float) -> dict[str, Any]:
    """Return the share of queries whose answer is the geometrically nearest map frame ([T] 3.5.1), or nearly so.

    With a tolerance, answers count as well if they are farther away by at most that distance. Frames that are equally
    near up to rounding (a nanometre) all count as the nearest one.
    """
    hits = int((excess <= tolerance + 1e-9).sum())
    return {"tolerance": float(tolerance), "rate": hits / len(excess), "hits": hits, "queries": len(excess)}


def _heading(errors: NDArray | None) -> dict[str, Any]:
    """Return the summary of the heading errors in degrees; empty if none is known."""
    known = np.empty(0) if errors is None else errors[np.isfinite(errors)]
    return {"heading_error": summarize(known)} if len(known) else {}
