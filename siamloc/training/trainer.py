"""The Lightning trainer of a run, with checkpoints and curves, and the checks of its arguments."""

from __future__ import annotations

import logging
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

import torch
from torch import Tensor

from foundation.files import content_key
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError, in_one_line
from siamloc.lightning import Callback, LayerSync, LightningModule, Trainer
from siamloc.models.module import NetworkModule
from siamloc.models.network import Network
from siamloc.progress import shown
from siamloc.runs import Run
from siamloc.training.batch_norm import OneBatch
from siamloc.training.callbacks import AtomicCheckpoints, Curves, MovingAverage, checkpoint_callbacks
from siamloc.training.guard import FiniteGuard
from siamloc.training.loggers import check_loggers, listed, loggers_of
from siamloc.training.pace import Pace
from siamloc.training.settings import Training
from siamloc.training.stopping import Limits, StepCheckpoints

TRAINER: Mapping[str, Any] = {"accelerator": "auto", "devices": 1, "log_every_n_steps": 10, "logger": "tensorboard"}
"""Default arguments of `lightning.Trainer` in `fit`."""
_LAUNCHED = {"MASTER_ADDR", "SLURM_JOB_ID", "LSB_JOBID", "TORCHELASTIC_RUN_ID", "OMPI_COMM_WORLD_SIZE"}
"""Environment variables set by the launchers of several machines."""
_NO_MEMORY = re.compile("out of memory|allocate memory|not enough memory|ALLOC_FAILED")  # of CUDA, CPUs, cuDNN
BACKEND = "inductor"  # of torch.compile


def run_trainer(run: Run, settings: Training, further: Mapping[str, Any] | None, monitor: str | None) -> Trainer:
    """Make the trainer of a run: checkpoints, curves and the files of its loggers go to the run's folder.

    Args:
        run: the run.
        settings: number of epochs, clipping, moving average, patience and checkpoints within epochs.
        further: further arguments of `lightning.Trainer`.
        monitor: name of the logged figure that chooses the best epoch, such as "val/error"; None if nothing is
            validated.

    Raises:
        ConfigError: arguments that Lightning refuses, or that siamloc sets itself.
    """
    options = dict(further or {})
    loggers = loggers_of(run, options.pop("logger", TRAINER["logger"]))
    pace = Pace()
    guard = FiniteGuard()
    checked = getattr(settings.pairs, "by", None) == "steps"
    curves = Curves(run, monitor, pace, settings.patience, checked=checked)
    callbacks = [*listed(options.pop("callbacks", None)), _Seeds(settings.seed), guard, pace, curves]
    steps = StepCheckpoints(run.checkpoints / "last.ckpt", settings.checkpoint_every, guard)
    if settings.average is not None:
        callbacks.append(MovingAverage(decay=settings.average))
    if settings.clip is not None:
        if (other := options.get("gradient_clip_val")) is not None:
            raise ConfigError(
                f"clip={settings.clip:g} and trainer.gradient_clip_val={other} both limit the gradient: leave one out"
            )
        options["gradient_clip_val"] = settings.clip
    plugins = listed(options.pop("plugins", None))
    if "sync_batchnorm" not in options and not any(isinstance(one, LayerSync) for one in plugins):
        plugins.append(OneBatch(gpu=on_gpu(options)))
    own: dict[str, Any] = {
        "max_epochs": settings.epochs,
        "default_root_dir": run.folder,
        "logger": loggers,
        "callbacks": [Limits(steps), *callbacks, *checkpoint_callbacks(run.checkpoints, monitor), steps],
        "plugins": [*plugins, AtomicCheckpoints()],
        "num_sanity_val_steps": 0,
        "limit_val_batches": 1.0 if monitor else 0,
        "enable_model_summary": False,
    }
    taken = sorted(set(options) & set(own))
    if taken:
        raise ConfigError(f"trainer.{taken[0]} is set by siamloc itself: leave it out")
    options.setdefault("enable_progress_bar", shown() and sys.stderr.isatty())
    return _made(options, own)


