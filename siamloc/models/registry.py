"""Branches, heads, losses and optimizers by name ([T] tables 5.1 and 5.2). Loads no torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

from foundation.errors import known
from foundation.settings import Natural, NotNegative, Positive, Rule, Settings, Share, Size, Text, checked
from siamloc.errors import ConfigError, hint

Normalization = Literal["channels", "image", "local", "local_brightness", "local_and_colours"]
NORMALIZATIONS: tuple[Normalization, ...] = get_args(Normalization)
"""Normalizations of the images before the branch, see `siamloc.models.build`."""


@dataclass(frozen=True)
class BranchSpec:
    """How a branch is made.

    Attributes:
        kind: "torchvision", whose name there is the key in `BRANCHES`; "simple" or "residual".
        widths: outputs of the convolutions of a simple branch, and of the stages of a residual one.
        normalize: default normalization of images, see `siamloc.models.build`.
        summary: one line for the help.
    """

    kind: Literal["torchvision", "simple", "residual"] = "torchvision"
    widths: tuple[int, ...] = ()
    normalize: Normalization = "channels"
    summary: str = "The convolutions of torchvision's network ([T] table 5.1)."


_SIMPLE = "Three convolutions with {} outputs ([T] table 5.1)."
_OURS = "A small residual network of ours, for training from random weights."
_OURS_WIDE = "The same with half as many channels again in each layer."

PRETRAINED = Path(__file__).parent / "shipped" / "panoramas.safetensors"
"""The weights that ship with siamloc; the model card next to them describes them."""

PRETRAINED_SIZE = (64, 256)
"""Rows and columns of the panoramas for these weights."""

BANDS, HUES, SATURATIONS, VALUES = 4, 24, 8, 8
COLOURS = BANDS * (HUES * SATURATIONS + VALUES)
"""Number of values by which a network with colours=True describes the colours, after those that are learned."""

PRETRAINED_ELEVATIONS = (30.0, -45.0)
"""Elevations in degrees of the upper and the lower edge of these panoramas."""

BRANCHES: dict[str, BranchSpec] = {
    "simple1": BranchSpec("simple", (3, 8, 16), summary=_SIMPLE.format("3, 8, 16")),
    "simple2": BranchSpec("simple", (3, 16, 32), summary=_SIMPLE.format("3, 16, 32")),
    "alexnet": BranchSpec(),
    "densenet121": BranchSpec(),
    **{f"vgg{depth}{suffix}": BranchSpec() for suffix in ("", "_bn") for depth in (11, 13, 16, 19)},
    "panoresnet": BranchSpec("residual", (32, 64, 128, 192), "image", summary=_OURS),
    "panoresnet_wide": BranchSpec("residual", (48, 96, 192, 288), "image", summary=_OURS_WIDE),
}
"""The feature extractors of [T] table 5.1, `*_bn` with batch normalization after each convolution; and `panoresnet`,
our own small residual network for training from random weights, and `panoresnet_wide` with wider layers."""


@dataclass(frozen=True)
class HeadSpec:
    """How a head is made.

    Attributes:
        widths: neurons of the layers; the last number is the length of a descriptor, which can be chosen if there is
            one layer.
        kind: name of the class in `siamloc.models.heads`.
        summary: one line for the help.
    """

    widths: tuple[int, ...]
    kind: str = "FullyConnected"
    summary: str = "Fully connected layers ([T] table 5.2)."


_LAYERS = ((500, 500, 5), (500, 100, 10), (1000, 1000, 10), (4096, 4096, 1000))
_SOFTMAX = "The same layers, then a softmax: our reading of the softmax layer in [T] 5.3."

HEADS: dict[str, HeadSpec] = {
    **{f"fc{a}_{b}_{c}": HeadSpec((a, b, c)) for a, b, c in _LAYERS},
    **{f"fc{a}_{b}_{c}_softmax": HeadSpec((a, b, c), "SoftmaxHead", _SOFTMAX) for a, b, c in _LAYERS},
    "fc4096_4096": HeadSpec((4096, 4096), summary="Two layers, as in AlexNet before its class layer."),
    "flat": HeadSpec((256,), "Flat", "One layer over all features: what is seen where, relative to the robot."),
    "gem": HeadSpec((256,), "GeneralizedMean", "The generalized mean of each channel, then one layer."),
    "bands": HeadSpec((256,), "Bands", "The generalized mean of each row of each channel, then one layer."),
    "fourier": HeadSpec((256,), "Fourier", "Fourier magnitudes along the azimuth, then one layer."),
    "magnitudes": HeadSpec((2048,), "Magnitudes", "Fourier magnitudes along the azimuth, without weights."),
}
"""Three fully connected layers in versions 1 to 4 of [T] table 5.2, also with a softmax after the last; two layers as
in AlexNet before its class layer, with the descriptor of 4096 numbers in [T] table 5.19; and heads with descriptors of
unit length. The descriptors of the head `magnitudes` are shorter than 2048 if the features of small images have fewer
magnitudes."""


Outputs = Annotated[int, Rule("a whole number from 1 to 65,536", lambda value: 1 <= value <= 65_536)]
BelowOne = Annotated[float, Rule("a number from 0 to below 1", lambda value: 0 <= value < 1)]


@dataclass(frozen=True)
class Optimizer(Settings):
    """How the weights are updated; the defaults are those of [T] 5.3.

    Attributes:
        name: "sgd", "adam" or "adamw".
        learning_rate: step size.
        momentum: momentum of "sgd"; decay of the first moment (beta 1) of "adam" and "adamw".
        weight_decay: share of a weight that each step removes, times the learning rate.
        schedule: "constant"; or "one_cycle": the learning rate rises to `learning_rate` and falls to almost 0, each
            along half a cosine, over the whole training ([Smith 2018]).
        warm_up: share of the steps in which the learning rate rises.
        frozen_stages: number of stages, starting at the image, that are not trained, including the statistics of their
            batch normalizations; `siamloc.models.stages` lists the stages.
    """

    WHERE = "optimizer"

    name: Literal["sgd", "adam", "adamw"] = "sgd"
    learning_rate: Positive = 0.001
    momentum: BelowOne = 0.9
    weight_decay: NotNegative = 0.0
    schedule: Literal["constant", "one_cycle"] = "constant"
    warm_up: BelowOne = 0.2
    frozen_stages: Natural = 0


OPTIMIZERS: dict[str, tuple[Optimizer, str]] = {
    "sgd": (Optimizer(), "Stochastic gradient descent with momentum ([T] 5.3.4)."),
    "adamw": (
        Optimizer(name="adamw", weight_decay=0.01, schedule="one_cycle"),
        "AdamW over one cycle of the learning rate, for training from random weights.",
    ),
}
"""Optimizers by name, with one line each for the help."""


@dataclass(frozen=True)
class SoftContrastive(Settings):
    """All pairs of a batch: the nearer two images were taken, the more alike (`SoftContrastiveLoss`).

    Attributes:
        temperature: temperature of the softmax over the similarities of descriptors of unit length.
        kernel: how similar two images should be at a distance x: "gaussian", exp(-x^2 / 2 sigma^2), or "exponential",
            exp(-x / sigma), which distinguishes the nearest from the second nearest and still tells apart those beyond;
            or "overlap", v^(1 / sigma) for images with the share v of visible surfaces in common, only for pretraining.
        sigma: width of the kernel, in the unit of the positions; for "overlap" without a unit.
        sigma_start: width at the beginning of a training; each step multiplies it by the same factor, so that it is
            `sigma` in the last step. The same width throughout if None.
        room: share of the target that is spread equally over all images of the same room. The rest follows the kernel,
            and then excludes images of other rooms. With 1 this is the supervised contrastive loss on rooms
            ([Khosla 2020]), which needs no positions.
        beyond: distances, in the unit of the positions. For each, the loss has a further term, without images that are
            nearer to each other: how alike the others should be follows from their visual overlap. So a network also
            learns to find a place where the map has no frame near it; only for pretraining.
    """

    WHERE = "loss"

    temperature: Positive = 0.07
    kernel: Literal["gaussian", "exponential", "overlap"] = "gaussian"
    sigma: Positive = 0.4
    sigma_start: Positive | None = None
    room: Share = 0.0
    beyond: tuple[Positive, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.beyond and self.room > 0:
            raise ConfigError("loss.beyond compares surfaces, and loss.room the names of rooms: leave one of them out")


@dataclass(frozen=True)
class MetricCalibrated(Settings):
    """The distance of descriptors grows with that of the images, up to a cap (`MetricCalibratedLoss`).

    Attributes:
        cap: distance from which two images are maximally different, in the unit of the positions.
        cap_start: cap at the beginning of a training; see `sigma_start` of `SoftContrastive`.
    """

    WHERE = "loss"

    cap: Positive = 2.0
    cap_start: Positive | None = None


Miner = Literal["multi_similarity", "batch_hard", "batch_easy_hard"]
Closeness = Literal["cosine", "euclidean", "squared"]


@dataclass(frozen=True)
class NearAndFar(Settings):
    """Which images of a batch are positives and negatives of each other; pairs in between are ignored.

    Attributes:
        near: images up to this far apart are positives of each other, in the unit of the positions.
        far: images farther apart than this are negatives of each other.
        near_start: `near` at the beginning of a training; see `sigma_start` of `SoftContrastive`.
        far_start: `far` at the beginning of a training.
        miner: which of the positives and negatives of an image count; all if None. "multi_similarity": positives less
            similar than the most similar negative, and negatives more similar than the least similar positive, with a
            tolerance of 0.1; "batch_hard": the least similar positive and the most similar negative;
            "batch_easy_hard": the most similar positive, and the most similar of the negatives less similar than it.
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


