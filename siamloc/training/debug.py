"""`fit(debug=...)`: look at a training before it is started: one batch, one learned by heart, where the time goes."""

from __future__ import annotations

import copy
import math
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from statistics import mean
from typing import Any, Literal, cast

import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile, record_function
from torch.utils.data import DataLoader, Dataset

from augment.base import Effect
from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.files import atomic_path
from siamloc.models.batch_losses import Origins
from siamloc.models.module import NetworkModule
from siamloc.models.places import PlaceModule
from siamloc.runs import Run
from siamloc.training.batches import EpochDataModule
from siamloc.training.callbacks import images_in
from siamloc.training.guard import unscaled
from siamloc.training.run_folder import PROFILE

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402

Debug = Literal["overfit", "one_batch", "profile"]

OVERFIT_STEPS = 100
LEARNED, SLOW = 0.5, 0.05  # of what may go away of a loss: it learns from the first, not at all below the second
_LINES = 10
_AT_THE_END = 5  # steps whose mean loss is the last
_ENOUGH = 0.95  # of the way to the lowest loss: no further steps
_WARM_UP, _TIMED, _TRACED = 3, 10, 3
_OPERATORS = 5

_PHASES = ("waiting for data", "augmentation", "forward", "backward", "optimizer")


def debug_training(
    debug: Debug,
    module: NetworkModule,
    data: EpochDataModule,
    run: Run,
    used: Mapping[str, Any],
    make_trainer: Callable[..., Trainer],
) -> None:
    """Do one of these, say what came out, and leave the weights as they were.

    - "one_batch": a training step, and a batch of the validation: shapes, figures and times. Nothing is written.
    - "overfit": the first batch over and over, without augmentation: whether the loss goes down as it should. Nothing
      is written.
    - "profile": some steps, of which the parts are timed, then some under torch's profiler, whose trace is written
      into the run as `profile.json`.

    Args:
        debug: which.
        module: what happens in a step.
        data: serves the batches.
        run: gets the trace.
        used: the settings of the training, for the record of a run that has none yet.
        make_trainer: makes a trainer on the device of the training, with arguments of `lightning.Trainer`.

    Raises:
        ConfigError: the loss is not finite.
    """
    before = copy.deepcopy(module.state_dict())
    sigma = getattr(module.loss, "sigma", None)
    try:
        with torch.random.fork_rng(devices=[]):
            if debug == "profile":
                _profile(module, data, make_trainer, run, used)
            else:
                (_one_batch if debug == "one_batch" else _overfit)(module, data, make_trainer)
    finally:
        module.teardown("fit")  # which Lightning leaves out where something fails
        module.load_state_dict(before)
        module.zero_grad(set_to_none=True)
        if sigma is not None:  # which may have been on its way
            module.loss.sigma = sigma


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _milliseconds(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms"


@dataclass
class _Clock:
    """The time, once the device has done its work."""

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    def __call__(self) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()


class _Look(Callback):
    """Take down what a single batch gives."""

    def __init__(self) -> None:
        self.batches: dict[str, Mapping[str, Any]] = {}
        self.seconds: dict[str, float] = {}
        self.loss = self.gradient = math.nan
        self._clock = _Clock()
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


def _one_batch(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
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
    _say("one batch, of which nothing is kept:")
    _say(f"  network      {weights:,} weights, {trained:,} trained, on {device} in {trainer.precision}")
    for stage, batch in look.batches.items():
        _say(f"  {stage:12} {_shapes(batch)}")
        took, waited = look.seconds[stage], look.seconds[f"{stage} gathered"]
        if stage == "training":
            figures = f"loss {look.loss:.4g}, length of the gradient {look.gradient:.4g}"
            _say(f"               descriptors {_shape(shapes[0])}, {figures}")
        _say(f"               gathered in {_milliseconds(waited)}, computed in {_milliseconds(took)}")
    found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
    if found:
        listed = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
        _say(f"               {listed} (of this batch only)")
    if device.type == "cuda":
        _say(f"  memory       {torch.cuda.max_memory_allocated(device) / 2**30:.2f} GiB at most")
    _say(f"  an epoch has {steps} such steps; the first one takes longer than those that follow")


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _shapes(batch: Mapping[str, Any]) -> str:
    parts = {name: value for name, value in batch.items() if isinstance(value, Tensor)}
    kinds = {name: str(value.dtype).removeprefix("torch.") for name, value in parts.items()}
    return ", ".join(f"{name} {_shape(tuple(value.shape))} {kinds[name]}" for name, value in parts.items())


class _Same(Dataset[dict[str, Any]]):
    """One batch, so many times."""

    def __init__(self, batch: dict[str, Any], times: int) -> None:
        self._batch, self._times = batch, times

    def __len__(self) -> int:
        return self._times

    def __getitem__(self, number: int) -> dict[str, Any]:
        return dict(self._batch)


class _Losses(Callback):
    """Take down the loss of each step, and end the training where nearly nothing is left of it."""

    def __init__(self, lowest: float) -> None:
        self.lowest = lowest
        self.losses: list[float] = []

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self.losses.append(float(unscaled(trainer, loss)))

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        step = len(self.losses)
        if trainer.is_global_zero and (step == 1 or step % (OVERFIT_STEPS // _LINES) == 0):
            _say(f"  step {step:3}   loss {self.losses[-1]:.4g}")
        latest = self.losses[-_AT_THE_END:]
        nothing_left = max(latest) - self.lowest <= (1 - _ENOUGH) * (self.losses[0] - self.lowest)
        if not math.isfinite(latest[-1]) or (step > _AT_THE_END and nothing_left):
            trainer.should_stop = True


def _overfit(module: NetworkModule, data: EpochDataModule, make_trainer: Callable[..., Trainer]) -> None:
    data.augmentation = None
    batch = next(iter(data.train_dataloader()))
    losses = _Losses(_lowest(module, batch))
    trainer = make_trainer(callbacks=[losses], max_epochs=1, limit_val_batches=0)
    if trainer.is_global_zero:
        _say(f"one batch learned by heart, without augmentation, at most {OVERFIT_STEPS} steps; nothing is kept:")
    loader = DataLoader(_Same(batch, OVERFIT_STEPS), batch_size=None, generator=torch.Generator().manual_seed(0))
    try:
        trainer.fit(module, train_dataloaders=loader, val_dataloaders=[])
    except ConfigError:  # the module's, at the end of an epoch
        if math.isfinite(sum(losses.losses)):
            raise
    if trainer.is_global_zero:
        _say(verdict(losses.losses, losses.lowest, module.optimizer.learning_rate))


def _lowest(module: NetworkModule, batch: Mapping[str, Any]) -> float:
    """Return the smallest loss that the batch can have, where the loss knows it."""
    lowest = getattr(module.loss, "lowest", None)
    if lowest is None or not isinstance(module, PlaceModule):
        return 0.0
    return float(lowest(Origins(**{name: batch[name] for name in ("xy", "building", "room", "frame")})))


def verdict(losses: list[float], lowest: float, learning_rate: float) -> str:
    """Say in a sentence whether the loss of a batch that is learned over and over goes down as it should.

    Args:
        losses: of the steps.
        lowest: that the batch can have.
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
    if min(losses) < lowest - 1e-3 * max(1.0, abs(first)):  # a loss of one's own, which may go below 0
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


class _TimedEffect:
    """An effect whose time is added up."""

    def __init__(self, effect: Effect, clock: _Clock) -> None:
        self._effect, self._clock = effect, clock
        self.seconds = 0.0

    def _timed(self, work: Callable[..., Any], *given: Any) -> Any:
        start = self._clock()
        with record_function("augmentation"):
            result = work(*given)
        self.seconds += self._clock() - start
        return result

    def draw(self, generator: torch.Generator, batch: Tensor) -> dict[str, Tensor]:
        return dict(self._timed(self._effect.draw, generator, batch))

    def apply(self, batch: Tensor, params: Mapping[str, Tensor]) -> Tensor:
        found: Tensor = self._timed(self._effect.apply, batch, params)
        return found


class _Phases(Callback):
    """Time the parts of a step, and trace some more steps."""

    def __init__(self, clock: _Clock, effect: _TimedEffect | None) -> None:
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
        self._since = None  # what lies between epochs is no part of a step

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


def _profile(
    module: NetworkModule,
    data: EpochDataModule,
    make_trainer: Callable[..., Trainer],
    run: Run,
    used: Mapping[str, Any],
) -> None:
    clock, effect = _Clock(), None
    in_workers = data.workers > 0 and data.augmentation is not None and data.augmentation.where == "cpu"
    if data.augmentation is not None and not in_workers:
        effect = _TimedEffect(data.augmentation.effect, clock)
        data.augmentation = replace(data.augmentation, effect=cast(Effect, effect))
    phases = _Phases(clock, effect)
    steps = len(data.train_dataloader())
    # The first step of an epoch is not timed.
    epochs = -(-(_WARM_UP + _TIMED + _TRACED) // max(steps - 1, 1))
    trainer = make_trainer(callbacks=[phases], max_epochs=epochs, limit_val_batches=0)
    if trainer.is_global_zero:
        _say(f"where the time goes: {_WARM_UP + _TIMED + _TRACED} steps")
    trainer.fit(module, datamodule=data)
    if not trainer.is_global_zero:
        return
    if phases.profiler is None or not phases.images:
        _say("an epoch has a single step, which cannot be told from what starts it up: use a smaller batch")
        return
    parts = {name: mean(values) for name, values in phases.seconds.items()}
    whole = sum(parts.values())
    _say(f"a step of {phases.images} images on {clock.device} in {trainer.precision}, mean of {_TIMED}:")
    for name, seconds in parts.items():
        shown = f"{_milliseconds(seconds):>12} {100 * seconds / whole:5.0f} %"
        if name == "augmentation" and in_workers:
            shown = f"{'':12} in the {data.workers} workers, beside the steps"
        _say(f"  {name:18}{shown}")
    _say(f"  {'together':18}{_milliseconds(whole):>12}   100 %   {phases.images / whole:.0f} images/s")
    _say_operators(phases.profiler, clock.device)
    if not run.record.is_file():
        run.start(used, [PROFILE])
    run.record_written([PROFILE])
    path = run.folder / PROFILE
    with atomic_path(path) as temporary:
        phases.profiler.export_chrome_trace(str(temporary))
    _say(f"trace of {_TRACED} steps: {path}, to be opened in https://ui.perfetto.dev")


def _say_operators(profiler: profile, device: torch.device) -> None:
    """Name the operators that take most of the time by themselves."""
    kind = "self_device_time_total" if device.type == "cuda" else "self_cpu_time_total"
    own = [*_PHASES, "ProfilerStep", "Optimizer."]  # spans that hold operators, and no operators themselves
    found = [event for event in profiler.key_averages() if not any(event.key.startswith(name) for name in own)]
    total = sum(getattr(event, kind) for event in found) or 1.0
    _say(f"operators that take most of it, under the profiler, of {_TRACED} more steps:")
    for event in sorted(found, key=lambda event: -getattr(event, kind))[:_OPERATORS]:
        spent = getattr(event, kind)
        each = _milliseconds(spent / 1e6 / _TRACED)
        _say(f"  {event.key[:40]:40}{each:>12} {100 * spent / total:5.0f} %   {event.count // _TRACED} calls a step")
