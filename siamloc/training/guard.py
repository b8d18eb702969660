"""`FiniteGuard`: stop a training whose loss or gradient is not finite."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from siamloc.errors import ConfigError
from siamloc.lightning import Callback, LightningModule, Trainer
from siamloc.models.module import NetworkModule


class FiniteGuard(Callback):
    """Stop a training before its weights are updated with values that are not finite.

    On a GPU the figures of a step are read during the next one, so that no step waits for them: by then the weights in
    memory have taken the bad step, but those of the checkpoints have not.

    Raises:
        ConfigError: a loss or a gradient is not finite.
    """

    def __init__(self) -> None:
        self._loss = torch.zeros(())
        # Epoch, number in the epoch, and (mean loss, largest gradient), which arrives from the device with the event.
        self._pending: list[tuple[int, int, Tensor, torch.cuda.Event | None]] = []

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        """Record the loss of a step, without the scaling of half precision."""
        scaler = getattr(trainer.precision_plugin, "scaler", None)
        self._loss = loss.detach() if scaler is None else loss.detach() / scaler.get_scale()

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
        self._pending.append((trainer.current_epoch, number, figures, arrived))
        self.settle(trainer, pl_module, later=0 if arrived is None else 1)

    def settle(self, trainer: Trainer, pl_module: LightningModule, later: int = 0) -> None:
        """Check the losses and gradients of all steps except the latest `later` steps.

        Raises:
            ConfigError: the loss or the gradient of a step is not finite.
        """
        while len(self._pending) > later:
            epoch, number, figures, arrived = self._pending.pop(0)
            if arrived is not None:
                arrived.synchronize()
            if bool(torch.isfinite(figures).all()):
                continue
            self._pending.clear()
            loss = float(figures[0])
            what = "the gradient is not finite" if np.isfinite(loss) else f"the loss is {loss}"
            sign = f"{what} in epoch {epoch + 1}, step {number + 1}"
            if epoch == number == 0:
                raise ConfigError(
                    f"{sign}, before anything was learned: find out where the network or the loss turns the first "
                    "batch into numbers that are not finite"
                )
            assert isinstance(pl_module, NetworkModule)
            raise pl_module.diverged(sign)

    on_validation_start = on_train_epoch_end = settle  # before a checkpoint is chosen or written
