"""Groups of a job whose keys depend on an option: a loss, an augmentation, a descriptor, headings, nodes, a network."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from analytic.descriptors.fused import SIGN, distinct
from foundation.errors import known
from foundation.settings import Count, Natural, NotNegative, Rule, Settings, Share, Text, Workers, checked, fields_of
from siamloc.errors import ConfigError, check_known
from siamloc.models.registry import LOSSES, NORMALIZATIONS, Contrastive, Outputs, branch_spec, head_widths, is_backbone

Kind = TypeVar("Kind", bound="Choice")
Folder = Annotated[str, Rule("the name of a folder", lambda value: bool(value.strip()))]
Device = Annotated[str, Rule("auto, cpu or cuda", lambda value: re.fullmatch(r"auto|cpu|cuda(:\d+)?", value))]
Listed = Annotated[str, Rule("numbers between commas", lambda value: bool(re.fullmatch(r"\d+(,\d+)*,?", value)))]
Devices = Annotated[tuple[Natural, ...], Rule("a list of one number or more", lambda value: len(value) > 0)]
Check = Callable[[Mapping[str, Any]], object]
OF_A_RUN = ("network", "untrained")
"""Names of the descriptors that need the network of a run."""


@dataclass(frozen=True)
class Choice(Settings):
    """An option of a group, chosen by its name, with its parameters.

    Attributes:
        name: name of the option.
        parameters: parameters of the option, as plain values.
        label: name that folders and tables show instead of the option's name.
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
        checks = _checks(cls.WHERE)
        checks[known(name, checks, cls.WHERE)](given)
        return cls(name, given, label)

    @property
    def title(self) -> str:
        """The label if there is one, else the name, or the names of fused descriptors, such as pretrained+hsv."""
        return self.label or SIGN.join(names_in(self.plain()))

    def plain(self) -> dict[str, Any]:
        """Return the name and the parameters in one mapping, which `of` can read."""
        return {"name": self.name, **self.parameters, **({} if self.label is None else {"label": self.label})}


class Loss(Choice):
    """The loss of a training, by its name."""

    WHERE = "loss"


class Build(Choice):
    """How the frames of a map are grouped into nodes."""

    WHERE = "build"
    LABELLED = True


class DescriptorChoice(Choice):
    """The descriptor of a map: a network, an analytic one, or several fused."""

    WHERE = "descriptor"
    LABELLED = True


