"""Check every value of a configuration before a command does anything: its name, type and range.

The settings classes of the library define their valid values (`siamloc.settings`). This module adds the settings that
only the command line has, and assigns a class to each part of a configuration.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from omegaconf import DictConfig, OmegaConf

from siamloc.cli.schema import OF_TRAINING, config_folder
from siamloc.errors import ConfigError, hint
from siamloc.files import PICTURES, is_picture
from siamloc.models.registry import Outputs
from siamloc.settings import (
    Count,
    Natural,
    Rule,
    Seed,
    Settings,
    Share,
    Size,
    Text,
    Thousand,
    Workers,
    checked,
    fields_of,
)
from siamloc.training.settings import Training

Folder = Annotated[str, Rule("the name of a folder", lambda value: bool(value.strip()))]
Device = Annotated[str, Rule("auto, cpu or cuda", lambda value: re.fullmatch(r"auto|cpu|cuda(:\d+)?", value))]
Images = tuple[Text, ...] | Text | None
Listed = Annotated[str, Rule("numbers between commas", lambda value: bool(re.fullmatch(r"\d+(,\d+)*,?", value)))]
Depth = Annotated[int, Rule("a whole number from 1 to 10,000", lambda value: 1 <= value <= 10_000)]
Picture = Annotated[str, Rule(f"a picture's name, ending {' '.join(PICTURES)}", is_picture)]
Several = Annotated[tuple[Text, ...], Rule("a list of one name or more", lambda value: len(value) > 0)]
Devices = Annotated[tuple[Natural, ...], Rule("a list of one number or more", lambda value: len(value) > 0)]


@dataclass(frozen=True)
class Loader(Settings):
    """How images are loaded."""

    WHERE = "loader"

    workers: Workers = 0


@dataclass(frozen=True)
class Branch(Settings):
    """The branch of a network."""

    WHERE = "model.branch"

    name: Text
    weights: Text | None = None


@dataclass(frozen=True)
class Head(Settings):
    """The head of a network."""

    WHERE = "model.head"

    name: Text
    outputs: Outputs | None = None


@dataclass(frozen=True)
class Model(Settings):
    """A network."""

    WHERE = "model"

    branch: Branch
    head: Head
    circular: bool = False
    normalize: Text | None = None
    canonical: bool = False
    relative: bool = False


@dataclass(frozen=True)
class TrainerKeys(Settings):
    """The keys of `conf/trainer`; Lightning checks other arguments of its Trainer itself."""

    WHERE = "trainer"

    accelerator: Text = "auto"
    devices: Count | Literal["auto", -1] | Devices | Listed = 1
    num_nodes: Count = 1
    strategy: Text | None = "auto"
    precision: Text | Literal[16, 32, 64] | None = "32-true"
    log_every_n_steps: Natural = 10


@dataclass(frozen=True)
class Main(Settings):
    """The keys of `conf/config.yaml` that belong to no group."""

    run: Folder | None = None
    resume: bool = False
    overwrite: bool = False
    debug: Literal["overfit", "one_batch", "profile"] | None = None
    checkpoint: Literal["best", "last"] = "best"
    device: Device = "auto"
    distance: Literal["manhattan", "euclidean", "correlation", "cosine"] | None = None
    projector: bool = False
    bundle: Folder | None = None
    precision: Literal["float32", "float16", "int8", "auto"] = "float32"
    thumbnails: bool = False
    loader: Loader = field(default_factory=Loader)


@dataclass(frozen=True)
class Pretrain(Settings):
    """The keys of `conf/pretrain.yaml` that belong to no group."""

    run: Folder = "runs/pretrained"
    resume: bool = False
    overwrite: bool = False
    image_size: Size = (64, 256)
    loader: Loader = field(default_factory=Loader)


@dataclass(frozen=True)
class Report(Settings):
    """The keys of `conf/report.yaml`."""

    run: Text | None = None
    runs: tuple[Text, ...] | Text | None = ()
    out: Text | None = None


@dataclass(frozen=True)
class Compare(Settings):
    """The keys of `conf/compare.yaml`."""

    runs: Several | Text
    by: Text | None = None
    out: Text | None = None


@dataclass(frozen=True)
class Reproduce(Settings):
    """The keys of `conf/reproduce/reproduce.yaml`."""

    id: Text | None = None
    list: bool = False
    data: Literal["cold", "freiburg_sim", "mini"] = "freiburg_sim"
    root: Text | None = None
    scale: Literal["smoke", "short", "full"] = "short"
    out: Folder = "reproduced"
    page: Text | None = None
    measure: bool = True


@dataclass(frozen=True)
class Expand(Settings):
    """The keys of `conf/expand.yaml` that belong to no group."""

    out: Folder
    depth: Depth = 16
    sequences: tuple[Text, ...] | Text | None = ()
    seed: Seed = 0
    workers: Thousand = 2
    resume: bool = False


@dataclass(frozen=True)
class Preview(Settings):
    """The keys of `conf/preview.yaml` that belong to no group."""

    out: Picture = "augmentation.png"
    images: Images = ()
    count: Thousand = 6


@dataclass(frozen=True)
class Demo(Settings):
    """The keys of `conf/demo/demo.yaml`."""

    run: Folder = "runs/demo"
    data: Text = "data"
    seed: Seed = 0
    overwrite: bool = False


_OWN: dict[str, type[Settings]] = {
    "config": Main,
    "pretrain": Pretrain,
    "report": Report,
    "compare": Compare,
    "reproduce": Reproduce,
    "expand": Expand,
    "preview": Preview,
    "demo": Demo,
}


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
    _known(own, [*fields_of(_OWN[name]), *groups, *training], "")
    _OWN[name].of(own)
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


TASKS = ("absolute", "room_retrieval", "hierarchical", "mapping", "compact", "robustness", "buildings")
_BASELINES: dict[str, Any] = {"plots": bool, "baselines": tuple[str, ...]}
_MORE: dict[str, dict[str, Any]] = {
    "absolute": _BASELINES,
    "room_retrieval": _BASELINES,
    "robustness": {"names": tuple[str, ...], **_BASELINES},
    "hierarchical": {"names": tuple[str, ...], "plots": bool},
    "mapping": {"names": tuple[str, ...], "plots": bool},
    "compact": {"names": tuple[str, ...], "plots": bool, "clusters": str | None},
    "buildings": {
        "names": tuple[str, ...],
        "plots": bool,
        "maps": tuple[str, ...] | str | None,
    },
}
"""Keys of the tasks in addition to the settings of their call."""


def settings_of(task: Mapping[str, Any]) -> Settings | None:
    """Return the settings of a task in `conf/task`, as the call of `siamloc.evaluation` takes them.

    Raises:
        ConfigError: an unknown task or key, a value of the wrong type or out of range, or tasks that cannot be measured
            together.
    """
    from siamloc.evaluation.compact_maps import Compact
    from siamloc.evaluation.disturbed import Robustness
    from siamloc.evaluation.hierarchy import Hierarchical
    from siamloc.evaluation.layers import MapMeasures
    from siamloc.evaluation.localize import Localization

    names = checked(task.get("names"), tuple[str, ...], "task.names")
    for name in names:
        if name not in TASKS:
            raise ConfigError(f"unknown task {name!r}: {hint(str(name), TASKS)}")
    if len(names) != 1 and set(names) != {"absolute", "room_retrieval"}:
        raise ConfigError(f"task.names must be one of {', '.join(TASKS)}, or [absolute, room_retrieval], got {names}")
    name = names[0]
    own = {
        "hierarchical": "coarse",
        "mapping": "closure_radius",
        "compact": "clusters",
        "robustness": "robustness",
        "buildings": "maps",
    }
    if name in own and own[name] not in task:
        raise ConfigError(f"{name} has its own settings: choose it with task={name}")
    kinds = {
        "hierarchical": Hierarchical,
        "mapping": MapMeasures,
        "compact": Compact,
        "robustness": Robustness,
        "buildings": None,
    }
    kind: type[Settings] | None = kinds.get(name, Localization)
    values: dict[str, Any] = dict(task)
    more = {key: values.pop(key) for key in _MORE[name] if key in values}
    for key, value in more.items():
        checked(value, _MORE[name][key], f"task.{key}")
    _baselines(more.get("baselines", ()))
    if kind is Robustness:
        _known(values, ["robustness"], "task", _MORE[name])
        values = dict(checked(values["robustness"], Mapping, "task.robustness"))
    if kind is Hierarchical:
        coarse = dict(checked(values["coarse"], Mapping, "task.coarse"))
        checked(coarse.pop("descriptor", None), str | None, "task.coarse.descriptor")
        values["coarse"] = coarse
    if kind is None:
        _known(values, [], "task", _MORE[name])
        return None
    return kind.of(values)


def _baselines(names: Any) -> None:
    """Refuse a baseline that is not a descriptor in `conf/descriptor`."""
    known = sorted(file.stem for file in (config_folder() / "descriptor").glob("*.yaml"))
    for name in names:
        if name not in known:
            raise ConfigError(f"unknown descriptor {name!r} in task.baselines: {hint(name, known)}")


def _is_group(name: str, group: str) -> bool:
    """Whether a key is a group of a configuration: `siamloc demo` has its own key `data`."""
    return name != "demo" and group not in fields_of(_OWN[name])


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
    from siamloc.models.registry import LOSS_SETTINGS

    options = dict(values)
    name = checked(options.pop("name", None), Text, "loss.name")
    if name == "contrastive":
        _known(options, ["name", "margin"], "loss")
    elif name in LOSS_SETTINGS:
        LOSS_SETTINGS[name].of(options)
    else:
        raise ConfigError(f"unknown loss {name!r}: {hint(name, ['contrastive', *LOSS_SETTINGS])}")


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
    from analytic import DESCRIPTORS, Thumbnail

    options = dict(values)
    name = checked(options.pop("name", None), Text, "descriptor.name")
    checked(options.pop("label", None), Text | None, "descriptor.label")
    if name in ("network", "untrained", "pretrained"):
        _known(options, ["run"] if name == "network" else [], "descriptor")
        checked(options.get("run"), Text | None, "descriptor.run")
    elif name == "thumbnail":
        _known(options, ["rows", "columns"], "descriptor")
        Thumbnail(**options)
    elif name in DESCRIPTORS:
        _analytic(name, options, "descriptor")
    else:
        known = ("network", "pretrained", "untrained", "thumbnail", *DESCRIPTORS)
        raise ConfigError(f"unknown descriptor {name!r}: {hint(name, known)}")


def _analytic(name: str, options: Mapping[str, Any], where: str) -> None:
    """Check the parameters of an analytic descriptor; those that follow from data and device cannot be set."""
    from analytic import descriptor
    from analytic.descriptors.registry import parameters

    _known(options, set(parameters(name)) - {"circular", "device"}, where)
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
    settings_of(values)


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
