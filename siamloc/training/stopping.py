"""`StepCheckpoints`: checkpoints within an epoch, from which a training continues with the very next batch."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from siamloc.errors import ConfigError
from siamloc.interrupts import handled, stop_once
from siamloc.lightning import Callback, Checkpoint, LightningModule, SIGTERMException, Trainer
from siamloc.models.module import NetworkModule
from siamloc.training.guard import FiniteGuard
from siamloc.training.run_folder import EPOCH_SUMS


class StepCheckpoints(Checkpoint):
    """Write the last checkpoint every few steps, and when the training ends within an epoch.

    A training that continues from there ends with the same weights, curves and chosen checkpoint as one that never
    stopped, bit for bit on a CPU, and on a GPU with the trainer's deterministic=True: batches, their augmentation and
    dropout follow from the numbers of the epoch and the batch, and the checkpoint holds the sums since the epoch began.
    At the end of an epoch nothing is written here, since the checkpoint of the epoch follows.

    Args:
        path: path of the checkpoint.
        every: number of optimizer steps between checkpoints; only when the training is asked to stop if None.
        guard: checks the latest steps before anything is written.

    Attributes:
        asked: whether the training shall stop at the end of the step.
        begun: whether there are steps to finish, and not only workers that start and read the first batch.
    """

    def __init__(self, path: Path, every: int | None, guard: FiniteGuard) -> None:
        self.asked = self.begun = False
        self._path, self._every, self._guard = path, every, guard
        self._due = self._saving = self.limited = False
        self._step = 0
        self._sums: dict[str, Tensor] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Restore the sums of the epoch that a checkpoint within the epoch holds."""
        self._step = trainer.global_step
        if self._sums and isinstance(pl_module, NetworkModule):
            pl_module.load_epoch_sums({name: value.to(pl_module.device) for name, value in self._sums.items()})

    def on_train_batch_start(self, *_: Any) -> None:
        """Note that a step begins, which a signal lets finish."""
        self.begun = True

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Write the checkpoint if it is due.

        Raises:
            KeyboardInterrupt: the training was asked to stop.
            StopIteration: max_steps, max_time or a callback ends the training; Lightning then does not validate.
        """
        if trainer.global_step != self._step:  # otherwise gradients are still accumulating
            self._step = trainer.global_step
            self._due |= self._every is not None and self._step % self._every == 0
        self.on_validation_batch_end(trainer)
        loop = trainer.fit_loop.epoch_loop
        if loop._num_ready_batches_reached():
            return
        if trainer.fit_loop.done:
            self.limited, trainer.should_stop = True, False  # which would validate at once
        fetcher = trainer.fit_loop._data_fetcher
        assert fetcher is not None
        # The trainer cannot resume in the middle of these.
        busy = loop._should_accumulate() or (loop._should_check_val_fx(fetcher) and not self.limited)
        if busy or not (self._due or self.asked or self.limited):
            return
        self._guard.settle(trainer, pl_module)
        self._saving = True
        try:
            trainer.save_checkpoint(self._path)
        finally:
            self._saving = self._due = False
        if self.asked:
            raise KeyboardInterrupt
        if self.limited:
            raise StopIteration

    def on_validation_batch_end(self, trainer: Trainer, *_: Any) -> None:
        """Treat SIGTERM like Ctrl-C, before Lightning ends the training wherever it is: stop at the next checkpoint."""
        if trainer.received_sigterm and trainer.world_size == 1:
            trainer._signal_connector.received_sigterm = False
            self.asked = True

    def on_train_epoch_end(self, trainer: Trainer, *_: Any) -> None:
        """Stop after the checkpoint of the epoch, if requested and the training would continue.

        Raises:
            KeyboardInterrupt: the training was asked to stop.
        """
        self._due = False
        trainer.should_stop |= self.limited
        if self.asked and trainer.current_epoch + 1 < (trainer.max_epochs or 0):
            raise KeyboardInterrupt

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Add the sums of each process to a checkpoint within an epoch."""
        if not self._saving or not isinstance(pl_module, NetworkModule):
            return
        mine = {name: value.cpu() for name, value in pl_module.epoch_sums().items()}
        sums: list[Any] = [mine]
        if trainer.world_size > 1:
            sums = [None] * trainer.world_size
            torch.distributed.all_gather_object(sums, mine)
        checkpoint[EPOCH_SUMS] = sums

    def on_load_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Restore this process's sums of the epoch from a checkpoint.

        Raises:
            ConfigError: this number of processes cannot continue in the middle of this epoch.
        """
        sums = checkpoint.get(EPOCH_SUMS)
        if sums is None:
            return
        if len(sums) != trainer.world_size:
            raise ConfigError(
                f"the last checkpoint is within an epoch of {len(sums)} processes, whose batches differ from "
                f"those of {trainer.world_size}: resume with trainer.devices={len(sums)}"
            )
        self._sums = sums[trainer.global_rank]


class Limits(Callback):
    """Let max_steps, max_time and callbacks end a training within an epoch; the first of all callbacks.

    Args:
        steps: writes the checkpoint there.
    """

    def __init__(self, steps: StepCheckpoints) -> None:
        self._steps, self._max_steps = steps, -1

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Hide max_steps while the loops are restored: with it, Lightning would begin a finished epoch again."""
        loop = trainer.fit_loop.epoch_loop
        self._max_steps, loop.max_steps = loop.max_steps, -1

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Restore max_steps."""
        trainer.fit_loop.epoch_loop.max_steps = self._max_steps

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Let nobody take a part of an epoch for a whole one.

        Raises:
            StopIteration: the training ends within the epoch; Lightning then writes no checkpoint of the epoch.
        """
        if self._steps.limited and not trainer.fit_loop.epoch_loop._num_ready_batches_reached():
            raise StopIteration


@contextmanager
def stopped_by_signals(checkpoints: StepCheckpoints) -> Iterator[None]:
    """Stop the training after its step, with a checkpoint, at the first Ctrl-C, and at once at the second.

    A SIGTERM before the first step, which Lightning would wait for, stops it at once as well.
    """
    before, owner = signal.getsignal(signal.SIGINT), os.getpid()

    def ask(*_: object) -> None:
        if os.getpid() != owner:  # a worker, which gets the signal, too
            return
        signal.signal(signal.SIGINT, before)
        checkpoints.asked = True
        with suppress(RuntimeError):  # the signal arrived during printing
            print("stopping at the next checkpoint; Ctrl-C again stops at once", file=sys.stderr, flush=True)

    def end(*_: object) -> None:
        if not checkpoints.begun and os.getpid() == owner:
            raise KeyboardInterrupt

    asking = handled(signal.SIGINT, ask, signal.default_int_handler, stop_once)
    with asking, handled(signal.SIGTERM, end, signal.SIG_DFL):  # Lightning calls `end` after its own
        yield


@contextmanager
def interrupts_raised() -> Iterator[None]:
    """Raise KeyboardInterrupt where Lightning responds to Ctrl-C or SIGTERM by exiting the interpreter.

    Lightning ignores Ctrl-C after the first; this restores it. A `sys.exit` in user code passes through.
    """
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit as error:
        pressed = isinstance(error.__context__, KeyboardInterrupt)
        if not pressed and not isinstance(error, SIGTERMException):
            raise
        if pressed:
            signal.signal(signal.SIGINT, before)
        raise KeyboardInterrupt from error
    except Exception as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # Lightning fails to clean up what had not begun
            raise KeyboardInterrupt from error
        raise
