"""The settings of a training, typed once: keywords of `fit` and defaults of the command line. Loads no torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from siamloc.data.pairs import PairSettings
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.models.registry import Optimizer
from siamloc.settings import Count, Positive, Probability, Seed, Settings, Workers

Monitor = Literal["auto", "error", "recall", "room", "accuracy", "refined", "loss"]


@dataclass(frozen=True)
class Training(Settings):
    """How a network is trained.

    Attributes:
        epochs: how often `pairs.epoch_pairs` pairs, or `pairs.epoch_batches` batches of places, are drawn and learned
            from.
        batch_size: pairs in a step; batches of places have `pairs.places * pairs.images` images.
        seed: of the pairs and of their augmentation; that of the first weights belongs to `siamloc.models.build`.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        pairs: which pairs of frames, with which labels: `PairSettings`; or batches of places, all of whose pairs are
            learned from: `PlaceSettings`.
        optimizer: how the weights are updated.
        margin: of the contrastive loss; a loss of your own has its own.
        clip: length that the gradient is cut to; not cut if None.
        average: decay of the moving average of the weights, which is what is kept; no average if None.
        monitor: figure of the validation by which the checkpoint is chosen: "error", the mean error of localization;
            "recall", the share of queries found within `recall_radius`; "room", the share whose room is found;
            "accuracy", the share whose room `CrossEntropyLoss` names, with which it is the choice of "auto";
            "refined", the mean error of poses by comparison, of a network with relative=True; "loss", that of pairs, as
            published. "auto" is the refined error for such a network, and the error for others, where both sides have
            positions (with pairs, where they are of different drives, too); otherwise the loss with pairs, and the
            rooms with batches of places.
        recall_radius: a query is found if the map frame with the nearest descriptor lies this near, in the unit of the
            positions.
        patience: epochs without a better validation after which the training stops early; it never does if None. A
            one-cycle schedule ends with the last epoch, so that a training which stops before it has hardly settled.
        checkpoint_every: steps after which the last checkpoint is written within an epoch as well; at the end of each
            epoch, and when the training is stopped, if None.
        augment_where: "cpu": pictures are changed where batches are gathered; "gpu": after they have come to the
            device; "auto": the second on a GPU. The draws are the same, the pictures up to rounding.
        compile: let torch compile the network for training steps, which takes a while at the start; "auto" on a GPU
            only. Results differ by rounding, and by what dropout draws.

    Example:
        >>> Training(epochs=2, optimizer={"name": "adam"}).optimizer.name
        'adam'
    """

    epochs: Count = 30
    batch_size: Count = 16
    seed: Seed = 0
    workers: Workers = 0
    pairs: PairSettings | PlaceSettings = field(default_factory=PairSettings)
    optimizer: Optimizer = field(default_factory=Optimizer)
    margin: Positive = 2.0
    clip: Positive | None = None
    average: Probability | None = None
    monitor: Monitor = "auto"
    recall_radius: Positive = 0.5
    patience: Count | None = None
    checkpoint_every: Count | None = None
    augment_where: Literal["auto", "cpu", "gpu"] = "auto"
    compile: Literal["auto"] | bool = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.pairs, PlaceSettings):
            if self.monitor == "loss":
                raise ConfigError(
                    "monitor=loss is the loss of pairs, and batches of places have no loss of the validation: choose "
                    "auto, error, recall, room, accuracy or refined"
                )
            for name, instead in (("batch_size", "pairs.places and pairs.images"), ("margin", "a loss of its own")):
                if getattr(self, name) != getattr(Training, name):
                    raise ConfigError(f"{name} is of pairs, and batches of places have {instead}: leave it out")
