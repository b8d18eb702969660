"""`siamloc evaluate task=buildings`: which of several buildings a query is in, by their maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from analytic import DISTANCES, Description, Descriptor
from siamloc.cli.compose import plain
from siamloc.cli.mapping import layer_over
from siamloc.cli.searching import check_apart, parts_of, saved_map
from siamloc.cli.steps import Roles, build_map, finished_run, identity_of, label_of, make_descriptor, map_file
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, hint
from siamloc.evaluation.buildings import evaluate_buildings
from siamloc.evaluation.results import write_results
from siamloc.maps import VisualMap, match
from siamloc.runs import Run


@dataclass(frozen=True)
class Candidate:
    """A building that can be chosen.

    Attributes:
        building: its name, from the frames of its map.
        source: the file of the map, or the words for where else it comes from.
        known: the map.
        run: where its coarse layer lies.
        label: what that layer's folder is called, before the name of the build.
    """

    building: str
    source: str
    known: VisualMap
    run: Run
    label: str


def measure(config: DictConfig) -> None:
    """Choose the building of each query, write the files, print a table."""
    _check(config)
    run, options = finished_run(config), plain(config.descriptor)
    descriptor, label = make_descriptor(config, run, options), label_of(options)
    if descriptor.aligned and (config.build.name != "none" or config.task.distance is not None):
        raise ConfigError(
            f"descriptors of {descriptor.name} are compared after turning, by a distance of their own, and their means "
            "stand for nothing: leave build and task.distance out, or use another descriptor"
        )
    candidates, roles = _candidates(config, run, descriptor, label)
    queries, skipped = _known_buildings(config, roles["query"], [one.building for one in candidates])
    for one in candidates:
        check_apart(roles.protocol.kind, one.known.frames, queries.take(queries.building == one.building))
    names, vectors = _representatives(config, descriptor, candidates)
    apart, rows = _distances(config, descriptor, candidates, vectors, roles, queries, label)
    result = evaluate_buildings(queries, [one.building for one in candidates], apart, rows, names)
    build = label_of(plain(config.build))
    name = label if build == "none" else f"{label}-{build}"
    folder = run.evaluation(f"buildings-{name}")
    maps = {
        one.building: {"source": one.source, "frames": len(one.known), "representatives": len(part)}
        for one, part in zip(candidates, names, strict=True)
    }
    distance = config.task.distance or candidates[0].known.distance
    measures = {**result.measures(), "maps": maps, "distance": distance, "build": build}
    write_results(
        folder,
        {
            "command": "evaluate",
            "protocol": roles.protocol.kind,
            "descriptor": descriptor.identity,
            "config": plain(config),
            "measures": {"buildings": measures},
            "denominators": {"queries": len(result), "queries_of_the_role": len(roles["query"]), "maps": len(maps)},
            "skipped": skipped,
        },
        result.columns,
    )
    _print(name, measures)
    for what, reason in skipped.items():
        print(f"{what}: {reason}")
    if config.task.plots:
        from siamloc.report.draw import save_all

        for path in save_all(folder):
            print(f"picture: {path}")
    print(f"results: {folder / 'results.json'}, one row per query in {folder / 'queries.csv'}")


def _check(config: DictConfig) -> None:
    if "maps" not in config.task:
        raise ConfigError("choosing a building has settings of its own: choose it with task=buildings")
    maps, distance = config.task.maps, config.task.distance
    if maps is not None and not (OmegaConf.is_list(maps) and all(isinstance(one, str) for one in maps)):
        raise ConfigError(
            f"task.maps must be a list of run folders or map files, such as [runs/a,runs/b], got {maps!r}"
        )
    if maps is not None and len(maps) < 2:
        raise ConfigError(f"task=buildings chooses between maps, and task.maps names {len(maps)}: give two or more")
    if distance is not None and distance not in DISTANCES:
        raise ConfigError(f"unknown task.distance {distance!r}: {hint(str(distance), DISTANCES)}")


def _candidates(config: DictConfig, run: Run, descriptor: Descriptor, label: str) -> tuple[list[Candidate], Roles]:
    """Return the buildings to choose from, and the queries with their images."""
    if config.task.maps is None:
        return _split(config, run, descriptor, label)
    found = [_saved(config, descriptor, label, Path(name), run) for name in config.task.maps]
    for place, one in enumerate(found):
        for other in found[:place]:
            if other.building == one.building:
                raise ConfigError(f"{other.source} and {one.source} are both of building {one.building!r}: name one")
    return found, Roles(config, ("query",))


def _split(config: DictConfig, run: Run, descriptor: Descriptor, label: str) -> tuple[list[Candidate], Roles]:
    """Return a candidate for each building of the configured map frames."""
    known, source = saved_map(config, run, descriptor), str(map_file(run, label))
    roles = Roles(config, ("query",) if known is not None else ("map", "query"))
    if known is None:
        known, source = build_map(config, descriptor, roles.library, roles["map"], "describing the map"), "protocol.map"
    buildings = _buildings_of(known.frames, source)
    if len(buildings) < 2:
        raise ConfigError(
            f"task=buildings chooses between maps, and all map frames are of building {buildings[0]!r}: name the maps "
            "of several with task.maps=[runs/a,runs/b], or let protocol.map select frames of several"
        )
    parts = {one: known.take(known.frames.building == one) for one in buildings}
    return [Candidate(one, source, part, run, _folder(label, one)) for one, part in parts.items()], roles


def _saved(config: DictConfig, descriptor: Descriptor, label: str, path: Path, run: Run) -> Candidate:
    """Return the candidate of a saved map, given by its file or by the folder of its run.

    Raises:
        ConfigError: no such map, one by another descriptor, or one of several buildings.
    """
    its_run = run if path.is_file() else Run(path)
    file = path if path.is_file() else map_file(its_run, label)
    if not file.is_file():
        others = [found.parent.name for found in sorted(its_run.folder.glob("evaluation/*/map.npz"))]
        hint = f"it holds one by {' and one by '.join(others)}; choose that descriptor, or " if others else ""
        raise ConfigError(
            f"{path} holds no map by {label}: {hint}make it with `siamloc map run={path}` and the same descriptor and "
            "data"
        )
    known = VisualMap.load(file)
    try:
        known.check_describer(identity_of(config, descriptor))
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error
    buildings = _buildings_of(known.frames, str(file))
    if len(buildings) > 1:
        raise ConfigError(
            f"{file} holds frames of {len(buildings)} buildings ({', '.join(buildings)}): make one map for each, or "
            "leave task.maps out to have protocol.map split by building"
        )
    return Candidate(buildings[0], str(file), known, its_run, _folder(label, buildings[0]) if path.is_file() else label)


def _folder(label: str, building: str) -> str:
    """Return what the folder of a building's layer is called; a building may have any name, "north/1" too."""
    return f"{label}-{quote(building, safe=' ')}"


