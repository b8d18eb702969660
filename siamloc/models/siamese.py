"""The `LightningModule` of siamese training ([T] 5.2-5.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, DataError
from siamloc.models.describing import as_float, margin_of
from siamloc.models.drive_figures import RECALL_RADIUS
from siamloc.models.losses import ContrastiveLoss, check_labels, pair_distance
from siamloc.models.module import NetworkModule
from siamloc.models.network_stages import comparing_weights
from siamloc.models.outputs import checked_descriptors, checked_loss
from siamloc.models.registry import Optimizer
from siamloc.models.statistics import PairStatistics

ensure_torchvision()

from lightning.pytorch.loggers import TensorBoardLogger  # noqa: E402

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]

PICTURED_PAIRS = 6
_BATCH_KEYS = ("first", "second", "label", "same")
_CAPTION_ROWS = 16
_GAP = 2


class SiameseModule(NetworkModule):
    """Train one network on both images of a pair: loss, optimizer and logging.

    A batch is a dictionary with `first` and `second` (B, 3, H, W), uint8 or floating point in [0, 1]; `label` (B,)
    float32, dissimilarity in [0, 1]; and `same` (B,) bool, True where both images show the same room. uint8
    becomes floating point on the device. Both images go through the network in one pass, so that batch
    normalization sees them together.

    Logged at the end of an epoch: the figures of `PairStatistics`, as `train/...` and `val/...`; and in each training
    step its loss, as `loss_step`. If the validation also has batches of map frames and queries, as for a `PlaceModule`,
    the module also logs `val/error` and the other figures of a `PlaceModule`. A TensorBoard logger also gets an image
    of the first pairs.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        loss: (d0 (B, D), d1 (B, D), y (B,)) -> scalar, the mean over the pairs: a module, whose parameters are
            trained as well, or a function. A `ContrastiveLoss` of margin 2 if None.
        optimizer: how the weights are updated.
        recall_radius: of `val/recall`, in the unit of the positions.

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
        if loss is not None and not callable(loss):
            raise ConfigError(f"a loss is a function or a module (d0, d1, y) -> scalar, got {loss!r}")
        super().__init__(network, ContrastiveLoss() if loss is None else loss, optimizer, recall_radius)
        self.train_statistics = PairStatistics(margin_of(self.loss))
        self.val_statistics = PairStatistics(margin_of(self.loss))

    def training_step(self, batch: Mapping[str, Tensor], batch_index: int) -> Tensor:
        """Compute the loss of a batch of pairs."""
        loss = self._step(batch, batch_index, "train", self.train_statistics)
        self.log_step(loss)
        return loss

    def validation_step(self, batch: Mapping[str, Tensor], batch_index: int) -> None:
        """Add a batch of pairs to the validation statistics, or describe a batch of map frames and queries."""
        if "known" in batch:
            self.describe_drive(batch)
            return
        self._step(batch, batch_index, "val", self.val_statistics)

    def on_train_epoch_end(self) -> None:
        """Log the statistics of the training epoch."""
        self._log_epoch("train", self.train_statistics)

    def on_validation_epoch_end(self) -> None:
        """Log the statistics of the validation pairs, and the errors of the queries of the validation drive."""
        self._log_epoch("val", self.val_statistics, self.drive_figures())

    def epoch_sums(self) -> dict[str, Tensor]:
        """Return the sums behind the statistics of the current epoch, for a checkpoint."""
        return self.train_statistics.sums()

    def load_epoch_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue an epoch with the sums that `epoch_sums` returned for a checkpoint."""
        self.train_statistics.load_sums(sums)

    def _step(self, batch: Mapping[str, Tensor], batch_index: int, stage: str, statistics: PairStatistics) -> Tensor:
        missing = [key for key in _BATCH_KEYS if key not in batch]
        if missing:
            raise DataError(f"a batch of pairs needs {', '.join(_BATCH_KEYS)}; missing: {', '.join(missing)}")
        label = batch["label"]
        check_labels(label, len(batch["first"]))
        images = as_float(torch.cat([batch["first"], batch["second"]]))
        descriptors = checked_descriptors(self.computed(self.network, images), 2 * len(label))
        d0, d1 = descriptors.chunk(2)
        loss = checked_loss(self.loss(d0, d1, label), self.loss, descriptors.requires_grad)
        distance = pair_distance(d0.detach(), d1.detach())
        statistics.update(descriptors.detach(), distance, loss.detach(), batch["same"], label)
        if batch_index == 0:
            self._draw(batch, distance, stage)
        return loss

    def _log_epoch(self, stage: str, statistics: PairStatistics, further: Mapping[str, Tensor] | None = None) -> None:
        values = statistics.compute() if statistics.update_called else {}
        statistics.reset()
        self.log_epoch(stage, {**values, **(further or {})})

    def _draw(self, batch: Mapping[str, Tensor], distance: Tensor, stage: str) -> None:
        if self._trainer is None or self.trainer.sanity_checking or not self.trainer.is_global_zero:
            return
        boards = [logger for logger in self.loggers if isinstance(logger, TensorBoardLogger)]
        if not boards:
            return
        columns = (batch["first"], batch["second"], batch["label"], distance)
        picture = pair_picture(*(column[:PICTURED_PAIRS].cpu().numpy() for column in columns))
        for board in boards:
            board.experiment.add_image(f"{stage}/pairs", picture, self.global_step, dataformats="HWC")


def pair_picture(
    first: NDArray[Any], second: NDArray[Any], label: NDArray[Any], distance: NDArray[Any]
) -> NDArray[np.uint8]:
    """Draw pairs below each other, each with a caption, the first image and the second image.

    Args:
        first: (B, 3, H, W), uint8, or floating point in [0, 1].
        second: (B, 3, H, W), the second image of each pair, like `first`.
        label: (B,), dissimilarity in [0, 1].
        distance: (B,), distance of the descriptors.

    Returns:
        (rows, columns, 3) uint8, RGB.
    """
    rows = [_row(*pair) for pair in zip(first, second, label, distance, strict=True)]
    return np.concatenate(rows, axis=0)


def _row(first: NDArray[Any], second: NDArray[Any], label: float, distance: float) -> NDArray[np.uint8]:
    images = [_as_picture(first), _as_picture(second)]
    gap = np.full((_GAP, images[0].shape[1], 3), 255, np.uint8)
    caption = np.full((_CAPTION_ROWS, images[0].shape[1], 3), 255, np.uint8)
    text = f"y={float(label):.2f} d={float(distance):.2f}"
    cv2.putText(caption, text, (2, _CAPTION_ROWS - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([caption, images[0], gap, images[1], gap], axis=0)


def _as_picture(image: NDArray[Any]) -> NDArray[np.uint8]:
    picture = np.moveaxis(image, 0, -1)
    if picture.dtype != np.uint8:
        picture = (np.clip(picture, 0, 1) * 255).round().astype(np.uint8)
    return np.ascontiguousarray(picture)
