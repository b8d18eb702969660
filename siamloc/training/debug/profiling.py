"""`fit(debug="profile")`: time the parts of some steps, then run some under torch's profiler."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from statistics import mean
from typing import Any, cast

import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile, record_function

from augment.base import Effect
from augment.torchvision_compat import ensure_torchvision
from siamloc.files import atomic_path
from siamloc.models.module import NetworkModule
from siamloc.runs import Run
from siamloc.training.batches import EpochDataModule
from siamloc.training.debug.console import Clock, milliseconds, say
from siamloc.training.pace import images_in
from siamloc.training.run_folder import PROFILE

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402

_WARM_UP, _TIMED, _TRACED = 3, 10, 3
_OPERATORS = 5

_PHASES = ("waiting for data", "augmentation", "forward", "backward", "optimizer")


class _TimedEffect:
    """An effect that sums up the time of some of its methods, those that the training process calls."""

    def __init__(self, effect: Effect, clock: Clock, timed: Collection[str]) -> None:
        self._clock = clock
        self.seconds = 0.0
        for name in ("draw", "program", "apply", "play"):
            work = getattr(effect, name)
            setattr(self, name, partial(self._timed, work) if name in timed else work)

    def _timed(self, work: Callable[..., Any], *given: Any) -> Any:
        start = self._clock()
        with record_function("augmentation"):
            result = work(*given)
        self.seconds += self._clock() - start
        return result


class _Phases(Callback):
    """Time the parts of a step, and trace some more steps."""

    def __init__(self, clock: Clock, effect: _TimedEffect | None) -> None:
        self.seconds: dict[str, list[float]] = {name: [] for name in _PHASES}
        self.images = 0
        self.profiler: profile | None = None
        self._clock, self._effect = clock, effect
        self._now: dict[str, float] = {}
        self._since: float | None = None
        self._steps = 0
        self._span: AbstractContextManager[Any] | None = None

    def _next(self, finished: str | None, begins: str | None) -> None:
        """End a part of the step and begin another one, in the trace as well."""
        now = self._clock()
        if finished is not None and self._since is not None:
            self._now[finished] = now - self._since
        self._since = now
        if self._span is not None:
            self._span.__exit__(None, None, None)
        self._span = None if begins is None else record_function(begins)
        if self._span is not None:
            self._span.__enter__()

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._clock.device = pl_module.device

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._since = None  # the time between epochs is not part of a step

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self.images = images_in(batch)
        self._next(_PHASES[0], "forward")

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self._next("forward", "backward")

    def on_after_backward(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._next("backward", "optimizer")

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        self._next("optimizer", None)
        step, self._now = self._now, {}
        changed = 0.0 if self._effect is None else self._effect.seconds
        if self._effect is not None:
            self._effect.seconds = 0.0
        if _PHASES[0] in step:
            self._steps += 1
            if _WARM_UP < self._steps <= _WARM_UP + _TIMED:
                step["augmentation"] = min(changed, step[_PHASES[0]])
                step[_PHASES[0]] -= step["augmentation"]
                for name in _PHASES:
                    self.seconds[name].append(step[name])
        if self._steps == _WARM_UP + _TIMED and self.profiler is None:
            self._start_profiler()
        if self._steps == _WARM_UP + _TIMED + _TRACED:
            assert self.profiler is not None
            self.profiler.stop()
            trainer.should_stop = True
        else:
            self._next(None, _PHASES[0])

    def _start_profiler(self) -> None:
        kinds = [ProfilerActivity.CPU]
        if self._clock.device.type == "cuda":
            kinds.append(ProfilerActivity.CUDA)
        self.profiler = profile(activities=kinds)
        self.profiler.start()


def profile_steps(
    module: NetworkModule,
    data: EpochDataModule,
    make_trainer: Callable[..., Trainer],
    run: Run,
    used: Mapping[str, Any],
) -> None:
    """Time the parts of some steps, trace some more, and write the trace into the run."""
    clock, effect = Clock(), None
    in_workers = data.workers > 0 and data.augmentation is not None and data.augmentation.where == "cpu"
    if data.augmentation is not None and not in_workers:
        timed = ["play"] if data.workers else ["draw", "program", "apply", "play"]  # workers draw, and have no clock
        effect = _TimedEffect(data.augmentation.effect, clock, timed)
        data.augmentation = replace(data.augmentation, effect=cast(Effect, effect))
    phases = _Phases(clock, effect)
    steps = len(data.train_dataloader())
    # The first step of an epoch is not timed.
    epochs = -(-(_WARM_UP + _TIMED + _TRACED) // max(steps - 1, 1))
    trainer = make_trainer(callbacks=[phases], max_epochs=epochs, limit_val_batches=0)
    if trainer.is_global_zero:
        say(f"where the time goes: {_WARM_UP + _TIMED + _TRACED} steps")
    trainer.fit(module, datamodule=data)
    if not trainer.is_global_zero:
        return
    if phases.profiler is None or not phases.images:
        say("an epoch has a single step, which cannot be separated from its start-up: use a smaller batch")
        return
    parts = {name: mean(values) for name, values in phases.seconds.items()}
    whole = sum(parts.values())
    say(f"a step of {phases.images} images on {clock.device} in {trainer.precision}, mean of {_TIMED}:")
    for name, seconds in parts.items():
        shown = f"{milliseconds(seconds):>12} {100 * seconds / whole:5.0f} %"
        if name == "augmentation" and in_workers:
            shown = f"{'':12} in the {data.workers} workers, in parallel with the steps"
        say(f"  {name:18}{shown}")
    say(f"  {'together':18}{milliseconds(whole):>12}   100 %   {phases.images / whole:.0f} images/s")
    _say_operators(phases.profiler, clock.device)
    if not run.record.is_file():
        run.start(used, [PROFILE])
    run.record_written([PROFILE])
    path = run.folder / PROFILE
    with atomic_path(path) as temporary:
        phases.profiler.export_chrome_trace(str(temporary))
    say(f"trace of {_TRACED} steps: {path}, open it in https://ui.perfetto.dev")


def _say_operators(profiler: profile, device: torch.device) -> None:
    """Print the operators that take most of the time themselves."""
    kind = "self_device_time_total" if device.type == "cuda" else "self_cpu_time_total"
    own = [*_PHASES, "ProfilerStep", "Optimizer."]  # spans that contain operators, not operators themselves
    found = [event for event in profiler.key_averages() if not any(event.key.startswith(name) for name in own)]
    total = sum(getattr(event, kind) for event in found) or 1.0
    say(f"operators that take most of it, under the profiler, of {_TRACED} more steps:")
    for event in sorted(found, key=lambda event: -getattr(event, kind))[:_OPERATORS]:
        spent = getattr(event, kind)
        each = milliseconds(spent / 1e6 / _TRACED)
        say(f"  {event.key[:40]:40}{each:>12} {100 * spent / total:5.0f} %   {event.count // _TRACED} calls a step")