@dataclass(frozen=True)
class Triplet(NearAndFar):
    """Each image nearer to its positives than to its negatives, by a margin (`TripletLoss`).

    Attributes:
        miner: as for the other losses, or "semihard": triplets whose negative is less similar than the positive, but by
            no more than the margin.
        margin: by how much a negative must be farther away than a positive.
        distance: what the margin refers to, for descriptors of unit length: "euclidean", from 0 to 2; "squared", its
            square; or "cosine", the similarity from 1 to -1, which is 1 minus half the square.
    """

    miner: Literal[Miner, "semihard"] | None = None  # type: ignore[assignment]
    margin: Positive = 0.2
    distance: Closeness = "euclidean"


@dataclass(frozen=True)
class Circle(NearAndFar):
    """The circle loss over near and far images of a batch (`CircleLoss`).

    Attributes:
        m: how far similarities may be from 1 and from 0.
        gamma: scale of the similarities.
        distance: "cosine", the only one for this loss.
    """

    m: Positive = 0.4
    gamma: Positive = 80.0
    distance: Literal["cosine"] = "cosine"


@dataclass(frozen=True)
class MultiSimilarity(NearAndFar):
    """The multi-similarity loss over near and far images of a batch (`MultiSimilarityLoss`).

    Attributes:
        alpha: weight of the positives.
        beta: weight of the negatives.
        base: similarity, or distance, that separates positives from negatives.
        distance: how descriptors of unit length are compared: "cosine", the similarity from 1 to -1; "euclidean",
            from 0 to 2; or "squared", its square.
    """

    alpha: Positive = 2.0
    beta: Positive = 50.0
    base: float = 0.5
    distance: Closeness = "cosine"


