"""`FiniteGuard`: stop a training whose loss or gradient is not finite, and keep the batch that caused it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.torchvision_compat import ensure_torchvision
from foundation.files import atomic_path
from siamloc.errors import ConfigError, StorageError
from siamloc.models.module import NetworkModule
from siamloc.runs import Run
from siamloc.training.run_folder import bad_batch

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402


class _Step(NamedTuple):
    """A step whose figures may still be on their way from the device: mean loss, largest gradient."""

    batch: Mapping[str, Any]
    epoch: int
    number: int
    figures: Tensor
    arrived: torch.cuda.Event | None


def unscaled(trainer: Trainer, loss: Tensor) -> Tensor:
    """Undo the scaling of a loss that training in half precision applies for the gradient."""
    scaler = getattr(trainer.precision_plugin, "scaler", None)
    return loss.detach() if scaler is None else loss.detach() / scaler.get_scale()


class FiniteGuard(Callback):
    """Stop before weights are updated with non-finite values; the previous checkpoint stays as it was.

    The batch is kept in the run as `bad_batch.npz` (of further processes as `bad_batch_1.npz` and so on): the images
    as the network saw them, the other inputs of the loss, `epoch` and `batch`, both from 0, `loss`, and the paths of
    the frames as `first_path` and `second_path`, or `images_path`. `numpy.load` reads it.

    On a GPU the figures of a step are read during the next one, so that no step waits for them: by then the weights in
    memory have taken the bad step, but those of the checkpoints have not.

    Args:
        run: of the training.

    Raises:
        ConfigError: a loss or a gradient is not finite.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._batch: Mapping[str, Any] = {}
        self._loss = torch.zeros(())
        self._pending: list[_Step] = []

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """Record the batch."""
        self._batch = batch

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        """Record the loss."""
        self._loss = unscaled(trainer, loss)

    def on_after_backward(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Check the loss and the gradient over all processes, so that all of them stop."""
        grads = [weight.grad for weight in pl_module.parameters() if weight.grad is not None]
        if not grads or getattr(trainer.precision_plugin, "scaler", None) is not None:
            largest = torch.zeros_like(self._loss)  # in half precision the scaler handles gradients that are too large
        else:
            largest = torch.nn.utils.get_total_norm(grads, norm_type=float("inf"))
        figures = torch.stack([self._loss.reshape(()).float(), largest.float()])
        if trainer.world_size > 1:
            torch.distributed.all_reduce(figures)  # `trainer.strategy.reduce` would wait for all processes first
            figures = figures / trainer.world_size
        arrived = None
        if figures.is_cuda:
            figures = torch.empty(2, pin_memory=True).copy_(figures, non_blocking=True)
            arrived = torch.cuda.Event()
            arrived.record()
        number = trainer.fit_loop.epoch_loop.batch_idx
        self._pending.append(_Step(self._batch, trainer.current_epoch, number, figures, arrived))
        self.settle(trainer, pl_module, later=0 if arrived is None else 1)

    def settle(self, trainer: Trainer, pl_module: LightningModule, later: int = 0) -> None:
        """Check all steps except the latest `later` ones.

        Raises:
            ConfigError: the loss or the gradient of a step is not finite.
        """
        while len(self._pending) > later:
            step = self._pending.pop(0)
            if step.arrived is not None:
                step.arrived.synchronize()
            if not bool(torch.isfinite(step.figures).all()):
                self._pending.clear()
                raise self._stopped(trainer, pl_module, step)

    on_validation_start = on_train_epoch_end = settle  # before a checkpoint is chosen or written

    def _stopped(self, trainer: Trainer, pl_module: LightningModule, step: _Step) -> ConfigError:
        """Keep the batch, and return the error that names its file."""
        loss = float(step.figures[0])
        what = f"the gradient is not finite (the loss is {loss:.4g})" if np.isfinite(loss) else f"the loss is {loss}"
        sign = f"{what} in epoch {step.epoch + 1}, step {step.number + 1}"
        try:
            kept = f"its batch is kept in {self._keep(trainer, step, loss)}"
        except StorageError as error:
            kept = f"its batch could not be kept: {error}"
        if step.epoch == 0 and step.number == 0:
            return ConfigError(
                f"{sign}, before anything was learned: find out where the network or the loss turns this batch into "
                f"numbers that are not finite; {kept}"
            )
        assert isinstance(pl_module, NetworkModule)
        return pl_module.diverged(f"{sign}; {kept}")

    def _keep(self, trainer: Trainer, step: _Step, loss: float) -> Path:
        """Write the batch of this process into the run."""
        if trainer.is_global_zero:
            self._run.record_written(bad_batch(rank) for rank in range(trainer.world_size))
        arrays = {name: _array(value) for name, value in step.batch.items() if isinstance(value, Tensor)}
        paths = trainer.datamodule.paths(step.epoch, step.number)  # type: ignore[attr-defined]
        arrays |= {f"{name}_path": files for name, files in paths.items()}
        path = self._run.folder / bad_batch(trainer.global_rank)
        with atomic_path(path) as temporary:
            numbers = {"epoch": step.epoch, "batch": step.number, "loss": loss}
            np.savez_compressed(temporary, allow_pickle=False, **arrays, **numbers)
        return path


def _array(value: Tensor) -> NDArray[Any]:
    whole = value.detach().cpu()
    return (whole.float() if whole.dtype == torch.bfloat16 else whole).numpy()
