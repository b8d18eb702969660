"""The settings of a training: keywords of `fit` and defaults of the command line. Loads no torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from foundation.settings import Count, Positive, Probability, Seed, Settings, Workers
from siamloc.data.pairs import PairSettings
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.models.registry import Contrastive, Optimizer

Monitor = Literal["auto", "error", "recall", "room", "accuracy", "refined", "loss"]


_OF_PAIRS = "{} is of pairs, and batches of places have {}: leave it out"


@dataclass(frozen=True)
class Learning(Settings):
    """Settings of a training that have the same names on the command line.

    Attributes:
        epochs: number of epochs, each of `pairs.epoch_pairs` pairs, or `pairs.epoch_batches` batches of places.
        batch_size: pairs per step; batches of places have `pairs.places * pairs.images` images.
        seed: seed of the pairs and their augmentation; `siamloc.models.build` has its own for the initial weights.
        pairs: which pairs of frames with which labels (`PairSettings`), or which batches of places, where all pairs in
            a batch are used (`PlaceSettings`).
        optimizer: algorithm, learning rate and schedule with which the weights are updated.
        clip: length to which the gradient is clipped; no clipping if None.
        average: decay of the moving average of the weights, which is then the result; no average if None.
        monitor: validation figure by which the checkpoint is chosen: "error", the mean localization error; "recall",
            the share of queries found within `recall_radius`; "room", the share whose room is found; "accuracy", the
            share whose room `CrossEntropyLoss` names correctly, the choice of "auto" with that loss; "refined", the
            mean error of poses by comparison, for a network with relative=True; "loss", the pairs' loss, as published.
            "auto" is the refined error for a network with relative=True, and the error for other networks, if training
            and validation frames have positions (and, with pairs, come from different drives); otherwise the loss with
            pairs, and the rooms with batches of places.
        recall_radius: a query is found if the map frame with the nearest descriptor is this near, in the unit of the
            positions.
        patience: epochs without a better validation after which the training stops early; never if None. A one-cycle
            schedule ends with the last epoch, so a training that stops earlier has hardly settled.
        checkpoint_every: number of steps after which the last checkpoint is also written within an epoch; if None, only
            at the end of each epoch, and when the training is stopped.
        compile: let torch compile the network for training steps, which takes a while at the start; "auto" does so
            only on a GPU. Results differ by rounding, and by the draws of dropout.
    """

    epochs: Count = 30
    batch_size: Count = 16
    seed: Seed = 0
    pairs: PairSettings | PlaceSettings = field(default_factory=PairSettings)
    optimizer: Optimizer = field(default_factory=Optimizer)
    clip: Positive | None = None
    average: Probability | None = None
    monitor: Monitor = "auto"
    recall_radius: Positive = 0.5
    patience: Count | None = None
    checkpoint_every: Count | None = None
    compile: Literal["auto"] | bool = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.pairs, PlaceSettings):
            if self.monitor == "loss":
                raise ConfigError(
                    "monitor=loss is the loss of pairs, and batches of places have no loss of the validation: choose "
                    "auto, error, recall, room, accuracy or refined"
                )
            if self.batch_size != Learning.batch_size:
                raise ConfigError(_OF_PAIRS.format("batch_size", "pairs.places and pairs.images"))


@dataclass(frozen=True)
class Training(Learning):
    """Settings for training a network.

    Attributes:
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        margin: margin of the contrastive loss; a custom loss has its own.
        augment_where: "cpu": images are augmented where batches are gathered; "gpu": after transfer to the device;
            "auto": "gpu" if training runs on a GPU. The random draws are the same, the images equal up to rounding.

    Example:
        >>> Training(epochs=2, optimizer={"name": "adam"}).optimizer.name
        'adam'
    """

    workers: Workers = 0
    margin: Positive = Contrastive.margin
    augment_where: Literal["auto", "cpu", "gpu"] = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.pairs, PlaceSettings) and self.margin != Contrastive.margin:
            raise ConfigError(_OF_PAIRS.format("margin", "a loss of its own"))
