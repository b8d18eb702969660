"""Training a siamese network with Lightning ([T] 5.2-5.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from analytic.descriptors.base import Description, Descriptor
from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, DataError, FormatError, hint
from siamloc.models.checkpoint import FORMAT_KEY, FORMAT_VERSION, read_checkpoint
from siamloc.models.describing import CHUNK, as_float, describe
from siamloc.models.losses import ContrastiveLoss, check_labels, pair_distance
from siamloc.models.network import build, checked_image_size
from siamloc.models.pictures import pair_picture
from siamloc.models.statistics import PairStatistics
from siamloc.models.weights import mismatch

ensure_torchvision()

from lightning.pytorch import LightningModule  # noqa: E402
from lightning.pytorch.loggers import TensorBoardLogger  # noqa: E402

OPTIMIZERS = ("sgd", "adam", "adamw")
PICTURED_PAIRS = 6
_BATCH_KEYS = ("first", "second", "label", "same")


class SiameseModule(LightningModule, Descriptor):
    """One network for both images of a pair, its loss, its optimizer and what is logged; also a `Descriptor`.

    A batch is a dictionary with `first` and `second` (B, 3, H, W), uint8 or floating point in [0, 1]; `label` (B,)
    float32, dissimilarity in [0, 1]; and `same` (B,) bool, True where both images show the same room. uint8
    becomes floating point on the device. Both images go through the network in one pass, so that batch
    normalization sees them together.

    Logged at the end of an epoch as `train/...` and `val/...`: what `PairStatistics` computes; and as
    `loss_step` the loss of a training step. A TensorBoard logger also gets a picture of the first pairs.

    Args:
        branch: a name in `BRANCHES`.
        head: a name in `HEADS`.
        image_size: (H, W) in pixels.
        weights: None, the name of ImageNet weights, or a path; see `build`.
        margin: of the contrastive loss.
        optimizer: "sgd", "adam" or "adamw".
        learning_rate: step size, positive.
        momentum: in [0, 1): of "sgd"; decay of the first moment (beta 1) of the other two.
        weight_decay: not negative.
        seed: of the random weights.

    Raises:
        ConfigError: an unknown name or a number out of range.
    """

    name = "siamese"
    default_distance = "euclidean"

    def __init__(
        self,
        branch: str,
        head: str,
        image_size: Sequence[int] = (128, 512),
        weights: str | PathLike[str] | None = None,
        margin: float = 2.0,
        optimizer: str = "sgd",
        learning_rate: float = 0.001,
        momentum: float = 0.9,
        weight_decay: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        size = checked_image_size(image_size)
        hyperparameters = {
            "branch": str(branch),
            "head": str(head),
            "image_size": size,
            "weights": None if weights is None else fspath(weights),
            "margin": float(margin),
            "optimizer": str(optimizer),
            "learning_rate": float(learning_rate),
            "momentum": float(momentum),
            "weight_decay": float(weight_decay),
            "seed": seed,
        }
        _check_optimizer(hyperparameters)
        self.loss = ContrastiveLoss(margin)
        self.network = build(branch, head, size, weights, seed)
        self.train_statistics = PairStatistics(self.network.outputs, self.loss.margin)
        self.val_statistics = PairStatistics(self.network.outputs, self.loss.margin)
        self.save_hyperparameters(hyperparameters)

    @classmethod
    def load(cls, path: str | Path) -> SiameseModule:
        """Load a module from a Lightning checkpoint, on the CPU and in evaluation mode.

        No code in the file is run, and nothing is downloaded, whatever weights the training started from.

        Raises:
            FormatError: the file is missing, not whole, not such a checkpoint, or of another architecture.
        """
        content = read_checkpoint(path)
        hyperparameters = content["hyper_parameters"]
        try:
            module = cls(**{**hyperparameters, "weights": None})
        except (TypeError, ValueError) as error:
            raise FormatError(f"the checkpoint {path} names a network that cannot be made: {error}") from error
        difference = mismatch(module, content["state_dict"])
        if difference is not None:
            raise FormatError(
                f"the weights in the checkpoint {path} are of another architecture than its hyper-parameters say "
                f"({module.hparams['branch']} + {module.hparams['head']}): {difference}"
            )
        module.load_state_dict(content["state_dict"])
        module.hparams["weights"] = hyperparameters.get("weights")
        return module.eval()

    @property
    def identity(self) -> dict[str, Any]:
        """Name, branch, head, image size and a hash of the weights; see `Network.identity` for its cost."""
        return self.network.identity

    def forward(self, panorama: Tensor) -> Tensor:
        """Return descriptors (B, D) of panoramas (B, 3, H, W), floating point in [0, 1]."""
        return self.network(panorama)

    def describe(self, batch: Any, chunk: int = CHUNK) -> Description:
        """Describe images: array or tensor, uint8 or floating point in [0, 1], one image or a batch.

        The mode of the network and of all its parts stays as it was, and so does the random state.

        Args:
            batch: (B, 3, H, W), (3, H, W), (B, H, W) or (H, W).
            chunk: images in one pass; it bounds the memory and changes no result beyond rounding.

        Raises:
            DataError: another shape, type or range.
        """
        return Description(position=describe(self.network, batch, chunk))

    def training_step(self, batch: Mapping[str, Tensor], batch_index: int) -> Tensor:
        """Return the loss of a batch of pairs."""
        loss = self._step(batch, batch_index, "train", self.train_statistics)
        if self._trainer is not None:
            self.log("loss_step", loss.detach(), on_step=True, on_epoch=False, prog_bar=True, batch_size=1)
        return loss

    def validation_step(self, batch: Mapping[str, Tensor], batch_index: int) -> None:
        """Add a batch of pairs to the statistics of the validation."""
        self._step(batch, batch_index, "val", self.val_statistics)

    def on_train_epoch_end(self) -> None:
        """Log the statistics of the training epoch."""
        self._log_epoch("train", self.train_statistics)

    def on_validation_epoch_end(self) -> None:
        """Log the statistics of the validation."""
        self._log_epoch("val", self.val_statistics)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return the optimizer that the hyper-parameters name."""
        options = self.hparams
        common = {"lr": options["learning_rate"], "weight_decay": options["weight_decay"]}
        if options["optimizer"] == "sgd":
            return torch.optim.SGD(self.network.parameters(), momentum=options["momentum"], **common)
        kind = torch.optim.Adam if options["optimizer"] == "adam" else torch.optim.AdamW
        return kind(self.network.parameters(), betas=(options["momentum"], 0.999), **common)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Write the version of the format beside the weights."""
        checkpoint[FORMAT_KEY] = FORMAT_VERSION

    def _step(self, batch: Mapping[str, Tensor], batch_index: int, stage: str, statistics: PairStatistics) -> Tensor:
        missing = [key for key in _BATCH_KEYS if key not in batch]
        if missing:
            raise DataError(f"a batch of pairs needs {', '.join(_BATCH_KEYS)}; missing: {', '.join(missing)}")
        label = batch["label"]
        check_labels(label, len(batch["first"]))
        descriptors = self.network(as_float(torch.cat([batch["first"], batch["second"]])))
        distance = pair_distance(*descriptors.chunk(2))
        losses = self.loss.of_distance(distance, label)
        statistics.update(descriptors.detach(), distance.detach(), losses.detach(), batch["same"])
        if batch_index == 0:
            self._draw(batch, distance.detach(), stage)
        return losses.mean()

    def _log_epoch(self, stage: str, statistics: PairStatistics) -> None:
        values = statistics.compute() if statistics.update_called else {}
        statistics.reset()
        loss = values.get("loss")
        if loss is not None and not bool(torch.isfinite(torch.as_tensor(loss))):
            raise ConfigError(
                f"the training diverged: {stage}/loss of epoch {self.current_epoch + 1} is {float(loss)}; train anew "
                f"with a smaller optimizer.learning_rate than {self.hparams['learning_rate']:g}"
            )
        # The sums are already those of all processes; averaging equal numbers over them changes nothing.
        self.log_dict({f"{stage}/{name}": value for name, value in values.items()}, sync_dist=True)

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


def _check_optimizer(hyperparameters: Mapping[str, Any]) -> None:
    optimizer, rate = hyperparameters["optimizer"], hyperparameters["learning_rate"]
    momentum, decay = hyperparameters["momentum"], hyperparameters["weight_decay"]
    if optimizer not in OPTIMIZERS:
        raise ConfigError(f"unknown optimizer {optimizer!r}: {hint(optimizer, OPTIMIZERS)}")
    if not (rate > 0 and math.isfinite(rate)):
        raise ConfigError(f"learning_rate must be positive, got {rate}")
    if not 0 <= momentum < 1:
        raise ConfigError(f"momentum must be in [0, 1), got {momentum}")
    if not (decay >= 0 and math.isfinite(decay)):
        raise ConfigError(f"weight_decay must not be negative, got {decay}")
