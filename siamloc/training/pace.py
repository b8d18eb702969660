"""The speed of a training, and the share of time that it waits for data."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from siamloc.lightning import Callback, LightningModule, Trainer


def images_in(batch: Mapping[str, Any]) -> int:
    """Count the images in a batch, in all of its parts."""
    return sum(len(part) for part in batch.values() if isinstance(part, Tensor) and part.ndim == 4)


class Pace(Callback):
    """Measure the speed of a training, without the first steps of each epoch, which include start-up.

    On a GPU, events between the GPU's tasks measure the times, and are read at the end of the epoch, so that no step
    waits for them.
    """

    def __init__(self) -> None:
        self._images, self._seconds, self._waited = 0, 0.0, 0.0
        self._begun: Mark = 0.0
        self._ended: Mark | None = None
        self._steps: list[tuple[Mark, Mark, Mark, int]] = []  # end of the step before, begin, end, images

    @property
    def images_per_second(self) -> float:
        """Images per second that all processes train on, without validation; NaN until the third step ends."""
        self.on_train_epoch_end()
        return self._images / self._seconds if self._seconds else math.nan

    @property
    def waiting(self) -> float:
        """Share of the time spent waiting for batches to be gathered and augmented; NaN until the third step ends."""
        self.on_train_epoch_end()
        return self._waited / self._seconds if self._seconds else math.nan

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forget the end of the last step, so that the time between epochs does not count."""
        self._ended = None

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """Record the time at which the batch has arrived."""
        self._begun = mark(pl_module)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record the time at which the step ends, and the number of its images."""
        now = mark(pl_module)
        if self._ended is not None and batch_idx >= 2:
            self._steps.append((self._ended, self._begun, now, images_in(batch) * trainer.world_size))
        self._ended = now

    def on_train_epoch_end(self, *_: Any) -> None:
        """Add the recorded steps of the epoch to the sums of images and seconds."""
        for before, begun, ended, images in self._steps:
            self._images += images
            self._seconds += seconds_between(before, ended)
            self._waited += seconds_between(before, begun)
        self._steps.clear()


Mark = Any
"""A moment: a time in seconds, or on a GPU a mark among its tasks."""


def mark(module: LightningModule) -> Mark:
    """Return the current moment: a time in seconds, or on a GPU an event after all its queued tasks."""
    if module.device.type != "cuda":
        return time.monotonic()
    event = torch.cuda.Event(enable_timing=True)
    event.record(torch.cuda.current_stream(module.device))
    return event


def seconds_between(first: Mark, second: Mark) -> float:
    """Return the seconds between two moments; on a GPU this waits until the second one has passed."""
    if isinstance(first, torch.cuda.Event) and isinstance(second, torch.cuda.Event):
        second.synchronize()
        return first.elapsed_time(second) / 1000
    return second - first
