"""Settings that a command takes from the given run: those stored in the run and in its map.

The command line wins: a key such as `protocol.map.every=2` replaces the stored one, and a group such as `data=cold`
replaces everything that it chooses. The image size always comes from the network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from siamloc.cli.schema import OF_TRAINING
from siamloc.cli.sweeps import of_map, own_folder
from siamloc.data import Protocol
from siamloc.errors import ConfigError, FormatError
from siamloc.models.registry import Optimizer, whole_model
from siamloc.runs import Run, newest_run

# What a group on the command line chooses in addition: files in `conf/data` and `conf/experiment` choose others.
_CHOOSES = {
    "data": ("data", "unwrap", "protocol"),
    "experiment": (
        *("data", "unwrap", "protocol", "protocol.map", "model", "pairs", "optimizer", "loss"),
        *("augment", *OF_TRAINING),
    ),
    "protocol": ("protocol", "protocol.map"),
}


def with_settings_of_the_run(
    config: DictConfig, keys: Sequence[str], groups: Sequence[str], *, resumed: bool, replaces_map: bool, required: bool
) -> DictConfig:
    """Return a configuration with the settings of its run; unchanged if there is no such run yet.

    Args:
        config: with `run`, and `descriptor` where the command has one.
        keys: those given on the command line, such as "protocol.map.every".
        groups: those of the keys that are groups, with dots, such as "data" or "model.branch".
        resumed: whether to take the settings of the training as well.
        replaces_map: whether a new map is made: frames and headings of the existing one are then not taken.
        required: whether the run must exist if its network is needed.

    Raises:
        ConfigError: an empty run name, or a folder that is not a run although its network is needed.
        FormatError: a run or a map of another version.
    """
    if not str(config.run).strip():
        raise ConfigError("run= is empty: name a folder, such as run=runs/robot")
    run = Run(Path(config.run))
    network = config.get("descriptor", {}).get("run")
    trained = Run(Path(network)) if network is not None else run
    needed = required and by_network(config)
    if needed and not trained.record.is_file():
        _hint_at_maps(trained.folder)
    record = trained.settings if needed or trained.record.is_file() else {}
    made = None if resumed else _map_made(run, config)
    kept = _kept(record, made, resumed=resumed, replaces_map=replaces_map)
    _check_literal(kept, run)
    chosen = {part for group in groups for part in _CHOOSES.get(group, (group,))}
    said = {key: OmegaConf.select(config, key) for key in keys if key not in groups}
    result = config.copy()
    with open_dict(result):
        for section, values in kept.items():
            if section.partition(".")[0] in config and not any(
                section == part or (section != "protocol.map" and section.startswith(f"{part}.")) for part in chosen
            ):
                OmegaConf.update(result, section, values, merge=False)
        size = record.get("model", {}).get("image_size") or record.get("data", {}).get("image_size")
        if size is not None and "data" in config and "experiment" not in groups and by_network(config):
            result.data.image_size = size
        for key, value in said.items():
            OmegaConf.update(result, key, value, merge=False)
    return result


def _hint_at_maps(folder: Path) -> None:
    """Refuse a folder without a trained network that has maps of other descriptors, naming one of them.

    Raises:
        ConfigError: it has.
    """
    made = sorted(file.parent.name for file in folder.glob("evaluation/*/map.npz"))
    if made:
        raise ConfigError(
            f"{folder} holds no trained network, only maps by {', '.join(made)}: choose the descriptor, such as "
            f"descriptor={made[0].partition('-')[0]}, or train with `siamloc train run={folder}`"
        )


def _check_literal(stored: Any, run: Run) -> None:
    """Refuse texts that OmegaConf would look up in the environment of whoever opens somebody else's run.

    Raises:
        FormatError: there is such a text.
    """
    if isinstance(stored, Mapping):
        for value in stored.values():
            _check_literal(value, run)
    elif isinstance(stored, list | tuple):
        for value in stored:
            _check_literal(value, run)
    elif isinstance(stored, str) and "${" in stored:
        raise FormatError(f"{run.folder} holds the setting {stored!r}, which would be looked up elsewhere: train again")


def label_of(options: Mapping[str, Any]) -> str:
    """Return the name for the folders and table rows of a descriptor or a build: its label, else its name."""
    return str(options.get("label") or options["name"])


def map_file(run: Run, label: str) -> Path:
    """Return the path of a descriptor's map in a run."""
    return run.map if label == "network" else run.evaluation(label) / "map.npz"


