"""`DataJob` and `RunJob`: the bases of the jobs that read data, and of those that work on a run.

A job takes settings from the run that it names: those stored in the run and in its map. What is given wins: a key such
as `protocol.map.every=2` replaces the stored one, and a group such as `data=cold` replaces everything that it chooses.
The image size always comes from the network.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from analytic import DESCRIPTORS, Descriptor, descriptor
from analytic.descriptors.registry import parameters
from foundation.settings import Seed, fields_of
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.data.reading import DataSettings
from siamloc.errors import ConfigError
from siamloc.jobs.choices import OF_A_RUN, Build, DescriptorChoice, Device, Folder, Heading, Model
from siamloc.jobs.job import Given, Job, Say
from siamloc.jobs.options import option
from siamloc.jobs.sweep import of_map, own_folder
from siamloc.models.registry import PRETRAINED_SIZE, Optimizer
from siamloc.runs import Run, newest_run
from siamloc.training.settings import Learning

if TYPE_CHECKING:
    from siamloc.maps import VisualMap

OF_TRAINING = tuple(name for name in fields_of(Learning) if name not in ("pairs", "optimizer"))
"""Settings of a training that are keys of their own on the command line."""
# What a chosen option of a group sets in addition: data sets and experiments choose options of other groups.
_CHOOSES = {
    "data": ("data", "unwrap", "protocol"),
    "experiment": (
        *("data", "unwrap", "protocol", "protocol.map", "model", "pairs", "optimizer", "loss"),
        *("augment", *OF_TRAINING),
    ),
    "protocol": ("protocol", "protocol.map"),
}


@dataclass(frozen=True, kw_only=True)
class DataJob(Job):
    """Base of the jobs that read data.

    Attributes:
        data: which frames to read.
        unwrap: how omnidirectional images become panoramas: `kind` and the parameters of the camera.
        protocol: which frames have which role.
    """

    GROUPS: ClassVar = {"unwrap": "none", "protocol": "by_sequence", "data": "manifest"}

    data: DataSettings
    unwrap: Mapping[str, Any]
    protocol: Protocol

    def __post_init__(self) -> None:
        super().__post_init__()
        Preprocessing.checked(self.data.image_size, self.unwrap)

    @property
    def preprocessing(self) -> Preprocessing:
        """How images become panoramas."""
        return Preprocessing.checked(self.data.image_size, self.unwrap)

    def open_roles(self, *names: str, known: VisualMap | None = None) -> tuple[PanoramaLibrary, dict[str, FrameTable]]:
        """Return the panoramas that these roles of the protocol need, and the readable frames of each role.

        Args:
            names: roles to fill.
            known: a saved map whose sequences are opened as well.

        Raises:
            ConfigError: a role without frames, or data without the map's frames or with different ones.
        """
        table = self.data.read()
        roles = self.protocol.roles(table, *names)
        if known is not None:
            known.check_frames(table)
        tables = [*roles.values(), *([] if known is None else [known.frames])]
        sequences = sorted({name for frames in tables for name in frames.sequence.tolist()})
        images = self.data.library(table.take(np.isin(table.sequence, sequences)), self.unwrap)
        return images, {name: images.readable(frames) for name, frames in roles.items()}


EXPERIMENTAL = {
    **DataJob.GROUPS,
    "pairs": "default",
    "loss": "contrastive",
    "augment": "none",
    "model/branch": "vgg16",
    "model/head": "fc500_500_5",
    "optimizer": "sgd",
    "descriptor": "network",
    "heading": "none",
    "build": "none",
    "task": "localization",
}
"""The groups that an experiment may choose from."""


def of_job(names: Sequence[str]) -> dict[str, str]:
    """Return some of the groups that an experiment may choose from."""
    return {group: name for group, name in EXPERIMENTAL.items() if group in names}


@dataclass(frozen=True, kw_only=True)
class RunJob(DataJob):
    """Base of the jobs that describe images for a run.

    Attributes:
        folder: of the run.
        model: the architecture of the network, to make sure that the run's network has it.
        checkpoint: of the network: best on the validation sequence, or last; best falls back to last.
        device: where networks describe.
        descriptor: a network or an analytic descriptor.
        heading: the descriptor that estimates headings for a network that cannot.
        distance: how descriptors are compared; the descriptor's own if None.
        build: how the frames of the map are grouped into nodes.
        seed: seed of all random draws.
    """

    GROUPS: ClassVar = of_job([*DataJob.GROUPS, "model/branch", "model/head", "descriptor", "heading", "build"])
    SHARED = True
    REPLACES_MAP: ClassVar[bool] = False

    folder: Folder | None = None
    model: Model
    checkpoint: Literal["best", "last"] = "best"
    device: Device = "auto"
    descriptor: DescriptorChoice
    heading: Heading
    distance: Literal["manhattan", "euclidean", "correlation", "cosine"] | None = None
    build: Build
    seed: Seed = 0

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return values together with the settings of the run."""
        chosen = values["descriptor"]
        if values.get("run") is not None:
            told = cls.REPLACES_MAP or any(key.partition(".")[0] == "descriptor" for key in given.keys)
            if not told and chosen.get("name") == "network" and chosen.get("run") is None:
                values = {**values, "descriptor": _described_by(values["run"]) or chosen}
            values = with_settings_of_the_run(values, given, cls.key_names(), replaces_map=cls.REPLACES_MAP)
        elif chosen.get("name") in OF_A_RUN and chosen.get("run") is None:
            raise ConfigError(f"no run is named: {suggestion()}")
        if values["descriptor"].get("name") == "pretrained" and "data.image_size" not in given.keys:
            values["data"] = {**values["data"], "image_size": list(PRETRAINED_SIZE)}
        return values

    @cached_property
    def titles(self) -> dict[str, str]:
        """The titles of the descriptor and the build, for folders and tables."""
        return {"descriptor": self.descriptor.title, "build": self.build.title}

    @cached_property
    def here(self) -> Run:
        """The run that the job works on; analytic descriptors need none and have their own folder."""
        if self.folder is not None:
            return Run(Path(self.folder))
        return Run(Path("runs") / (self.data.name or "data") / self.descriptor.title)

    @property
    def way(self) -> dict[str, Any]:
        """How frames are grouped into nodes, as arguments of `siamloc.maps.group`."""
        return {"way": self.build.name, "seed": self.seed, **self.build.parameters}

    def make_descriptor(self, chosen: DescriptorChoice | None = None) -> Descriptor:
        """Make a descriptor, a network's on the job's device; the job's own if None."""
        chosen = chosen or self.descriptor
        if chosen.name in DESCRIPTORS:
            return descriptor(chosen.name, **chosen.parameters, circular=self.data.circular)
        from siamloc import models

        if chosen.name == "pretrained":
            self._check_size(PRETRAINED_SIZE, "the network that ships with siamloc")
            return models.as_descriptor(models.pretrained(circular=self.data.circular), self.device)
        trained = Run(Path(chosen.parameters["run"])) if chosen.parameters.get("run") else self.here
        network = models.load(trained, which="untrained" if chosen.name == "untrained" else self.checkpoint)
        self._check_architecture(network, trained, own=trained == self.here)
        return models.as_descriptor(network, self.device)

    def make_heading(self, say: Say) -> Descriptor | None:
        """Make the descriptor that estimates headings; None if there is none, or the job's descriptor gives them."""
        name = self.heading.name
        if name == "none":
            return None
        if self.descriptor.name in DESCRIPTORS and descriptor(self.descriptor.name).tells_heading:
            say(f"heading={name} left out: {self.descriptor.name} gives headings itself")
            return None
        if not self.data.circular:
            raise ConfigError(f"heading={name} needs columns that are a full turn, and data.circular is false")
        return descriptor(name, **self.heading.parameters)

    def _check_architecture(self, network: Any, run: Run, *, own: bool) -> None:
        """Refuse a network for other images than configured, or with another architecture than configured."""
        self._check_size(getattr(network, "image_size", None), f"the network of {run.folder}")
        for key in ("branch", "head") if own else ():
            found, wanted = getattr(getattr(network, key, None), "name", None), getattr(self.model, key).name
            if found is not None and found != wanted:
                raise ConfigError(
                    f"the checkpoint of {run.folder} is of another architecture: its {key} is {found}, and the "
                    f"configuration says {wanted}: leave model/{key} out, or train another run"
                )

    def _check_size(self, size: Sequence[int] | None, network: str) -> None:
        """Refuse panoramas of a size that the network does not take."""
        if size is not None and tuple(size) != tuple(self.data.image_size):
            rows, columns = size
            raise ConfigError(
                f"{network} takes panoramas of {rows} x {columns}, and data.image_size says "
                f"{list(self.data.image_size)}: leave it out, or say data.image_size=[{rows},{columns}]"
            )


