"""Estimates beyond the nearest map frame: filtered poses, poses between map frames, and expected errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from foundation.columns import Rows
from foundation.settings import Count, NotNegative, Positive, Probability, Settings
from siamloc.data.checks import wrong_headings
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.absolute import estimate_columns, estimate_measures, most_neighbours
from siamloc.evaluation.calibration import calibration_measures
from siamloc.evaluation.metrics import localization_error
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Search, Session
from siamloc.maps.comparing import comparison_of
from siamloc.maps.error_model import ErrorModel
from siamloc.maps.joining import RefinedPoses
from siamloc.maps.motion import motions
from siamloc.maps.pose_filter import PoseFilter
from siamloc.maps.refinement import Refinement, check_compares
from siamloc.maps.sequence_filter import MotionModel, SequenceFilter, steps_of, temperature_of_map, tune_filter
from siamloc.maps.visual_map import VisualMap
from siamloc.results import FURTHER, Columns
from siamloc.stopwatch import Stopwatch

MATCHES = 20  # nearest map frames from which an error model predicts
ESTIMATES = {"interpolate": "interpolated", "relative": "refined"}  # names of finer poses, by their method
_ELSEWHERE = 3.0  # place radii within which map frames are removed, so that a place and its view are off the map
_STANDING = 0.01  # step of a filter in a map whose frames are all in the same place


@dataclass(frozen=True)
class FilterSettings(Settings):
    """Settings of the sequence filter, which tracks the robot through the queries of a sequence.

    The filter is a discrete Bayes filter over the map frames; see `siamloc.maps.sequence_filter`.

    Attributes:
        temperature: T in exp(-d / T), the likelihood of a map frame at the descriptor distance d, in the unit of d; the
            smaller, the more a query's nearest frames count. Learned from the map if None.
        kidnapping: probability, from one query to the next, that the robot was carried to any place in the map.
    """

    WHERE = "task.filter_settings"

    temperature: Positive | None = None
    kidnapping: Probability = 1e-3


@dataclass(frozen=True)
class Estimates(Settings):
    """Which estimates are made of each query's position in addition to the nearest map frame's position.

    Attributes:
        filter: track the robot through each sequence, also by queries without a position, which are not scored; keeps
            the distances of all queries to all map frames. With `refine`, poses between map frames are tracked as well.
        filter_settings: temperature and probability of kidnapping of that filter.
        filter_tune: choose temperature and kidnapping on the validation frames.
        refine: a pose finer than the map: "interpolate" takes one between the nearest map frames, "relative" compares
            the query with each of them, with a network built with relative=True; "none" leaves it out. The ellipses of
            "relative" are learned from validation frames, if given.
        neighbours: number of nearest map frames used to refine a pose.
        error_model: predict the expected error of each query, learned on the validation frames: the error of the finer
            pose with `refine`, else the error of the nearest map frame's pose.
        lost_above: expected error above which a query counts as lost, in the unit of the positions.
        place_radius: map frames farther apart are different places, for interpolation and the error model.
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
class Learned:
    """What the estimates need to know, learned from the map and the validation frames.

    Attributes:
        validation: the validation frames, searched in the map; None if nothing is learned from them.
        refinement: the method for poses finer than the map, with the learned width of the ellipses; None for none.
        errors: the model that predicts the error of each query; None if it was not requested.
        about: the data from which the refinement and the error model were learned, as plain values.
    """

    validation: Validation | None
    refinement: Refinement | None
    errors: ErrorModel | None
    about: dict[str, Any]


@dataclass(frozen=True)
class Validation:
    """Validation frames, searched in the map like queries.

    Attributes:
        drive: all validation frames.
        search: the search for the n frames that have positions.
        elsewhere: a search for the same frames among distant map frames only, which imitates images of places that the
            map lacks; for validation frames with enough distant map frames. None if no frame has enough, or nothing
            needs this search.
        bare: the search for the frames without positions, through which the filter tracks the robot as well. None if
            there are none, or nothing needs this search.
    """

    drive: FrameTable
    search: Search
    elsewhere: Search | None = None
    bare: Search | None = None

    @property
    def frames(self) -> FrameTable:
        """The n validation frames that have positions."""
        return self.drive.take(self.search.rows)


