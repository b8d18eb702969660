"""`siamloc evaluate`: call the function of `siamloc.evaluation` that a configuration asks for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from omegaconf import DictConfig

from analytic import Descriptor
from siamloc import evaluation, maps
from siamloc.cli.compose import plain
from siamloc.cli.inherit import label_of, map_file, map_known
from siamloc.cli.objects import (
    baselines_of,
    data_of,
    descriptor_of,
    files_in,
    heading_of,
    open_roles,
    way_of,
)
from siamloc.cli.sweeps import of_layer, own_folder
from siamloc.data import FrameTable, PanoramaLibrary, Protocol, Role
from siamloc.errors import ConfigError
from siamloc.evaluation import Result
from siamloc.evaluation.compact_maps import Compact
from siamloc.evaluation.disturbed import Robustness
from siamloc.evaluation.hierarchy import Hierarchical
from siamloc.evaluation.layers import MapMeasures
from siamloc.evaluation.localize import Localization
from siamloc.files import real_path
from siamloc.jobs.options import values_of
from siamloc.jobs.tasks import RobustnessTask, call_settings, task_of
from siamloc.maps import Built, VisualMap
from siamloc.runs import Run


def result_of(config: DictConfig, run: Run) -> tuple[str, Result]:
    """Measure the configured task; return the name of its folder and the result."""
    settings = task_of(plain(config.task))
    if isinstance(settings, MapMeasures):
        return _mapping(config, run, call_settings(settings, MapMeasures))
    if isinstance(settings, Hierarchical):
        return _hierarchical(config, run, call_settings(settings, Hierarchical))
    if isinstance(settings, Compact):
        return _compact(config, run, call_settings(settings, Compact))
    if isinstance(settings, RobustnessTask):
        return _robustness(config, run, settings.robustness)
    if isinstance(settings, Localization):
        return _localization(config, run, call_settings(settings, Localization))
    return _buildings(config, run)


def _localization(config: DictConfig, run: Run, settings: Localization) -> tuple[str, Result]:
    learned = settings.error_model or settings.filter_tune
    learned |= settings.refine == "relative" and _protocol(config).validation != Role()
    known, images, roles = _known(config, run, "query", *(["validation"] if learned else []))
    label = _named(config)
    result = evaluation.localization(
        known,
        images,
        roles["query"],
        validation=roles.get("validation"),
        protocol=_protocol(config),
        baselines=baselines_of(config, run, label_of(config.descriptor)),
        name=label,
        seed=config.seed,
        settings=settings,
    )
    return label, result


def _robustness(config: DictConfig, run: Run, settings: Robustness) -> tuple[str, Result]:
    known, images, roles = _known(config, run, "query")
    label = _named(config)
    result = evaluation.robustness(
        known,
        images,
        roles["query"],
        protocol=_protocol(config),
        baselines=baselines_of(config, run, label_of(config.descriptor)),
        name=label,
        seed=config.seed,
        settings=settings,
    )
    return f"robustness-{label}", result


def _hierarchical(config: DictConfig, run: Run, settings: Hierarchical) -> tuple[str, Result]:
    known, images, roles = _known(config, run, "query")
    known = known.placed()
    label, other = _named(config), config.task.coarse.descriptor
    coarse, coarse_label = None, label
    if other is not None and other != label_of(config.descriptor):
        trained = (Path(other) / "run.json").is_file()
        options = {"name": "network", "run": other} if trained else values_of("descriptor", other)
        coarse_label = f"network-{real_path(other).name}" if "run" in options else label_of(options)
        coarse = maps.build(descriptor_of(config, run, options), images, known.frames, distance=config.distance)
    if (known if coarse is None else coarse).aligned and settings.coarse.by == "representatives":
        raise ConfigError(
            f"descriptors of {coarse_label} are compared after turning, so their means are meaningless: use "
            "task.coarse.by=vote, or another task.coarse.descriptor"
        )
    built, _ = _layer(config, run, known if coarse is None else coarse, coarse_label)
    by = [] if settings.coarse.by == "representatives" else [settings.coarse.by]
    name = "-".join(dict.fromkeys([label, coarse_label, label_of(config.build), *by]))
    result = evaluation.hierarchical(
        known,
        images,
        roles["query"],
        built,
        coarse_map=coarse,
        protocol=_protocol(config),
        name=name,
        settings=settings,
    )
    return f"hierarchical-{name}", result


def _mapping(config: DictConfig, run: Run, settings: MapMeasures) -> tuple[str, Result]:
    known, _, _ = _known(config, run)
    label = _named(config)
    built, folder = _layer(config, run, known, label)
    name = f"{label_of(config.build)} over {label}"
    result = evaluation.mapping(known, built, name=name, settings=settings)
    return f"mapping-{label}-{label_of(config.build)}", replace(result, layer=folder)


def _compact(config: DictConfig, run: Run, settings: Compact) -> tuple[str, Result]:
    known, images, roles = _known(config, run, "query")
    name, other, clusters = _named(config), config.task.clusters, None
    if other is not None and other != label_of(config.descriptor):
        name = f"{name}-by-{other}"
        clusters = maps.build(descriptor_of(config, run, values_of("descriptor", other)), images, known.frames)
    result = evaluation.compact(
        known,
        images,
        roles["query"],
        clusters=clusters,
        protocol=_protocol(config),
        name=name,
        seed=config.seed,
        settings=settings,
    )
    return f"compact-{name}", result


def _buildings(config: DictConfig, run: Run) -> tuple[str, Result]:
    label, named = _named(config), config.task.maps
    if named is None:
        known, images, roles = _known(config, run, "query")
        candidates = [known]
    else:
        images, roles = open_roles(config, "query")
        saved = _saved_maps(named, label_of(config.descriptor), descriptor_of(config, run))
        candidates = [one.with_distance(config.distance) for one in saved]
    layers = None
    if config.build.name != "none":
        parts = evaluation.by_building(candidates)
        layers, build = {}, label_of(config.build)
        for building, part in parts.items():
            shared = run.layer(f"{label}-{quote(building, safe=' ')}", build)  # a building may have any name
            folder = own_folder(shared, config, of_layer)
            layers[building] = maps.group(part, folder=folder, **way_of(config)).layer
            run.record_written(files_in(folder))
        label = f"{label}-{build}"
    result = evaluation.buildings(
        candidates,
        images,
        roles["query"],
        layers=layers,
        protocol=_protocol(config),
        name=label,
    )
    return f"buildings-{label}", result


def _named(config: DictConfig) -> str:
    """Return the name of a descriptor's results: its label, with the distance if one is given."""
    label = label_of(config.descriptor)
    return label if config.distance is None else f"{label}-{config.distance}"


