"""`siamloc evaluate`: measure localization and room retrieval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli import buildings, hierarchical, mapping, robustness
from siamloc.cli.baselines import baseline_descriptors
from siamloc.cli.compose import plain
from siamloc.cli.estimates import (
    MATCHES,
    check_asked,
    check_validation,
    estimate,
    learned_errors,
    needs_validation,
    prepare_search,
)
from siamloc.cli.evaluation import Evaluation, write
from siamloc.cli.headings import heading_descriptor, with_headings
from siamloc.cli.searching import Search, Vectors, check_apart, lacking, run_searches, saved_map
from siamloc.cli.steps import Roles, build_map, finished_run, label_of, make_descriptor
from siamloc.cli.tables import print_calibration, print_summary
from siamloc.data.frames import FrameTable
from siamloc.data.pairs import PairSampler
from siamloc.errors import ConfigError, DataError, SiamlocError, hint
from siamloc.evaluation.absolute import evaluate_absolute, neighbours
from siamloc.evaluation.beside import located_columns
from siamloc.evaluation.room_retrieval import PairResult, evaluate_pairs, evaluate_rooms
from siamloc.maps import VisualMap, WithHeading

TASKS = ("absolute", "room_retrieval", "hierarchical")


def main(config: DictConfig) -> None:
    """Measure the tasks that are asked for; each kind of result has a folder of its own."""
    names = list(config.task.names)
    check_asked(config)
    if names == ["mapping"]:
        mapping.measure(config)
        return
    if names == ["robustness"]:
        robustness.measure(config)
        return
    if names == ["buildings"]:
        buildings.measure(config)
        return
    for name in names:
        if name not in TASKS:
            raise ConfigError(f"unknown task {name!r}: {hint(name, TASKS)}")
    if "hierarchical" in names:
        hierarchical.measure(config)
    if set(names) != {"hierarchical"}:
        _measure(config)


def _measure(config: DictConfig) -> None:
    """Evaluate a descriptor and its baselines, write the files, print a table."""
    run = finished_run(config)
    options = plain(config.descriptor)
    descriptor = make_descriptor(config, run, options)
    skipped: dict[str, str] = {}
    label = label_of(options)
    others = baseline_descriptors(config, run, label, skipped)
    heading = heading_descriptor(config)
    known = saved_map(config, run, descriptor)
    if known is not None:
        known = with_headings(known, heading)
    validated = needs_validation(config)
    wanted = ("query", "validation") if validated else ("query",)
    if known is not None:
        roles = Roles(config, wanted, known.frames)
        map_frames = roles["known"]
    else:
        roles = Roles(config, ("map", *wanted))
        map_frames = roles["map"]
        built = build_map(config, descriptor, roles.library, map_frames, "describing the map", heading)
        known = with_headings(built, heading)
    check_apart(roles.protocol.kind, known.frames, roles["query"])
    if validated:
        check_validation(known.frames, roles["validation"])
    main_result = _evaluate(config, descriptor, known, roles, label, alone=False, heading=heading)
    main_result.skipped.update(skipped)
    # Where no query can be scored there is nothing that a baseline could stand beside.
    baselines = {
        name: _evaluate(config, other, _map_like(config, other, map_frames, roles, name), roles, name)
        for name, other in others.items()
        if main_result.scored
    }
    folder = run.evaluation(label)
    measures = write(config, folder, descriptor, main_result, baselines, roles.protocol.kind)
    _print(label, measures, main_result, known.frames, roles["query"])
    if config.task.plots:
        from siamloc.report.draw import save_all

        for path in save_all(folder):
            print(f"picture: {path}")
    table = "queries.csv" if main_result.absolute else "rooms.csv" if main_result.rooms else "located.csv"
    print(f"results: {folder / 'results.json'}, one row per query in {folder / table}")


def _print(label: str, measures: Mapping[str, Any], result: Evaluation, known: FrameTable, queries: FrameTable) -> None:
    """Print the tables, what was left out, and what would help."""
    own = measures["measures"]
    if own:
        rows = {label: own}
        for name, sign in (("filtered", "filter"), ("interpolated", "interpolation")):
            if f"absolute_{name}" in own:
                rows[f"{label} + {sign}"] = {"absolute": own[f"absolute_{name}"]}
        print_summary({**rows, **measures["baselines"]})
    if "calibration" in own:
        print_calibration(own["calibration"], own["absolute"]["unit"])
    for name, reason in result.skipped.items():
        print(f"{name} left out: {reason}")
    if result.located is not None:
        print(f"located all the same, without a score: {len(result.located['path'])} queries, in located.csv")
    if result.rooms is not None and (text := hierarchical.missing_rooms(known, queries)):
        print(text)


def _map_like(config: DictConfig, descriptor: Descriptor, frames: FrameTable, roles: Roles, name: str) -> VisualMap:
    return build_map(config, descriptor, roles.library, frames, f"describing the map, {name}")


def _evaluate(
    config: DictConfig,
    descriptor: Descriptor,
    known: VisualMap,
    roles: Roles,
    name: str,
    alone: bool = True,
    heading: Descriptor | None = None,
) -> Evaluation:
    """Measure one descriptor; with the estimates beside the single-frame one unless that is wanted alone."""
    result = Evaluation()
    queries = roles["query"]
    k = neighbours(list(config.task.ks), len(known))
    searches = {
        task: search
        for task, what, count in (("absolute", "position", k), ("room_retrieval", "room label", 1))
        if task in config.task.names and (search := _search(config, what, task, known, queries, count, result))
    }
    if "absolute" in searches and not alone:
        searches["absolute"] = prepare_search(config, searches["absolute"])
    placed = known.frames.has_position
    bare = np.flatnonzero(~queries.has_position)
    if len(bare) and placed.any() and not alone:
        matches = MATCHES if config.task.error_model else 1
        searches["located"] = Search(known if placed.all() else known.take(placed), bare, matches)
    if not searches:
        raise DataError(f"nothing could be measured: {'; '.join(result.skipped.values())}")
    both = descriptor if heading is None else WithHeading(descriptor, heading)
    vectors = run_searches(both, roles.library, queries, searches, f"describing the queries, {name}")
    if "absolute" in searches:
        search = searches["absolute"]
        radii, ks = list(config.task.radii), list(config.task.ks)
        placed_queries = queries.take(search.rows)
        headings = None if search.headings is None else search.headings[:, 0]
        result.absolute = evaluate_absolute(search.known, None, placed_queries, radii, ks, search.retrieval, headings)
        if not alone:
            added = estimate(config, descriptor, roles, search, placed_queries, result.absolute)
            result.absolute, result.errors = added.result, added.model
            result.further, result.details = added.measures, added.details
    if "located" in searches:
        search = searches["located"]
        headings = None if search.headings is None else search.headings[:, 0]
        if config.task.error_model and result.errors is None:
            result.errors, result.details["error_model"] = learned_errors(config, descriptor, roles, search.known)
        bare_queries = queries.take(bare)
        result.located = located_columns(search.known, bare_queries, search.retrieval, headings, result.errors)
    if "room_retrieval" in searches:
        search = searches["room_retrieval"]
        labelled = queries.take(search.rows)
        result.rooms = evaluate_rooms(search.known, None, labelled, search.retrieval)
        if vectors is not None:
            result.pairs = _pairs(config, descriptor, vectors[search.rows], labelled, result.skipped)
    return result


def _search(
    config: DictConfig,
    what: str,
    task: str,
    known: VisualMap,
    queries: FrameTable,
    k: int,
    result: Evaluation,
) -> Search | None:
    """Return the search among the frames that have what a task needs, and note how many do not."""
    in_map, in_queries = (
        table.has_position if what == "position" else table.room != "" for table in (known.frames, queries)
    )
    for where, has in (("queries", in_queries), ("map frames", in_map)):
        text = lacking(config, has, f"{where} have no {what}")
        if not has.any():
            result.skipped[task] = f"{text}: add {'x and y' if what == 'position' else 'rooms'} to the data"
            return None
        if text:
            result.skipped[f"{task}, {where}"] = text
    return Search(known if in_map.all() else known.take(in_map), np.flatnonzero(in_queries), k)


def _pairs(
    config: DictConfig,
    descriptor: Descriptor,
    vectors: Vectors,
    queries: FrameTable,
    skipped: dict[str, str],
) -> PairResult | None:
    margin = getattr(getattr(descriptor, "loss", None), "margin", None)
    if margin is None:
        skipped["room_pairs"] = f"{descriptor.name} has no margin to tell same from different rooms by"
        return None
    wanted = config.task.pairs
    try:
        sampler = PairSampler(queries, "room", wanted.same_room_share, wanted.count, seed=config.seed)
    except SiamlocError as error:
        skipped["room_pairs"] = str(error)
        return None
    pairs = sampler.epoch(0)
    one, other = queries.lighting[pairs.first], queries.lighting[pairs.second]
    first, second = np.where(one <= other, one, other), np.where(one <= other, other, one)
    lighting = np.where(first == second, first, np.char.add(np.char.add(first, " and "), second))
    labels = {"first": queries.path[pairs.first], "second": queries.path[pairs.second]}
    return evaluate_pairs(vectors[pairs.first], vectors[pairs.second], pairs.same, margin, 0.5, lighting, labels)