@dataclass(frozen=True, eq=False)
class Tracked(Rows):
    """What the filters take of each query of a drive, with a position or without, in capture order.

    Attributes:
        row: rows of the queries (n,).
        distances: distances to all map frames (n, m).
        refined: refined poses; None unless requested.
    """

    row: NDArray[np.int64]
    distances: NDArray[np.float64]
    refined: RefinedPoses

    @classmethod
    def of(cls, frames: FrameTable, search: Search, bare: Search | None) -> Tracked:
        """Return the queries of two searches in one map; those of `bare` only on the drives of the other search.

        Args:
            frames: all queries, of which the searches have rows.
            search: the search for the queries with positions.
            bare: the search for those without; None if there is none.
        """
        parts = [cls(one.rows, one.found.distances, one.found.refined) for one in (search, bare) if one is not None]
        if len(parts) == 1:
            return parts[0]  # the distances are large
        whole = cls.concatenate(parts)
        order = np.argsort(whole.row)
        return whole.take(order[np.isin(frames.sequence[whole.row[order]], frames.sequence[search.rows])])


def search_validation(session: Session, frames: FrameTable | None, settings: Estimates, known: VisualMap) -> Validation:
    """Search for validation frames in the map.

    Raises:
        ConfigError: there are no validation frames.
        DataError: no validation frame has a position.
    """
    if frames is None:
        raise ConfigError(
            "the error model and the filter's settings are learned from validation frames: give validation=FRAMES "
            "(on the command line protocol.validation.sequences)"
        )
    has = frames.has_position
    remedy = ": errors, ellipses and the filter's settings are learned from known positions"
    session.leave_out(has, "validation frames have no position", "validation", remedy)
    k = min(max(MATCHES, settings.neighbours), len(known))
    finer, rows = refinement(settings, known), np.flatnonzero(has)
    search = Search(known, rows, k, refinement=finer, with_distances=settings.filter_tune)
    elsewhere, bare = None, None
    if settings.filter_tune and not has.all():
        bare = Search(known, np.flatnonzero(~has), 1, with_distances=True)
    if settings.error_model and comparison_of(known) is None:
        offsets = (known.frames.xy - xy for xy in frames.xy[search.rows])
        near = np.stack([np.hypot(*offset.T) <= _ELSEWHERE * settings.place_radius for offset in offsets])
        enough = (~near).sum(axis=1) >= k
        if enough.any():
            elsewhere = Search(known, search.rows[enough], k, excluded=near[enough])
    session.run(known, frames, filter(None, (search, elsewhere, bare)), "the validation frames", Stopwatch())
    return Validation(frames, search, elsewhere, bare)


def refinement(settings: Estimates, known: VisualMap) -> Refinement | None:
    """Return an untrained `Refinement`, which computes a query's pose from several map frames instead of the nearest.

    Returns:
        None if `settings.refine` is "none".

    Raises:
        ConfigError: `refine` is "relative", and the map's descriptor does not compare.
        DataError: `refine` is "relative", and the map has headings that cannot be right.
    """
    if settings.refine == "none":
        return None
    if settings.refine == "relative":
        for finding in wrong_headings(known.frames):
            raise DataError(f"task.refine=relative depends on the headings of the map: {finding}")
        check_compares(known)  # before the queries are described
    return Refinement(settings.refine, settings.neighbours, settings.place_radius, map_digest=known.digest)


def prepared(settings: Estimates, search: Search) -> Search:
    """Return a search with the distances and refined poses that the settings of `Estimates` need.

    Raises:
        ConfigError, DataError: as for `refinement`.
    """
    finer = refinement(settings, search.known)
    wanted = max(search.k, 0 if finer is None else finer.neighbours, MATCHES if settings.error_model else 0)
    k = most_neighbours(wanted, len(search.known), search.excluded)
    if finer is not None and finer.method == "interpolate":
        finer = replace(finer, neighbours=min(finer.neighbours, k))
    return replace(search, k=k, refinement=finer, with_distances=settings.filter)


def learn(session: Session, settings: Estimates, search: Search) -> Learned:
    """Learn the error model and the width of the ellipses of refined poses, as far as the settings need them.

    Args:
        session: a session, with validation frames if the settings need them.
        settings: settings of the task.
        search: a search that `prepared` returned.

    Raises:
        ConfigError: there are no validation frames.
        DataError: validation frames without positions, or too few.
    """
    known, finer, errors = search.known, search.refinement, None
    needed = settings.error_model or settings.filter_tune
    needed |= settings.refine == "relative" and session.validation is not None
    validation = search_validation(session, session.validation, settings, known) if needed else None
    about: dict[str, Any] = {}
    if finer is not None:
        learned: dict[str, Any] = {"neighbours": finer.neighbours}
        if finer.method == "interpolate":
            learned["radius"] = finer.radius
        elif validation is not None:
            try:
                finer = replace(finer, widening=validation.search.found.refined.widening(validation.frames.xy))
                learned |= {"widened": finer.widening, "validation": len(validation.frames)}
            except DataError as error:
                session.skipped["ellipses"] = str(error)
        about[FURTHER[ESTIMATES[finer.method]]] = learned
    if settings.error_model and validation is not None:
        errors, about["error_model"] = learned_errors(settings, known, validation, session.skipped)
    return Learned(validation, finer, errors, about)


