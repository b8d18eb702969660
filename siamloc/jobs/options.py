"""The options of each group, made from the registries of losses, heads, branches, descriptors and the like.

Hydra gets them through its config store, next to the files in `conf/`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from analytic.descriptors.fused import SIGN, distinct
from foundation.errors import not_yaml
from foundation.settings import complaint, defaults_of, merged
from siamloc.errors import ConfigError, hint
from siamloc.jobs.choices import Choice, Frozen, Fusion, parameters_of
from siamloc.models.registry import is_backbone


@dataclass(frozen=True)
class Option:
    """An option of a group, such as vgg16 of model/branch.

    Attributes:
        values: the keys of the group with their defaults.
        summary: description of the option in one line.
        chooses: names of the options of other groups that come with this option, by group.
    """

    values: Mapping[str, Any]
    summary: str
    chooses: Mapping[str, str] = field(default_factory=dict)

    def node(self) -> dict[str, Any]:
        """Return the option as Hydra reads it from a file."""
        chosen = [{f"override /{group}": name} for group, name in self.chooses.items()]
        return {"defaults": [*chosen, "_self_"], **self.values} if chosen else dict(self.values)


Options = dict[str, dict[str, Option]]


@lru_cache(maxsize=1)
def options() -> Options:
    """Return all options by group and name."""
    found = {**_of_data(), **_of_training(), **_of_maps()}
    for name, group, option in _of_recipes():
        found.setdefault(group, {})[name] = option
    return found


def summary_of(kind: Callable[..., Any]) -> str:
    """Return the first line of the docstring of a class or function."""
    return (kind.__doc__ or "").strip().partition("\n")[0]


def _each(kinds: Mapping[str, type], tag: str = "name", **further: Any) -> dict[str, Option]:
    """Return an option for each class of settings: its name under the key `tag`, and the defaults of the class."""
    return {name: Option({tag: name, **defaults_of(kind), **further}, summary_of(kind)) for name, kind in kinds.items()}


def _of_data() -> Options:
    from siamloc.data.cameras import CAMERAS
    from siamloc.data.central import CentralCamera
    from siamloc.data.protocol import Protocol
    from siamloc.data.reading import READERS, DataSettings

    kinds = {kind: Option(DataSettings.options(kind), summary_of(reader)) for kind, reader in READERS.items()}
    cameras = {name: camera for name, camera in CAMERAS.items() if camera is not None}
    edges = {"top": None, "bottom": None, "level": None}
    central = dict.fromkeys(key for key in defaults_of(CentralCamera) if key != "image_size")
    calibrated = {"kind": "calibrated", "file": "???", "camera": None, **central, **edges}
    filed = {path.stem for path in (config_folder() / "data").glob("*.yaml")}
    return {
        "data": {kind: option for kind, option in kinds.items() if kind not in filed},
        "unwrap": {
            "none": Option(
                {"kind": "none"}, "The images are panoramas, or come from an ordinary camera: only resized."
            ),
            **_each(cameras, "kind", **edges),
            "calibrated": Option(
                calibrated, "The camera of a calibration file of Kalibr, OpenCV, ROS, CamOdoCal or OCamCalib."
            ),
            "own": Option({"kind": "???", **edges}, "A camera class of your own, unwrap.kind=module:Class."),
        },
        "protocol": {"by_sequence": Option(defaults_of(Protocol), "Roles by the names of sequences, or patterns.")},
        "settings": {f"data_{kind}": option for kind, option in kinds.items()},
    }


def _of_training() -> Options:
    from augment.registry import POLICIES
    from siamloc.data.pairs import PairSettings
    from siamloc.data.places import PlaceSettings
    from siamloc.models.registry import BRANCHES, HEADS, LOSSES, OPTIMIZERS, Contrastive

    return {
        "model/branch": {
            name: Option({"name": name, "weights": None}, branch.summary) for name, branch in BRANCHES.items()
        },
        "model/head": {
            name: Option({"name": name, **({"outputs": None} if len(head.widths) == 1 else {})}, head.summary)
            for name, head in HEADS.items()
        },
        "loss": _each({**{name: kind for name, (kind, _) in LOSSES.items()}, "contrastive": Contrastive}),
        "optimizer": {name: Option(made.plain(), text) for name, (made, text) in OPTIMIZERS.items()},
        "pairs": {
            "default": Option(defaults_of(PairSettings), "Pairs, labelled by room, or by distance if all is one room."),
            "in_batch": Option(defaults_of(PlaceSettings), "Batches of places: training uses all pairs in a batch."),
        },
        "augment": {
            **{
                name: Option({"name": name, "rotate": None}, f"The policy {name} of `augment`, and more rotations.")
                for name in POLICIES
            },
            "none": Option({"name": "none"}, "No augmentation."),
        },
    }


def _of_maps() -> Options:
    from analytic import DESCRIPTORS, descriptor
    from siamloc.jobs.tasks import TASKS
    from siamloc.maps.grouping import WAYS
    from siamloc.maps.heading import HEADINGS

    values = {name: parameters_of(name) for name in DESCRIPTORS}
    return {
        "descriptor": {
            "network": Option({"name": "network", "run": None}, "The trained network of a run."),
            "untrained": Option({"name": "untrained"}, "The network of the run with its initial weights."),
            "pretrained": Option({"name": "pretrained"}, "The network that ships with siamloc; needs no run."),
            "frozen": Option({"name": "frozen", "branch": "???", **defaults_of(Frozen)}, summary_of(Frozen)),
            "fused": Option({"name": "fused", "parts": "???", **defaults_of(Fusion)}, summary_of(Fusion)),
            **{name: Option({"name": name, **own}, summary_of(type(descriptor(name)))) for name, own in values.items()},
        },
        "heading": {
            "none": Option({"name": "none"}, "No headings, unless the descriptor estimates them itself."),
            **{
                name: Option({"name": name, **values[name], **own}, f"Headings by {name} in place of a network's.")
                for name, own in HEADINGS.items()
            },
        },
        "build": {"none": Option({"name": "none"}, "No nodes: the map has only its frames."), **_each(WAYS)},
        "task": {name: Option(defaults_of(kind), summary_of(kind)) for name, kind in TASKS.items()},
    }


_BY_GROUP = ("pairs", "optimizer", "loss", "augment")


def _of_recipes() -> Iterator[tuple[str, str, Option]]:
    """Yield the options that a recipe adds to the groups of its settings, and its experiment."""
    from siamloc.data.places import PlaceSettings
    from siamloc.models.registry import LOSSES, Optimizer
    from siamloc.pretraining.settings import RECIPE
    from siamloc.training.recipes import RECIPES

    for name, recipe in {**RECIPES, "pretraining": RECIPE}.items():
        training, loss, model = dict(recipe.training), dict(recipe.loss or {}), dict(recipe.model)
        parts: dict[str, Mapping[str, Any]] = {
            "pairs": {**defaults_of(PlaceSettings), **training.pop("pairs")},
            "optimizer": {**defaults_of(Optimizer), **training.pop("optimizer")},
            "loss": {**defaults_of(LOSSES[loss["name"]][0]), **loss},
            "augment": recipe.augmentation,
        }
        for group, values in parts.items():
            yield name, group, Option(values, f"That of the recipe {name}.")
        chosen = {"model/branch": model.pop("branch"), "model/head": model.pop("head")}
        weights = {"branch": {"weights": model.pop("weights")}} if "weights" in model else {}
        rest = {"model": {**model, **weights}, "trainer": dict(recipe.trainer), **training}
        size = {"image_size": list(recipe.image_size)}
        if recipe is RECIPE:  # of a job of its own
            continue
        circular = {} if model.get("circular") else {"circular": False}
        choices = {**dict.fromkeys(_BY_GROUP, name), **chosen}
        yield name, "experiment", Option({**rest, "data": {**size, **circular}}, recipe.summary, choices)


def config_folder() -> Path:
    """Return the folder of the configuration files: inside the installed package, or next to it in a checkout.

    Raises:
        ConfigError: the folder is missing.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "protocol").is_dir():
            return folder
    raise ConfigError(f"the configuration files are missing from {package}: install siamloc again")


