"""The settings classes of the library as defaults of the configuration, so that every value is defined once."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from siamloc.jobs.options import options

OF_TRAINING = (
    *("seed", "epochs", "batch_size", "clip", "average"),
    *("monitor", "recall_radius", "patience", "checkpoint_every", "compile"),
)
"""Settings of a training that have the same name on the command line."""


def register(name: str) -> None:
    """Register the options of the groups, and the defaults that a configuration file names, with Hydra."""
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    store = ConfigStore.instance()
    for key in [key for key in store.repo if key != "hydra" and not key.startswith("_")]:
        del store.repo[key]  # those of another command, whose keys may have the names of groups
    if name == "simulate":
        from siamloc.files import plain
        from siamloc.simulate import SimulateConfig

        store.store("simulate_defaults", OmegaConf.create(plain(asdict(SimulateConfig()))))
    if name not in ("config", "pretrain", "expand", "preview"):
        return
    for group, inside in options().items():
        package = {"experiment": "_global_"}.get(group)
        for option, one in inside.items():
            store.store(option, OmegaConf.create(one.node()), group=group, package=package)
    for node, values in _nodes().items():
        store.store(node, OmegaConf.create(values), group="settings")


def _nodes() -> dict[str, dict[str, Any]]:
    """Return the defaults that belong to no group."""
    from siamloc.pretraining.settings import ViewSettings
    from siamloc.settings import defaults_of
    from siamloc.training.settings import Training

    training = defaults_of(Training)
    return {
        "views": defaults_of(ViewSettings),
        "training": {
            **{key: training[key] for key in OF_TRAINING},
            "loader": {"workers": training["workers"]},
            "augment": {"where": training["augment_where"]},
        },
    }
