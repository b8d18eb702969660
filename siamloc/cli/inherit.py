"""What a command takes over from the run that is named: the settings stored in the run and in its map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from siamloc.errors import ConfigError
from siamloc.runs import Run


def settings_of(config: DictConfig, *, whole: bool) -> dict[str, Any] | None:
    """Return the settings of the named run by section of the configuration; None where there is no such run yet.

    Args:
        config: with `run`, and `descriptor` where the command has one.
        whole: those of the training as well, to resume it.
    """
    if not str(config.run).strip():
        raise ConfigError("run= is empty: name a folder, such as run=runs/robot")
    run = Run(Path(config.run))
    other = config.get("descriptor", {}).get("run")
    record = run if run.record.is_file() or other is None else Run(Path(other))
    kept: dict[str, Any] = {}
    if record.record.is_file():
        kept = _of_record(record.settings, whole)
    made = _made(run, config)
    if made is not None and not whole:
        if "data" not in kept and "data" in made:
            kept |= _of_data(made["data"])
        if "role" in made:
            kept["protocol.map"] = made["role"]
    return kept or None


def _of_record(settings: dict[str, Any], whole: bool) -> dict[str, Any]:
    model, training = settings.get("model", {}), settings.get("training", {})
    kept = {
        **_of_data(settings.get("data", {})),
        "protocol": settings.get("protocol", {}),
        "seed": training.get("seed", 0),
    }
    if "branch" in model:
        kept |= {"model.branch.name": model["branch"], "model.head.name": model["head"]}
    if not whole:
        return kept
    return {
        **kept,
        "model.branch.weights": model.get("weights"),
        "pairs": training["pairs"],
        "optimizer": training["optimizer"],
        "loss.margin": training["margin"],
        "augment": {**(settings.get("augment") or {"name": "none"}), "where": training["augment_where"]},
        **{key: training[key] for key in ("epochs", "batch_size")},
    }


def _of_data(data: dict[str, Any]) -> dict[str, Any]:
    held = dict(data)
    unwrap = held.pop("unwrap", None) or {"kind": "none"}
    return {"data": held, "unwrap": unwrap} if held.get("kind") else {}


def _made(run: Run, config: DictConfig) -> dict[str, Any] | None:
    """Return how the map of the named descriptor was made, where the run has one."""
    from siamloc.maps import VisualMap

    if "descriptor" not in config:
        return None
    path = map_file(run, label_of(config.descriptor))
    return dict(VisualMap.load(path).made) if path.is_file() else None


def label_of(options: Mapping[str, Any]) -> str:
    """Return what the folders and table rows of a descriptor or a build are called: its label, else its name."""
    return str(options.get("label") or options["name"])


def map_file(run: Run, label: str) -> Path:
    """Return where the map of a descriptor lies in a run."""
    return run.map if label == "network" else run.evaluation(label) / "map.npz"