def groups() -> list[str]:
    """Return the names of all groups, such as "data" and "model/branch"."""
    folder = config_folder()
    folders = {path.parent.relative_to(folder).as_posix() for path in folder.rglob("*/*.yaml")}
    return sorted({*folders, *(group for group in options() if not group.startswith("settings"))} - {"building"})


def choices(group: str) -> dict[str, str]:
    """Return the names of a group's options, from registries and files, with a line about each."""
    found = {name: option.summary for name, option in options().get(group, {}).items()}
    for path in (config_folder() / group).glob("*.yaml"):
        lines = re.findall(r"^# ([^@ ].*)", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        found[path.stem] = f"{re.split(r'[.] (?=[A-Z])', ' '.join(lines))[0].rstrip('.')}."
    return dict(sorted(found.items()))


def is_fused(name: str) -> bool:
    """Whether the name of a descriptor stands for several that are fused, such as hog+hsv."""
    return SIGN in name


def option(group: str, name: str) -> Option:
    """Return an option, from its registry or from its file and the options that the file starts from.

    Args:
        group: group of options, a folder of `conf/`, such as "model/branch".
        name: name of the option, such as "vgg16"; names of descriptors with a plus between them stand for all of them
            fused.

    Raises:
        ConfigError: an unknown option, or a file that is not YAML or not a mapping.
    """
    if name in options().get(group, {}):
        return options()[group][name]
    if group == "model/branch" and is_backbone(name):
        return Option({"name": name, "weights": None}, "A network that siamloc does not define.")
    if group == "descriptor" and is_fused(name):
        return Option({**options()[group]["fused"].values, "parts": distinct(name.split(SIGN))}, summary_of(Fusion))
    path = config_folder() / group / f"{name}.yaml"
    if not path.is_file():
        raise ConfigError(f"unknown {group} {name!r}: {hint(name, choices(group))}")
    try:
        own = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(not_yaml(path, error)) from error
    if complaint(own, Mapping) or complaint(own.get("defaults", []), list[str | Mapping]):
        raise ConfigError(f"{path} must be a mapping of keys to values, and its `defaults` a list of options")
    values: dict[str, Any] = {}
    chooses: dict[str, str] = {}
    for entry in own.pop("defaults", []):
        if isinstance(entry, str):
            if entry != "_self_":
                start = option(group, entry)
                values, chooses = merged(values, start.values), {**chooses, **start.chooses}
            continue
        for words, chosen in entry.items():
            if words == "/settings@_here_":
                values = merged(values, options()["settings"][chosen].values)
            else:  # such as "override /unwrap@_global_.unwrap"
                chooses[words.removeprefix("override /").partition("@")[0]] = chosen
    return Option(merged(values, own), "", chooses)


def words_of(group: str, chosen: Choice) -> dict[str, Any]:
    """Return the keys that choose an option again: its name, and the parameters that differ from the option's."""
    title = chosen.title
    named = title in choices(group) or is_fused(title)
    word = {group: title} if named else {group: chosen.name, f"+{group}.label": title}
    usual = option(group, title if named else chosen.name).values
    return word | {f"{group}.{key}": value for key, value in chosen.parameters.items() if value != usual.get(key)}