def _saved_maps(named: Any, label: str, described: Descriptor) -> list[VisualMap]:
    """Return saved maps, each given by its file or the folder of its run.

    Raises:
        ConfigError: fewer than two maps, a map that does not exist, or one with another descriptor.
    """
    if isinstance(named, str):
        raise ConfigError(
            f"task.maps must be a list of run folders or map files, such as [runs/a,runs/b], got {named!r}"
        )
    if len(named) < 2:
        raise ConfigError(f"task=buildings chooses between maps, and task.maps names {len(named)}: give two or more")
    found = []
    for path in map(Path, named):
        file = path if path.is_file() else map_file(Run(path), label)
        if not file.is_file():
            others = [other.parent.name for other in sorted(path.glob("evaluation/*/map.npz"))]
            held = f"it holds one by {' and one by '.join(others)}; choose that descriptor, or " if others else ""
            raise ConfigError(
                f"{path} holds no map by {label}: {held}make it with `siamloc map run={path}` and the same descriptor "
                "and data"
            )
        try:
            found.append(VisualMap.load(file, described))
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from error
    return found


def _known(config: DictConfig, run: Run, *roles: str) -> tuple[VisualMap, PanoramaLibrary, dict[str, FrameTable]]:
    """Return the saved map, or one made from the configured frames, with the frames of some roles.

    Nothing is written: only `siamloc map` creates and replaces maps.

    Raises:
        ConfigError: the saved map has another descriptor, or other frames than protocol.map asks for.
    """
    described, heading = descriptor_of(config, run), heading_of(config)
    path = map_known(run, config)
    known = VisualMap.load(path, described) if path.is_file() else None
    if known is not None and _is_wanted(known, config):
        images, frames = open_roles(config, *roles, known=known)
        return known.with_heading(heading).with_distance(config.distance), images, frames
    if known is not None and roles:
        raise ConfigError(
            f"{path} was made of other frames than protocol.map asks for: run `siamloc map` again with the "
            "intended protocol.map keys"
        )
    images, frames = open_roles(config, "map", *roles)
    known = maps.build(described, images, frames["map"], heading=heading, distance=config.distance)
    return known, images, frames


def _is_wanted(known: VisualMap, config: DictConfig) -> bool:
    """Whether a saved map was made from the frames that the configuration asks for."""
    wanted, role = _protocol(config), known.made.get("role")
    if role is not None:
        return Protocol.of({"map": role}).map == wanted.map
    if wanted.map == Role():  # a map made in Python, and no other frames requested
        return True
    asked = wanted.frames("map", data_of(config).read())
    return asked.identities() == known.frames.identities()


def _layer(config: DictConfig, run: Run, known: VisualMap, label: str) -> tuple[Built, Path]:
    """Return the configured layer over a map and its folder: an existing one, if it fits.

    A layer over any other map does not replace that of the saved map.
    """
    if config.build.name == "none":
        raise ConfigError(
            f"task={config.task.names[0]} needs a coarse layer: choose one with build={'|'.join(maps.WAYS)}"
        )
    shared, saved = run.layer(label, label_of(config.build)), map_file(run, label)
    folder = own_folder(shared, config, of_layer)
    if folder == shared and saved.is_file() and VisualMap.load(saved).digest != known.digest:
        folder = run.evaluation(f"layer-{folder.name}")
    before = _changed(folder / "layer.npz")
    built = maps.group(known, folder=folder, **way_of(config))
    if _changed(folder / "layer.npz") != before:
        print(built.summary(folder))
    run.record_written(files_in(folder))
    return built, folder


def _changed(path: Path) -> int | None:
    """Return when a file was last written; None if it does not exist."""
    return path.stat().st_mtime_ns if path.is_file() else None


def _protocol(config: DictConfig) -> Protocol:
    return Protocol.of(plain(config.protocol))
