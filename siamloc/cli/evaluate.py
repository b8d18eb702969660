"""`siamloc evaluate`: measure localization and room retrieval."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from analytic import Description, Descriptor
from siamloc.cli.compose import config_folder, plain
from siamloc.cli.mapping import measure
from siamloc.cli.steps import (
    Roles,
    build_map,
    described,
    finished_run,
    identity_of,
    label_of,
    make_descriptor,
    map_file,
)
from siamloc.cli.tables import print_summary
from siamloc.data.frames import FrameTable
from siamloc.data.pairs import PairSampler
from siamloc.errors import ConfigError, DataError, SiamlocError, nearest
from siamloc.maps import Retrieval, VisualMap, estimated_headings, match
from siamloc.runs import Run
from siamloc.tasks.absolute import AbsoluteResult, evaluate_absolute, neighbours
from siamloc.tasks.results import write_results
from siamloc.tasks.room_retrieval import PairResult, RoomResult, evaluate_pairs, evaluate_rooms

Vectors = np.ndarray[Any, np.dtype[np.float32]]
TASKS = ("absolute", "room_retrieval")


def main(config: DictConfig) -> None:
    """Evaluate a descriptor and its baselines, write the files, print a table."""
    if list(config.task.names) == ["mapping"]:
        measure(config)
        return
    for name in config.task.names:
        if name not in TASKS:
            raise ConfigError(f"unknown task {name!r}: {nearest(name, TASKS)}")
    run = finished_run(config)
    options = plain(config.descriptor)
    descriptor = make_descriptor(config, run, options)
    skipped: dict[str, str] = {}
    label = label_of(options)
    others = _baseline_descriptors(config, run, label, skipped)
    known = _saved_map(config, run, descriptor)
    if known is not None:
        roles = Roles(config, ("query",), known.frames)
        map_frames = roles["known"]
    else:
        roles = Roles(config, ("map", "query"))
        map_frames = roles["map"]
        known = build_map(config, descriptor, roles.library, map_frames, "describing the map")
    _check_apart(roles.protocol.kind, known.frames, roles["query"])
    main_result = _evaluate(config, descriptor, known, roles, label)
    main_result.skipped.update(skipped)
    baselines = {
        name: _evaluate(config, other, _map_like(config, other, map_frames, roles, name), roles, name)
        for name, other in others.items()
    }
    folder = run.evaluation(label)
    measures = _write(config, folder, descriptor, main_result, baselines, roles.protocol.kind)
    print_summary({label: measures["measures"], **measures["baselines"]})
    for name, reason in main_result.skipped.items():
        print(f"{name} left out: {reason}")
    if config.task.plots:
        from siamloc.report import plots

        for path in plots.draw_all(folder):
            print(f"picture: {path}")
    print(f"results: {folder / 'results.json'}, one row per query in {folder / 'queries.csv'}")


@dataclass
class Evaluation:
    """The results of one descriptor by task; what could not be measured, with the reason."""

    absolute: AbsoluteResult | None = None
    rooms: RoomResult | None = None
    pairs: PairResult | None = None
    skipped: dict[str, str] = field(default_factory=dict)

    def measures(self) -> dict[str, Any]:
        """Return the measures of what was measured."""
        parts = {"absolute": self.absolute, "room_retrieval": self.rooms, "room_pairs": self.pairs}
        return {name: part.measures() for name, part in parts.items() if part is not None}

    def tables(self, suffix: str = "") -> dict[str, dict[str, Any]]:
        """Return the columns of what was measured by table name."""
        parts = {"queries": self.absolute, "rooms": self.rooms, "pairs": self.pairs}
        return {name + suffix: part.columns for name, part in parts.items() if part is not None}


def _saved_map(config: DictConfig, run: Run, descriptor: Descriptor) -> VisualMap | None:
    """Return the map that `siamloc map` made for this descriptor, if there is one."""
    path = map_file(run, label_of(plain(config.descriptor)))
    if not path.is_file():
        return None
    known = VisualMap.load(path)
    known.check_describer(identity_of(config, descriptor))
    role = known.made.get("role")
    if role is not None and role != plain(config.protocol.map):
        raise ConfigError(
            f"{path} was made of other frames than protocol.map asks for now: run `siamloc map` again, with the "
            "protocol.map keys that are wanted"
        )
    return known


def _check_apart(kind: str, known: FrameTable, queries: FrameTable) -> None:
    """Make sure that no query comes from the map's own run, unless the protocol says so."""
    if kind == "same_run":
        return
    shared = sorted(set(known.sequence.tolist()) & set(queries.sequence.tolist()))
    copies = np.flatnonzero(np.isin(queries.path, known.path))
    if shared or len(copies):
        what = f"sequence {shared[0]!r}" if shared else f"image {queries.path[copies[0]]}"
        raise ConfigError(
            f"{what} is in the map and among the queries, so that the result would not be honest: query another "
            "sequence, or say protocol.kind=same_run"
        )