def with_estimates(
    result: Result, settings: Estimates, search: Search, frames: FrameTable, learned: Learned, bare: Search | None
) -> Result:
    """Return a result of absolute localization with the further estimates that the settings request.

    Args:
        result: result of the single-frame estimates.
        settings: settings of the task.
        search: a search that `prepared` returned and that has been run, for the n queries with positions.
        frames: all queries.
        learned: what was learned for the map.
        bare: such a search for the queries without positions; None if there are none, or they cannot be searched.
    """
    finer, model, made = learned.refinement, learned.errors, dict(learned.about)
    queries = frames.take(search.rows)
    if settings.filter:
        whole = Tracked.of(frames, search, bare)
        drive = frames.take(whole.row)
        columns, made["filter"], between = filtered(settings, search.known, drive, whole, learned.validation)
        result = _with_columns(result, "filtered", columns)
        if settings.refine == "interpolate":
            steps = {key: made["filter"][key] for key in ("step", "kidnapping")} | _by_wheels(drive)
            made["tracking"] = {**steps, "radius": settings.place_radius}
            result = _with_columns(result, "tracked", estimate_columns("tracked", between, queries))
    if finer is not None:
        poses = search.found.refined.widened(finer.widening)
        result = _with_columns(result, ESTIMATES[finer.method], refined(finer, poses, queries))
        if settings.filter and finer.method == "relative":
            step, kidnapping = made["filter"]["step"], settings.filter_settings.kidnapping
            poses = whole.refined.widened(finer.widening)
            columns, made["tracking"] = tracked(step, kidnapping, drive, poses)
            result = _with_columns(result, "tracked", columns)
    if model is not None:
        expected, lost = model.judged(
            search.found.retrieval, search.known.frames.xy, search.found.refined if model.of_poses else None
        )
        assert lost is not None  # the model has learned the threshold
        columns = {**result.tables["queries"], "error_m": expected, "lost": lost}
        judged = f"{ESTIMATES[model.refine]}_error" if model.refine in ESTIMATES else "error"
        calibrated = calibration_measures({**columns, "error": columns[judged]}, settings.lost_above)
        result = result.with_part("calibration", calibrated, columns)
    about = {**result.about, "estimates": made} if made else result.about
    return replace(result, about=about, error_model=model, refinement=finer)


def filtered(
    settings: Estimates, known: VisualMap, drive: FrameTable, whole: Tracked, validation: Validation | None
) -> tuple[Columns, dict[str, Any], NDArray[np.float64]]:
    """Track the robot through the queries of each sequence, by their odometry where they have any.

    Args:
        settings: gives the temperature and the probability of kidnapping, or asks to choose them.
        known: the map.
        drive: the queries through which the robot is tracked, of which n have positions.
        whole: their distances.
        validation: the frames on which temperature and kidnapping are chosen with `filter_tune`; else None.

    Returns:
        The columns of the n queries with positions, the filter's parameters, and positions (n, 2) between map frames.
    """
    temperature, kidnapping = settings.filter_settings.temperature, settings.filter_settings.kidnapping
    if temperature is None:
        temperature = temperature_of_map(known)
    tuned = None
    if validation is not None and settings.filter_tune:
        seen = Tracked.of(validation.drive, validation.search, validation.bare)
        frames = validation.drive.take(seen.row)
        motion = MotionModel.learn(known.frames, interval=_interval(frames))
        given = seen.distances, frames.xy, frames.sequence
        best = tune_filter(motion, *given, temperature, moves=motions(frames))[0]
        temperature, kidnapping = best.temperature, best.kidnapping
        tuned = {"queries": len(validation.frames), "error": best.error}
    motion = MotionModel.learn(known.frames, interval=_interval(drive))
    track = SequenceFilter(motion, temperature, kidnapping).run(
        whole.distances, drive.sequence, settings.place_radius, motions(drive)
    )
    scored = drive.has_position
    track = track.take(scored)
    assert track.xy is not None
    columns = {
        **estimate_columns("filtered", known.frames.xy[track.frame], drive.take(scored)),
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
        **_by_wheels(drive),
    }
    return columns, about, track.xy


