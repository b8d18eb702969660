"""`fit(debug=...)`: look at a training before starting it, with Lightning's own means; nothing is kept."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable
from typing import Any, Literal

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from augment.torchvision_compat import ensure_torchvision
from siamloc.models.module import NetworkModule
from siamloc.training.batches import EpochDataModule
from siamloc.training.guard import unscaled

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402
from lightning.pytorch.profilers import SimpleProfiler  # noqa: E402
from lightning.pytorch.utilities.model_summary import ModelSummary  # noqa: E402

Debug = Literal["overfit", "one_batch", "profile"]
_STEPS = {"overfit": 100, "profile": 20}
_CLEARLY = 0.1  # share of its first value by which the loss of a batch falls if it is learned


class _Losses(Callback):
    """Record the loss of each step."""

    def __init__(self) -> None:
        self.losses: list[float] = []

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self.losses.append(float(unscaled(trainer, loss)))


def debug_training(
    debug: Debug, module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]
) -> None:
    """Run a part of a training, print its figures, and leave the weights as they were.

    - "one_batch": one step and one validation batch, an overview of the network, and their figures.
    - "overfit": the same batch 100 times, without augmentation, and whether its loss falls by a tenth or more.
    - "profile": some steps with the time of each part (Lightning's `SimpleProfiler`).

    Args:
        debug: "one_batch", "overfit" or "profile".
        module: the training module.
        data: the batches.
        make_trainer: makes a trainer on the device of the training, with arguments of `lightning.Trainer`.

    Raises:
        ConfigError: the loss is not finite.
    """
    before, sigma = copy.deepcopy(module.state_dict()), getattr(module.loss, "sigma", None)
    try:
        with torch.random.fork_rng(devices=[]):
            {"one_batch": _one_batch, "overfit": _overfit, "profile": _profile}[debug](module, data, make_trainer)
    finally:
        module.teardown("fit")  # Lightning skips this on failure
        module.load_state_dict(before)
        module.zero_grad(set_to_none=True)
        if sigma is not None:  # of a loss that changes during a training
            module.loss.sigma = sigma


def _one_batch(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    losses = _Losses()
    limits = {"limit_train_batches": 1, "limit_val_batches": int(bool(data.val_dataloader()))}
    trainer = make_trainer(callbacks=[losses], max_epochs=1, **limits)
    trainer.fit(module, datamodule=data)
    found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
    figures = [f"{name} {value:.4g}" for name, value in found.items()]
    _say(trainer, str(ModelSummary(module, max_depth=2)))
    _say(trainer, f"one batch, nothing is kept: {', '.join([f'loss {losses.losses[0]:.4g}', *figures])}")


def _overfit(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    data.augmentation = None
    batch = data.on_after_batch_transfer(next(iter(data.train_dataloader())), 0)
    losses = _Losses()
    trainer = make_trainer(callbacks=[losses], max_epochs=1, limit_val_batches=0)
    steps: Any = [batch] * _STEPS["overfit"]
    trainer.fit(module, DataLoader(steps, batch_size=None, collate_fn=dict), val_dataloaders=[])
    first, last = losses.losses[0], sum(losses.losses[-5:]) / len(losses.losses[-5:])
    fell = first - last > _CLEARLY * abs(first)
    verdict = "as it should" if fell else "it hardly goes down: look at the labels, loss and learning rate"
    text = f"loss {first:.4g} at first and {last:.4g} after {len(losses.losses)} steps, {verdict}"
    _say(trainer, f"one batch learned by heart, without augmentation, nothing is kept: {text}")


def _profile(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    profiler = SimpleProfiler()
    trainer = make_trainer(profiler=profiler, max_steps=_STEPS["profile"], max_epochs=-1, limit_val_batches=0)
    trainer.fit(module, datamodule=data)
    _say(trainer, f"where the time of {trainer.global_step} steps goes, nothing is kept:{profiler.summary()}")


def _say(trainer: Trainer, text: str) -> None:
    if trainer.is_global_zero:
        print(text, file=sys.stderr, flush=True)
