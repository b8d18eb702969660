"""What a training saves: checkpoints that are whole or absent, and the curves stored in them."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import Any

import torch

from foundation.files import atomic_path, csv_text, write_text
from siamloc.errors import StorageError
from siamloc.lightning import (
    Callback,
    Checkpoint,
    LightningModule,
    ModelCheckpoint,
    TensorBoardLogger,
    TorchCheckpointIO,
    Trainer,
    WeightAveraging,
)
from siamloc.models.describing import margin_of
from siamloc.models.places import PlaceModule
from siamloc.progress import shown
from siamloc.runs import Run, higher_is_better
from siamloc.training.loggers import files_logged
from siamloc.training.pace import Pace

_SAID = (
    *("train/loss", "train/accuracy", "train/active", "train/relative"),
    *("val/loss", "val/accuracy", "val/error", "val/recall", "val/room", "val/refined"),
)
_COLLAPSED = 0.01  # spread of descriptors of length 1, below which they distinguish nothing
_COLLAPSED_PAIRS = 0.0125  # the same of the mean distance of pairs, as a share of the margin; random weights have more
_ACTIVE = 0.01  # share of pairs or triplets with a loss, below which hardly anything is learned
_PATHS = ("best_model_path", "kth_best_model_path", "last_model_path")
_SHORT_WRITE = ("inline_container", "unexpected pos", "PytorchStreamWriter failed")


class AtomicCheckpoints(TorchCheckpointIO):
    """Write a checkpoint under a temporary name and rename it, so that a killed run keeps the previous one."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any | None = None) -> None:
        """Save a checkpoint of the trainer.

        Raises:
            StorageError: the disk is full or refuses; the previous checkpoint stays as it was.
        """
        with atomic_path(path) as temporary:
            try:
                torch.save(checkpoint, temporary)
            except RuntimeError as error:
                # torch bypasses Python for writing, and reports a short write only by the position in the file.
                if not any(sign in str(error) for sign in _SHORT_WRITE):
                    raise
                raise StorageError(
                    f"the checkpoint {path} could not be written whole: free some space on the disk or write elsewhere"
                ) from error


class _MovableCheckpoint(ModelCheckpoint):
    """A checkpoint callback that knows its best figure even after the folder of its run was moved."""

    @property
    def state_key(self) -> str:
        """The name of its state in a checkpoint: that of the Lightning class."""
        return super().state_key.replace(type(self).__qualname__, ModelCheckpoint.__qualname__)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue with the state of a run, in the current folder."""
        folder = Path(str(self.dirpath))

        def here(path: str) -> str:
            return str(folder / Path(path).name) if path else path

        paths = {name: here(state_dict[name]) for name in _PATHS if name in state_dict}
        kept = {here(path): score for path, score in state_dict.get("best_k_models", {}).items()}
        super().load_state_dict({**state_dict, **paths, "best_k_models": kept, "dirpath": self.dirpath})


def checkpoint_callbacks(folder: Path, monitor: str | None) -> list[Callback]:
    """Make the callbacks that write `last.ckpt` after every epoch, and `best.ckpt` by the best logged figure.

    Args:
        folder: folder of the checkpoints.
        monitor: name of the logged figure that chooses the best epoch, such as "val/error"; None writes no `best.ckpt`.
    """
    common: dict[str, Any] = {"dirpath": folder, "save_top_k": 1, "enable_version_counter": False}
    last = _MovableCheckpoint(filename="last", save_on_train_epoch_end=True, **common)
    if monitor is None:
        return [last]
    mode = "max" if higher_is_better(monitor) else "min"
    best = _MovableCheckpoint(filename="best", monitor=monitor, mode=mode, save_on_train_epoch_end=False, **common)
    return [best, last]


class MovingAverage(WeightAveraging):
    """Average the weights over the steps of a training, on the device where they are trained.

    After each step a <- a + (1 - decay) (w - a), in this form because it leaves anything constant exactly as it is:
    frozen stages, and constants among the buffers.

    Args:
        decay: weight of the average a in the next average, from 0 to 1.
    """

    def __init__(self, decay: float) -> None:
        super().__init__(use_buffers=True)
        self._decay = decay

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Set the device of the average to the device of the trainer."""
        self._device = trainer.strategy.root_device
        super().setup(trainer, pl_module, stage)

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *more: Any) -> None:
        """Update the average; after the first step without reading numbers from the device, which would block."""
        average = self._average_model
        if average is None or self._latest_update_step == 0:
            super().on_train_batch_end(trainer, pl_module, *more)
        elif trainer.global_step > self._latest_update_step:
            self._latest_update_step = trainer.global_step
            average.n_averaged += 1
            averages, weights = ([*one.parameters(), *one.buffers()] for one in (average.module, pl_module))
            moving = [row for row, value in enumerate(averages) if value.is_floating_point()]
            with torch.no_grad():
                steps = torch._foreach_sub([weights[row] for row in moving], [averages[row] for row in moving])
                torch._foreach_mul_(steps, 1 - self._decay)
                torch._foreach_add_([averages[row] for row in moving], steps)
                for held, current in zip(averages, weights, strict=True):
                    if not held.is_floating_point():
                        held.copy_(current)


