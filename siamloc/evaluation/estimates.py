"""Estimates alongside the single-frame one, on the same queries: filtered, between frames, expected errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.checks import wrong_headings
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import calibration
from siamloc.evaluation.absolute import most_neighbours
from siamloc.evaluation.columns import check_retrieval, room_names
from siamloc.evaluation.metrics import heading_error, localization_error, recall_from_ranks, summarize
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Search, Session
from siamloc.maps.error_model import ErrorModel
from siamloc.maps.interpolation import interpolate_poses
from siamloc.maps.pose_filter import PoseFilter
from siamloc.maps.refinement import RefinedPoses, Refinement
from siamloc.maps.search import Retrieval
from siamloc.maps.sequence_filter import MotionModel, SequenceFilter, temperature_of_map, tune_filter
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns, rows_by_label
from siamloc.settings import Count, NotNegative, Positive, Probability, Settings

MATCHES = 20  # that an error model looks at
_STANDING = 0.01  # step of a filter in a map whose frames are all at one place


@dataclass(frozen=True)
class FilterSettings(Settings):
    """The sequence filter.

    Attributes:
        temperature: of the softmax of the descriptor distances; learned from the map if None.
        kidnapping: probability that the robot is anywhere.
    """

    WHERE = "task.filter_settings"

    temperature: Positive | None = None
    kidnapping: Probability = 1e-3


@dataclass(frozen=True)
class Estimates(Settings):
    """What is estimated of each query besides the position of the nearest map frame.

    Attributes:
        filter: follow the robot through each sequence; keeps the distances of all queries to all map frames. With
            `refine`, poses between them are followed as well.
        filter_settings: of that filter.
        filter_tune: choose both of them on the validation frames.
        refine: a pose finer than the map: "interpolate" takes one between the nearest map frames, "relative" compares
            the query with each of them, by a network built with relative=True; "none" leaves it out. With validation
            frames the ellipses of "relative" are learned from them.
        neighbours: how many of the nearest map frames that looks at.
        error_model: expected error of each query, learned on the validation frames: of the pose by comparison with
            refine="relative", else of the nearest map frame's.
        lost_above: a larger expected error means lost, in the unit of the positions.
        place_radius: map frames farther apart are different places: for interpolation and the error model.
    """

    WHERE = "task"

    filter: bool = False
    filter_settings: FilterSettings = field(default_factory=FilterSettings)
    filter_tune: bool = False
    refine: Literal["none", "interpolate", "relative"] = "none"
    neighbours: Count = 3
    error_model: bool = False
    lost_above: Positive = 1.0
    place_radius: NotNegative = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.filter_tune and not self.filter:
            raise ConfigError("task.filter_tune=true chooses the settings of the sequence filter: set task.filter=true")


@dataclass(frozen=True)
class Validation:
    """Validation frames with positions, looked for in the map as queries are."""

    frames: FrameTable
    search: Search


def needs_validation(settings: Estimates) -> bool:
    """Return whether validation frames are needed to learn from."""
    return settings.error_model or (settings.filter and settings.filter_tune)


def search_validation(session: Session, frames: FrameTable | None, settings: Estimates, known: VisualMap) -> Validation:
    """Look for validation frames in the map.

    Raises:
        ConfigError: there are none.
        DataError: none of them has a position.
    """
    if frames is None:
        raise ConfigError(
            "the error model and the filter's settings are learned from validation frames: give validation=FRAMES "
            "(on the command line protocol.validation.sequences)"
        )
    has = frames.has_position
    if text := session.lacking(has, "validation frames have no position"):
        if not has.any():
            raise DataError(f"{text}: errors, ellipses and the filter's settings are learned from known positions")
        session.skipped["validation"] = text
    k = min(max(MATCHES, settings.neighbours), len(known))
    tuned = settings.filter and settings.filter_tune
    compared = settings.neighbours if settings.refine == "relative" else 0
    search = Search(known, np.flatnonzero(has), k, refined_by=compared, with_distances=tuned)
    session.run(known, frames, {"validation": search}, "the validation frames")
    return Validation(frames.take(has), search)


def prepared(settings: Estimates, search: Search) -> Search:
    """Return a search for all that the further estimates need."""
    refined = 0 if settings.refine == "none" else settings.neighbours
    if settings.refine == "relative":
        for finding in wrong_headings(search.known.frames):
            raise DataError(f"task.refine=relative rests on the headings of the map: {finding}")
    wanted = max(search.k, refined, MATCHES if settings.error_model else 0)
    return replace(
        search,
        k=most_neighbours(wanted, len(search.known), search.excluded),
        headings_of=max(1, min(refined, len(search.known))) if settings.refine == "interpolate" else 1,
        refined_by=refined if settings.refine == "relative" else 0,
        with_distances=settings.filter,
    )


def with_estimates(
    result: Result, session: Session, settings: Estimates, search: Search, queries: FrameTable
) -> Result:
    """Return a result of absolute localization with the further estimates that the settings ask for.

    Args:
        result: of the single-frame estimates.
        session: with validation frames where `needs_validation`.
        settings: of the task.
        search: as `prepared` returned it, run.
        queries: those of the search (n), all with positions.

    Raises:
        DataError: validation frames without positions, or too few.
    """
    known = search.known
    learns = needs_validation(settings) or (settings.refine == "relative" and session.validation is not None)
    validation = search_validation(session, session.validation, settings, known) if learns else None
    if settings.filter:
        columns, about, between = filtered(settings, search, queries, validation)
        result = _with_columns(result, "filtered", columns, {"filter": about})
        if settings.refine == "interpolate":
            about = {"step": about["step"], "kidnapping": about["kidnapping"], "radius": settings.place_radius}
            columns = estimate_columns("tracked", between, queries)
            result = _with_columns(result, "tracked", columns, {"tracking": about})
    if settings.refine == "relative":
        columns, about, refinement, poses = refined(settings, search, queries, validation, session.skipped)
        result = _with_columns(result, "refined", columns, {"refinement": about})
        result = replace(result, refinement=refinement)
        if settings.filter:
            step = result.about["estimates"]["filter"]["step"] or _STANDING
            columns, about = tracked(step, settings.filter_settings.kidnapping, queries, poses)
            result = _with_columns(result, "tracked", columns, {"tracking": about})
    if settings.refine == "interpolate":
        k, radius = settings.neighbours, settings.place_radius
        found = interpolate_poses(search.retrieval, known.frames, k, radius, search.headings)
        columns = estimate_columns("interpolated", found.xy, queries, found.theta)
        columns["interpolated_used"] = found.used
        result = _with_columns(result, "interpolated", columns, {"interpolation": {"neighbours": k, "radius": radius}})
        result = replace(result, refinement=Refinement("interpolate", k, radius, map_digest=known.digest))
    if settings.error_model and validation is not None:
        model, about = learned_errors(settings, known, validation)
        expected = expected_errors(model, known, search)
        columns = {**result.tables["queries"], "error_m": expected, "lost": model.lost(expected)}
        judged = {**columns, "error": columns["refined_error"]} if model.of_poses else columns
        result = replace(
            result,
            parts={**result.parts, "calibration": calibration.measures_of(judged, settings.lost_above)},
            tables={**result.tables, "queries": columns},
            about={**result.about, "estimates": {**result.about.get("estimates", {}), "error_model": about}},
            error_model=model,
        )
    return result


def filtered(
    settings: Estimates, search: Search, queries: FrameTable, validation: Validation | None
) -> tuple[Columns, dict[str, Any], NDArray[np.float64]]:
    """Follow the robot through the queries of each sequence.

    Returns:
        The columns, what the filter ran with, and positions (n, 2) between map frames.
    """
    known = search.known
    temperature, kidnapping = settings.filter_settings.temperature, settings.filter_settings.kidnapping
    if temperature is None:
        temperature = temperature_of_map(known)
    tuned = None
    if validation is not None and settings.filter_tune:
        frames = validation.frames
        motion = MotionModel.learn(known.frames, interval=_interval(frames))
        best = tune_filter(motion, validation.search.distances, frames.xy, frames.sequence, temperature)[0]
        temperature, kidnapping = best.temperature, best.kidnapping
        tuned = {"queries": len(frames), "error": best.error}
    motion = MotionModel.learn(known.frames, interval=_interval(queries))
    track = SequenceFilter(motion, temperature, kidnapping).run(
        search.distances, queries.sequence, settings.place_radius
    )
    assert track.xy is not None
    columns = {
        **estimate_columns("filtered", known.frames.xy[track.frame], queries),
        "filtered_match": track.frame,
        "filtered_probability": track.probability,
        "filtered_spread": track.spread,
    }
    about = {
        "temperature": float(temperature),
        "kidnapping": float(kidnapping),
        "step": motion.step,
        "spacing": motion.spacing,
        "tuned": tuned,
    }
    return columns, about, track.xy


def refined(
    settings: Estimates,
    search: Search,
    queries: FrameTable,
    validation: Validation | None,
    skipped: dict[str, str],
) -> tuple[Columns, dict[str, Any], Refinement, RefinedPoses]:
    """Return the columns of the poses by comparison, what they were made with, how the robot makes such, and the poses.

    How wide their ellipses are is learned from validation frames, where there are enough; it is noted where not.
    """
    poses, widening = search.refined, 1.0
    about: dict[str, Any] = {"neighbours": settings.neighbours}
    if validation is not None:
        try:
            about["widened"] = widening = validation.search.refined.widening(validation.frames.xy)
            about["validation"] = len(validation.frames)
            poses = poses.widened(widening)
        except DataError as error:
            skipped["ellipses"] = str(error)
    refinement = Refinement("relative", settings.neighbours, widening=widening, map_digest=search.known.digest)
    columns = {
        **estimate_columns("refined", poses.xy, queries, poses.theta),
        "refined_match": poses.frame,
        "refined_agreement": poses.agreement,
        "refined_inside": poses.inside(queries.xy),
    }
    return columns, about, refinement, poses


def tracked(step: float, kidnapping: float, queries: FrameTable, poses: RefinedPoses) -> tuple[Columns, dict[str, Any]]:
    """Follow the poses by comparison through the queries of each sequence; return columns, and what that ran with."""
    found = PoseFilter(step, kidnapping).run(poses, queries.sequence)
    columns = {
        **estimate_columns("tracked", found.xy, queries, found.theta),
        "tracked_match": found.frame,
        "tracked_agreement": found.agreement,
        "tracked_inside": found.inside(queries.xy),
    }
    return columns, {"step": step, "kidnapping": kidnapping}


def learned_errors(settings: Estimates, known: VisualMap, validation: Validation) -> tuple[ErrorModel, dict[str, Any]]:
    """Return the error model of a map, learned on the validation frames, and what it was learned from.

    Raises:
        DataError: too few validation frames.
    """
    if settings.refine == "relative":
        poses = validation.search.refined
        model = ErrorModel.fit_poses(poses, localization_error(poses.xy, validation.frames.xy))
    else:
        found, xy = validation.search.retrieval, known.frames.xy
        errors = localization_error(xy[found.indices[:, 0]], validation.frames.xy)
        model = ErrorModel.fit(found, xy, errors, radius=settings.place_radius, neighbours=MATCHES)
    about = {
        "file": "error_model.json",
        "sequences": list(validation.frames.rows_by("sequence")),
        "queries": len(validation.frames),
    }
    return replace(model, lost_above=settings.lost_above, map_digest=known.digest), about


def expected_errors(model: ErrorModel, known: VisualMap, search: Search) -> NDArray[np.float64]:
    """Return the expected errors of what was looked for (n,)."""
    return model.predict_poses(search.refined) if model.of_poses else model.predict(search.retrieval, known.frames.xy)


def estimate_columns(
    name: str, estimated_xy: ArrayLike, frames: FrameTable, headings: ArrayLike | None = None
) -> Columns:
    """Return the columns of one more estimate of each query.

    Args:
        name: what the columns' names begin with.
        estimated_xy: (n, 2).
        frames: the queries (n), all with positions.
        headings: estimated headings (n,), rad, NaN where unknown.

    Returns:
        `<name>_est_x`, `<name>_est_y`, `<name>_error`; with headings also `<name>_est_theta` and
        `<name>_heading_error` in degrees, NaN where one of the two headings is unknown.

    Raises:
        DataError: arrays that do not fit each other, or positions that are unknown.
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
    """Return the measures of one more estimate, from the columns of `queries.csv`.

    Returns:
        What `siamloc.evaluation.absolute.measures_of` returns, with the recall of the estimate itself (k = 1) alone.
        The excess is that over the nearest map frame, and negative where an estimate between frames is nearer.
        `inside` is the share of true positions inside the 90 % ellipse, where an estimate has one.
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
    poses: RefinedPoses | None = None,
) -> Columns:
    """Return where queries were found whose true poses are unknown: what `located.csv` holds.

    Args:
        known: m frames, all with positions.
        frames: the queries (n).
        found: their nearest map frames.
        headings: estimated headings (n,), rad.
        errors: the model of the expected error, with a threshold of being lost; of poses where those are given.
        poses: by comparison with map frames.

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
        columns |= {"refined_est_x": poses.xy[:, 0], "refined_est_y": poses.xy[:, 1], "refined_est_theta": poses.theta}
    if errors is not None:
        columns["error_m"] = errors.predict(found, known.frames.xy) if poses is None else errors.predict_poses(poses)
        columns["lost"] = errors.lost(columns["error_m"])
    return columns


def _interval(frames: FrameTable) -> float | None:
    """Return the median time between consecutive frames of one sequence; None where there are no times."""
    seconds = np.concatenate(
        [np.empty(0), *(np.diff(frames.time[rows]) for rows in frames.rows_by("sequence").values())]
    )
    seconds = seconds[np.isfinite(seconds) & (seconds > 0)]
    return float(np.median(seconds)) if len(seconds) else None


def _with_columns(result: Result, name: str, columns: Columns, about: dict[str, Any]) -> Result:
    """Return a result with one more estimate of each query: its columns, its measures and what made it."""
    table, held = {**result.tables["queries"], **columns}, result.parts["absolute"]
    measures = measures_of(table, name, held["radii"], held["map_frames"], held["unit"])
    return replace(
        result,
        parts={**result.parts, f"absolute_{name}": measures},
        tables={**result.tables, "queries": table},
        about={**result.about, "estimates": {**result.about.get("estimates", {}), **about}},
    )
