"""What a network can be made of and trained with, by name ([T] tables 5.1 and 5.2). Loads no torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from siamloc.errors import ConfigError, hint
from siamloc.settings import Natural, NotNegative, Positive, Rule, Settings, Share, checked

Normalization = Literal["channels", "image", "local", "local_brightness"]
NORMALIZATIONS: tuple[Normalization, ...] = get_args(Normalization)
"""What can happen to images before the branch sees them, see `siamloc.models.build`."""


@dataclass(frozen=True)
class BranchSpec:
    """How a branch is made.

    Attributes:
        name: what configurations call it; for a torchvision network its name there.
        kind: "torchvision", "simple" or "residual".
        widths: outputs of the convolutions of a simple branch, and of the stages of a residual one.
        normalize: what happens to images first, see `siamloc.models.build`.
    """

    name: str
    kind: Literal["torchvision", "simple", "residual"] = "torchvision"
    widths: tuple[int, ...] = ()
    normalize: Normalization = "channels"


PRETRAINED = Path(__file__).parent / "shipped" / "panoramas.safetensors"
"""The weights that come with siamloc; the card beside them says what they are."""

PRETRAINED_SIZE = (64, 256)
"""Rows and columns of the panoramas that they are for."""

BRANCHES: dict[str, BranchSpec] = {
    spec.name: spec
    for spec in (
        BranchSpec("simple1", "simple", widths=(3, 8, 16)),
        BranchSpec("simple2", "simple", widths=(3, 16, 32)),
        BranchSpec("alexnet"),
        BranchSpec("densenet121"),
        *(BranchSpec(f"vgg{depth}{suffix}") for suffix in ("", "_bn") for depth in (11, 13, 16, 19)),
        BranchSpec("panoresnet", "residual", widths=(32, 64, 128, 192), normalize="image"),
    )
}
"""The feature extractors of [T] table 5.1, `*_bn` with a batch normalization after each convolution; and `panoresnet`,
a small residual network of ours for training from random weights."""

HEADS: dict[str, tuple[int, ...]] = {
    "fc500_500_5": (500, 500, 5),
    "fc500_100_10": (500, 100, 10),
    "fc1000_1000_10": (1000, 1000, 10),
    "fc4096_4096_1000": (4096, 4096, 1000),
    "fc4096_4096": (4096, 4096),
    "flat": (256,),
    "gem": (256,),
    "bands": (256,),
    "fourier": (256,),
    "magnitudes": (2048,),
}
"""Neurons of the fully connected layers: three in versions 1 to 4 of [T] table 5.2; two in the layers that AlexNet has
before its classes, the descriptor of 4096 numbers in [T] table 5.19; one in the heads that give descriptors of unit
length, whose number of outputs can be chosen. `magnitudes` has no neurons, and so many outputs where its features give
as many numbers."""


Outputs = Annotated[int, Rule("a whole number from 1 to 65,536", lambda value: 1 <= value <= 65_536)]
BelowOne = Annotated[float, Rule("a number from 0 to below 1", lambda value: 0 <= value < 1)]


@dataclass(frozen=True)
class Optimizer(Settings):
    """How the weights are updated; the defaults are those of [T] 5.3.

    Attributes:
        name: "sgd", "adam" or "adamw".
        learning_rate: step size.
        momentum: of "sgd"; for the other two the decay of the first moment (beta 1).
        weight_decay: share of a weight that each step takes away, times the learning rate.
        schedule: "constant"; "one_cycle": the learning rate grows to `learning_rate` and falls to almost 0, each along
            half a cosine, over the whole training ([Smith 2018]); or "cosine": it grows evenly and falls along half a
            cosine ([Loshchilov 2017]).
        warm_up: share of the steps in which it grows.
        frozen_stages: how many stages of the network, from the image on, stay as they are, the statistics of their
            batch normalizations as well; `siamloc.models.stages` lists them.
        stage_decay: what the learning rate of a stage is multiplied with for that of the stage before it. The last
            stage, the head where it has weights, has the full one.
    """

    WHERE = "optimizer"

    name: Literal["sgd", "adam", "adamw"] = "sgd"
    learning_rate: Positive = 0.001
    momentum: BelowOne = 0.9
    weight_decay: NotNegative = 0.0
    schedule: Literal["constant", "one_cycle", "cosine"] = "constant"
    warm_up: BelowOne = 0.2
    frozen_stages: Natural = 0
    stage_decay: Annotated[float, Rule("a number above 0, at most 1", lambda value: 0 < value <= 1)] = 1.0


@dataclass(frozen=True)
class SoftContrastive(Settings):
    """The parameters of `SoftContrastiveLoss`.

    Attributes:
        temperature: of the softmax of the similarities of descriptors of unit length.
        kernel: how alike two images should look, by the distance x between them: "gaussian",
            exp(-x^2 / 2 sigma^2), or "exponential", exp(-x / sigma), which tells the nearest from the second nearest
            and still says something of those beyond.
        sigma: width of the kernel, in the unit of the positions.
        sigma_start: width with which a training begins; from step to step it is multiplied with the same number until
            it is `sigma` in the last one. The same width throughout if None.
        room: share of what is wanted that goes to all images of the same room alike, the rest goes by the kernel, and
            then not to those of other rooms. With 1 it is the supervised contrastive loss of the rooms ([Khosla 2020]),
            which needs no positions.
    """

    WHERE = "loss"

    temperature: Positive = 0.07
    kernel: Literal["gaussian", "exponential"] = "gaussian"
    sigma: Positive = 0.4
    sigma_start: Positive | None = None
    room: Share = 0.0


@dataclass(frozen=True)
class MetricCalibrated(Settings):
    """The parameters of `MetricCalibratedLoss`.

    Attributes:
        cap: distance from which two images are as different as can be, in the unit of the positions.
        cap_start: what the cap is at the beginning of a training, as `sigma_start` of `SoftContrastive`.
    """

    WHERE = "loss"

    cap: Positive = 2.0
    cap_start: Positive | None = None


Miner = Literal["multi_similarity", "batch_hard", "batch_easy_hard", "semihard"]
Closeness = Literal["cosine", "euclidean", "squared"]


@dataclass(frozen=True)
class NearAndFar(Settings):
    """Which images of a batch belong together, and which do not; of those in between nothing is wanted.

    Attributes:
        near: images up to this far apart are positives of each other, in the unit of the positions.
        far: images farther apart than this are negatives of each other.
        near_start: what `near` is at the beginning of a training, as `sigma_start` of `SoftContrastive`.
        far_start: what `far` is at the beginning of a training.
        miner: which of the positives and negatives of an image count; all if None. "multi_similarity": positives less
            alike than the most alike negative, and negatives more alike than the least alike positive, or by at most
            0.1 the other way; "batch_hard": the least alike positive and the most alike negative; "batch_easy_hard":
            the most alike positive, and the most alike of the negatives less alike than that one; "semihard": triplets
            whose negative is less alike than the positive, but by no more than the margin.
    """

    WHERE = "loss"

    near: NotNegative = 0.3
    far: NotNegative = 1.0
    near_start: Positive | None = None
    far_start: Positive | None = None
    miner: Miner | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.far < self.near:
            raise ConfigError(f"loss.far, {self.far:g}, must not be less than loss.near, {self.near:g}")
        for name, start, last in (("near", self.near_start, self.near), ("far", self.far_start, self.far)):
            if start is not None and last == 0:
                raise ConfigError(f"loss.{name}_start shrinks by equal factors, never to 0: set loss.{name} above 0")
        near, far = self.near_start or self.near, self.far_start or self.far
        if far < near:
            raise ConfigError(
                f"far begins with {far:g}, which must not be less than what near begins with, {near:g}: set "
                "loss.far_start, loss.near_start or both"
            )
        if self.miner == "semihard" and not isinstance(self, Triplet):
            raise ConfigError(
                "loss.miner=semihard goes by the margin between a positive and a negative, which loss=triplet alone "
                "has: choose multi_similarity, batch_hard or batch_easy_hard"
            )


@dataclass(frozen=True)
class Triplet(NearAndFar):
    """The parameters of `TripletLoss`.

    Attributes:
        margin: by which a negative must be farther than a positive.
        distance: what the margin is counted in, of descriptors of unit length: "euclidean", from 0 to 2, "squared",
            its square, or "cosine", the similarity from 1 to -1, which is 1 less half of the square.
    """

    margin: Positive = 0.2
    distance: Closeness = "euclidean"


@dataclass(frozen=True)
class Circle(NearAndFar):
    """The parameters of `CircleLoss`.

    Attributes:
        m: how far from 1 and from 0 similarities may stay.
        gamma: scale of the similarities.
        distance: "cosine"; the loss is made for no other.
    """

    m: Positive = 0.4
    gamma: Positive = 80.0
    distance: Closeness = "cosine"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.distance != "cosine":
            raise ConfigError(
                "the circle loss draws its circle among cosine similarities: set loss.distance to cosine, "
                f"got {self.distance}"
            )


@dataclass(frozen=True)
class MultiSimilarity(NearAndFar):
    """The parameters of `MultiSimilarityLoss`.

    Attributes:
        alpha: weight of the positives.
        beta: weight of the negatives.
        base: similarity, or distance, that tells the two apart.
        distance: what is compared, of descriptors of unit length: "cosine", the similarity from 1 to -1; "euclidean",
            from 0 to 2; or "squared", its square.
    """

    alpha: Positive = 2.0
    beta: Positive = 50.0
    base: float = 0.5
    distance: Closeness = "cosine"


@dataclass(frozen=True)
class CrossEntropy(Settings):
    """The parameters of `CrossEntropyLoss`.

    Attributes:
        temperature: what the scores of the rooms are divided by. With heads of unit length a small one, such as 0.1,
            makes clear answers possible.
    """

    WHERE = "loss"

    temperature: Positive = 1.0


LOSS_SETTINGS: dict[str, type[Settings]] = {
    "soft_contrastive": SoftContrastive,
    "metric_calibrated": MetricCalibrated,
    "triplet": Triplet,
    "circle": Circle,
    "multi_similarity": MultiSimilarity,
    "cross_entropy": CrossEntropy,
}
"""The losses over batches of places, by the names that configurations call them, with their parameters."""


def branch_spec(name: str) -> BranchSpec:
    """Look up a branch by its name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in BRANCHES:
        raise ConfigError(f"unknown branch {name!r}: {hint(name, BRANCHES)}")
    return BRANCHES[name]


def whole_model(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of a network with what older ones leave out; that of a module of one's own as it is."""
    if "branch" not in model:
        return dict(model)
    usual = {
        "outputs": None,
        "circular": False,
        "normalize": branch_spec(model["branch"]).normalize,
        "canonical": False,
        "relative": False,
    }
    return {**usual, **model}


def head_widths(name: str, outputs: int | None = None) -> tuple[int, ...]:
    """Look up the neurons of a head's layers by its name.

    Args:
        name: a name in `HEADS`.
        outputs: length of a descriptor, for heads of one layer; the head's own if None.

    Raises:
        ConfigError: an unknown name, no positive number, or outputs for a head that has its own.
    """
    if name not in HEADS:
        raise ConfigError(f"unknown head {name!r}: {hint(name, HEADS)}")
    if outputs is None:
        return HEADS[name]
    if len(HEADS[name]) > 1:
        raise ConfigError(f"the head {name} gives {HEADS[name][-1]} numbers, as its name says: leave outputs out")
    return (checked(outputs, Outputs, "outputs"),)