@dataclass(frozen=True)
class Fusion(Settings):
    """Several descriptors as one; their list is short for it: descriptor=[pretrained,hsv,hog].

    Attributes:
        parts: names of two descriptors or more.
        weights: a weight for each; learned from protocol.validation if None, see `siamloc.maps.build`.
    """

    WHERE = "descriptor"

    parts: tuple[str, ...]
    weights: tuple[NotNegative, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        distinct(self.parts)
        if self.weights is not None and len(self.weights) != len(self.parts):
            raise ConfigError(
                f"descriptor.weights must be {len(self.parts)} numbers, one for each of {', '.join(self.parts)}, got "
                f"{list(self.weights)}"
            )


def names_in(chosen: Mapping[str, Any]) -> list[str]:
    """Return the name of a chosen descriptor, or the names of its parts if it is fused."""
    parts = chosen.get("parts")
    return [str(name) for name in parts] if isinstance(parts, list | tuple) else [str(chosen.get("name"))]


@dataclass(frozen=True)
class Frozen(Settings):
    """A network as it is published, as a descriptor.

    Attributes:
        branch: the network, as for `siamloc.models.build`, such as timm/vit_small_patch14_dinov2.
        weights: its weights, as for `siamloc.models.build`.
        head: a head without weights of its own.
        circular: whether its convolutions wrap around the azimuth.
    """

    WHERE = "descriptor"

    branch: Text
    weights: Text | None = "cached"
    head: Literal["magnitudes"] = "magnitudes"
    circular: bool = False


class Heading(Choice):
    """The descriptor that estimates headings for a network that cannot."""

    WHERE = "heading"


def _checks(where: str) -> Mapping[str, Check]:
    """Return the options of a group by name, each with a function that refuses parameters that it does not have."""
    if where == "loss":
        return {"contrastive": Contrastive.of, **{name: kind.of for name, (kind, _) in LOSSES.items()}}
    if where == "build":
        from siamloc.maps.grouping import WAYS

        return {"none": _only(where), **{name: way.of for name, way in WAYS.items()}}
    plain = dict.fromkeys(("untrained", "pretrained"), _only(where))
    networks = {"network": _only(where, "run"), "frozen": Frozen.of, "fused": Fusion.of, **plain}
    return {**(networks if where == "descriptor" else {"none": _only(where)}), **_analytic(where)}


def _only(where: str, *texts: str) -> Check:
    """Return a function that refuses all parameters except these, whose values are texts."""

    def check(parameters: Mapping[str, Any]) -> None:
        check_known(parameters, texts, where)
        for key, value in parameters.items():
            checked(value, Text | None, f"{where}.{key}")

    return check


def parameters_of(name: str) -> dict[str, Any]:
    """Return the parameters, with defaults, of an analytic descriptor, a name in `analytic.DESCRIPTORS`.

    `circular` is left out: whether columns wrap around follows from the data.
    """
    from analytic.descriptors.registry import parameters

    return {key: value for key, value in parameters(name).items() if key != "circular"}


def _analytic(where: str) -> Mapping[str, Check]:
    from analytic import DESCRIPTORS, descriptor

    def check(name: str, parameters: Mapping[str, Any]) -> None:
        check_known(parameters, parameters_of(name), where)
        descriptor(name, **parameters)

    return {name: partial(check, name) for name in DESCRIPTORS}


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
    """How many processes gather the images of training batches.

    Attributes:
        workers: processes that gather batches; 0 gathers in the training process.
    """

    WHERE = "loader"

    workers: Workers = 0


@dataclass(frozen=True)
class Branch(Settings):
    """The branch of a network.

    Attributes:
        name: a name in `siamloc.models.registry.BRANCHES`, such as "panoresnet"; or timm/NAME, torchvision/NAME or
            package.module:factory.
        weights: imagenet, siamloc, cached or download, or the path of a run or of a file of weights; random if None.
    """

    WHERE = "model.branch"

    name: Text
    weights: Text | None = None

    @property
    def own(self) -> dict[str, str]:
        """The setting that further commands need for a network of your own, since files import no code."""
        return {"model/branch": self.name} if ":" in self.name else {}


@dataclass(frozen=True)
class Head(Settings):
    """The head of a network.

    Attributes:
        name: a name in `siamloc.models.registry.HEADS`, such as "magnitudes".
        outputs: length of a descriptor, for heads of one layer; the head's default if None.
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
        canonical: turn panoramas first, so that a turn by whole columns leaves the descriptor; for circular=true.
        relative: whether to learn where an image was taken relative to a map frame.
        colours: whether to describe colours as well, which are not learned.
    """

    WHERE = "model"

    branch: Branch
    head: Head
    circular: bool = False
    normalize: Text | None = None
    canonical: bool = False
    relative: bool = False
    colours: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if is_backbone(self.branch.name):
            from siamloc.models.backbones import check_backbone

            check_backbone(self.branch.name)
        else:
            branch_spec(self.branch.name)
        head_widths(self.head.name, self.head.outputs)
        if self.normalize is not None:
            known(self.normalize, NORMALIZATIONS, "normalization")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `siamloc.models.build`."""
        branch, head = self.branch, self.head
        named = {"branch": branch.name, "weights": branch.weights, "head": head.name, "outputs": head.outputs}
        return {**vars(self), **named}


@dataclass(frozen=True)
class TrainerKeys(Settings):
    """Arguments of Lightning's Trainer, which itself checks the arguments that are no fields of this class.

    Attributes:
        logger: where curves and settings go: tensorboard, csv, wandb, mlflow, a list of them, or false.
        further: other arguments of Lightning's Trainer.
    """

    WHERE = "trainer"

    accelerator: Text = "auto"
    devices: Count | Literal["auto", -1] | Devices | Listed = 1
    num_nodes: Count = 1
    strategy: Text | None = "auto"
    precision: Text | Literal[16, 32, 64] | None = "32-true"
    log_every_n_steps: Natural = 10
    logger: Text | tuple[Text, ...] | Literal[False] = "tensorboard"
    further: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> TrainerKeys:
        """Read arguments of the Trainer from one mapping.

        Raises:
            ConfigError: an argument that the Trainer does not have, or a value of the wrong type.
        """
        own = set(fields_of(cls)) - {"further"}
        if further := {key: value for key, value in values.items() if key not in own}:
            from siamloc.lightning import Trainer

            check_known(further, inspect.signature(Trainer).parameters, "trainer")
        return cls(**{key: value for key, value in values.items() if key in own}, further=further)

    def plain(self) -> dict[str, Any]:
        """Return all arguments in one mapping, which `of` can read."""
        values = super().plain()
        further = values.pop("further")
        return {**values, **further}
