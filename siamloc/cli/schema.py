"""The settings classes of the library as defaults of the configuration, so that every value stands in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any


def register(name: str) -> None:
    """Make the defaults that a configuration file names known to Hydra."""
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    store = ConfigStore.instance()
    for group, nodes in (_of_config() if name == "config" else _of_data() if name in _READS_DATA else {}).items():
        for node, values in nodes.items():
            store.store(node, OmegaConf.create(values), group=group)
    if name == "simulate":
        from siamloc.files import plain
        from siamloc.simulate import SimulateConfig

        store.store("simulate_defaults", OmegaConf.create(plain(asdict(SimulateConfig()))))


def keys_of(name: str) -> dict[str, list[str]]:
    """Return all keys of a configuration by what chooses them: "data=cold|folder|..." and "other keys".

    They are read from the configuration files and the settings classes, so that the list is always complete.
    """
    from siamloc.cli.compose import composed_defaults, config_folder, folder_of

    nodes = _of_config() if name == "config" else _of_data()
    config = composed_defaults(name)
    found: dict[str, list[str]] = {}
    chosen = [*_groups_of(folder_of(name) / f"{name}.yaml"), *(["experiment"] if name == "config" else [])]
    for group in chosen:
        section, options = group.replace("/", "."), sorted((config_folder() / group).glob("*.yaml"))
        keys = set(_flat(config, section))
        for file in options if group != "experiment" else []:
            for key, value in _loaded(file, nodes).items():
                keys |= set(_flat(value, f"{section}.{key}"))
        found[f"{group}={'|'.join(file.stem for file in options)}"] = sorted(keys)
    inside = {key for keys in found.values() for key in keys}
    others = [key for key in _flat(config, "") if key not in inside and key != "experiment"]
    return {**found, "other keys": sorted(others)} if found else {"keys": sorted(others)}


_READS_DATA = ("expand", "preview")


def _of_config() -> dict[str, dict[str, Any]]:
    """Return the nodes of the configuration of most commands by group."""
    from analytic.descriptors.registry import DESCRIPTORS, parameters
    from siamloc.data.pairs import PairSettings
    from siamloc.evaluation.disturbed import Robustness
    from siamloc.evaluation.hierarchy import Hierarchical
    from siamloc.evaluation.layers import MapMeasures
    from siamloc.evaluation.localize import Localization
    from siamloc.maps.grouping import WAYS
    from siamloc.models.registry import Optimizer
    from siamloc.settings import defaults_of
    from siamloc.training.settings import Training

    training = defaults_of(Training)
    descriptors = {
        # Whether columns wrap around follows from the data, and where to compute from `device`.
        name: {key: value for key, value in parameters(name).items() if key not in ("circular", "device")}
        for name in DESCRIPTORS
    }
    tasks = {
        "localization": defaults_of(Localization),
        "hierarchical": defaults_of(Hierarchical),
        "mapping": defaults_of(MapMeasures),
        "robustness": {"robustness": defaults_of(Robustness)},
    }
    return {
        **_of_data(),
        "settings": {
            "pairs": defaults_of(PairSettings),
            "optimizer": defaults_of(Optimizer),
            "training": {
                **{key: training[key] for key in ("seed", "epochs", "batch_size")},
                "loss": {"margin": training["margin"]},
                "loader": {"workers": training["workers"]},
                "augment": {"where": training["augment_where"]},
            },
            **_of_data()["settings"],
        },
        "settings/task": tasks,
        "settings/build": {name: defaults_of(way) for name, way in WAYS.items()},
        "parameters/descriptor": descriptors,
    }


def _of_data() -> dict[str, dict[str, Any]]:
    from siamloc.data.panorama import HyperbolicMirror, PolarRing
    from siamloc.data.protocol import Protocol
    from siamloc.data.reading import DataSettings
    from siamloc.settings import defaults_of

    data = defaults_of(DataSettings)
    own = {"manifest": (), "cold": ("places", "camera"), "folder": ()}
    every = {key: value for key, value in data.items() if key not in ("manifest", "root", "places", "camera")}
    return {
        "settings": {
            "protocol": defaults_of(Protocol),
            **{f"data_{kind}": {**every, **{key: data[key] for key in keys}} for kind, keys in own.items()},
        },
        "settings/unwrap": {"polar": _fields(PolarRing), "hyperbolic": _fields(HyperbolicMirror)},
    }


def _groups_of(file: Path) -> list[str]:
    """Return the groups that a configuration file chooses from, such as "data" and "model/branch"."""
    from omegaconf import OmegaConf

    held: Any = OmegaConf.to_container(OmegaConf.load(file))
    defaults = held.get("defaults", [])
    return [str(key) for entry in defaults if not isinstance(entry, str) for key in entry if "@" not in str(key)]


def _loaded(file: Path, nodes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return what a file of a group holds, with the settings classes that it names."""
    from omegaconf import OmegaConf

    held: Any = OmegaConf.to_container(OmegaConf.load(file))
    named = [entry for entry in held.pop("defaults", []) if isinstance(entry, dict)]
    pairs = [(key.removesuffix("@_here_").strip("/"), node) for entry in named for key, node in entry.items()]
    return {key: value for group, node in pairs for key, value in nodes.get(group, {}).get(node, {}).items()} | held


def _flat(value: Any, prefix: str) -> list[str]:
    """Return the keys inside of a section, with dots."""
    from omegaconf import DictConfig, OmegaConf

    if isinstance(value, DictConfig):
        inside = OmegaConf.to_container(value, resolve=False)
        for part in prefix.split(".") if prefix else []:
            inside = inside.get(part, {}) if isinstance(inside, dict) else {}
        return _flat(inside, prefix)
    if not isinstance(value, dict):
        return [prefix]
    parts = [_flat(item, f"{prefix}.{key}" if prefix else str(key)) for key, item in value.items()]
    return [key for keys in parts for key in keys]


def _fields(camera: type) -> dict[str, Any]:
    import dataclasses

    return {
        field.name: field.default for field in dataclasses.fields(camera) if field.default is not dataclasses.MISSING
    }
