"""Groups of a job whose keys depend on an option: a loss, an augmentation, a descriptor, headings, nodes, a network."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from siamloc.errors import ConfigError, check_known, hint
from siamloc.models.registry import LOSSES, NORMALIZATIONS, Contrastive, Outputs, branch_spec, head_widths
from siamloc.settings import Count, Natural, Rule, Settings, Share, Text, Workers, checked, fields_of

Kind = TypeVar("Kind", bound="Choice")
Folder = Annotated[str, Rule("the name of a folder", lambda value: bool(value.strip()))]
Device = Annotated[str, Rule("auto, cpu or cuda", lambda value: re.fullmatch(r"auto|cpu|cuda(:\d+)?", value))]
Listed = Annotated[str, Rule("numbers between commas", lambda value: bool(re.fullmatch(r"\d+(,\d+)*,?", value)))]
Devices = Annotated[tuple[Natural, ...], Rule("a list of one number or more", lambda value: len(value) > 0)]
NETWORKS = ("network", "untrained", "pretrained")
"""Descriptors that are networks."""


@dataclass(frozen=True)
class Choice(Settings):
    """An option of a group by its name, with its parameters.

    Attributes:
        name: of the option.
        parameters: of the option, as plain values.
        label: name in folders and tables in place of the option's.
    """

    LABELLED: ClassVar[bool] = False

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    label: str | None = None

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any]) -> Kind:
        """Read an option from its name and parameters in one mapping.

        Raises:
            ConfigError: an unknown name or parameter, or a value of the wrong type or out of range.
        """
        given = dict(values)
        name = checked(given.pop("name", None), Text, f"{cls.WHERE}.name")
        label = checked(given.pop("label", None), Text | None, f"{cls.WHERE}.label") if cls.LABELLED else None
        if name not in (valid := cls.names()):
            raise ConfigError(f"unknown {cls.WHERE} {name!r}: {hint(name, valid)}")
        cls.check(name, given)
        return cls(name, given, label)

    @classmethod
    def names(cls) -> Iterable[str]:
        """Return the names of the options."""
        raise NotImplementedError

    @classmethod
    def check(cls, name: str, parameters: Mapping[str, Any]) -> None:
        """Check the parameters of an option."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """The label, else the name."""
        return self.label or self.name

    def plain(self) -> dict[str, Any]:
        """Return the name and the parameters in one mapping, which `of` can read."""
        return {"name": self.name, **self.parameters, **({} if self.label is None else {"label": self.label})}


class Loss(Choice):
    """The loss of a training."""

    WHERE = "loss"

    @classmethod
    def names(cls) -> Iterable[str]:
        """Return the names of the losses."""
        return ("contrastive", *LOSSES)

    @classmethod
    def check(cls, name: str, parameters: Mapping[str, Any]) -> None:
        """Check the parameters of a loss."""
        (LOSSES[name][0] if name in LOSSES else Contrastive).of(parameters)


class Build(Choice):
    """How the frames of a map are grouped into nodes."""

    WHERE = "build"
    LABELLED = True

    @classmethod
    def names(cls) -> Iterable[str]:
        """Return the names of the ways of grouping."""
        from siamloc.maps.grouping import WAYS

        return ("none", *WAYS)

    @classmethod
    def check(cls, name: str, parameters: Mapping[str, Any]) -> None:
        """Check the parameters of a way of grouping."""
        from siamloc.maps.grouping import WAYS

        if name == "none":
            check_known(parameters, ["name", "label"], "build")
        else:
            WAYS[name].of(parameters)


class DescriptorChoice(Choice):
    """The descriptor of a map: a network or an analytic one."""

    WHERE = "descriptor"
    LABELLED = True

    @classmethod
    def names(cls) -> Iterable[str]:
        """Return the names of the descriptors."""
        from analytic import DESCRIPTORS

        return (*NETWORKS, *DESCRIPTORS)

    @classmethod
    def check(cls, name: str, parameters: Mapping[str, Any]) -> None:
        """Check the parameters of a descriptor."""
        if name in NETWORKS:
            check_known(parameters, ["run"] if name == "network" else [], "descriptor")
            checked(parameters.get("run"), Text | None, "descriptor.run")
        else:
            _check_analytic(name, parameters, "descriptor")

    @property
    def by_network(self) -> bool:
        """Whether it is the network of a run."""
        return self.name in ("network", "untrained")


class Heading(Choice):
    """The descriptor that estimates headings for a network that cannot."""

    WHERE = "heading"

    @classmethod
    def names(cls) -> Iterable[str]:
        """Return the names of the descriptors."""
        from analytic import DESCRIPTORS

        return ("none", *DESCRIPTORS)

    @classmethod
    def check(cls, name: str, parameters: Mapping[str, Any]) -> None:
        """Check the parameters of a descriptor."""
        if name == "none":
            check_known(parameters, [], "heading")
        else:
            _check_analytic(name, parameters, "heading")


def _check_analytic(name: str, parameters: Mapping[str, Any], where: str) -> None:
    """Check the parameters of an analytic descriptor; `circular` follows from the data."""
    from analytic import descriptor
    from analytic.descriptors.registry import parameters as every

    check_known(parameters, set(every(name)) - {"circular"}, where)
    descriptor(name, **parameters)


@dataclass(frozen=True)
class Augment(Settings):
    """How the images of a training are augmented.

    Attributes:
        policy: the policy, as plain values.
        where: "cpu", "gpu" or "auto": see `siamloc.training.Training`.
    """

    WHERE = "augment"

    policy: Mapping[str, Any]
    where: Literal["auto", "cpu", "gpu"] = "auto"

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Augment:
        """Read the keys of a policy and `where` from one mapping.

        Raises:
            ConfigError, AugmentError: an unknown key, or a value of the wrong type or out of range.
        """
        policy = dict(values)
        where = policy.pop("where", "auto")
        if checked(policy.get("name"), Text, "augment.name") == "none":
            check_known(policy, ["name"], "augment")
            return cls(policy, where)
        checked(policy.get("rotate"), Share | None, "augment.rotate")
        from siamloc.training.fitting import effect_of

        effect_of(policy, circular=True)
        return cls(policy, where)

    def plain(self) -> dict[str, Any]:
        """Return the keys of the policy and `where` in one mapping, which `of` can read."""
        return {**self.policy, "where": self.where}


@dataclass(frozen=True)
class Loader(Settings):
    """How images are loaded.

    Attributes:
        workers: processes that gather batches; 0 gathers in the training process.
    """

    WHERE = "loader"

    workers: Workers = 0


@dataclass(frozen=True)
class Branch(Settings):
    """The branch of a network.

    Attributes:
        name: of the branch.
        weights: imagenet or siamloc, or the path of a run or of a file of weights; random if None.
    """

    WHERE = "model.branch"

    name: Text
    weights: Text | None = None


@dataclass(frozen=True)
class Head(Settings):
    """The head of a network.

    Attributes:
        name: of the head.
        outputs: length of a descriptor, for heads of one layer; the head's own if None.
    """

    WHERE = "model.head"

    name: Text
    outputs: Outputs | None = None


@dataclass(frozen=True)
class Model(Settings):
    """A network; see `siamloc.models.build`.

    Attributes:
        branch: the convolutional part.
        head: turns features into a descriptor.
        circular: convolutions wrap around the azimuth; refused with data.circular=false.
        normalize: channels, image, local or local_brightness; the default of the branch if None.
        canonical: turn panoramas first, so that a turn by whole columns changes nothing; for circular=true.
        relative: also learn where an image was taken relative to a map frame; for circular=true.
    """

    WHERE = "model"

    branch: Branch
    head: Head
    circular: bool = False
    normalize: Text | None = None
    canonical: bool = False
    relative: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        branch_spec(self.branch.name)
        head_widths(self.head.name, self.head.outputs)
        if self.normalize is not None and self.normalize not in NORMALIZATIONS:
            raise ConfigError(f"unknown normalization {self.normalize!r}: {hint(self.normalize, NORMALIZATIONS)}")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `siamloc.models.build`."""
        own = {key: getattr(self, key) for key in ("circular", "normalize", "canonical", "relative")}
        branch = {"branch": self.branch.name, "weights": self.branch.weights}
        return {**branch, "head": self.head.name, "outputs": self.head.outputs, **own}


