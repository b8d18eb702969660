"""The `LightningModule` of siamese training ([T] 5.2-5.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from siamloc.errors import ConfigError
from siamloc.models.describing import as_float, margin_of
from siamloc.models.descriptor_checks import checked_descriptors
from siamloc.models.drive_figures import RECALL_RADIUS
from siamloc.models.losses import ContrastiveLoss, check_labels, pair_distance
from siamloc.models.module import NetworkModule, checked_loss
from siamloc.models.network_stages import comparing_weights
from siamloc.models.origins import required
from siamloc.models.registry import Optimizer

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]

_BATCH_KEYS = ("first", "second", "label", "same")
_GROUPS = ("same", "different")
SAME_BELOW = 0.5


class SiameseModule(NetworkModule):
    """Train one network on both images of a pair: loss, optimizer and logging.

    A batch is a dictionary with `first` and `second` (B, 3, H, W), uint8 or floating point in [0, 1]; `label` (B,)
    float32, dissimilarity in [0, 1]; and `same` (B,) bool, True where both images show the same room. uint8
    becomes floating point on the device. Both images go through the network in one pass, so that batch
    normalization sees them together.

    Logged at the end of an epoch: the figures of `pair_figures`, as `train/...` and `val/...`; and in each training
    step its loss, as `loss_step`. If the validation also has batches of map frames and queries, as for a `PlaceModule`,
    the module also logs `val/error` and the other figures of a `PlaceModule`.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        loss: (d0 (B, D), d1 (B, D), y (B,)) -> scalar, the mean over the pairs: a module, whose parameters are
            trained as well, or a function. A `ContrastiveLoss` of margin 2 if None.
        optimizer: how the weights are updated.
        recall_radius: radius of `val/recall`, in the unit of the positions.

    Raises:
        ConfigError: a network that is not a module or was built with relative=True, or a loss that is not callable.

    Example:
        >>> import torch
        >>> from siamloc.models import SiameseModule, build
        >>> module = SiameseModule(build("simple1", "fc500_500_5", (32, 64)), optimizer=Optimizer(learning_rate=0.01))
        >>> first, second = torch.rand(2, 4, 3, 32, 64)
        >>> batch = {"first": first, "second": second, "label": torch.zeros(4), "same": torch.ones(4, dtype=torch.bool)}
        >>> module.training_step(batch, 0).shape
        torch.Size([])
    """

    default_loss = ContrastiveLoss

    def __init__(
        self,
        network: nn.Module,
        loss: Loss | None = None,
        optimizer: Optimizer | None = None,
        recall_radius: float = RECALL_RADIUS,
    ) -> None:
        if comparing_weights(network):
            raise ConfigError(
                "model.relative=true (from Python relative=True) is learned from batches of places, and these are "
                "pairs: set it to false, or train on places as the recipe modern does"
            )
        super().__init__(network, loss, optimizer, recall_radius)
        self._sums: dict[str, dict[str, Tensor]] = {"train": {}, "val": {}}  # of `pair_sums`, over the epoch so far

    def training_step(self, batch: Mapping[str, Tensor], batch_index: int) -> Tensor:
        """Return the loss of a batch of pairs."""
        loss = self._step(batch, "train")
        self.log_step(loss)
        return loss

    def validation_step(self, batch: Mapping[str, Tensor], batch_index: int, dataloader_idx: int = 0) -> None:
        """Add a batch of pairs to the validation figures, or describe a batch of map frames and queries."""
        if "known" in batch:
            self.describe_drive(batch)
        else:
            self._step(batch, "val")

    def on_train_epoch_end(self) -> None:
        """Log the figures of the training epoch."""
        self._log_epoch("train")

    def on_validation_epoch_end(self) -> None:
        """Log the figures of the validation pairs, and the errors of the queries of the validation drive."""
        self._log_epoch("val", self.drive_figures())

    def epoch_sums(self) -> dict[str, Tensor]:
        """Return the sums behind the figures of the current epoch, for a checkpoint within the epoch."""
        return self._sums["train"]

    def load_epoch_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue an epoch with the sums that `epoch_sums` returned for a checkpoint."""
        self._sums["train"] = dict(sums)

    def _step(self, batch: Mapping[str, Tensor], stage: str) -> Tensor:
        required(batch, _BATCH_KEYS, "pairs")
        label = batch["label"]
        check_labels(label, len(batch["first"]))
        images = as_float(torch.cat([batch["first"], batch["second"]]))
        descriptors = checked_descriptors(self.computed(self.network, images), 2 * len(label))
        learned_from = descriptors if stage == "train" else None
        loss = checked_loss(self.loss(*descriptors.chunk(2), label), self.loss, learned_from)
        added = pair_sums(descriptors.detach(), loss.detach(), batch["same"], label, margin_of(self.loss))
        before = self._sums[stage]
        self._sums[stage] = {name: before[name] + value if before else value for name, value in added.items()}
        return loss

    def _log_epoch(self, stage: str, further: Mapping[str, Tensor] | None = None) -> None:
        sums, self._sums[stage] = self._sums[stage], {}
        if self._trainer is not None:
            sums = {name: self.trainer.strategy.reduce(value, reduce_op="sum") for name, value in sums.items()}
        self.log_epoch(stage, {**pair_figures(sums), **(further or {})})


