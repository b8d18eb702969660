"""What absolute localization tells beside its single-frame estimate: filter, interpolation, error in metres."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli.searching import Search, lacking, run_searches, shared_with
from siamloc.cli.steps import Roles
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import beside, calibration
from siamloc.evaluation.absolute import AbsoluteResult, neighbours
from siamloc.evaluation.error_model import ErrorModel
from siamloc.evaluation.interpolation import interpolate_poses
from siamloc.evaluation.metrics import localization_error
from siamloc.maps import VisualMap
from siamloc.maps.filter_learning import temperature_of_map, tune_filter
from siamloc.maps.motion import MotionModel
from siamloc.maps.sequence_filter import SequenceFilter
from siamloc.results import Columns

MATCHES = 20  # that an error model looks at


@dataclass
class Estimates:
    """Further estimates of the queries.

    Attributes:
        result: the result with their columns.
        measures: by name: "absolute_filtered", "absolute_interpolated", "calibration".
        details: what they were made with, as plain values.
        model: of the error, where it was learned.
    """

    result: AbsoluteResult
    measures: dict[str, Any] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    model: ErrorModel | None = None


def needs_validation(config: DictConfig) -> bool:
    """Say whether validation frames are needed to learn from."""
    return "absolute" in config.task.names and bool(
        config.task.error_model or (config.task.filter and config.task.filter_tune)
    )


def check_asked(config: DictConfig) -> None:
    """Make sure that what is asked for beside the single-frame estimate has one to stand beside.

    Raises:
        ConfigError: it has not.
    """
    asked = [key for key in ("filter", "interpolate", "error_model") if config.task.get(key)]
    if asked and "absolute" not in config.task.names:
        raise ConfigError(
            f"task.{asked[0]} stands beside absolute localization, which {', '.join(config.task.names)} leaves out: "
            f"use task=absolute, or leave task.{asked[0]} out"
        )
    if config.task.get("filter_tune") and not config.task.filter:
        raise ConfigError("task.filter_tune=true chooses the settings of the sequence filter: set task.filter=true too")


def check_validation(known: FrameTable, validation: FrameTable) -> None:
    """Make sure that the validation frames come from another run than the map.

    Raises:
        ConfigError: they do not.
    """
    if what := shared_with(known, validation):
        raise ConfigError(
            f"{what} is in the map and in protocol.validation, so that nothing could be learned of the errors on "
            "another day: validate on another sequence"
        )


def prepare_search(config: DictConfig, search: Search) -> Search:
    """Return a search with all that the further estimates need."""
    interpolated = config.task.interpolate or 0
    wanted = max(search.k, interpolated, MATCHES if config.task.error_model else 0)
    return replace(
        search,
        k=min(wanted, len(search.known)),
        headings_of=max(1, min(interpolated, len(search.known))),
        with_distances=bool(config.task.filter),
    )


def estimate(
    config: DictConfig,
    descriptor: Descriptor,
    roles: Roles,
    search: Search,
    queries: FrameTable,
    result: AbsoluteResult,
) -> Estimates:
    """Return the estimates that the configuration asks for.

    Args:
        config: the configuration.
        descriptor: what made the map.
        roles: with "validation" where `needs_validation`.
        search: as `prepare_search` returned it, run.
        queries: those of the search (n), all with positions.
        result: of the single-frame estimates.

    Raises:
        ConfigError: a parameter out of range.
        DataError: validation frames without positions, or too few.
    """
    added = Estimates(result)
    validation = None
    if needs_validation(config):
        validation = _search_validation(config, descriptor, roles, search.known)
    if config.task.filter:
        _filter(config, descriptor, search, queries, validation, added)
    if config.task.interpolate:
        _interpolate(config, search, queries, added)
    if config.task.error_model and validation is not None:
        _expect_errors(config, search, validation, added)
    return added


@dataclass(frozen=True)
class _Validation:
    frames: FrameTable
    search: Search


def _search_validation(config: DictConfig, descriptor: Descriptor, roles: Roles, known: VisualMap) -> _Validation:
    """Look for the validation frames in the map, as for queries."""
    frames = roles["validation"]
    has = frames.has_position
    if text := lacking(config, has, "validation frames have no position"):
        if not has.any():
            raise DataError(f"{text}: the error model and the filter's settings are learned from known positions")
        print(f"{text}: left out")
    k = min(max(neighbours(list(config.task.ks), len(known)), MATCHES), len(known))
    tuned = bool(config.task.filter and config.task.filter_tune)
    search = Search(known, np.flatnonzero(has), k, with_distances=tuned)
    run_searches(descriptor, roles.library, frames, {"validation": search}, "describing the validation frames")
    return _Validation(frames.take(has), search)


def _filter(
    config: DictConfig,
    descriptor: Descriptor,
    search: Search,
    queries: FrameTable,
    validation: _Validation | None,
    added: Estimates,
) -> None:
    """Follow the robot through the queries of each sequence."""
    settings, known = config.task.filter_settings, search.known
    temperature, kidnapping = settings.temperature, settings.kidnapping
    if temperature is None:
        temperature = temperature_of_map(known, descriptor)
    tuned = None
    if config.task.filter_tune and validation is not None:
        frames, tuning = validation.frames, validation.search
        motion = MotionModel.learn(known.frames, interval=_interval(frames))
        best = tune_filter(motion, tuning.distances, frames.xy, frames.sequence, temperature)[0]
        temperature, kidnapping = best.temperature, best.kidnapping
        tuned = {"queries": len(frames), "error": best.error}
    motion = MotionModel.learn(known.frames, interval=_interval(queries))
    track = SequenceFilter(motion, temperature, kidnapping).run(search.distances, queries.sequence)
    _add(
        added,
        "filtered",
        {
            **beside.estimate_columns("filtered", known.frames.xy[track.frame], queries),
            "filtered_match": track.frame,
            "filtered_probability": track.probability,
            "filtered_spread": track.spread,
        },
    )
    added.details["filter"] = {
        "temperature": float(temperature),
        "kidnapping": float(kidnapping),
        "step": motion.step,
        "spacing": motion.spacing,
        "tuned": tuned,
    }


def _interval(frames: FrameTable) -> float | None:
    """Return the median time between consecutive frames of one sequence; None where there are no times."""
    seconds = np.concatenate(
        [np.empty(0), *(np.diff(frames.time[rows]) for rows in frames.rows_by("sequence").values())]
    )
    seconds = seconds[np.isfinite(seconds) & (seconds > 0)]
    return float(np.median(seconds)) if len(seconds) else None


def _interpolate(config: DictConfig, search: Search, queries: FrameTable, added: Estimates) -> None:
    """Put the queries between the nearest frames of the map."""
    k, radius = config.task.interpolate, config.task.place_radius
    poses = interpolate_poses(search.retrieval, search.known.frames, k, radius, search.headings)
    columns = beside.estimate_columns("interpolated", poses.xy, queries, poses.theta)
    _add(added, "interpolated", {**columns, "interpolated_used": poses.used})
    added.details["interpolation"] = {"neighbours": k, "radius": radius}


def learned_errors(
    config: DictConfig, descriptor: Descriptor, roles: Roles, known: VisualMap
) -> tuple[ErrorModel, dict[str, Any]]:
    """Return the error model of a map, learned on the validation frames, and what it was learned from.

    Args:
        config: the configuration.
        descriptor: what made the map.
        roles: with "validation".
        known: map frames, all with positions.

    Raises:
        DataError: validation frames without positions, or too few.
    """
    return _learned(config, known, _search_validation(config, descriptor, roles, known))


def _learned(config: DictConfig, known: VisualMap, validation: _Validation) -> tuple[ErrorModel, dict[str, Any]]:
    found, xy = validation.search.retrieval, known.frames.xy
    errors = localization_error(xy[found.indices[:, 0]], validation.frames.xy)
    model = ErrorModel.fit(found, xy, errors, radius=config.task.place_radius, neighbours=MATCHES)
    details = {
        "file": "error_model.json",
        "sequences": list(validation.frames.rows_by("sequence")),
        "queries": len(validation.frames),
    }
    return replace(model, lost_above=float(config.task.lost_above), map_digest=known.digest), details


def _expect_errors(config: DictConfig, search: Search, validation: _Validation, added: Estimates) -> None:
    """Learn on the validation frames how far off an estimate is, and tell it of the queries."""
    added.model, added.details["error_model"] = _learned(config, search.known, validation)
    expected = added.model.predict(search.retrieval, search.known.frames.xy)
    _extend(added, {"error_m": expected, "lost": added.model.lost(expected)})
    added.measures["calibration"] = calibration.measures_of(added.result.columns, config.task.lost_above)


def _add(added: Estimates, name: str, columns: Columns) -> None:
    _extend(added, columns)
    result = added.result
    added.measures[f"absolute_{name}"] = beside.measures_of(
        result.columns, name, result.radii, len(result.map_columns["path"]), result.unit
    )


def _extend(added: Estimates, columns: Columns) -> None:
    added.result = replace(added.result, columns={**added.result.columns, **columns})
