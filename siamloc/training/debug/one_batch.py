"""`fit(debug="one_batch")`: a training step and a validation batch: shapes, figures and times."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from augment.torchvision_compat import ensure_torchvision
from siamloc.models.module import NetworkModule
from siamloc.training.batches import EpochDataModule
from siamloc.training.debug.console import Clock, milliseconds, say
from siamloc.training.guard import unscaled

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402


class _Look(Callback):
    """Record the figures and times of a single batch."""

    def __init__(self) -> None:
        self.batches: dict[str, Mapping[str, Any]] = {}
        self.seconds: dict[str, float] = {}
        self.loss = self.gradient = math.nan
        self._clock = Clock()
        self._since = time.perf_counter()

    def _begin(self, stage: str, module: LightningModule, batch: Any) -> None:
        self._clock.device = module.device
        now = self._clock()
        self.batches[stage] = batch
        self.seconds[f"{stage} gathered"], self._since = now - self._since, now

    def _end(self, stage: str) -> None:
        now = self._clock()
        self.seconds[stage], self._since = now - self._since, now

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._since = time.perf_counter()

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self._begin("training", pl_module, batch)

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self.loss = float(unscaled(trainer, loss))

    def on_after_backward(self, trainer: Trainer, pl_module: LightningModule) -> None:
        grads = [weight.grad for weight in pl_module.parameters() if weight.grad is not None]
        self.gradient = float(torch.nn.utils.get_total_norm(grads)) if grads else 0.0

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        self._end("training")

    def on_validation_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, *_: Any) -> None:
        self._begin("validation", pl_module, batch)

    def on_validation_batch_end(self, trainer: Trainer, *_: Any) -> None:
        self._end("validation")


def one_batch(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    """Run a training step and a validation batch, and print their shapes, figures and times."""
    look, shapes = _Look(), []
    handle = module.network.register_forward_hook(lambda *given: shapes.append(tuple(given[2].shape)))
    validated = bool(data.val_dataloader())
    steps = len(data.train_dataloader())
    trainer = make_trainer(
        callbacks=[look], max_epochs=1, limit_train_batches=1, limit_val_batches=1 if validated else 0
    )
    try:
        trainer.fit(module, datamodule=data)
    finally:
        handle.remove()
    if not trainer.is_global_zero:
        return
    weights = sum(weight.numel() for weight in module.network.parameters())
    trained = sum(weight.numel() for weight in module.parameters() if weight.requires_grad)
    device = look._clock.device
    say("one batch, nothing is kept:")
    say(f"  network      {weights:,} weights, {trained:,} trained, on {device} in {trainer.precision}")
    for stage, batch in look.batches.items():
        say(f"  {stage:12} {_shapes(batch)}")
        took, waited = look.seconds[stage], look.seconds[f"{stage} gathered"]
        if stage == "training":
            figures = f"loss {look.loss:.4g}, length of the gradient {look.gradient:.4g}"
            say(f"               descriptors {_shape(shapes[0])}, {figures}")
        say(f"               gathered in {milliseconds(waited)}, computed in {milliseconds(took)}")
    found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
    if found:
        listed = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
        say(f"               {listed} (of this batch only)")
    if device.type == "cuda":
        say(f"  memory       {torch.cuda.max_memory_allocated(device) / 2**30:.2f} GiB at most")
    say(f"  an epoch has {steps} such steps; the first one takes longer than the others")


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _shapes(batch: Mapping[str, Any]) -> str:
    parts = {name: value for name, value in batch.items() if isinstance(value, Tensor)}
    kinds = {name: str(value.dtype).removeprefix("torch.") for name, value in parts.items()}
    return ", ".join(f"{name} {_shape(tuple(value.shape))} {kinds[name]}" for name, value in parts.items())
