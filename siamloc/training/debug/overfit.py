"""`fit(debug="overfit")`: the first batch over and over, and whether the loss goes down as it should."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from statistics import mean
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models.module import NetworkModule
from siamloc.models.origins import Origins
from siamloc.models.places import PlaceModule
from siamloc.training.batches import EpochDataModule
from siamloc.training.debug.console import say
from siamloc.training.guard import unscaled

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402

_STEPS = 100
LEARNED, SLOW = (
    0.5,
    0.05,
)  # of the possible decrease of the loss: learns above the first, not at all below the second
_LINES = 10
_AT_THE_END = 5  # steps whose mean loss counts as the last
_ENOUGH = 0.95  # of the way to the lowest loss: then stop


class _Same(Dataset[dict[str, Any]]):
    """The same batch, several times."""

    def __init__(self, batch: dict[str, Any], times: int) -> None:
        self._batch, self._times = batch, times

    def __len__(self) -> int:
        return self._times

    def __getitem__(self, number: int) -> dict[str, Any]:
        return dict(self._batch)


class _Losses(Callback):
    """Record the loss of each step, and stop the training when almost nothing is left of it."""

    def __init__(self, lowest: float) -> None:
        self.lowest = lowest
        self.losses: list[float] = []

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self.losses.append(float(unscaled(trainer, loss)))

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        step = len(self.losses)
        if trainer.is_global_zero and (step == 1 or step % (_STEPS // _LINES) == 0):
            say(f"  step {step:3}   loss {self.losses[-1]:.4g}")
        latest = self.losses[-_AT_THE_END:]
        nothing_left = max(latest) - self.lowest <= (1 - _ENOUGH) * (self.losses[0] - self.lowest)
        if not math.isfinite(latest[-1]) or (step > _AT_THE_END and nothing_left):
            trainer.should_stop = True


def overfit(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    """Train on the first batch only, and print whether the loss went down as it should."""
    data.augmentation = None
    batch = next(iter(data.train_dataloader()))
    losses = _Losses(_lowest(module, batch))
    trainer = make_trainer(callbacks=[losses], max_epochs=1, limit_val_batches=0)
    if trainer.is_global_zero:
        say(f"one batch learned by heart, without augmentation, at most {_STEPS} steps; nothing is kept:")
    loader = DataLoader(_Same(batch, _STEPS), batch_size=None, generator=torch.Generator().manual_seed(0))
    try:
        trainer.fit(module, train_dataloaders=loader, val_dataloaders=[])
    except ConfigError:  # from the module, at the end of an epoch
        if math.isfinite(sum(losses.losses)):
            raise
    if trainer.is_global_zero:
        say(verdict(losses.losses, losses.lowest, module.optimizer.learning_rate))


def _lowest(module: NetworkModule, batch: Mapping[str, Any]) -> float:
    """Return the smallest loss possible for the batch, if the loss can compute it."""
    lowest = getattr(module.loss, "lowest", None)
    if lowest is None or not isinstance(module, PlaceModule):
        return 0.0
    return float(lowest(Origins(**{name: batch[name] for name in ("xy", "building", "room", "frame")})))


def verdict(losses: list[float], lowest: float, learning_rate: float) -> str:
    """Return a sentence that says whether the loss goes down as it should when one batch is trained repeatedly.

    Args:
        losses: of the steps.
        lowest: smallest loss possible for the batch.
        learning_rate: of the optimizer.

    Example:
        >>> verdict([2.0, 1.0, 0.1, 0.1, 0.1, 0.1, 0.1], 0.0, 0.001)
        'it learns: the loss went from 2 to 0.1 in 7 steps, 95 % of the way to 0, as it should'
    """
    first, steps = losses[0], len(losses)
    last = mean(losses[-_AT_THE_END:])
    if not math.isfinite(sum(losses)):
        bad = next(number for number, loss in enumerate(losses, 1) if not math.isfinite(loss))
        return (
            f"the loss is not finite at step {bad}: try a smaller optimizer.learning_rate than {learning_rate:g}"
            if bad > 1
            else "the loss is not finite from the start: look at what the network and the loss make of the batch"
        )
    if min(losses) < lowest - 1e-3 * max(1.0, abs(first)):  # a custom loss, which may go below 0
        return f"the loss went from {first:.4g} to {last:.4g} in {steps} steps; what it should reach is not known"
    lowest = min(lowest, *losses)
    room = first - lowest
    if room <= 1e-6 * max(1.0, abs(first)):
        return f"there is nothing to learn in this batch: its loss is {first:.4g} from the start, which is the lowest"
    way = (first - last) / room
    fell = f"the loss went from {first:.4g} to {last:.4g} in {steps} steps, {way:.0%} of the way to {lowest:.4g}"
    fell = fell.replace("%", " %")
    if way >= LEARNED:
        return f"it learns: {fell}, as it should"
    if way >= SLOW:
        return f"it learns slowly: {fell}; try a larger optimizer.learning_rate than {learning_rate:g}"
    return (
        f"it does not learn: {fell}; try another optimizer.learning_rate than {learning_rate:g}, and see whether the "
        "labels and the loss are what you mean"
    )
