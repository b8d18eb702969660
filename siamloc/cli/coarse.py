"""The coarse layer of a hierarchical search: by which descriptor, over which map, and which nodes a query tries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from analytic import Description, Descriptor
from siamloc.cli.steps import Roles, build_map, descriptor_options, identity_of, label_of, make_descriptor, map_file
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import CoarseLayer, VisualMap, match
from siamloc.maps.node_ranking import NodeRanking, rank_by_representatives, rank_by_vote
from siamloc.runs import Run


@dataclass(frozen=True)
class CoarseDescriptor:
    """What nodes are built of and ranked by.

    Attributes:
        label: what its files are called.
        descriptor: the fine one itself, or another.
    """

    label: str
    descriptor: Descriptor


@dataclass(frozen=True)
class Coarse:
    """A coarse layer, with the map that it was built over and what described that map."""

    described: CoarseDescriptor
    known: VisualMap
    layer: CoarseLayer


def coarse_descriptor(config: DictConfig, run: Run, descriptor: Descriptor, label: str) -> CoarseDescriptor:
    """Return the configured descriptor of the coarse layer; the fine one if none is named.

    Raises:
        ConfigError: an unknown one, or one by which nodes cannot be ranked as configured.
    """
    name = config.task.coarse.descriptor
    chosen = CoarseDescriptor(label, descriptor)
    if name is not None and name != label:
        settings, options = _options(config, str(name))
        chosen = CoarseDescriptor(_label(options), make_descriptor(settings, run, options))
    if chosen.descriptor.aligned and config.task.coarse.by == "representatives":
        raise ConfigError(
            f"descriptors of {chosen.descriptor.name} are compared after turning, and their means stand for nothing: "
            "use task.coarse.by=vote, or another task.coarse.descriptor"
        )
    return chosen


def coarse_map(config: DictConfig, run: Run, coarse: CoarseDescriptor, known: VisualMap, roles: Roles) -> VisualMap:
    """Return the map of the same frames by another descriptor: the saved one if it fits."""
    path = map_file(run, coarse.label)
    saved = _saved(path, identity_of(config, coarse.descriptor), known.frames) if path.is_file() else None
    return saved or _described(config, coarse, known, roles)


def _options(config: DictConfig, name: str) -> tuple[DictConfig, dict[str, Any]]:
    """Return the options of a named descriptor, or of the network of a run, with the configuration it is made by."""
    if (Path(name) / "run.json").is_file():
        trained = Run(Path(name)).load_record()["config"]
        _check_size(name, list(trained["data"]["image_size"]), list(config.data.image_size))
        model = OmegaConf.create(trained["model"])
        return OmegaConf.merge({**config, "model": model}), {"name": "network", "run": name}  # type: ignore[return-value]
    return config, descriptor_options(name)


def _check_size(run: str, trained: list[int], read: list[int]) -> None:
    """Raise ConfigError if a network of another run does not take the panoramas that the fine layer reads."""
    if trained != read:
        there, here = (f"{rows} x {columns}" for rows, columns in (trained, read))
        raise ConfigError(
            f"the network of {run} was trained on panoramas of {there}, and the fine layer reads {here}: both layers "
            f"read the same panoramas, say data.image_size=[{trained[0]},{trained[1]}]"
        )


def _label(options: dict[str, Any]) -> str:
    """Return what the coarse descriptor's files are called; a network of another run by that run."""
    return f"network-{Path(options['run']).resolve().name}" if options.get("run") else label_of(options)


def _saved(path: Path, identity: dict[str, Any], frames: FrameTable) -> VisualMap | None:
    """Return a saved map if it is of these frames by this descriptor."""
    try:
        saved = VisualMap.load(path)
        saved.check_describer(identity)
    except (FormatError, ConfigError):
        return None
    return replace(saved, frames=frames) if np.array_equal(saved.frames.path, frames.path) else None


def _described(config: DictConfig, coarse: CoarseDescriptor, known: VisualMap, roles: Roles) -> VisualMap:
    frames = roles["known" if "known" in roles else "map"]
    if len(frames) != len(known):
        raise DataError(
            f"{len(known) - len(frames)} of the map's {len(known)} images cannot be read any more, and the coarse "
            "layer needs all of them: make the map anew with `siamloc map`"
        )
    return build_map(config, coarse.descriptor, roles.library, frames, f"describing the map, {coarse.label}")


def rank(config: DictConfig, coarse: Coarse, queries: Description) -> NodeRanking:
    """Return the candidate nodes of some queries, described by the coarse layer's descriptor."""
    task, known = config.task, coarse.known
    if task.coarse.by == "vote":
        votes = match(known, queries, coarse.described.descriptor, task.coarse.neighbours)
        return rank_by_vote(votes, coarse.layer.labels, task.candidates)
    return rank_by_representatives(queries.position, coarse.layer.representatives, task.candidates, known.distance)
