"""Robustness on the command line: queries disturbed by noise, bars, turns and effects, in a clean map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli.baselines import baseline_descriptors
from siamloc.cli.compose import plain
from siamloc.cli.searching import check_apart, saved_map
from siamloc.cli.steps import Roles, build_map, finished_run, label_of, make_descriptor, usable
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.evaluation.columns import Columns
from siamloc.evaluation.results import write_results
from siamloc.evaluation.robustness import Disturbance, answers, concatenated, curves, locate_disturbed, measures
from siamloc.maps import Retrieval, VisualMap, match
from siamloc.progress import track


def measure(config: DictConfig) -> None:
    """Measure the configured descriptor and its baselines under every disturbance; write the files, print a table."""
    options = plain(config.task.robustness)
    disturbances, every = _disturbances(config, options), options["every"]
    run = finished_run(config)
    chosen = plain(config.descriptor)
    descriptor, label = make_descriptor(config, run, chosen), label_of(chosen)
    skipped: dict[str, str] = {}
    others = baseline_descriptors(config, run, label, skipped)
    known = saved_map(config, run, descriptor)
    roles = Roles(config, ("map", "query")) if known is None else Roles(config, ("query",), known.frames)
    map_frames = roles["map" if known is None else "known"]
    check_apart(roles.protocol.kind, map_frames, roles["query"])
    queries = usable(config, roles["query"], roles["query"].has_position, "of the queries have no position (x, y)")
    rows = np.arange(0, len(queries), every)
    parts, tables = [], []
    for name, other in {label: descriptor, **others}.items():
        own = known if known is not None and name == label else None
        own = own or build_map(config, other, roles.library, map_frames, f"describing the map, {name}")
        own = _placed(config, own)
        parts.append(_answers(config, other, own, roles, queries, rows, disturbances, name))
        tables.append(curves(parts[-1], options["radius"], len(own)))
    columns, table = concatenated(parts), concatenated(tables)
    found = measures(table, disturbances, config.data.unit, every)
    folder = run.evaluation(f"robustness-{label}")
    write_results(
        folder,
        {
            "command": "evaluate",
            "protocol": roles.protocol.kind,
            "descriptor": descriptor.identity,
            "config": plain(config),
            "measures": {"robustness": found},
            "denominators": {
                "queries": len(rows),
                "queries_of_the_role": len(queries),
                "map_frames": found["map_frames"],
            },
            "skipped": skipped,
        },
        tables={"robustness": table, "answers": columns},
    )
    _print(found)
    for name, reason in skipped.items():
        print(f"{name} left out: {reason}")
    if config.task.plots:
        from siamloc.report.draw import save_all

        for path in save_all(folder):
            print(f"picture: {path}")
    print(f"results: {folder / 'results.json'}, one row per method, disturbance and level in robustness.csv there")


def _disturbances(config: DictConfig, options: Mapping[str, Any]) -> list[Disturbance]:
    from analytic.disturb import NOISE_LEVELS, OCCLUSION_LEVELS

    every, radius = options["every"], options["radius"]
    if isinstance(every, bool) or not isinstance(every, int) or every < 1:
        raise ConfigError(f"task.robustness.every must be a whole number from 1, got {every!r}")
    if isinstance(radius, bool) or not isinstance(radius, (int, float)) or not radius >= 0:
        raise ConfigError(f"task.robustness.radius must be a number from 0, got {radius!r}")
    wanted = [("noise", "noise", NOISE_LEVELS), ("occlusion", "occlusion", OCCLUSION_LEVELS), ("turn", "turn", ())]
    wanted += [(str(name), "effect", options["strengths"]) for name in _list(options, "effects")]
    names = [name for name, _, _ in wanted]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"task.robustness.effects names {twice!r} twice, or a disturbance that is there already")
    made = []
    for name, kind, published in wanted:
        levels = options["strengths" if kind == "effect" else name]
        levels = list(published) if levels is None else _list(options, "strengths" if kind == "effect" else name)
        if levels or kind == "effect":
            if any(isinstance(level, bool) or not isinstance(level, (int, float)) for level in levels):
                raise ConfigError(f"the levels of {name} in task.robustness must be numbers, got {levels}")
            made.append(Disturbance(name, tuple(map(float, levels)), kind, config.data.circular))
    if not made:
        raise ConfigError("task.robustness has no levels at all: give noise, occlusion, turn or effects")
    return made


def _list(options: Mapping[str, Any], key: str) -> list[Any]:
    value = options[key]
    if not isinstance(value, list):
        raise ConfigError(f"task.robustness.{key} must be a list, got {value!r}")
    return value


def _placed(config: DictConfig, known: VisualMap) -> VisualMap:
    has = known.frames.has_position
    usable(config, known.frames, has, "of the map have no position (x, y)")
    return known if has.all() else known.take(np.flatnonzero(has))


def _answers(
    config: DictConfig,
    descriptor: Descriptor,
    known: VisualMap,
    roles: Roles,
    queries: FrameTable,
    rows: np.ndarray,
    disturbances: list[Disturbance],
    name: str,
) -> Columns:
    """Locate some of the queries, batch by batch, at every level of every disturbance."""

    def locate(images: np.ndarray) -> Retrieval:
        return match(known, descriptor.describe(images), descriptor, 1)

    frames = queries.take(rows)
    batches = track(roles.library.batches(frames), len(frames), f"disturbed queries, {name}", size=len)
    found, start = [], 0
    for images in batches:
        found.append(locate_disturbed(locate, images, rows[start : start + len(images)], disturbances, config.seed))
        start += len(images)
    joined = {key: np.concatenate([part[key] for part in found]) for key in found[0]}
    return answers(name, known.frames, frames, joined)


def _print(found: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    unit = f"[{found['unit']}]".replace("[", r"\[")
    table = Table(box=None, header_style="bold", pad_edge=False)
    for head in ("method", "disturbance", "level"):
        table.add_column(head)
    for head in (f"mean {unit}", f"median {unit}", f"floor {unit}", f"within {found['radius']:g} {found['unit']}"):
        table.add_column(head, justify="right")
    for method, by_name in found["methods"].items():
        for name, levels in by_name.items():
            for entry in levels:
                cells = [f"{entry[key]:.3f}" for key in ("mean", "median", "floor")]
                share = f"{100 * entry['share']:.1f} % ({entry['within']})"
                table.add_row(method, name, f"{entry['level']:g}", *cells, share)
    console = Console()
    console.print(table) if console.is_terminal else Console(width=160).print(table)
    print(f"queries: {found['queries']} (one in {found['every']}), map: {found['map_frames']} frames")
