"""The settings classes of the library as defaults of the configuration, so that every value is defined once."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from siamloc.errors import ConfigError

OF_TRAINING = (
    *("seed", "epochs", "batch_size", "clip", "average"),
    *("monitor", "recall_radius", "patience", "checkpoint_every", "compile"),
)
"""Settings of a training that have the same name on the command line."""


def config_folder() -> Path:
    """Return the folder of the configuration files: inside the installed package, or next to it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"the configuration files are missing from {package}: install siamloc again")


def register(name: str) -> None:
    """Register the defaults that a configuration file names with Hydra."""
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    store = ConfigStore.instance()
    groups = nodes_of_config() if name in ("config", "pretrain") else nodes_of_data() if name in _READS_DATA else {}
    for group, nodes in groups.items():
        for node, values in nodes.items():
            store.store(node, OmegaConf.create(values), group=group)
    if name == "simulate":
        from siamloc.files import plain
        from siamloc.simulate import SimulateConfig

        store.store("simulate_defaults", OmegaConf.create(plain(asdict(SimulateConfig()))))


_READS_DATA = ("expand", "preview")


def nodes_of_config() -> dict[str, dict[str, Any]]:
    """Return the nodes of the configuration of most commands by group."""
    from analytic.descriptors.registry import DESCRIPTORS, parameters
    from siamloc.data.pairs import PairSettings
    from siamloc.data.places import PlaceSettings
    from siamloc.evaluation.compact_maps import Compact
    from siamloc.evaluation.disturbed import Robustness
    from siamloc.evaluation.hierarchy import Hierarchical
    from siamloc.evaluation.layers import MapMeasures
    from siamloc.evaluation.localize import Localization
    from siamloc.maps.grouping import WAYS
    from siamloc.models.registry import LOSS_SETTINGS, Optimizer
    from siamloc.pretraining.settings import ViewSettings
    from siamloc.settings import defaults_of
    from siamloc.training.settings import Training

    training = defaults_of(Training)
    descriptors = {
        # Whether columns wrap around follows from the data, and the device from `device`.
        name: {key: value for key, value in parameters(name).items() if key not in ("circular", "device")}
        for name in DESCRIPTORS
    }
    tasks = {
        "localization": defaults_of(Localization),
        "hierarchical": defaults_of(Hierarchical),
        "mapping": defaults_of(MapMeasures),
        "compact": defaults_of(Compact),
        "robustness": {"robustness": defaults_of(Robustness)},
    }
    return {
        **nodes_of_data(),
        "settings": {
            "pairs": defaults_of(PairSettings),
            "places": defaults_of(PlaceSettings),
            "views": defaults_of(ViewSettings),
            "optimizer": defaults_of(Optimizer),
            "training": {
                **{key: training[key] for key in OF_TRAINING},
                "loader": {"workers": training["workers"]},
                "augment": {"where": training["augment_where"]},
            },
            **nodes_of_data()["settings"],
        },
        "settings/task": tasks,
        **_nodes_of_recipes(),
        "settings/loss": {
            "contrastive": {"margin": training["margin"]},
            **{name: defaults_of(loss) for name, loss in LOSS_SETTINGS.items()},
        },
        "settings/build": {name: defaults_of(way) for name, way in WAYS.items()},
        "parameters/descriptor": descriptors,
    }


_BY_GROUP = ("pairs", "loss", "optimizer")


def _nodes_of_recipes() -> dict[str, dict[str, Any]]:
    """Return the settings of the recipes by group; those without a group are under "settings/recipe"."""
    from siamloc.pretraining.settings import RECIPE
    from siamloc.training.recipes import RECIPES

    nodes: dict[str, dict[str, Any]] = {}
    for name, recipe in {**RECIPES, "pretraining": RECIPE}.items():
        chosen = {**recipe.training, "loss": dict(recipe.loss or {})}
        for group in _BY_GROUP:
            nodes.setdefault(f"settings/recipe/{group}", {})[name] = chosen.pop(group)
        model = {key: value for key, value in recipe.model.items() if key not in ("branch", "head", "weights")}
        model |= {"branch": {"weights": recipe.model["weights"]}} if "weights" in recipe.model else {}
        rest: dict[str, Any] = {"model": model, "trainer": dict(recipe.trainer)}
        size = {"image_size": list(recipe.image_size)}
        rest |= size if recipe is RECIPE else {"data": size}
        nodes.setdefault("settings/recipe", {})[name] = {**rest, **chosen}
    return nodes


def nodes_of_data() -> dict[str, dict[str, Any]]:
    """Return the nodes of commands that only read data, by group."""
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


def _fields(camera: type) -> dict[str, Any]:
    import dataclasses

    return {
        field.name: field.default for field in dataclasses.fields(camera) if field.default is not dataclasses.MISSING
    }