def recorded(trainer: Trainer, further: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the trainer's settings, besides the number of batches, that determine the steps and what they learn."""
    keys = "accumulate_grad_batches", "limit_train_batches", "max_steps"
    given = further or {}
    return {
        "precision": "auto" if precision_of(given) == "auto" else str(trainer.precision),
        "processes": trainer.world_size,
        **{key: getattr(trainer, key) for key in keys},
        "gradient_clip_val": given.get("gradient_clip_val"),
        "gradient_clip_algorithm": given.get("gradient_clip_algorithm") or "norm",
    }


def check_trainer(further: Mapping[str, Any] | None) -> Trainer:
    """Make a trainer that writes nothing, so that wrong arguments are refused before any work is done for them.

    Raises:
        ConfigError: arguments that Lightning refuses.
    """
    check_loggers({**TRAINER, **(further or {})}["logger"])
    own = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    with quiet():
        return _made({name: value for name, value in (further or {}).items() if name not in own}, own)


def _made(options: Mapping[str, Any], own: Mapping[str, Any]) -> Trainer:
    """Make a trainer.

    Raises:
        ConfigError: arguments that Lightning refuses.
    """
    options = {**TRAINER, **options}
    _check_processes(options)
    if options.get("precision") == "auto":
        # bfloat16 if the device has instructions for it: CPUs have AVX512-BF16, and those with AMX have it as well.
        gpu = on_gpu(options)
        fast = torch.cuda.is_bf16_supported(including_emulation=False) if gpu else torch.cpu._is_avx512_bf16_supported()
        options["precision"] = "bf16-mixed" if fast else "32-true"
    try:
        return Trainer(**{**options, **own})
    except Exception as error:  # Lightning and the device backends may raise anything
        sentence = f"the trainer cannot be set up with these trainer keys: {in_one_line(error)}"
        if (wanted := options["accelerator"]) in ("gpu", "cuda") and not torch.cuda.is_available():
            sentence = f"trainer.accelerator={wanted} needs a GPU, and torch finds none here: use auto or cpu"
        raise ConfigError(sentence) from error


def _check_processes(options: Mapping[str, Any]) -> None:
    """Make sure that the training does not wait for processes that nobody starts.

    Raises:
        ConfigError: far more processes than processors without a GPU, or several machines without a launcher.
    """
    devices, nodes = options.get("devices", 1), options.get("num_nodes", 1)
    processors = os.cpu_count() or 1
    if isinstance(devices, int) and devices > max(8, 2 * processors) and not on_gpu(options):
        raise ConfigError(
            f"trainer.devices={devices} starts as many processes, and this machine has {processors} processors and no "
            "GPU: ask for fewer"
        )
    if isinstance(nodes, int) and nodes > 1 and not _LAUNCHED & set(os.environ):
        raise ConfigError(
            f"trainer.num_nodes={nodes} waits for processes on other machines, and no launcher has started any "
            f"(none of {', '.join(sorted(_LAUNCHED))} is set): start it with torchrun or a cluster's launcher, or "
            "leave trainer.num_nodes out"
        )


def on_gpu(options: Mapping[str, Any] | None) -> bool:
    """Whether a trainer with these arguments of `lightning.Trainer` uses a CUDA GPU."""
    accelerator = str({**TRAINER, **(options or {})}["accelerator"])
    return accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available()


def precision_of(options: Mapping[str, Any] | None) -> str:
    """Return the precision that arguments of `lightning.Trainer` ask for."""
    return str((options or {}).get("precision", "32-true"))


@contextmanager
def computing(module: NetworkModule, settings: Training, further: Mapping[str, Any] | None) -> Iterator[None]:
    """Run the steps of a training inside a `with` block: in training mode, compiled if the settings say so.

    A network in evaluation mode is put into training mode; if only some parts are in evaluation, they stay so.

    With the trainer's precision "auto", a network from `build` stores the channels of a pixel together, which makes
    convolutions faster. Custom modules stay as they are, since they may rely on their layout.

    Raises:
        ConfigError: the device or the machine has too little memory.
    """
    if not module.network.training:
        module.network.train()
    precision = precision_of(further)
    if layout := precision == "auto" and isinstance(module.network, Network):
        module.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    try:
        with compiled(module, settings.compile if on_gpu(further) else settings.compile is True):
            yield
    except (MemoryError, RuntimeError) as error:
        if not (isinstance(error, MemoryError) or _NO_MEMORY.search(str(error))):
            raise
        places = isinstance(settings.pairs, PlaceSettings)
        batch = "pairs.places and pairs.images" if places else f"batch_size={settings.batch_size}"
        raise ConfigError(
            f"there is too little memory for {batch}, trainer.precision={precision} and "
            f"augment.where={settings.augment_where}: take smaller batches, trainer.precision=bf16-mixed, or "
            "augment.where=cpu"
        ) from error
    finally:
        if layout:
            module.network.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]


