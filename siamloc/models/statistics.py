"""The figures of an epoch: sums and counts over all batches and processes, never means of means."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from augment.torchvision_compat import ensure_torchvision

ensure_torchvision()

from torchmetrics import Metric  # noqa: E402

_GROUPS = ("same", "different")
SAME_BELOW = 0.5


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
        margin: of the loss; None for a loss without one: then there are neither accuracies nor `active`.
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
            descriptors: (2 B, D).
            distance: (B,).
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
        """Return all sums since the last reset."""
        return {name: getattr(self, name).clone() for name in self._defaults}

    def load_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue with the sums that `sums` returned."""
        for name, value in sums.items():
            setattr(self, name, value.clone())
        self._update_count = max(self._update_count, 1)  # `compute` warns if there was no update

    def compute(self) -> dict[str, Tensor]:
        """Compute the scalars that are based on at least one pair."""
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