class Curves(Checkpoint):
    """Write a row per epoch with all logged figures to a CSV file, and print a line per epoch.

    The rows also determine which epoch is the best, and whether it is time to stop.

    They are stored in the checkpoint, so that the file of a resumed run equals that of a run that never stopped. This
    class is a checkpoint callback because those run last: after the module has logged its epoch.

    Args:
        run: run of the training.
        monitor: name of the logged figure that chooses the best epoch, such as "val/error"; None if nothing is
            validated.
        pace: speed of the training, for the printed lines.
        patience: number of validations without a better figure after which the training stops; never if None.
        checked: whether a check after the training chooses the weights, which then prints the checkpoint.
    """

    def __init__(
        self, run: Run, monitor: str | None, pace: Pace, patience: int | None = None, *, checked: bool = False
    ) -> None:
        self._run, self._monitor, self._pace, self._patience, self._checked = run, monitor, pace, patience, checked
        self._rows: list[dict[str, float]] = []
        self._start = (0.0, 0)
        self._validated = False
        self._logged_before = files_logged(run)

    def on_train_start(self, trainer: Trainer, *_: Any) -> None:
        """Note the start time and the first epoch, and record the files that the loggers opened."""
        self._start = (time.monotonic(), trainer.current_epoch)
        trainer.should_stop |= self._stale()
        self.on_fit_end(trainer)

    def on_fit_end(self, trainer: Trainer, *_: Any) -> None:
        """Record the files of the loggers, pictures included."""
        if trainer.is_global_zero:
            self._run.record_written(files_logged(self._run) - self._logged_before)

    def on_exception(self, trainer: Trainer, *_: Any) -> None:
        """Record the files of the loggers if the training ends early."""
        self.on_fit_end(trainer)

    def on_validation_end(self, *_: Any) -> None:
        """Note that the figures of the validation are those of this epoch."""
        self._validated = True

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the figures of the epoch as a row of the file."""
        old = " " if self._validated else "val/"  # the trainer keeps the figures of earlier validations
        figures = trainer.callback_metrics.items()
        values = {key: float(value) for key, value in figures if "/" in key and not key.startswith(old)}
        self._validated = False
        self._rows.append({"epoch": trainer.current_epoch, "step": trainer.global_step, **values})
        trainer.should_stop |= self._stale()
        if trainer.is_global_zero:
            self._write()
            self._say(trainer, values)
            self._warn(trainer, pl_module, values)

    def on_train_end(self, trainer: Trainer, *_: Any) -> None:
        """Record the files of the loggers, and print a summary, unless the training was interrupted."""
        self.on_fit_end(trainer)
        if not (trainer.is_global_zero and shown()):
            return
        took = time.monotonic() - self._start[0]
        parts = [f"trained in {took / 60:.1f} min" if took >= 60 else f"trained in {took:.0f} s"]
        if (done := len(self._rows)) < (trainer.max_epochs or 0):
            reason = f"none of the last {self._patience} was better"
            if not self._stale():
                limit = "max_steps" if 0 <= trainer.max_steps <= trainer.global_step else "max_time or a callback"
                reason = f"by the trainer's {limit}"
            parts.append(f"stopped early after epoch {done} of {trainer.max_epochs}, {reason}")
        if (best := self._best()) is not None:
            parts.append(self._figures_of(best[1]))
        if math.isfinite(self._pace.images_per_second):
            parts.append(f"{self._pace.images_per_second:.0f} images/s")
            parts.append(f"{self._pace.waiting:.0%} of the time waiting for data")
        checkpoint = self._run.checkpoints / ("last.ckpt" if best is None else "best.ckpt")
        kept = "" if self._checked else f"checkpoint: {checkpoint}; "
        self._tell(trainer, ", ".join(parts))
        board = any(isinstance(logger, TensorBoardLogger) for logger in trainer.loggers)
        curves = f"tensorboard --logdir {quote(str(self._run.tensorboard))}" if board else str(self._run.metrics)
        if self._rows:
            self._tell(trainer, f"{kept}curves: {curves}")

    def state_dict(self) -> dict[str, Any]:
        """Return the rows so far, for the checkpoint."""
        return {"rows": self._rows}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the rows from a checkpoint."""
        self._rows = list(state_dict["rows"])

    def _best(self) -> tuple[float, int] | None:
        """Return the best figure and its epoch; the first in a tie, as for the checkpoint."""
        name = self._monitor
        if name is None:
            return None
        found = [(row[name], int(row["epoch"])) for row in self._rows if name in row]
        return (max if higher_is_better(name) else min)(found, key=lambda pair: pair[0], default=None)

    def _figures_of(self, epoch: int) -> str:
        """Name the best epoch with its validation figures, starting with the figure by which the epoch was chosen."""
        row = next(row for row in self._rows if row["epoch"] == epoch)
        others = sorted(name for name in row if name.startswith("val/") and name != self._monitor)
        listed = f" ({', '.join(f'{name[4:]} {row[name]:.4f}' for name in others)})" if others else ""
        return f"best epoch {epoch + 1} by {self._monitor} {row[str(self._monitor)]:.4f}{listed}"

    def _stale(self) -> bool:
        """Whether the last `patience` validations brought no improvement."""
        best = self._best()
        if self._patience is None or best is None:
            return False
        return sum(self._monitor in row and row["epoch"] > best[1] for row in self._rows) >= self._patience

    def _say(self, trainer: Trainer, values: dict[str, float]) -> None:
        if not shown():
            return
        start, first = self._start
        done, total = trainer.current_epoch + 1, trainer.max_epochs or 0
        left = (time.monotonic() - start) / (done - first) * (total - done)
        figures = ", ".join(f"{name} {values[name]:.4f}" for name in _SAID if name in values)
        self._tell(trainer, f"epoch {done} of {total}: {figures}, {left:.0f} s left")

    def _warn(self, trainer: Trainer, module: LightningModule, values: dict[str, float]) -> None:
        """Warn if a training collapsed, or has nothing left to learn from."""
        spread = values.get("train/spread", math.inf)
        if isinstance(module, PlaceModule):  # whose descriptors have unit length
            collapsed, where = spread < _COLLAPSED, "places in a batch"
        else:
            # Without a margin, the largest distance of the descriptors so far.
            widths = [width for row in self._rows if math.isfinite(width := _apart(row))]
            widest = margin_of(getattr(module, "loss", None)) or max(widths, default=0.0)
            collapsed, where = _apart(values) < _COLLAPSED_PAIRS * widest, "pairs of different places"
        if collapsed:
            self._tell(
                trainer,
                f"warning: the network gives nearly every image the same descriptor, train/spread is {spread:.2g}: "
                f"if this persists, train with a smaller optimizer.learning_rate, or with more {where}",
            )
        active = values.get("train/active", math.inf)
        if active < _ACTIVE and not collapsed:
            what = "pairs or triplets" if isinstance(module, PlaceModule) else "pairs of different places"
            self._tell(
                trainer,
                f"warning: hardly any {what} contribute to the loss, train/active is {active:.2%}: if the validation "
                "is not good yet, train with a larger margin, or with more examples that are hard to distinguish",
            )

    def _tell(self, trainer: Trainer, text: str) -> None:
        say = print if trainer.progress_bar_callback is None else trainer.progress_bar_callback.print
        say(text, file=sys.stderr)

    def _write(self) -> None:
        names = ["epoch", "step", *sorted({name for row in self._rows for name in row} - {"epoch", "step"})]
        write_text(self._run.metrics, csv_text([names, *([row.get(name) for name in names] for row in self._rows)]))


def _apart(figures: Mapping[str, float]) -> float:
    """Return the mean distance between the descriptors of pairs; infinity if unknown."""
    distances = [figures[name] for name in ("train/distance_same", "train/distance_different") if name in figures]
    return max(distances, default=math.inf)