def refined(refinement: Refinement, poses: RefinedPoses, queries: FrameTable) -> Columns:
    """Return the columns of `queries.csv` with poses between map frames and, for "relative", their agreement."""
    columns = estimate_columns(ESTIMATES[refinement.method], poses.xy, queries, poses.theta)
    if refinement.method == "interpolate":
        used = np.rint(poses.agreement * refinement.neighbours)
        return {**columns, "interpolated_used": used.astype(np.int64)}
    agreement, inside = poses.agreement, poses.inside(queries.xy)
    return {**columns, "refined_match": poses.frame, "refined_agreement": agreement, "refined_inside": inside}


def tracked(step: float, kidnapping: float, drive: FrameTable, poses: RefinedPoses) -> tuple[Columns, dict[str, Any]]:
    """Filter refined poses along the queries of each sequence, by their odometry where they have any.

    Returns the columns of the queries with positions, and the filter's parameters.

    Args:
        step: distance the robot moves between two queries, learned from the map; the median step of the query poses if
            that is larger.
        kidnapping: probability, from one query to the next, that the robot was carried elsewhere, as for `PoseFilter`.
        drive: the n queries, whose sequences are filtered one by one.
        poses: refined poses of the queries (n).
    """
    gone = [np.hypot(*np.diff(poses.xy[rows], axis=0).T) for rows in drive.rows_by("sequence").values()]
    usual = float(np.median(steps)) if len(steps := np.concatenate([np.empty(0), *gone])) else 0.0
    step = max(step, usual, _STANDING)
    scored = drive.has_position
    found = PoseFilter(step, kidnapping).run(poses, drive.sequence, motions(drive)).take(scored)
    queries = drive.take(scored)
    columns = {
        **estimate_columns("tracked", found.xy, queries, found.theta),
        "tracked_match": found.frame,
        "tracked_agreement": found.agreement,
        "tracked_inside": found.inside(queries.xy),
    }
    return columns, {"step": step, "kidnapping": kidnapping, **_by_wheels(drive)}


def learned_errors(
    settings: Estimates, known: VisualMap, validation: Validation, skipped: dict[str, str]
) -> tuple[ErrorModel, dict[str, Any]]:
    """Return the error model of a map, learned on the validation frames, and a summary of the data used.

    If there are too few frames to learn the threshold for foreign queries, `skipped` gets the reason.

    Raises:
        DataError: too few validation frames.
    """
    found, xy = validation.search.found.retrieval, known.frames.xy
    if settings.refine == "none":
        estimated = xy[found.indices[:, 0]]
    else:
        estimated = validation.search.found.refined.xy
    errors = localization_error(estimated, validation.frames.xy)
    if settings.refine == "relative":
        model = ErrorModel.fit_poses(validation.search.found.refined, errors)
    else:
        model = ErrorModel.fit(found, xy, errors, radius=settings.place_radius, neighbours=MATCHES)
    about = {
        "file": "error_model.json",
        "sequences": list(validation.frames.rows_by("sequence")),
        "queries": len(validation.frames),
    }
    model = replace(model, refine=settings.refine, lost_above=settings.lost_above, map_digest=known.digest)
    right = np.flatnonzero(errors <= settings.lost_above)
    other = None if validation.elsewhere is None else validation.elsewhere.found.retrieval
    try:
        model = model.with_foreign(found.take(right), xy, other)
    except DataError as error:
        skipped["foreign"] = str(error)
    return model, {**about, "foreign_above": model.foreign_above}


def _by_wheels(queries: FrameTable) -> dict[str, int]:
    """Return the number of moves known from odometry, if there are any, for what a result says about a filter."""
    known = int(np.isfinite(motions(queries)).all(axis=1).sum())
    return {"odometry": known} if known else {}


def _interval(frames: FrameTable) -> float | None:
    """Return the median time between consecutive frames of a sequence; None if there are no times."""
    _, seconds = steps_of(frames)
    seconds = seconds[np.isfinite(seconds) & (seconds > 0)]
    return float(np.median(seconds)) if len(seconds) else None


def _with_columns(result: Result, name: str, columns: Columns) -> Result:
    """Return a result with a further estimate of each query: its columns and measures."""
    table = {**result.tables["queries"], **columns}
    return result.with_part(f"absolute_{name}", estimate_measures(table, name, result.parts["absolute"]), table)