@dataclass(frozen=True)
class CrossEntropy(Settings):
    """Name the room of an image by a layer on its descriptor (`CrossEntropyLoss`), best with pairs=frames.

    Attributes:
        temperature: divisor of the room scores. With heads of unit length, small values such as 0.1 make clear
            answers possible.
    """

    WHERE = "loss"

    temperature: Positive = 1.0


@dataclass(frozen=True)
class Distillation(Settings):
    """Images as alike as a larger network finds them, without labels (`DistillationLoss`).

    Attributes:
        teacher: the larger network: "siamloc" for the one that ships with siamloc, a run or a file of weights, or
            timm/NAME or torchvision/NAME.
        weights: weights of a network of timm or torchvision, see `siamloc.models.build`.
        image_size: rows and columns to which images are scaled for a network of timm or torchvision.
    """

    WHERE = "loss"

    teacher: Text = "siamloc"
    weights: Text | None = "cached"
    image_size: Size = (112, 448)


@dataclass(frozen=True)
class Contrastive(Settings):
    """Pairs of images: near ones alike, others apart by a margin ([T] eq. 5.1).

    Attributes:
        margin: distance from which a pair of other places costs nothing.
    """

    WHERE = "loss"

    margin: Positive = 2.0


LOSSES: dict[str, tuple[type[Settings], str]] = {
    "soft_contrastive": (SoftContrastive, "batch_losses.SoftContrastiveLoss"),
    "metric_calibrated": (MetricCalibrated, "batch_losses.MetricCalibratedLoss"),
    "triplet": (Triplet, "near_and_far.TripletLoss"),
    "circle": (Circle, "near_and_far.CircleLoss"),
    "multi_similarity": (MultiSimilarity, "near_and_far.MultiSimilarityLoss"),
    "distillation": (Distillation, "distillation.DistillationLoss"),
    "cross_entropy": (CrossEntropy, "cross_entropy.CrossEntropyLoss"),
}
"""The losses over batches of places by name: the class of their parameters, and their own class in `siamloc.models`."""


BACKBONES = {
    "timm/NAME": "A network of timm, such as timm/resnet18.",
    "torchvision/NAME": "A network of torchvision for classes, such as torchvision/resnet18.",
    "package.module:factory": "A network of your own, which a function or class gives without arguments.",
}
"""Names of branches that siamloc does not define, with one line each for the help; see `siamloc.models.backbones`."""


def is_backbone(name: str) -> bool:
    """Return whether a name has the form of a branch that siamloc does not define."""
    return "/" in name or ":" in name


def branch_spec(name: str) -> BranchSpec:
    """Look up a branch by its name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in BRANCHES:
        raise ConfigError(f"unknown branch {name!r}: {hint(name, BRANCHES)}; or {', '.join(BACKBONES)}")
    return BRANCHES[name]


def head_widths(name: str, outputs: int | None = None) -> tuple[int, ...]:
    """Look up the neurons of a head's layers by its name.

    Args:
        name: a name in `HEADS`.
        outputs: length of a descriptor, for heads of one layer; the head's default if None.

    Raises:
        ConfigError: an unknown name, a number that is not positive, or outputs for a head with a fixed number.
    """
    widths = HEADS[known(name, HEADS, "head")].widths
    if outputs is None:
        return widths
    if len(widths) > 1:
        raise ConfigError(f"the head {name} gives {widths[-1]} numbers, as its name says: leave outputs out")
    return (checked(outputs, Outputs, "outputs"),)
