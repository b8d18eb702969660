"""Make the objects of the library from a configuration: frames, panoramas, descriptors, runs, maps, layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from analytic import DESCRIPTORS, Descriptor, descriptor
from siamloc.cli.checking import training_of
from siamloc.cli.compose import plain
from siamloc.cli.inherit import check_named, label_of
from siamloc.cli.sweeps import sweep_suffix
from siamloc.data import DataSettings, FrameTable, PanoramaLibrary, Protocol
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import image_files
from siamloc.errors import ConfigError, DataError, hint
from siamloc.files import read_json
from siamloc.jobs.options import values_of
from siamloc.maps import ErrorModel, Refinement, VisualMap
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.runs import Run

_RANKING = ("by", "neighbours", "ratio")


def data_of(config: DictConfig) -> DataSettings:
    """Return the settings of the data set."""
    return DataSettings.of(plain(config.data))


def preprocessing_of(config: DictConfig) -> Preprocessing:
    """Return how images become panoramas."""
    return Preprocessing.checked(tuple(config.data.image_size), plain(config.unwrap))


def open_roles(
    config: DictConfig, *names: str, known: VisualMap | None = None
) -> tuple[PanoramaLibrary, dict[str, FrameTable]]:
    """Return the panoramas that these roles of the protocol need, and the readable frames of each role.

    Args:
        config: the configuration.
        names: roles to fill.
        known: a saved map whose sequences are opened as well.

    Raises:
        ConfigError: a role without frames, or data without the map's frames or with different ones.
    """
    data, protocol = data_of(config), Protocol.of(plain(config.protocol))
    table = data.read()
    roles = protocol.roles(table, *names)
    if known is not None:
        known.check_frames(table)
    tables = [*roles.values(), *([] if known is None else [known.frames])]
    sequences = sorted({name for frames in tables for name in frames.sequence.tolist()})
    images = data.library(table.take(np.isin(table.sequence, sequences)), plain(config.unwrap))
    return images, {name: images.readable(frames) for name, frames in roles.items()}


def images_named(names: Any) -> list[Path]:
    """Return the image files of a key: one file or folder, or a list of them.

    Raises:
        ConfigError: no images given.
        DataError: a file that does not exist, or a folder without images.
    """
    paths: list[Path] = []
    for name in [names] if isinstance(names, str) else list(names or []):
        path = Path(name)
        inside = image_files(path) if path.is_dir() else [path]
        if not inside or not inside[0].is_file():
            raise DataError(f"{path} holds no images" if path.is_dir() else f"there is no image {path}")
        paths.extend(inside)
    if not paths:
        raise ConfigError("no images given: name files or folders, images=[a.jpeg,folder]")
    return paths


def run_of(config: DictConfig) -> Run:
    """Return the run that a command works on; analytic descriptors need none and have their own folder.

    Raises:
        ConfigError: a network is needed, and no run is given.
    """
    if config.run is not None:
        return Run(Path(config.run))
    check_named(config)
    return Run(Path("runs") / (config.data.name or "data") / label_of(config.descriptor))


def loss_of(config: DictConfig) -> Any:
    """Return the configured loss over batches of places; None for the contrastive loss, whose margin is a setting.

    Raises:
        ConfigError: an unknown loss, or one that does not fit the way batches are drawn.
    """
    from siamloc.data.places import PlaceSettings
    from siamloc.models.batch_losses import make_loss
    from siamloc.models.registry import LOSSES

    options = plain(config.loss)
    in_batch = isinstance(training_of(config).pairs, PlaceSettings)
    if options["name"] == "contrastive" and not in_batch:
        return None
    if options["name"] == "contrastive" or not in_batch:
        raise ConfigError(
            f"loss={options['name']} does not go with these pairs: pairs=in_batch goes with loss={'|'.join(LOSSES)}, "
            "other pairs with loss=contrastive"
        )
    return make_loss(**options)


def network_of(config: DictConfig) -> dict[str, Any]:
    """Return the configured network as arguments of `siamloc.models.build`."""
    model = plain(config.model)
    return {
        "branch": model["branch"]["name"],
        "weights": model["branch"]["weights"],
        "head": model["head"]["name"],
        "outputs": model["head"].get("outputs"),
        "circular": model["circular"],
        "normalize": model["normalize"],
        "canonical": model["canonical"],
        "relative": model["relative"],
    }


def training_folder(config: DictConfig) -> Path:
    """Return the folder that a training writes into."""
    data = config.data.name or "data" if "data" in config else "pretrained"
    names = [data, config.model.branch.name, config.model.head.name, f"seed{config.seed}"]
    folder = Path("runs") / "-".join(names) if config.run is None else Path(config.run)
    return folder / sweep_suffix() if sweep_suffix() else folder


def descriptor_of(config: DictConfig, run: Run, options: Mapping[str, Any] | None = None) -> Descriptor:
    """Return a descriptor, a network's on the configured device, from its options or those of the configuration."""
    parameters = dict(plain(config.descriptor) if options is None else options)
    name, _ = parameters.pop("name"), parameters.pop("label", None)
    if name in DESCRIPTORS:
        return descriptor(name, **parameters, circular=config.data.circular)
    if name not in ("network", "untrained", "pretrained"):
        known = ("network", "pretrained", *DESCRIPTORS)
        raise ConfigError(f"unknown descriptor {name!r}: {hint(name, known)}")
    from siamloc import models

    if name == "pretrained":
        _check_size(config, PRETRAINED_SIZE, "the network that ships with siamloc")
        return models.as_descriptor(models.pretrained(circular=config.data.circular), config.device)
    trained = Run(Path(parameters["run"])) if parameters.get("run") else run
    network = models.load(trained, which="untrained" if name == "untrained" else config.checkpoint)
    _check_architecture(config, network, trained, own=trained == run)
    return models.as_descriptor(network, config.device)


