"""The `LightningModule` for training on places, with all pairs of a batch at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from siamloc.errors import DataError
from siamloc.models.batch_losses import SoftContrastiveLoss
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.describing import as_float, required_comparing
from siamloc.models.descriptor_checks import checked_descriptors
from siamloc.models.module import NetworkModule, checked_loss
from siamloc.models.network_stages import comparing_weights
from siamloc.models.origins import Origins, required
from siamloc.models.relative import relative_loss

BatchLoss = Callable[[Tensor, Origins], Tensor]

_KEYS = ("images", "xy", "building", "room", "frame")
_FURTHER = ("theta", "overlap", "deviation")


class PlaceModule(NetworkModule):
    """Train a network on all pairs of a batch.

    A batch is a dictionary with `images` (N, 3, H, W), uint8 or floating point in [0, 1], and these fields of
    `Origins`: `xy` (N, 2), positions in a unit such as metres; and `building`, `room` and `frame` (N,), whole numbers.
    A network built with relative=True also learns the displacement and turn between two images, from the same
    features and without changing them; then the batch also has `theta` (N,), headings in rad. A batch may have
    `deviation` (N, 2), of positions and headings; and `overlap` (N, N), the visual overlap of its images, which
    `SoftContrastiveLoss(kernel="overlap")` needs. A validation batch also has `known` (N,) bool: True for map frames,
    False for the queries that are searched among them.

    Logged at the end of a training epoch:

    - `train/loss`;
    - `train/spread`, the mean distance of descriptors from their mean, near 0 if the network gives every image the same
      descriptor;
    - `train/active`, with losses that report it, such as `TripletLoss`: the share of triplets with a non-zero loss, or
      of pairs with a gradient;
    - `train/relative`, with relative=True: the mean error of the estimated displacements between two images at most
      `siamloc.models.relative.REACH` = 8 apart, in the unit of the positions.

    Logged after the validation, where the match of a query is the map frame with the nearest descriptor:

    - `val/error` and `val/median`, mean and median of the distances between queries and their matches, in the unit of
      the positions; a match in another building counts as 100;
    - `val/recall`, the share of queries at most `recall_radius` from their match;
    - `val/room`, the share of queries in the same room as their match;
    - `val/refined`, with relative=True: the mean error of the queries' positions if the estimated displacement from the
      match is added to the match's position.

    With a `CrossEntropyLoss`, `train/accuracy` and `val/accuracy` are the shares of images whose room is named
    correctly.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        loss: (descriptors (N, D), `Origins`) -> scalar, a module or a function; a `SoftContrastiveLoss` if None.
        optimizer: algorithm, learning rate and schedule with which the weights are updated.
        recall_radius: radius of `val/recall`, in the unit of the positions.

    Raises:
        ConfigError: a network that is not a module, or a loss that is not callable.
    """

    default_loss = SoftContrastiveLoss

    def training_step(self, batch: Mapping[str, Tensor], batch_index: int) -> Tensor:
        """Return the loss of a batch of places."""
        required(batch, _KEYS, "places")
        origins = Origins(**{key: batch[key] for key in (*_KEYS[1:], *_FURTHER) if key in batch})
        if callable(teach := getattr(self.loss, "teach", None)):
            origins = replace(origins, taught=teach(as_float(batch["images"])))
        found, orientation = self._described(batch)
        descriptors = checked_descriptors(found, len(batch["images"]))
        mine = origins, descriptors.detach()
        if self._trainer is not None and self.trainer.world_size > 1:
            descriptors, origins = self._of_all(descriptors, origins)
        # With all stages but the last frozen, a network may learn displacements alone.
        fixed = orientation is not None and not descriptors.requires_grad
        loss = checked_loss(self.loss(descriptors, origins), self.loss, None if fixed else descriptors)
        seen, total = descriptors.detach(), loss
        apart = torch.linalg.vector_norm(seen - seen.mean(dim=0), dim=1)
        figures = {"loss": loss.detach(), "spread": apart.mean()}
        if hasattr(self.loss, "active"):
            figures["active"] = self.loss.active(seen, origins)
        if isinstance(self.loss, CrossEntropyLoss):
            figures["accuracy"] = self.loss.accuracy(seen, origins.room)
        if orientation is not None:
            with torch.autocast(device_type=orientation.device.type, enabled=False):  # its sums need full precision
                relative = required_comparing(self.network)
                compare = partial(self.computed, relative)
                more, figures["relative"] = relative_loss(relative, orientation.float(), *mine, compare)
            total = loss + more
        for name, figure in figures.items():  # read at the end of the epoch: no step waits for the device
            self._figures.setdefault(name, []).append(figure)
        self.log_step(loss)
        return total

    def configure_gradient_clipping(
        self,
        optimizer: torch.optim.Optimizer,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Clip the gradients of the displacement weights separately, so that they do not affect all others."""
        apart = comparing_weights(self.network)
        if not apart or not gradient_clip_val or gradient_clip_algorithm not in (None, "norm"):
            super().configure_gradient_clipping(optimizer, gradient_clip_val, gradient_clip_algorithm)
            return
        rest = [weight for weight in self.parameters() if not any(weight is one for one in apart)]
        for weights in (apart, rest):
            torch.nn.utils.clip_grad_norm_(weights, gradient_clip_val)

    def _described(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor | None]:
        """Return descriptors, and orientation parts if displacements are learned."""
        images, network = as_float(batch["images"]), self.comparing_network
        if network is None:
            return self.computed(self.network, images), None
        if "theta" not in batch:
            raise DataError("a network built with relative=True learns from headings: a batch needs theta as well")
        return self.computed(network.with_orientation, images)

    def on_train_epoch_end(self) -> None:
        """Log the figures of the training epoch."""
        figures, self._figures = self.epoch_sums(), {}
        if figures:
            self.log_epoch("train", {name: each.nanmean() for name, each in figures.items()})

    def validation_step(self, batch: Mapping[str, Tensor], batch_index: int) -> None:
        """Describe a batch of map frames and queries of the validation drive, and keep the descriptors."""
        self.describe_drive(batch)

    def on_validation_epoch_end(self) -> None:
        """Search the queries in the map, and log their errors."""
        self.log_epoch("val", self.drive_figures())

    def _of_all(self, descriptors: Tensor, origins: Origins) -> tuple[Tensor, Origins]:
        """Gather the batches of all processes, with gradients."""

        def gathered(value: Tensor, grads: bool = False) -> Tensor:
            return self.all_gather(value, sync_grads=grads).flatten(0, 1)  # type: ignore[union-attr]

        names = [*_KEYS[1:], *(name for name in ("deviation", "taught") if getattr(origins, name) is not None)]
        fields = {name: gathered(getattr(origins, name)) for name in names}
        if origins.overlap is not None:  # the processes have different buildings
            fields["overlap"] = torch.block_diag(*gathered(origins.overlap).split(len(descriptors)))
        return gathered(descriptors, grads=True), Origins(**fields)