@dataclass(frozen=True)
class TrainerKeys(Settings):
    """Arguments of Lightning's Trainer; it checks those without an attribute here itself.

    Attributes:
        further: other arguments of Lightning's Trainer.
    """

    WHERE = "trainer"

    accelerator: Text = "auto"
    devices: Count | Literal["auto", -1] | Devices | Listed = 1
    num_nodes: Count = 1
    strategy: Text | None = "auto"
    precision: Text | Literal[16, 32, 64] | None = "32-true"
    log_every_n_steps: Natural = 10
    further: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> TrainerKeys:
        """Read arguments of the Trainer from one mapping.

        Raises:
            ConfigError: an argument that the Trainer does not have, or a value of the wrong type.
        """
        own = set(fields_of(cls)) - {"further"}
        if further := {key: value for key, value in values.items() if key not in own}:
            from augment.torchvision_compat import ensure_torchvision

            ensure_torchvision()
            from lightning.pytorch import Trainer

            check_known(further, inspect.signature(Trainer).parameters, "trainer")
        return cls(**{key: value for key, value in values.items() if key in own}, further=further)

    def plain(self) -> dict[str, Any]:
        """Return all arguments in one mapping, which `of` can read."""
        values = super().plain()
        further = values.pop("further")
        return {**values, **further}
