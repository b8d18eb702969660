"""`siamloc evaluate task=hierarchical`: a coarse layer says in which nodes to look, the map where in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig

from analytic import Description, Descriptor
from siamloc.cli.coarse import Coarse, coarse_descriptor, coarse_map, rank
from siamloc.cli.compose import plain
from siamloc.cli.headings import heading_descriptor, with_headings
from siamloc.cli.mapping import layer_over
from siamloc.cli.searching import check_apart, headings_by, lacking, parts_of, saved_map
from siamloc.cli.steps import Roles, build_map, finished_run, label_of, make_descriptor
from siamloc.cli.tables import print_hierarchical
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.absolute import neighbours
from siamloc.evaluation.beside import located_columns
from siamloc.evaluation.columns import Columns, room_names
from siamloc.evaluation.hierarchical import HierarchicalResult, evaluate_hierarchical
from siamloc.evaluation.results import write_results
from siamloc.maps import CoarseLayer, Retrieval, VisualMap, WithHeading, match
from siamloc.maps.hierarchy import HierarchicalRetrieval, HierarchicalSearch
from siamloc.maps.layers import BUILDS
from siamloc.maps.node_ranking import NodeRanking, rank_by_position
from siamloc.runs import Run


def measure(config: DictConfig) -> None:
    """Search hierarchically and in the whole map, write the files, print a table."""
    _check(config)
    run = finished_run(config)
    options = plain(config.descriptor)
    descriptor, label = make_descriptor(config, run, options), label_of(options)
    chosen = coarse_descriptor(config, run, descriptor, label)
    heading = heading_descriptor(config)
    known, roles = _map(config, run, descriptor, heading)
    queries = roles["query"]
    check_apart(roles.protocol.kind, known.frames, queries)
    coarse_known = known if chosen.descriptor is descriptor else coarse_map(config, run, chosen, known, roles)
    skipped: dict[str, str] = {}
    placed = known.frames.has_position
    if text := lacking(config, placed, "map frames have no position"):
        if not placed.any():
            raise DataError(f"{text}: localization needs a map with positions, add columns x and y to the data")
        skipped["hierarchical, map frames"] = text
        known, coarse_known = known.take(placed), coarse_known.take(placed)
    scored = queries.has_position
    if text := lacking(config, scored, "queries have no position"):
        skipped["hierarchical, queries"] = f"{text}; located all the same in located.csv"
    layer, _ = layer_over(config, run, coarse_known, chosen.descriptor, chosen.label)
    coarse = Coarse(chosen, coarse_known, layer)
    if text := missing_rooms(known.frames, queries):
        skipped["rooms"] = text
    found = _run(config, descriptor, known, coarse, roles, label, heading)
    vote = ["vote"] if config.task.coarse.by == "vote" else []
    name = "-".join(dict.fromkeys([label, chosen.label, label_of(plain(config.build)), *vote]))
    folder = run.evaluation(f"hierarchical-{name}")
    result = _evaluated(config, known, layer, queries.take(scored), found, scored) if scored.any() else None
    _write(config, folder, descriptor, coarse, roles, result, _unscored(known, queries, found, ~scored), skipped)
    if result is not None:
        print_hierarchical(name, result.measures())
        if config.task.plots:
            from siamloc.report.draw import save_all

            for path in save_all(folder):
                print(f"picture: {path}")
    for what, reason in skipped.items():
        print(f"{what}: {reason}")
    table = "queries.csv" if result is not None else "located.csv"
    print(f"results: {folder / 'results.json'}, one row per query in {folder / table}")


def missing_rooms(known: FrameTable, queries: FrameTable) -> str:
    """Return which rooms of the queries the map lacks and what to do about it; nothing if it has all."""
    in_map, rooms = room_names(known, queries)
    missing = sorted(set(rooms.tolist()) - set(in_map.tolist()) - {""})
    if not missing:
        return ""
    count = int(np.isin(rooms, missing).sum())
    return (
        f"{count} of {len(rooms)} queries are in rooms that the map lacks ({', '.join(missing)}), and cannot be found "
        "there: add frames of these rooms to protocol.map, or choose others with protocol.query.rooms"
    )


@dataclass(frozen=True)
class _Found:
    """What became of each query: by both layers, by a perfect coarse layer, and in the whole map."""

    both: HierarchicalRetrieval
    perfect: HierarchicalRetrieval | None  # of the queries with positions alone
    whole: Retrieval
    headings: NDArray[np.float64] | None


def _check(config: DictConfig) -> None:
    """Make sure that there is a coarse layer to search.

    Raises:
        ConfigError: there is none, or its keys are missing.
    """
    if "coarse" not in config.task:
        raise ConfigError("hierarchical localization has settings of its own: choose it with task=hierarchical")
    if config.build.name == "none":
        raise ConfigError(f"task=hierarchical searches a coarse layer first: choose one with build={'|'.join(BUILDS)}")


def _map(config: DictConfig, run: Run, descriptor: Descriptor, heading: Descriptor | None) -> tuple[VisualMap, Roles]:
    known = saved_map(config, run, descriptor)
    if known is None:
        roles = Roles(config, ("map", "query"))
        return build_map(config, descriptor, roles.library, roles["map"], "describing the map", heading), roles
    with_headings(known, heading)  # one that does not fit is an error before any work
    return known, Roles(config, ("query",), known.frames)


def _run(
    config: DictConfig,
    descriptor: Descriptor,
    known: VisualMap,
    coarse: Coarse,
    roles: Roles,
    label: str,
    heading: Descriptor | None,
) -> _Found:
    """Look for all queries, batch by batch where the descriptions are large."""
    queries, scored = roles["query"], roles["query"].has_position
    rankings = None
    other = coarse.described
    if other.descriptor is not descriptor:
        parts = parts_of(other.descriptor, roles.library, queries, f"describing the queries, {other.label}")
        rankings = NodeRanking.concatenate([rank(config, coarse, part) for part in parts])
    search = HierarchicalSearch(known, coarse.layer, descriptor)
    k = neighbours(list(config.task.ks), len(known))
    seeing = descriptor if heading is None else WithHeading(descriptor, heading)
    turning = with_headings(known, heading)
    both, perfect, whole, turned, start = [], [], [], [], 0
    for seen in parts_of(seeing, roles.library, queries, f"describing the queries, {label}"):
        part = seen if heading is None else Description(seen.position)
        rows = np.arange(start, start + len(part))
        ranking = rank(config, coarse, part) if rankings is None else rankings.take(rows)
        both.append(search.search(part, ranking, k))
        whole.append(match(known, part, descriptor, 1))
        turned.append(headings_by(turning, seen, seeing, both[-1].found))
        inside = np.flatnonzero(scored[rows])
        if len(inside):
            true = rank_by_position(queries.xy[rows[inside]], known.frames.xy, coarse.layer.labels)
            perfect.append(search.search(part.take(inside), true, 1))
        start += len(part)
    headings = np.concatenate(turned)[:, 0]
    return _Found(
        HierarchicalRetrieval.concatenate(both),
        HierarchicalRetrieval.concatenate(perfect) if perfect else None,
        Retrieval.concatenate(whole),
        headings if np.isfinite(headings).any() else None,
    )


def _evaluated(
    config: DictConfig,
    known: VisualMap,
    layer: CoarseLayer,
    queries: FrameTable,
    found: _Found,
    scored: NDArray[np.bool_],
) -> HierarchicalResult:
    """Return what became of the queries with positions."""
    assert found.perfect is not None
    return evaluate_hierarchical(
        known,
        layer,
        queries,
        found.both.take(scored),
        found.perfect,
        found.whole.take(scored),
        list(config.task.radii),
        list(config.task.ks),
        None if found.headings is None else found.headings[scored],
    )


def _unscored(known: VisualMap, queries: FrameTable, found: _Found, rows: NDArray[np.bool_]) -> Columns | None:
    if not rows.any():
        return None
    headings = None if found.headings is None else found.headings[rows]
    columns = located_columns(known, queries.take(rows), found.both.found.take(rows), headings)
    return {**columns, "node": found.both.node[rows], "comparisons": found.both.compared[rows]}


def _write(
    config: DictConfig,
    folder: Path,
    descriptor: Descriptor,
    coarse: Coarse,
    roles: Roles,
    result: HierarchicalResult | None,
    located: Columns | None,
    skipped: dict[str, str],
) -> None:
    tables = {} if located is None else {"located": located}
    denominators: dict[str, Any] = {"queries": 0, "nodes": len(coarse.layer)}
    if result is not None:
        tables |= {"map": result.map_columns, "nodes": result.node_columns}
        denominators |= result.denominators()
    write_results(
        folder,
        {
            "command": "evaluate",
            "protocol": roles.protocol.kind,
            "descriptor": descriptor.identity,
            "coarse_descriptor": coarse.described.descriptor.identity,
            "layer": coarse.layer.made,
            "config": plain(config),
            "measures": {} if result is None else {"hierarchical": result.measures()},
            "denominators": denominators,
            "skipped": skipped,
        },
        None if result is None else result.columns,
        tables,
    )