def _buildings_of(frames: FrameTable, source: str) -> list[str]:
    unknown = int((frames.building == "").sum())
    if unknown:
        raise DataError(
            f"{unknown} of the {len(frames)} map frames of {source} have no building: give the manifest a column "
            "`building`, or lay the images out as COLD's and make the map anew"
        )
    return sorted(set(frames.building.tolist()))


def _known_buildings(
    config: DictConfig, queries: FrameTable, buildings: list[str]
) -> tuple[FrameTable, dict[str, str]]:
    """Return the queries whose building is known, and what was left out.

    Raises:
        DataError: none has one, some have none and data.on_error is "raise", or one has a building without a map.
    """
    has = queries.building != ""
    text = f"{int((~has).sum())} of {len(queries)} queries have no building"
    if not has.any() or (not has.all() and config.data.on_error == "raise"):
        raise DataError(f"{text}: give the manifest a column `building`, or lay the images out as COLD's")
    strange = sorted(set(queries.building[has].tolist()) - set(buildings))
    if strange:
        count = int(np.isin(queries.building, strange).sum())
        raise DataError(
            f"{count} of {len(queries)} queries are in a building that has no map ({', '.join(strange)}; the maps are "
            f"of {', '.join(buildings)}): add its map, or choose other queries with protocol.query.sequences"
        )
    return (queries, {}) if has.all() else (queries.take(has), {"queries": f"{text}: left out"})


def _representatives(
    config: DictConfig, descriptor: Descriptor, candidates: list[Candidate]
) -> tuple[list[NDArray[np.str_]], list[NDArray[np.float32]]]:
    """Return what stands for each building: its map's frames, or the nodes of the configured build; and their names."""
    if config.build.name == "none":
        return [one.known.frames.path for one in candidates], [one.known.descriptors for one in candidates]
    layers = [layer_over(config, one.run, one.known, descriptor, one.label)[0] for one in candidates]
    return [layer.names for layer in layers], [layer.representatives for layer in layers]


def _distances(
    config: DictConfig,
    descriptor: Descriptor,
    candidates: list[Candidate],
    vectors: list[NDArray[np.float32]],
    roles: Roles,
    queries: FrameTable,
    label: str,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance to the nearest representative of each building, and its row (n, B)."""
    apart, rows = [], []
    for part in parts_of(descriptor, roles.library, queries, f"describing the queries, {label}"):
        found = [_nearest(config, descriptor, one, own, part) for one, own in zip(candidates, vectors, strict=True)]
        apart.append(np.stack([distance for distance, _ in found], axis=1))
        rows.append(np.stack([row for _, row in found], axis=1))
    return np.concatenate(apart), np.concatenate(rows)


def _nearest(
    config: DictConfig, descriptor: Descriptor, one: Candidate, vectors: NDArray[np.float32], queries: Description
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if descriptor.aligned:
        found = match(one.known, queries, descriptor, 1)
        return found.distances[:, 0], found.indices[:, 0]
    from analytic.buildings import choose_building

    choice = choose_building(queries.position, [vectors], config.task.distance or one.known.distance)
    return choice.apart[:, 0], choice.representative


def _print(name: str, measures: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    labels, maps = measures["confusion"]["labels"], measures["maps"]
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("lighting")
    for head in (*(f"of {label}" for label in labels), "all", "queries"):
        table.add_column(head.replace("[", r"\["), justify="right")
    groups = dict(measures["lighting"])
    if len(groups) != 1:
        groups["all"] = measures["overall"]
    for lighting, group in groups.items():
        shares = [_share(group["building"].get(label)) for label in labels]
        table.add_row(lighting, *shares, _share(group), str(group["queries"]))
    print(f"building chosen rightly, {name}, {measures['distance']} distance")
    console = Console()
    console.print(table) if console.is_terminal else Console(width=160).print(table)
    listed = [
        f"{label} {one['frames']} frames"
        + (f" in {one['representatives']} nodes" if measures["build"] != "none" else "")
        for label, one in maps.items()
    ]
    print(f"maps: {'; '.join(listed)}")


def _share(group: Mapping[str, Any] | None) -> str:
    return "-" if group is None else f"{100 * group['accuracy']:.1f} % ({group['correct']}/{group['queries']})"