def map_of_job(run: Run, config: DictConfig) -> Path:
    """Return the path of a job's map: in its own folder if a sweep makes different maps, else `map_file`."""
    label = label_of(config.descriptor)
    shared = run.evaluation(label)
    own = own_folder(shared, config, of_map)
    return map_file(run, label) if own == shared else own / "map.npz"


def map_known(run: Run, config: DictConfig) -> Path:
    """Return the map that a job searches: its own, or one shared across distances and headings; it need not exist."""
    label = label_of(config.descriptor)
    shared = run.evaluation(label)
    for others in ((), ("distance",), ("distance", "heading")):
        own = own_folder(shared, config, lambda key, others=others: of_map(key) and key not in others)  # type: ignore[misc]
        path = map_file(run, label) if own == shared else own / "map.npz"
        if path.is_file():
            return path
    return path


def _kept(
    record: Mapping[str, Any], made: Mapping[str, Any] | None, *, resumed: bool, replaces_map: bool
) -> dict[str, Any]:
    """Return the stored settings by section of the configuration."""
    model, training = whole_model(record.get("model", {})), record.get("training", {})
    kept = _of_data(record.get("data") or (made or {}).get("data") or {})
    if "protocol" in record:
        kept["protocol"] = Protocol.of(record["protocol"]).plain()
    if made is not None and not replaces_map:
        kept |= {key: made[key] for key in ("protocol.map", "heading") if key in made}
    if "seed" in training:
        kept["seed"] = training["seed"]
    if "branch" in model:
        head = {"name": model["head"], "outputs": model.get("outputs")}
        kept |= {"model.branch.name": model["branch"], "model.head": head}
        keys = ("circular", "normalize", "canonical", "relative")
        kept |= {f"model.{key}": model[key] for key in keys if key in model}
    if resumed and training:
        kept |= {
            "model.branch.weights": model.get("weights"),
            "loss": _of_loss(record.get("loss") or {}),
            "augment": {**(record.get("augment") or {"name": "none"}), "where": training["augment_where"]},
            "trainer.precision": record.get("trainer", {}).get("precision", "32-true"),
            "pairs": training["pairs"],
            "optimizer": Optimizer.of(training["optimizer"]).plain(),
            **({"views": record["views"], "image_size": model["image_size"]} if "views" in record else {}),
            **{key: training[key] for key in OF_TRAINING if key in training},
        }
    return kept


def _of_loss(loss: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": "contrastive", **{key: value for key, value in loss.items() if key != "class"}}


def _of_data(data: Mapping[str, Any]) -> dict[str, Any]:
    if not data.get("kind"):
        return {}
    held = dict(data)
    return {"unwrap": held.pop("unwrap", None) or {"kind": "none"}, "data": held}


def _map_made(run: Run, config: DictConfig) -> dict[str, Any] | None:
    """Return the settings with which the map of the descriptor was made, by section; None without a map."""
    if "descriptor" not in config:
        return None
    places = (map_known(run, config), map_file(run, label_of(config.descriptor)))
    path = next((one for one in places if one.is_file()), None)
    if path is None:
        return None
    from siamloc.maps import VisualMap

    known = VisualMap.load(path)
    found: dict[str, Any] = {}
    if "data" in known.made:
        found["data"] = {**known.made["data"], "unit": known.unit}
    if "role" in known.made:
        found["protocol.map"] = known.made["role"]
    if known.heading is not None and not known.heading.own:  # headings need columns that are a full turn
        found["heading"] = {key: value for key, value in known.heading.identity.items() if key != "circular"}
    return found


def by_network(config: DictConfig) -> bool:
    """Whether the configured descriptor is the network of a run."""
    return config.get("descriptor", {}).get("name", "network") in ("network", "untrained")


def check_named(config: DictConfig) -> None:
    """Make sure that a run is given if its network is needed.

    Raises:
        ConfigError: no run is given; the error suggests the newest one.
    """
    if config.get("run") is None and by_network(config) and config.descriptor.get("run") is None:
        raise ConfigError(f"no run is named: {suggestion()}")


def suggestion() -> str:
    """Suggest a run for an error message."""
    try:
        return f"give run=FOLDER, such as run={newest_run().folder}, the newest one"
    except ConfigError:
        return "train one first with `siamloc train run=FOLDER`, or choose a descriptor that needs none, descriptor=hog"