def files_in(folder: Path) -> list[Path]:
    """Return all files in a folder, for the record of files written into a run."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def with_settings_of_the_run(
    values: dict[str, Any],
    given: Given,
    known: Container[str],
    *,
    resumed: bool = False,
    replaces_map: bool = False,
) -> dict[str, Any]:
    """Return the values of a job with the settings of its run; unchanged if there is no such run yet.

    Args:
        values: with `run`, and `descriptor` where the job has one.
        given: what wins over the run.
        known: keys of the job.
        resumed: whether to take the settings of the training as well.
        replaces_map: whether a new map is made: frames and headings of the existing one are then not taken.

    Raises:
        ConfigError: an empty run name, or a folder that is not a run although its network is needed.
        FormatError: a run or a map of another version.
    """
    if not isinstance(values["run"], str) or not values["run"].strip():
        return values  # which the check of the job refuses
    run = Run(Path(values["run"]))
    network = values.get("descriptor", {}).get("run")
    trained = Run(Path(network)) if network is not None else run
    by_network = values.get("descriptor", {}).get("name", "network") in OF_A_RUN
    needed = by_network and not resumed
    if needed and not trained.record.is_file():
        _hint_at_maps(trained.folder)
    record = trained.settings if needed or trained.record.is_file() else {}
    made = None if resumed else _map_made(run, values)
    kept = _kept(record, made, resumed=resumed, replaces_map=replaces_map)
    chosen = {part for group in given.groups for part in _CHOOSES.get(group, (group,))}
    said = {key: _select(values, key) for key in given.keys if key not in given.groups and _has(values, key)}
    result = dict(values)
    for section, stored in kept.items():
        if section.partition(".")[0] in known and not any(
            section == part or (section != "protocol.map" and section.startswith(f"{part}.")) for part in chosen
        ):
            _put(result, section, stored)
    size = record.get("model", {}).get("image_size") or record.get("data", {}).get("image_size")
    if size is not None and "data" in known and "experiment" not in given.groups and by_network:
        _put(result, "data.image_size", size)
    for key, value in said.items():
        _put(result, key, value)
    return result


def map_file(run: Run, label: str) -> Path:
    """Return the path of a descriptor's map in a run."""
    return run.map if label == "network" else run.evaluation(label) / "map.npz"