def _baseline_descriptors(config: DictConfig, run: Run, main: str, skipped: dict[str, str]) -> dict[str, Descriptor]:
    """Return the baselines by name; "untrained" is left out where there is no trained network to begin with."""
    folder = config_folder() / "descriptor"
    found: dict[str, Descriptor] = {}
    for name in config.task.baselines:
        path = folder / f"{name}.yaml"
        if not path.is_file():
            raise ConfigError(f"unknown baseline {name!r}: {nearest(name, [p.stem for p in folder.glob('*.yaml')])}")
        if name == main:
            continue
        if name in ("network", "untrained") and not run.record.is_file():
            skipped[f"baseline {name}"] = f"{run.folder} holds no trained network"
            continue
        found[name] = make_descriptor(config, run, plain(OmegaConf.load(path)))  # type: ignore[arg-type]
    return found


def _map_like(config: DictConfig, descriptor: Descriptor, frames: FrameTable, roles: Roles, name: str) -> VisualMap:
    return build_map(config, descriptor, roles.library, frames, f"describing the map, {name}")


def _evaluate(config: DictConfig, descriptor: Descriptor, known: VisualMap, roles: Roles, name: str) -> Evaluation:
    result = Evaluation()
    queries = roles["query"]
    k = neighbours(list(config.task.ks), len(known))
    searches = {
        task: search
        for task, what, count in (("absolute", "position", k), ("room_retrieval", "room label", 1))
        if task in config.task.names and (search := _search(config, what, task, known, queries, count, result))
    }
    if not searches:
        raise DataError(f"nothing could be measured: {'; '.join(result.skipped.values())}")
    vectors = _run_searches(descriptor, roles, searches, f"describing the queries, {name}")
    if "absolute" in searches:
        search = searches["absolute"]
        radii, ks = list(config.task.radii), list(config.task.ks)
        result.absolute = evaluate_absolute(
            search.known, None, queries.take(search.rows), radii, ks, search.retrieval, search.headings
        )
    if "room_retrieval" in searches:
        search = searches["room_retrieval"]
        labelled = queries.take(search.rows)
        result.rooms = evaluate_rooms(search.known, None, labelled, search.retrieval)
        if vectors is not None:
            result.pairs = _pairs(config, descriptor, vectors[search.rows], labelled, result.skipped)
    return result


@dataclass
class _Search:
    """Queries to be looked for in a map, and what was found so far.

    Attributes:
        known: map frames that have what the task needs.
        rows: of the queries that have it (n,), in order.
        k: neighbours wanted.
    """

    known: VisualMap
    rows: NDArray[np.int64]
    k: int
    found: list[Retrieval] = field(default_factory=list)
    turned: list[NDArray[np.float64] | None] = field(default_factory=list)

    @property
    def retrieval(self) -> Retrieval:
        return Retrieval(
            np.concatenate([part.indices for part in self.found]),
            np.concatenate([part.distances for part in self.found]),
        )

    @property
    def headings(self) -> NDArray[np.float64] | None:
        told = [part for part in self.turned if part is not None]
        return np.concatenate(told) if len(told) == len(self.turned) else None


