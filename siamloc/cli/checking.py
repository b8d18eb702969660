"""Check every value of a configuration before a command does anything: its name, type and range.

The settings classes define the valid values: those of the library (`siamloc.settings`) and those of the command line
alone (`siamloc.cli.settings`). This module assigns a class to each part of a configuration.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal

from omegaconf import DictConfig, OmegaConf

from siamloc.cli.schema import OF_TRAINING
from siamloc.cli.settings import OWN, Model, TrainerKeys
from siamloc.errors import ConfigError, hint
from siamloc.jobs.options import choices
from siamloc.jobs.tasks import task_of
from siamloc.settings import Share, Size, Text, checked, fields_of
from siamloc.training.settings import Training


def check(name: str, config: DictConfig) -> None:
    """Check every value of a configuration.

    Args:
        name: of the main configuration file.
        config: complete, except for values that the command does not need.

    Raises:
        ConfigError: an unknown key, or a value of the wrong type or out of range.
        AnalyticError: an invalid parameter of a descriptor.
        AugmentError: an invalid parameter of an augmentation.
    """
    values = OmegaConf.to_container(config, resolve=True)
    assert isinstance(values, dict)
    if name == "simulate":
        from siamloc.simulate import SimulateConfig

        SimulateConfig.of(values)  # type: ignore[arg-type]
        return
    groups = {group: of_group for group, of_group in _GROUPS.items() if group in values and _is_group(name, group)}
    training = [key for key in OF_TRAINING if key in values] if name in ("config", "pretrain") else []
    own = {str(key): value for key, value in values.items() if key not in groups and key not in training}
    _known(own, [*fields_of(OWN[name]), *groups, *training], "")
    OWN[name].of(own)
    for group, of_group in groups.items():
        if not isinstance(values[group], Mapping):
            raise ConfigError(f"{group} is a group of keys: set them one by one, such as {group}.KEY=VALUE")
        of_group(config, values[group])
    if training:
        training_of(config)


def training_of(config: DictConfig) -> Training:
    """Return the settings of a training; errors use the key names of the command line."""
    held: Any = OmegaConf.to_container(config, resolve=True)
    values = {key: held[key] for key in (*OF_TRAINING, "pairs", "optimizer")}
    others = {"workers": "loader.workers", "augment_where": "augment.where"}
    if held["loss"].get("name") == "contrastive":  # others have their own margins
        others["margin"] = "loss.margin"
    for name, key in others.items():
        value = OmegaConf.select(config, key)
        if value is not None:
            values[name] = checked(value, fields_of(Training)[name], key)
    return Training.of(values)


def _baselines(names: Any) -> None:
    """Refuse a baseline that is not an option of the group of descriptors."""
    known = choices("descriptor")
    for name in names:
        if name not in known:
            raise ConfigError(f"unknown descriptor {name!r} in task.baselines: {hint(name, known)}")


def _is_group(name: str, group: str) -> bool:
    """Whether a key is a group of a configuration: `siamloc demo` has its own key `data`."""
    return name != "demo" and group not in fields_of(OWN[name])


def _known(values: Mapping[str, Any], names: Iterable[str], where: str, others: Iterable[str] = ()) -> None:
    """Refuse a key that is not among the names of a group; the error lists `others` as well."""
    names, before = set(names), f"{where}." if where else ""
    for key in values:
        if key not in names:
            valid = sorted(f"{before}{name}" for name in {*names, *others})
            raise ConfigError(f"unknown configuration key {f'{before}{key}'!r}: {hint(f'{before}{key}', valid)}")


def _data(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.data import DataSettings

    DataSettings.of(values)


def _unwrap(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.data.decoding import Preprocessing

    Preprocessing.checked(checked(OmegaConf.to_object(config.data.image_size), Size, "data.image_size"), values)


def _protocol(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.data import Protocol

    Protocol.of(values)


def _model(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.models.registry import NORMALIZATIONS, branch_spec, head_widths

    model = Model.of(values)
    branch_spec(model.branch.name)
    head_widths(model.head.name, model.head.outputs)
    if model.normalize is not None and model.normalize not in NORMALIZATIONS:
        raise ConfigError(f"unknown normalization {model.normalize!r}: {hint(model.normalize, NORMALIZATIONS)}")


def _loss(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.models.registry import LOSSES

    options = dict(values)
    name = checked(options.pop("name", None), Text, "loss.name")
    if name == "contrastive":
        _known(options, ["name", "margin"], "loss")
    elif name in LOSSES:
        LOSSES[name][0].of(options)
    else:
        raise ConfigError(f"unknown loss {name!r}: {hint(name, ['contrastive', *LOSSES])}")


def _augment(config: DictConfig, values: Mapping[str, Any]) -> None:
    checked(values.get("where", "auto"), Literal["auto", "cpu", "gpu"], "augment.where")
    checked(values.get("name"), Text, "augment.name")
    if values.get("name") == "none":
        _known(values, ["name", "where"], "augment")
        return
    checked(values.get("rotate"), Share | None, "augment.rotate")
    from siamloc.training.fitting import effect_of

    effect_of({key: value for key, value in values.items() if key != "where"}, circular=True)


def _trainer(config: DictConfig, values: Mapping[str, Any]) -> None:
    own = fields_of(TrainerKeys)
    TrainerKeys.of({key: value for key, value in values.items() if key in own})
    if further := [key for key in values if key not in own]:
        from augment.torchvision_compat import ensure_torchvision

        ensure_torchvision()
        from lightning.pytorch import Trainer

        _known(dict.fromkeys(further), inspect.signature(Trainer).parameters, "trainer")


def _descriptor(config: DictConfig, values: Mapping[str, Any]) -> None:
    from analytic import DESCRIPTORS

    options = dict(values)
    name = checked(options.pop("name", None), Text, "descriptor.name")
    checked(options.pop("label", None), Text | None, "descriptor.label")
    if name in ("network", "untrained", "pretrained"):
        _known(options, ["run"] if name == "network" else [], "descriptor")
        checked(options.get("run"), Text | None, "descriptor.run")
    elif name in DESCRIPTORS:
        _analytic(name, options, "descriptor")
    else:
        known = ("network", "pretrained", "untrained", *DESCRIPTORS)
        raise ConfigError(f"unknown descriptor {name!r}: {hint(name, known)}")


def _analytic(name: str, options: Mapping[str, Any], where: str) -> None:
    """Check the parameters of an analytic descriptor; `circular` follows from the data."""
    from analytic import descriptor
    from analytic.descriptors.registry import parameters

    _known(options, set(parameters(name)) - {"circular"}, where)
    descriptor(name, **options)


def _heading(config: DictConfig, values: Mapping[str, Any]) -> None:
    from analytic import DESCRIPTORS

    options = dict(values)
    name = checked(options.pop("name", None), Text, "heading.name")
    if name == "none":
        _known(options, ["name"], "heading")
    elif name in DESCRIPTORS:
        _analytic(name, options, "heading")
    else:
        raise ConfigError(f"unknown heading {name!r}: {hint(name, ['none', *DESCRIPTORS])}")


def _build(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.maps.grouping import WAYS

    options = {key: value for key, value in values.items() if key not in ("name", "label")}
    checked(values.get("label"), Text | None, "build.label")
    name = checked(values.get("name"), Text, "build.name")
    if name == "none":
        _known(options, ["name", "label"], "build")
    elif name in WAYS:
        WAYS[name].of(options)
    else:
        raise ConfigError(f"unknown build {name!r}: {hint(name, ['none', *WAYS])}")


def _task(config: DictConfig, values: Mapping[str, Any]) -> None:
    _baselines(getattr(task_of(values), "baselines", ()))


def _views(config: DictConfig, values: Mapping[str, Any]) -> None:
    from siamloc.pretraining.settings import ViewSettings

    ViewSettings.of(values)


_GROUPS: dict[str, Callable[[DictConfig, Mapping[str, Any]], None]] = {
    "data": _data,
    "unwrap": _unwrap,
    "protocol": _protocol,
    "model": _model,
    "loss": _loss,
    "augment": _augment,
    "trainer": _trainer,
    "descriptor": _descriptor,
    "heading": _heading,
    "build": _build,
    "task": _task,
    "views": _views,
    "pairs": lambda config, values: None,  # checked with the training
    "optimizer": lambda config, values: None,
}