def pair_sums(
    descriptors: Tensor, loss: Tensor, same: Tensor, label: Tensor, margin: float | None
) -> dict[str, Tensor]:
    """Return the sums over a batch of B pairs from which `pair_figures` computes its figures.

    Args:
        descriptors: (2 B, D), of the first images, then of the second images.
        loss: mean over the batch, a scalar.
        same: (B,) bool, True where both images show the same room.
        label: (B,), dissimilarity in [0, 1].
        margin: margin of the loss; None for a loss without a margin.
    """
    distance, values = pair_distance(*descriptors.chunk(2)).double(), descriptors.double()
    groups = torch.stack([same, ~same]).double()
    sums = {
        "count": groups.sum(1),
        "distance": groups @ distance,
        "loss": loss.double() * len(distance),
        "values": values.sum(0),
        "squares": values.square().sum(0),
    }
    if margin is not None:
        apart = label == 1
        sums["correct"] = groups @ ((distance / margin < SAME_BELOW) == same).double()
        sums["active"] = torch.stack([(apart & (distance < margin)).sum(), apart.sum()]).double()
    return sums


def pair_figures(sums: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Compute loss, distances, accuracies and spread from the sums over all pairs of an epoch, see `pair_sums`.

    - `loss`: mean over the pairs;
    - `distance_same`, `distance_different`: mean distance of the pairs of one room and of two rooms;
    - `accuracy`, `accuracy_same`, `accuracy_different`: share of correct decisions when a pair counts as the same
      room if min(d / margin, 1) < 0.5 ([T] 5.3.4). `accuracy`, of all pairs, needs both kinds: if all pairs are of
      one kind, a network that distinguishes nothing has 0 or 1;
    - `active`: share of the pairs with label 1 that are nearer than the margin: the others cost nothing in the
      contrastive loss. The lower it is, the less is left to learn from such pairs;
    - `spread`: standard deviation of the descriptors' values, averaged over the D dimensions. Near 0 the network
      gives every image the same descriptor.

    A loss without a margin has neither accuracies nor `active`. Figures without any pairs are left out, so that no NaN
    reaches a logger.
    """
    if not sums:
        return {}
    count, total = sums["count"], sums["count"].sum()
    figures = {"loss": sums["loss"] / total}
    if "active" in sums and sums["active"][1] > 0:
        figures["active"] = sums["active"][0] / sums["active"][1]
    if "correct" in sums and (count > 0).all():
        figures["accuracy"] = sums["correct"].sum() / total
    for index, group in enumerate(_GROUPS):
        for name, key in (("distance", "distance"), ("accuracy", "correct")):
            if key in sums and count[index] > 0:
                figures[f"{name}_{group}"] = sums[key][index] / count[index]
    mean = sums["values"] / (2 * total)
    figures["spread"] = (sums["squares"] / (2 * total) - mean.square()).clamp(min=0).sqrt().mean()
    return {name: value.float() for name, value in figures.items()}