def _run_searches(descriptor: Descriptor, roles: Roles, searches: dict[str, _Search], what: str) -> Vectors | None:
    """Describe the queries and look for them; return the position parts, or None for such as are not kept.

    The parts of descriptors that are compared after turning are large, so that only those of a batch are there at once.
    """
    parts: Iterable[Description] = described(descriptor, roles.library, roles["query"], what)
    if not descriptor.aligned:
        parts = [Description.concatenate(list(parts))]
    start, vectors = 0, []
    for part in parts:
        for search in searches.values():
            inside = search.rows[(search.rows >= start) & (search.rows < start + len(part))] - start
            queries = part if len(inside) == len(part) else part.take(inside)
            if len(queries):
                found = match(search.known, queries, descriptor, search.k)
                search.found.append(found)
                search.turned.append(estimated_headings(search.known, queries, descriptor, found))
        start += len(part)
        vectors.append(part.position)
        if descriptor.aligned:
            vectors.clear()
    return vectors[0] if vectors else None


def _search(
    config: DictConfig,
    what: str,
    task: str,
    known: VisualMap,
    queries: FrameTable,
    k: int,
    result: Evaluation,
) -> _Search | None:
    """Return the search among the frames that have what a task needs, and note how many do not."""
    in_map, in_queries = (
        table.has_position if what == "position" else table.room != "" for table in (known.frames, queries)
    )
    for where, has in (("queries", in_queries), ("map frames", in_map)):
        if has.all():
            continue
        text = f"{int((~has).sum())} of {len(has)} {where} have no {what}"
        if not has.any():
            result.skipped[task] = text
            return None
        if config.data.on_error == "raise":
            raise DataError(f"{text}: data.on_error=skip leaves them out")
        result.skipped[f"{task}, {where}"] = text
    return _Search(known if in_map.all() else known.take(in_map), np.flatnonzero(in_queries), k)


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
    first, second = queries.lighting[pairs.first], queries.lighting[pairs.second]
    lighting = np.where(first == second, first, np.char.add(np.char.add(first, " and "), second))
    labels = {"first": queries.path[pairs.first], "second": queries.path[pairs.second]}
    return evaluate_pairs(vectors[pairs.first], vectors[pairs.second], pairs.same, margin, 0.5, lighting, labels)


def _write(
    config: DictConfig,
    folder: Any,
    descriptor: Descriptor,
    result: Evaluation,
    baselines: dict[str, Evaluation],
    kind: str,
) -> dict[str, Any]:
    """Write the files and return the measures of the descriptor and of its baselines."""
    tables = result.tables()
    rows = tables.pop("queries", None)
    denominators: dict[str, Any] = {}
    if result.absolute is not None:
        for name, baseline in baselines.items():
            if baseline.absolute is not None:
                result.absolute = result.absolute.with_baseline(name, baseline.absolute)
        rows = result.absolute.columns
        tables["map"] = result.absolute.map_columns
        denominators = result.absolute.denominators()
    elif result.rooms is not None:
        denominators = {"queries": len(result.rooms)}
    if result.pairs is not None:
        denominators["pairs"] = len(result.pairs)
    for name, baseline in baselines.items():
        tables.update(baseline.tables(f"_{name}"))
    measures = {
        "measures": result.measures(),
        "baselines": {name: baseline.measures() for name, baseline in baselines.items()},
    }
    write_results(
        folder,
        {
            "command": "evaluate",
            "protocol": kind,
            "descriptor": descriptor.identity,
            "config": plain(config),
            **measures,
            "denominators": denominators,
            "skipped": result.skipped,
        },
        rows,
        tables,
    )
    return measures
