"""`DataJob` and `RunJob`: the bases of the jobs that read data, and of those that work on a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np

from analytic import DESCRIPTORS, Descriptor, Fused, descriptor
from analytic.descriptors.fused import SIGN, distinct
from foundation.settings import Seed, leaves
from foundation.words import as_words
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.library import PanoramaLibrary
from siamloc.data.mounting import GivenMounting
from siamloc.data.protocol import Protocol, Role
from siamloc.data.reading import DataSettings
from siamloc.errors import ConfigError
from siamloc.jobs.choices import OF_A_RUN, Build, DescriptorChoice, Device, Folder, Frozen, Heading, Model, names_in
from siamloc.jobs.job import Given, Job, Say
from siamloc.jobs.options import option, words_of
from siamloc.jobs.stored import descriptor_of, only_map, with_settings_of_the_run
from siamloc.jobs.sweep import of_layer, own_folder
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.runs import Run, suggested_run

if TYPE_CHECKING:
    from siamloc.maps import Built, VisualMap

Kind = TypeVar("Kind", bound="RunJob")


@dataclass(frozen=True, kw_only=True)
class DataJob(Job):
    """Base of the jobs that read data.

    Attributes:
        data: the frames to read: the kind of data, its folder or list, and the image size.
        unwrap: how omnidirectional images become panoramas: `kind`, such as "none", "polar" or "fisheye", the
            parameters of the camera, and the elevations `top` and `bottom` of a panorama.
        protocol: which frames have which role, such as map, queries or training, by sequence, lighting or room.
    """

    GROUPS: ClassVar[Mapping[str, str]] = {"unwrap": "none", "protocol": "by_sequence", "data": "manifest"}

    data: DataSettings
    unwrap: Mapping[str, Any]
    protocol: Protocol

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.has_camera:
            Preprocessing.checked(self.data.image_size, self.unwrap)
        if self.data.where.get("camera") == "std_cam" and (self.unwrap.get("kind") == "cold" or self.data.circular):
            raise ConfigError("the pictures of COLD's std_cam show no full turn: set unwrap=none data.circular=false")

    @property
    def has_camera(self) -> bool:
        """Whether the camera is known before the job runs."""
        return True

    @property
    def preprocessing(self) -> Preprocessing:
        """How images become panoramas."""
        return Preprocessing.checked(self.data.image_size, self.unwrap)

    @property
    def own_camera(self) -> dict[str, str]:
        """The setting that further commands need for a camera of your own, since files import no code."""
        kind = str(self.unwrap.get("kind"))
        return {"unwrap.kind": kind} if ":" in kind else {}

    def open_roles(self, *names: str, known: VisualMap | None = None) -> tuple[PanoramaLibrary, dict[str, FrameTable]]:
        """Open the panoramas for some roles of the protocol; also return the readable frames of each role.

        Args:
            names: roles to fill.
            known: a saved map whose sequences are opened as well.

        Raises:
            ConfigError: a role without frames, or data without the map's frames or with different ones.
        """
        table = self.data.read()
        roles = self.protocol.roles(table, *names)
        if known is not None and len(lacking := known.check_frames(table)):
            table = concatenate([table, lacking])
        tables = [*roles.values(), *([] if known is None else [known.frames])]
        sequences = sorted({name for frames in tables for name in frames.sequence.tolist()})
        images = self.data.library(table.take(np.isin(table.sequence, sequences)), self.unwrap)
        return images, {name: images.readable(frames) for name, frames in roles.items()}


OF_NETWORKS = {"model/branch": "vgg16", "model/head": "fc500_500_5"}
"""The groups of the jobs that have a network."""


@dataclass(frozen=True, kw_only=True)
class RunJob(DataJob):
    """Base of the jobs that describe images for a run.

    Attributes:
        folder: folder of the run.
        model: the architecture of the network, to make sure that the run's network has it.
        checkpoint: checkpoint of the network: best on the validation sequence, or last; best falls back to last.
        device: device on which networks compute: "auto", "cpu", or a GPU such as "cuda:0".
        descriptor: a network or an analytic descriptor; or a list of several, which are fused.
        heading: the descriptor that estimates headings for a network that cannot.
        distance: how descriptors are compared; the descriptor's default if None.
        mounting: how the camera is mounted; the map estimates it if nothing is said.
        build: how the frames of the map are grouped into nodes.
        seed: seed of all random draws.
    """

    GROUPS: ClassVar[Mapping[str, str]] = {
        **DataJob.GROUPS,
        **OF_NETWORKS,
        **{"descriptor": "network", "heading": "none", "build": "none"},
    }
    SHARED = True
    REPLACES_MAP: ClassVar[bool] = False

    folder: Folder | None = None
    model: Model
    checkpoint: Literal["best", "last"] = "best"
    device: Device = "auto"
    descriptor: DescriptorChoice
    heading: Heading
    distance: Literal["manhattan", "euclidean", "correlation", "cosine"] | None = None
    mounting: GivenMounting = field(default_factory=GivenMounting)
    build: Build
    seed: Seed = 0

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any], given: Given | None = None) -> Kind:
        """Make a job from plain values, as `Job.of`; a list of names as the descriptor stands for all of them fused."""
        if isinstance(values.get("descriptor"), list | tuple):
            values = {**values, "descriptor": SIGN.join(distinct(values["descriptor"]))}
        return super().of(values, given)

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return values together with the settings of the run."""
        values = super().completed(values, given)
        chosen = values["descriptor"]
        if values.get("run") is not None:
            told = cls.REPLACES_MAP or any(key.partition(".")[0] == "descriptor" for key in given.keys)
            own = chosen.get("name") == "network" and chosen.get("run") is None
            loaded = only_map(Run(Path(str(values["run"])))) if own and not told else {}
            for file, known in loaded.items():
                values = {**values, "descriptor": descriptor_of(file, known.identity) or chosen}
            replaces = cls.REPLACES_MAP and not (values.get("update") or {}).get("sequences")
            values = with_settings_of_the_run(values, given, cls.key_names(), replaces_map=replaces, loaded=loaded)
        elif set(names_in(chosen)) & set(OF_A_RUN) and chosen.get("run") is None:
            otherwise = "train one first with `siamloc train run=FOLDER`, or choose a descriptor that needs none"
            raise ConfigError(f"no run is named: {suggested_run(f'{otherwise}, descriptor=hog')}")
        if "pretrained" in names_in(values["descriptor"]) and "data.image_size" not in given.keys:
            values["data"] = {**values["data"], "image_size": list(PRETRAINED_SIZE)}
        return values

    @cached_property
    def titles(self) -> dict[str, str]:
        """The titles of the descriptor and of the build, by group, for the names of folders and rows of tables."""
        return {"descriptor": self.descriptor.title, "build": self.build.title}

    @cached_property
    def here(self) -> Run:
        """The run that the job works on; for analytic descriptors without a run, the job's own folder."""
        if self.folder is not None:
            return Run(Path(self.folder))
        return Run(Path("runs") / (self.data.name or "data") / self.descriptor.title)

    @property
    def named(self) -> dict[str, Any]:
        """The settings by which further commands find the map of the job: its run, descriptor and code of your own."""
        described = words_of("descriptor", self.descriptor)
        chosen = {} if described == {"descriptor": "network"} else described
        return {"run": str(self.here.folder), **chosen, **self.own_camera, **self.model.branch.own}

    def layer_folder(self, label: str) -> Path:
        """Return the folder of the coarse layer over the map with this label."""
        return own_folder(self.here.layer(label, self.build.title), self.titles, of_layer)

    def group(self, known: VisualMap, folder: Path) -> Built:
        """Group the frames of a map into nodes, which are written into a folder; or read them there if they fit."""
        from siamloc import maps

        built = maps.group(known, self.build.name, folder=folder, seed=self.seed, **self.build.parameters)
        self.here.record_written(files_in(folder))
        return built

    def make_descriptor(self, chosen: DescriptorChoice | None = None) -> Descriptor:
        """Make a descriptor, by default the job's; a network computes on the job's device."""
        chosen = chosen or self.descriptor
        if chosen.name in DESCRIPTORS:
            return descriptor(chosen.name, **chosen.parameters, circular=self.data.circular)
        if chosen.name == Fused.name:
            parts = {name: self.make_descriptor(by_name(name)) for name in names_in(chosen.parameters)}
            weights = chosen.parameters.get("weights")
            return Fused(parts, None if weights is None else dict(zip(parts, weights, strict=True)))
        from siamloc import models

        if chosen.name == "pretrained":
            self._check_size(PRETRAINED_SIZE, "the network that ships with siamloc")
            return models.as_descriptor(models.pretrained(circular=self.data.circular), self.device)
        if chosen.name == "frozen":
            frozen = models.build(image_size=self.data.image_size, **Frozen.of(chosen.parameters).plain())
            return models.as_descriptor(frozen, self.device)
        trained = Run(Path(chosen.parameters["run"])) if chosen.parameters.get("run") else self.here
        network = models.load(trained, which="untrained" if chosen.name == "untrained" else self.checkpoint)
        self._check_architecture(network, trained, own=trained == self.here)
        return models.as_descriptor(network, self.device)

    def for_evaluation(self, protocol: Protocol, read: Callable[[], FrameTable], *roles: str) -> dict[str, Any] | None:
        """Return the settings of a protocol that an evaluation needs and the run does not store.

        Roles without frames get a drive of the frames to be read that no other role has; None if too few are left.
        """
        if missing := [role for role in roles if getattr(protocol, role).sequences is None]:
            frames = read()
        for role in missing:
            if not (free := protocol.without_role(frames)):
                return None
            protocol = replace(protocol, **{role: replace(getattr(protocol, role), sequences=(free[0],))})
        return self.not_stored(protocol, "train", "map")

    def not_stored(self, protocol: Protocol, *without: str) -> dict[str, Any]:
        """Return the settings of a protocol that the run does not store, by their keys, without those of some roles."""
        stored = self.here.settings.get("protocol", {}) if self.here.record.is_file() else {}
        found = dict(leaves(Protocol.of(stored).plain()))
        needed = {key: value for key, value in leaves(protocol.plain()) if key.partition(".")[0] not in without}
        return {f"protocol.{key}": value for key, value in needed.items() if value != found[key]}

    @property
    def learned_from(self) -> list[str]:
        """The roles of the frames from which a map's descriptor is learned: validation frames, for fused weights."""
        learns = self.descriptor.name == Fused.name and self.descriptor.parameters.get("weights") is None
        return ["validation"] if learns and self.protocol.validation != Role() else []

    def load_map(self, path: Path, described: Descriptor) -> VisualMap | None:
        """Load a saved map; None if there is none.

        Raises:
            ConfigError: a map with another mounting than the one that is given.
        """
        from siamloc.maps import VisualMap

        known = VisualMap.load(path, described) if path.is_file() else None
        if known is not None and self.mounting.known not in (None, known.mounting):
            raise ConfigError(
                f"{path} was made with another mounting of the camera ({as_words(known.mounting.plain())}): run "
                "`siamloc map` again with the intended mounting keys, or leave them out"
            )
        return known

    def make_heading(self, say: Say) -> Descriptor | None:
        """Make the descriptor that estimates headings; None without one, or if the job's descriptor estimates them."""
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


def by_name(name: str) -> DescriptorChoice:
    """Return the choice of a descriptor that is given by its name alone, such as a part of a fused one.

    Raises:
        ConfigError: an unknown name, or a descriptor that needs further keys.
    """
    values = option("descriptor", name).values
    if needed := [key for key, value in values.items() if value == "???"]:
        key = f"descriptor.{needed[0]}"
        raise ConfigError(
            f"{name} cannot be given by its name alone: it needs {key}; choose another descriptor here, or use it by "
            f"itself, descriptor={name} {key}=..."
        )
    return DescriptorChoice.of(values)


def files_in(folder: Path) -> list[Path]:
    """Return all files in a folder, for the record of files written into a run."""
    return sorted(path for path in folder.rglob("*") if path.is_file())