def baselines_of(config: DictConfig, run: Run, main: str) -> dict[str, Descriptor]:
    """Return the baseline descriptors by name; those that need a network only if the run has one."""
    found = {}
    for name in config.task.baselines:
        if name == main:
            continue
        if name in ("network", "untrained") and not run.record.is_file():
            print(f"baseline {name} left out: {run.folder} holds no trained network")
            continue
        size = _size_of(str(name), run)
        if size is not None and size != list(config.data.image_size):
            print(f"baseline {name} left out: it takes panoramas of {size[0]} x {size[1]}, unlike {main}")
            continue
        found[str(name)] = descriptor_of(config, run, values_of("descriptor", str(name)))
    return found


def heading_of(config: DictConfig) -> Descriptor | None:
    """Return the descriptor that estimates headings in place of the configured one; None if not requested."""
    options = plain(config.heading)
    name = options.pop("name")
    if name == "none":
        return None
    if config.descriptor.name in DESCRIPTORS and descriptor(config.descriptor.name).tells_heading:
        print(f"heading={name} left out: {config.descriptor.name} gives headings itself")
        return None
    if not config.data.circular:
        raise ConfigError(f"heading={name} needs columns that are a full turn, and data.circular is false")
    return descriptor(name, **options)


def way_of(config: DictConfig) -> dict[str, Any]:
    """Return how frames are grouped into nodes, as arguments of `siamloc.maps.group`."""
    options = {key: value for key, value in plain(config.build).items() if key != "label"}
    return {"way": options.pop("name"), "seed": config.seed, **options}


def search_of(config: DictConfig) -> dict[str, Any]:
    """Return how task=hierarchical searches a coarse layer, as arguments of `siamloc.maps.LayerSearch`."""
    task = plain(config.task)
    if "candidates" not in task:
        return {}
    return {"candidates": task["candidates"], "along": task["along"], **{k: task["coarse"][k] for k in _RANKING}}


def figures_in(path: Path) -> dict[str, Any] | None:
    """Return the date of an evaluation and its errors; None if there is no evaluation."""
    if not path.is_file():
        return None
    found = read_json(path)
    measures = {name: part.get("overall", {}).get("error") for name, part in found.get("measures", {}).items()}
    return {"created": found.get("created"), "errors": {name: error for name, error in measures.items() if error}}


def further_steps(
    run: Run, known: VisualMap | None, errors: ErrorModel | None, refinement: Refinement | None, label: str
) -> list[str]:
    """Return lines that say what else could be exported for the robot."""
    lines, named = [], f"run={run.folder}" + ("" if label == "network" else f" descriptor={label}")
    none = known is not None and known.heading is None and known.orientation is None
    if known is not None and none and known.made.get("data", {}).get("circular", True):
        which = "" if known.descriptor.tells_heading else " heading=hog"
        lines.append(f"for a heading as well: siamloc map {named}{which}, then export again")
    if known is not None and errors is None:
        if (run.evaluation(label) / "error_model.json").is_file():
            lines.append("error_model.json left out, it was learned on another map")
        lines.append(f"for expected errors: siamloc evaluate {named} task.error_model=true, then export again")
    if known is not None and refinement is None:
        if (run.evaluation(label) / "refinement.json").is_file():
            lines.append("refinement.json left out, it was learned on another map")
        elif getattr(known.descriptor, "compares", False):
            step = f"siamloc evaluate {named} task.refine=relative"
            lines.append(f"for poses finer than the map: {step}, then export again")
    return lines


def files_in(folder: Path) -> list[Path]:
    """Return all files in a folder, for the record of files written into a run."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _check_architecture(config: DictConfig, network: Any, run: Run, *, own: bool) -> None:
    """Refuse a network for other images than configured, or with another architecture than configured."""
    _check_size(config, getattr(network, "image_size", None), f"the network of {run.folder}")
    for key in ("branch", "head") if own else ():
        found, wanted = getattr(getattr(network, key, None), "name", None), config.model[key].name
        if found is not None and found != wanted:
            raise ConfigError(
                f"the checkpoint of {run.folder} is of another architecture: its {key} is {found}, and the "
                f"configuration says {wanted}: leave model/{key} out, or train another run"
            )


def _size_of(name: str, run: Run) -> list[int] | None:
    """Return the size of panoramas that a named network takes; None for any."""
    if name == "pretrained":
        return list(PRETRAINED_SIZE)
    size = run.settings["model"].get("image_size") if name in ("network", "untrained") else None
    return None if size is None else list(size)


def _check_size(config: DictConfig, size: Sequence[int] | None, network: str) -> None:
    """Refuse panoramas of a size that the network does not take."""
    if size is not None and list(size) != list(config.data.image_size):
        rows, columns = size
        raise ConfigError(
            f"{network} takes panoramas of {rows} x {columns}, and data.image_size says "
            f"{list(config.data.image_size)}: leave it out, or say data.image_size=[{rows},{columns}]"
        )