def map_of_job(run: Run, titles: Mapping[str, str]) -> Path:
    """Return the path of a job's map: in its own folder if a sweep makes different maps, else `map_file`."""
    label = titles["descriptor"]
    shared = run.evaluation(label)
    own = own_folder(shared, titles, of_map)
    return map_file(run, label) if own == shared else own / "map.npz"


def map_known(run: Run, titles: Mapping[str, str]) -> Path:
    """Return the map that a job searches: its own, or one shared across distances and headings; it need not exist."""
    label = titles["descriptor"]
    shared = run.evaluation(label)
    for others in ((), ("distance",), ("distance", "heading")):
        own = own_folder(shared, titles, lambda key, others=others: of_map(key) and key not in others)  # type: ignore[misc]
        path = map_file(run, label) if own == shared else own / "map.npz"
        if path.is_file():
            return path
    return path


def suggestion() -> str:
    """Suggest a run for an error message."""
    try:
        return f"give run=FOLDER, such as run={newest_run().folder}, the newest one"
    except ConfigError:
        return "train one first with `siamloc train run=FOLDER`, or choose a descriptor that needs none, descriptor=hog"


def _described_by(run: Any) -> dict[str, Any] | None:
    """Return the only descriptor that a folder without a trained network has a map of; None if there are others."""
    folder = Path(str(run))
    made = list(folder.glob("evaluation/*/map.npz"))
    if Run(folder).record.is_file() or len(made) != 1:
        return None
    from siamloc.maps import VisualMap

    label, identity = made[0].parent.name, VisualMap.load(made[0]).identity
    name = identity.get("name")
    if name not in DESCRIPTORS:
        return dict(option("descriptor", label).values) if label == "pretrained" else None
    values = {key: identity[key] for key in ("name", *parameters(name)) if key in identity and key != "circular"}
    return values if label == name else {**values, "label": label}


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


def _kept(
    record: Mapping[str, Any], made: Mapping[str, Any] | None, *, resumed: bool, replaces_map: bool
) -> dict[str, Any]:
    """Return the stored settings by section of the job."""
    model, training = record.get("model", {}), record.get("training", {})
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


def _map_made(run: Run, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the settings with which the map of the descriptor was made, by section; None without a map."""
    if "descriptor" not in values:
        return None
    titles = {group: str(values[group].get("label") or values[group]["name"]) for group in ("descriptor", "build")}
    places = (map_known(run, titles), map_file(run, titles["descriptor"]))
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
    if known.heading is not None and not known.heading_by_network:  # headings need columns that are a full turn
        found["heading"] = {key: value for key, value in known.heading.items() if key != "circular"}
    return found


def _select(values: Mapping[str, Any], key: str) -> Any:
    for part in key.split("."):
        values = values[part]
    return values


def _has(values: Mapping[str, Any], key: str) -> bool:
    try:
        _select(values, key)
    except (KeyError, TypeError):
        return False
    return True


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a nested value; mappings on the way are copied."""
    first, _, rest = key.partition(".")
    if rest:
        values[first] = dict(values[first]) if isinstance(values.get(first), Mapping) else {}
        _put(values[first], rest, value)
    else:
        values[first] = value
