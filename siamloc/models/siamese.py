"""The `LightningModule` of siamese training ([T] 5.2-5.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models.describing import as_float, checked_descriptors, margin_of
from siamloc.models.drive_figures import RECALL_RADIUS
from siamloc.models.losses import ContrastiveLoss, check_labels, pair_distance
from siamloc.models.module import NetworkModule, checked_loss
from siamloc.models.network_stages import comparing_weights
from siamloc.models.origins import required
from siamloc.models.registry import Optimizer

ensure_torchvision()

from torchmetrics import Metric  # noqa: E402

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

    Logged at the end of an epoch: the figures of `PairStatistics`, as `train/...` and `val/...`; and in each training
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
        self.train_statistics = PairStatistics(margin_of(self.loss))
        self.val_statistics = PairStatistics(margin_of(self.loss))

    def training_step(self, batch: Mapping[str, Tensor], batch_index: int) -> Tensor:
        """Return the loss of a batch of pairs."""
        loss = self._step(batch, "train", self.train_statistics)
        self.log_step(loss)
        return loss

    def validation_step(self, batch: Mapping[str, Tensor], batch_index: int, dataloader_idx: int = 0) -> None:
        """Add a batch of pairs to the validation statistics, or describe a batch of map frames and queries."""
        if "known" in batch:
            self.describe_drive(batch)
            return
        self._step(batch, "val", self.val_statistics)

    def on_train_epoch_end(self) -> None:
        """Log the statistics of the training epoch."""
        self._log_epoch("train", self.train_statistics)

    def on_validation_epoch_end(self) -> None:
        """Log the statistics of the validation pairs, and the errors of the queries of the validation drive."""
        self._log_epoch("val", self.val_statistics, self.drive_figures())

    def epoch_sums(self) -> dict[str, Tensor]:
        """Return the sums behind the pair statistics of the current epoch, for a checkpoint within the epoch."""
        return self.train_statistics.sums()

    def load_epoch_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue an epoch with the sums that `epoch_sums` returned for a checkpoint."""
        self.train_statistics.load_sums(sums)

    def _step(self, batch: Mapping[str, Tensor], stage: str, statistics: PairStatistics) -> Tensor:
        required(batch, _BATCH_KEYS, "pairs")
        label = batch["label"]
        check_labels(label, len(batch["first"]))
        images = as_float(torch.cat([batch["first"], batch["second"]]))
        descriptors = checked_descriptors(self.computed(self.network, images), 2 * len(label))
        d0, d1 = descriptors.chunk(2)
        loss = checked_loss(self.loss(d0, d1, label), self.loss, descriptors.requires_grad)
        distance = pair_distance(d0.detach(), d1.detach())
        statistics.update(descriptors.detach(), distance, loss.detach(), batch["same"], label)
        return loss

    def _log_epoch(self, stage: str, statistics: PairStatistics, further: Mapping[str, Tensor] | None = None) -> None:
        values = statistics.compute() if statistics.update_called else {}
        statistics.reset()
        self.log_epoch(stage, {**values, **(further or {})})


class PairStatistics(Metric):
    """Compute loss, distances, accuracies and spread over all pairs since the last reset.

    `compute` returns a dictionary of scalars:

    - `loss`: mean over the pairs;
    - `distance_same`, `distance_different`: mean distance of the pairs of one room and of two rooms;
    - `accuracy`, `accuracy_same`, `accuracy_different`: share of correct decisions when a pair counts as the same
      room if min(d / margin, 1) < 0.5 ([T] 5.3.4). `accuracy`, of all pairs, needs both kinds: if all pairs are of
      one kind, a network that distinguishes nothing has 0 or 1;
    - `active`: share of the pairs with label 1 that are nearer than the margin: the others cost nothing in the
      contrastive loss. The lower it is, the less is left to learn from such pairs;
    - `spread`: standard deviation of the descriptors' values, averaged over the D dimensions. Near 0 the network
      gives every image the same descriptor.

    Figures without any pairs are left out, so that no NaN reaches a logger.

    Args:
        margin: margin of the loss; None for a loss without a margin, which gives neither accuracies nor `active`.
    """

    full_state_update = False
    count: Tensor
    distance: Tensor
    correct: Tensor
    active: Tensor
    loss: Tensor
    values: Tensor
    squares: Tensor

    def __init__(self, margin: float | None) -> None:
        super().__init__()
        self.margin = margin
        for name in ("count", "distance", "correct", "active"):
            self.add_state(name, torch.zeros(2, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("loss", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        for name in ("values", "squares"):  # the first batch sets their length to D
            self.add_state(name, torch.zeros(1, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, descriptors: Tensor, distance: Tensor, loss: Tensor, same: Tensor, label: Tensor) -> None:
        """Add a batch of B pairs to the sums.

        Args:
            descriptors: (2 B, D), of the first images, then of the second images.
            distance: (B,) distance of the two descriptors of each pair.
            loss: mean over the batch, a scalar.
            same: (B,) bool, True where both images show the same room.
            label: (B,), dissimilarity in [0, 1].
        """
        distance = distance.double()
        groups = torch.stack([same, ~same]).double()
        self.count += groups.sum(1)
        self.distance += groups @ distance
        if self.margin is not None:
            decided_same = distance / self.margin < SAME_BELOW
            self.correct += groups @ (decided_same == same).double()
            apart = label == 1
            self.active += torch.stack([(apart & (distance < self.margin)).sum(), apart.sum()])
        self.loss += loss.double() * len(distance)
        values = descriptors.double()
        self.values = self.values + values.sum(0)
        self.squares = self.squares + values.square().sum(0)

    def sums(self) -> dict[str, Tensor]:
        """Return all sums over pairs since the last reset, by name."""
        return {name: value.clone() for name, value in self.metric_state.items()}  # type: ignore[union-attr]

    def load_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue with sums over earlier pairs, as `sums` returned them."""
        for name, value in sums.items():
            setattr(self, name, value.clone())
        self._update_count = max(self._update_count, 1)  # `compute` warns if there was no update

    def compute(self) -> dict[str, Tensor]:
        """Return the statistics by name, without those that no pair contributes to."""
        count, total = self.count, self.count.sum()
        if total == 0:
            return {}
        result = {"loss": self.loss / total}
        if self.margin is not None and self.active[1] > 0:
            result["active"] = self.active[0] / self.active[1]
        if self.margin is not None and (count > 0).all():
            result["accuracy"] = self.correct.sum() / total
        for index, group in enumerate(_GROUPS):
            if count[index] > 0:
                result[f"distance_{group}"] = self.distance[index] / count[index]
            if self.margin is not None and count[index] > 0:
                result[f"accuracy_{group}"] = self.correct[index] / count[index]
        mean = self.values / (2 * total)
        variance = (self.squares / (2 * total) - mean.square()).clamp(min=0)
        result["spread"] = variance.sqrt().mean()
        return {name: value.float() for name, value in result.items()}