@contextmanager
def compiled(module: NetworkModule, wanted: Literal["auto"] | bool) -> Iterator[None]:
    """Let training steps use the compiled network; validation and later calls use the network as it is.

    The network, or each of the two parts of one that learns displacements, is compiled once, for the size of a whole
    batch; a smaller last batch takes the network as it is. Names of weights, checkpoints and hooks stay as they are.
    With "auto", a network that cannot be compiled is used as it is, and a note is printed.

    Args:
        module: the training module with the network.
        wanted: True compiles, False does not; "auto" compiles if that works.

    Raises:
        ConfigError: the network cannot be compiled, which shows in the first step.
    """
    if not wanted:
        yield
        return
    from torch._dynamo.exc import TorchDynamoException
    from torch._inductor.exc import InductorError

    parts: dict[Callable[..., Any], tuple[Callable[..., Any], int]] = {}

    def call(part: Callable[..., Any], *inputs: Tensor) -> Any:
        if part not in parts:
            made = torch.compile(lambda *given: part(*given), backend=BACKEND, dynamic=False)
            parts[part] = made, len(inputs[0])
        fast, whole = parts[part]
        if len(inputs[0]) < whole:
            return part(*inputs)
        try:
            return fast(*inputs)
        except (TorchDynamoException, InductorError) as error:
            reason = " ".join([line.strip() for line in str(error).splitlines() if line.strip()][:2])
            if wanted != "auto":
                raise ConfigError(
                    f"torch cannot compile this network here: {reason}; leave compile=true out"
                ) from error
            print(f"note: training without torch.compile, which fails here: {reason}", file=sys.stderr)
            module.compiled = None
            return part(*inputs)

    module.compiled = call
    try:
        yield
    finally:
        module.compiled = None


@contextmanager
def quiet() -> Iterator[None]:
    """Hide what Lightning prints about itself; warnings that concern the user stay, and so do its profilers."""
    levels = {"pytorch": logging.WARNING, "fabric": logging.WARNING, "pytorch.profilers": logging.INFO}
    loggers = {logging.getLogger(f"lightning.{name}"): level for name, level in levels.items()}
    before = [logger.level for logger in loggers]
    unfounded = (
        "LeafSpec",
        "many workers",
        "smaller than the logging interval",
        "is not empty",
        "before the epoch ended",
        "is supported for historical reasons",  # the name bf16 for bf16-mixed
        r"add the following callbacks: \['Timer'\]",  # resumed without the max_time it had
        "The .grad attribute of a Tensor that is not a leaf",  # torch's compiler reads it
    )
    with warnings.catch_warnings():
        for text in unfounded:
            warnings.filterwarnings("ignore", message=f".*{text}")
        for logger, level in loggers.items():
            logger.setLevel(level)
        try:
            yield
        finally:
            for logger, level in zip(loggers, before, strict=True):
                logger.setLevel(level)


class _Seeds(Callback):
    """Seed the random generators of layers such as dropout, of the CPU and the GPU, from seed, epoch and batch."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """Seed the generators."""
        key = content_key([self._seed, trainer.current_epoch, batch_idx, trainer.global_rank], 15)
        torch.default_generator.manual_seed(int(key, 16))
        if trainer.strategy.root_device.type == "cuda":
            torch.cuda.manual_seed(int(key, 16))  # of this GPU; `torch.manual_seed` would seed all
