"""`fit`: train a network on pairs of frames, from the start or from the last checkpoint of its run."""

from __future__ import annotations

import inspect
import logging
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import torch
from torch import nn

import augment
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSettings
from siamloc.data.places import PlaceSettings
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError, SiamlocError, leave_out
from siamloc.files import content_key, plain
from siamloc.models.batch_losses import SoftContrastiveLoss
from siamloc.models.checkpoint import load, read_checkpoint
from siamloc.models.describing import describe
from siamloc.models.losses import ContrastiveLoss
from siamloc.models.module import NetworkModule, name_of
from siamloc.models.places import BatchLoss, PlaceModule
from siamloc.models.registry import branch_spec
from siamloc.models.siamese import Loss, SiameseModule
from siamloc.runs import Run
from siamloc.settings import takes
from siamloc.training.batches import BatchAugmentation, PairDataModule
from siamloc.training.callbacks import AtomicCheckpoints, Curves, MovingAverage, checkpoint_callbacks
from siamloc.training.place_batches import PlaceDataModule
from siamloc.training.settings import Training

ensure_torchvision()
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402
from lightning.pytorch.loggers import TensorBoardLogger  # noqa: E402
from lightning.pytorch.utilities.exceptions import MisconfigurationException  # noqa: E402

TRAINER: Mapping[str, Any] = {"accelerator": "auto", "devices": 1, "log_every_n_steps": 10}
"""Arguments of `lightning.Trainer` that `fit` begins with."""

# What may differ when a run is resumed: where files lie, how fast it goes, how long it trains.
_FREE = (
    *("data.cache", "data.manifest", "data.root", "data.places", "data.name", "data.on_error"),
    *("protocol.map", "protocol.query", "protocol.leave_one_out", "protocol.apart"),
    *("training.epochs", "training.workers", "training.augment_where"),
)
_UNIT_ROUNDING = 1e-2  # of the length of a descriptor in half precision
_LEARNED = ("data", "protocol", "model", "loss", "training", "augment", "frames")


@takes(Training)
def fit(
    network: nn.Module,
    images: PanoramaLibrary,
    frames: FrameTable,
    *,
    run: str | Path | Run,
    validation: FrameTable | None = None,
    loss: Loss | BatchLoss | None = None,
    augmentation: augment.Effect | Mapping[str, Any] | str | None = None,
    trainer: Mapping[str, Any] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    protocol: Mapping[str, Any] | None = None,
    settings: Training,
) -> Run:
    """Train a network on pairs of frames, in place.

    Afterwards it holds the weights that `siamloc.models.load(run)` gives: the best by the validation (by the loss of
    pairs, or with batches of places by the error of localization), or the last where nothing is validated. Everything
    that can be checked is checked before the run's folder is touched. Where several processes train together
    (`trainer={"devices": 2, "strategy": "ddp"}`, torchrun, SLURM), each calls `fit`, and only the first writes.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        images: decoded panoramas of all frames.
        frames: training frames, among those of the library.
        run: folder of the run, a new or empty one.
        validation: frames by which the checkpoint is chosen, other ones than `frames`.
        loss: of pairs, (d0 (B, D), d1 (B, D), y (B,)) -> scalar, the mean over the pairs, `ContrastiveLoss(margin)` if
            None; of batches of places, (descriptors (N, D), `Origins`) -> scalar, `SoftContrastiveLoss()` if None.
        augmentation: what happens to the training images: an effect or a policy of `augment`, a policy's name, or
            plain values as a policy file has them; nothing if None.
        trainer: further arguments of `lightning.Trainer`, such as {"accelerator": "gpu"}. Callbacks and plugins are
            added to those of the training. {"precision": "auto"} is bfloat16 where the device computes it fast.
        resume: go on from the last checkpoint of the run; only `epochs`, `workers` and the place of files may differ.
        overwrite: replace a run: what siamloc wrote into the folder is removed, all other files stay.
        protocol: who does what in the data, as plain values for the record; the sequences of the frames if None.
        settings: the fields of `Training` together, instead of one keyword each: epochs, batch_size, seed, workers,
            pairs, optimizer, margin, augment_where.

    Returns:
        The run.

    Raises:
        ConfigError: settings that have no meaning or contradict each other, a folder that holds a run or other files,
            a run of other settings to resume, or a training that diverges.
        DataError: frames that give no pairs, or images that the network cannot take.
        KeyboardInterrupt: the user stopped it; the checkpoint of the last finished epoch is there.
        StorageError: the disk is full or refuses.

    Example:
        >>> import cv2, numpy, pathlib, siamloc, tempfile
        >>> folder, noise = pathlib.Path(tempfile.mkdtemp()), numpy.random.default_rng(0)
        >>> paths = [folder / f"{number}.png" for number in range(8)]
        >>> for path in paths:
        ...     _ = cv2.imwrite(str(path), noise.integers(0, 256, (32, 64, 3), dtype=numpy.uint8))
        >>> frames = siamloc.data.FrameTable(path=paths, room=["office", "kitchen"] * 4)
        >>> images = siamloc.data.PanoramaLibrary(frames, folder / "cache", image_size=(32, 64))
        >>> network = siamloc.models.build("simple1", "fc500_500_5", image_size=(32, 64))
        >>> run = fit(network, images, frames, run=folder / "run", epochs=2, batch_size=4)
        >>> sorted(run.curves())[:3]
        ['epoch', 'step', 'train/accuracy']
        >>> fit(network, images, frames, run=run, epochs=3, batch_size=4, resume=True).curves()["epoch"]
        array([0., 1., 2.])
    """
    run = run if isinstance(run, Run) else Run(run)  # type: ignore[arg-type]
    first = process_rank() == 0
    if first:
        _check_folder(run, resume, overwrite)
    train, validated = _usable(images, frames, validation, settings)
    effect, augmented = _effect(augmentation, images)
    change = None if effect is None else BatchAugmentation(effect, settings.augment_where, settings.seed)
    data, module = _parts(network, images, train, validated, loss, change, settings)
    _check_network(network, images, unit=isinstance(module.loss, SoftContrastiveLoss))
    content = module.content()
    used = {
        "data": {**train.source, "unit": train.unit, **images.settings()},
        "protocol": dict(protocol) if protocol is not None else _protocol(train, validated),
        "model": content["model"],
        "loss": content["loss"],
        "training": settings.plain(),
        "augment": augmented,
        "trainer": {"precision": str((trainer or {}).get("precision", "32-true"))},
        "frames": {"train": _frames_key(train), "validation": None if validated is None else _frames_key(validated)},
    }
    last = run.checkpoints / "last.ckpt"
    if resume and first:
        _check_same_training(run, plain(used), settings.epochs)
    if not network.training:  # as `load` and an earlier `fit` leave it; parts that alone are frozen stay so
        network.train()
    with _quiet():
        lightning = _trainer(run, settings, trainer, validated=validated is not None)
        if first:
            _open(run, used, resume=resume, validated=validated is not None)
            name = content["model"].get("class") or f"{content['model']['branch']} + {content['model']['head']}"
            print(
                f"training {name} on {len(train)} frames, {data.sampler.summary()} per epoch, "
                f"epochs: {settings.epochs}, into {run.folder}",
                file=sys.stderr,
            )
        start = last if resume and last.is_file() else None
        _train(lightning, module, data, run, start)
    load(run, network=network)
    return run


def process_rank() -> int:
    """Find the number of this process among those that train together; 0 when there is one."""
    for name in ("RANK", "SLURM_PROCID", "LOCAL_RANK"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def _check_folder(run: Run, resume: bool, overwrite: bool) -> None:
    """Refuse to write over a run unless told to, and over anything else in any case."""
    if resume and overwrite:
        raise ConfigError("resume=true goes on with a run, overwrite=true throws it away: choose one")
    if run.record.is_file():
        run.load_record()
        if not resume and not overwrite:
            raise ConfigError(
                f"{run.folder} holds a run already: go on with it by resume=true, replace it by overwrite=true, "
                "or choose another run="
            )
    elif resume:
        raise ConfigError(f"there is no run to resume in {run.folder}: leave out resume=true to start one")
    elif run.folder.is_dir() and any(run.folder.iterdir()):
        other = min(path.name for path in run.folder.iterdir())
        raise ConfigError(
            f"{run.folder} is not a run and holds other files, such as {other}: choose a new or empty folder as run="
        )
    elif run.folder.exists() and not run.folder.is_dir():
        raise ConfigError(f"{run.folder} is a file: choose a new or empty folder as run=")
    foreign = run.foreign(_names(validated=True))
    if foreign:
        raise ConfigError(
            f"{run.folder / foreign[0]} would be replaced, but siamloc did not write it into this run: move it away, "
            "or choose another run="
        )


def _usable(
    images: PanoramaLibrary, frames: FrameTable, validation: FrameTable | None, settings: Training
) -> tuple[FrameTable, FrameTable | None]:
    """Select the frames whose image can be read; for distance labels those that have a position."""
    found: list[FrameTable | None] = []
    pairs = settings.pairs
    distance = isinstance(pairs, PlaceSettings) or pairs.label == "distance"
    for name, table in (("training", frames), ("validation", validation)):
        if table is None:
            found.append(None)
            continue
        readable = images.readable(table)
        if not len(readable):
            raise DataError(f"there are no {name} frames" if not len(table) else f"no {name} image can be read")
        if name == "training" and isinstance(pairs, PairSettings) and pairs.label == "auto":
            distance = len(set(readable.place.tolist())) == 1
        if distance:
            missing = readable.path[~readable.has_position].tolist()
            what = f"{name} frames have no position, which {pairs.needs_positions} need"
            leave_out(missing, len(readable), what, str(images.settings()["on_error"]))
            readable = readable.take(readable.has_position)
        found.append(readable)
    train, validated = found
    assert train is not None
    if validated is not None:
        known = set(train.identities())
        both = [key for key in validated.identities() if key in known]
        if both:
            raise ConfigError(
                f"{len(both)} validation frames are training frames too, the first is {both[0][1]}, so that the result "
                "would not be honest: validate with other frames"
            )
    return train, validated


def _parts(
    network: nn.Module,
    images: PanoramaLibrary,
    train: FrameTable,
    validated: FrameTable | None,
    loss: Loss | BatchLoss | None,
    augmentation: BatchAugmentation | None,
    settings: Training,
) -> tuple[PairDataModule | PlaceDataModule, NetworkModule]:
    """Make what serves the batches, and what happens with them: pairs, or places with all their pairs."""
    common: dict[str, Any] = {"workers": settings.workers, "augmentation": augmentation, "seed": settings.seed}
    if isinstance(settings.pairs, PlaceSettings):
        _check_loss(loss, 2)
        places = PlaceDataModule(images, train, validated, places=settings.pairs, **common)
        return places, PlaceModule(network, cast("BatchLoss | None", loss), settings.optimizer)
    _check_loss(loss, 3)
    pairs = PairDataModule(images, train, validated, pairs=settings.pairs, batch_size=settings.batch_size, **common)
    chosen = ContrastiveLoss(settings.margin) if loss is None else cast(Loss, loss)
    return pairs, SiameseModule(network, chosen, settings.optimizer)


def _check_loss(loss: Loss | BatchLoss | None, arguments: int) -> None:
    """Make sure that a loss takes as many arguments as there will be."""
    if loss is None or not callable(loss):
        return
    try:
        called = loss.forward if isinstance(loss, nn.Module) else loss
        inspect.signature(called).bind(*[None] * arguments)
    except TypeError as error:
        raise ConfigError(
            "a loss of batches of places takes (descriptors, origins), one of pairs takes (d0, d1, y): this one, "
            f"{name_of(loss)}, does not go with these pairs"
        ) from error
    except ValueError:  # functions without a signature
        return


def _effect(
    given: augment.Effect | Mapping[str, Any] | str | None, images: PanoramaLibrary
) -> tuple[augment.Effect | None, dict[str, Any]]:
    """Make the augmentation, and describe it in plain values; None where nothing happens to the images."""
    if given is None or isinstance(given, str):
        given = {"name": "none" if given is None else given}
    if isinstance(given, Mapping):
        effect: augment.Effect = augment.policy_from_config({"circular": images.circular, **given})
        described = dict(given)
    elif isinstance(given, augment.Effect):
        effect = given
        described = {"name": effect.name, "effects": [repr(effect)]}
    else:
        raise ConfigError(f"augmentation is an effect or a policy of augment, a policy's name, or None; got {given!r}")
    if isinstance(effect, augment.Policy):
        if effect is given:
            described["effects"] = [f"{step.probability:g} {step.effect!r}" for step in effect.slots]
        if not effect.slots:
            return None, described
    return effect, described


def _check_network(network: nn.Module, images: PanoramaLibrary, *, unit: bool) -> None:
    """Describe one image, so that a network of another image size is found before anything is written."""
    try:
        descriptor = describe(network, images.batch([0]))
    except SiamlocError:
        raise
    except Exception as error:  # a module of one's own may raise anything
        shape = " x ".join(map(str, images.image_shape))
        first_line = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"the network cannot take panoramas of {shape}: {first_line}") from error
    if descriptor.ndim != 2 or len(descriptor) != 1:
        raise DataError(f"the network must give descriptors of shape (B, D), got {descriptor.shape} for one image")
    length = float((descriptor.astype("float64") ** 2).sum() ** 0.5)
    if unit and abs(length - 1) > _UNIT_ROUNDING:
        raise ConfigError(
            f"the soft contrastive loss needs descriptors of length 1, this network's have {length:.3g}: choose the "
            "head flat, gem or fourier, or end your own network with torch.nn.functional.normalize"
        )


def _trainer(run: Run, settings: Training, further: Mapping[str, Any] | None, *, validated: bool) -> Trainer:
    """Make the trainer of a run: checkpoints, curves and TensorBoard lie in the run's folder.

    Raises:
        ConfigError: arguments that Lightning refuses.
    """
    options = {**TRAINER, **(further or {})}
    if options.get("precision") == "auto":
        options["precision"] = _fast_precision(str(options["accelerator"]))
    callbacks = [*_listed(options.pop("callbacks", None)), _Seeds(settings.seed), Curves(run)]
    if settings.average is not None:
        callbacks.append(MovingAverage(decay=settings.average))
    if settings.clip is not None:
        options.setdefault("gradient_clip_val", settings.clip)
    monitor = "val/error" if isinstance(settings.pairs, PlaceSettings) else "val/loss"
    own: dict[str, Any] = {
        "max_epochs": settings.epochs,
        "default_root_dir": run.folder,
        "logger": TensorBoardLogger(run.folder, name="tensorboard", version=""),
        "callbacks": [*callbacks, *checkpoint_callbacks(run.checkpoints, monitor if validated else None)],
        "plugins": [*_listed(options.pop("plugins", None)), AtomicCheckpoints()],
        "num_sanity_val_steps": 0,
        "limit_val_batches": 1.0 if validated else 0,
        "enable_model_summary": False,
    }
    taken = sorted(set(options) & set(own))
    if taken:
        raise ConfigError(f"trainer.{taken[0]} is set by siamloc itself: leave it out")
    options.setdefault("enable_progress_bar", sys.stderr.isatty())
    try:
        return Trainer(**options, **own)
    except (MisconfigurationException, TypeError, ValueError, RuntimeError) as error:
        first_line = str(error).strip().splitlines()[0]
        raise ConfigError(f"the trainer cannot be set up with these trainer keys: {first_line}") from error


def _fast_precision(accelerator: str) -> str:
    """Return bfloat16 for most of the network where the device has instructions for it, else full precision."""
    if accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available():
        fast = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        fast = torch.cpu._is_amx_tile_supported()
    return "bf16-mixed" if fast else "32-true"


def _open(run: Run, used: Mapping[str, Any], *, resume: bool, validated: bool) -> None:
    """Make the folder ready: remove what an earlier training left, and write down the settings."""
    if resume:
        run.record_written(_names(validated=validated))
        record = run.load_record()
        run.start(used, record["written"])
    else:
        if run.record.is_file():
            run.clear()
        run.start(used, _names(validated=validated))
    run.clear_temporaries()


def _names(*, validated: bool) -> list[str]:
    """Name the files that a training writes, but for TensorBoard's, whose names are not known before."""
    best = ["checkpoints/best.ckpt"] if validated else []
    return ["metrics.csv", "checkpoints/last.ckpt", *best, "tensorboard/hparams.yaml"]


def _train(
    trainer: Trainer, module: NetworkModule, data: PairDataModule | PlaceDataModule, run: Run, start: Path | None
) -> None:
    """Fit; when the user stops it, say how to go on.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    handler = signal.getsignal(signal.SIGINT)
    try:
        with torch.random.fork_rng(devices=[]):
            trainer.fit(module, datamodule=data, ckpt_path=start, weights_only=True)
    except SystemExit as error:
        # Lightning ignores further Ctrl-C and leaves the interpreter with status 1.
        if not trainer.interrupted:
            raise
        signal.signal(signal.SIGINT, handler)
        done = _finished_epochs(run)
        text = f"stopped after {done} of {trainer.max_epochs} epochs: go on with resume=true, run={run.folder}"
        print(text, file=sys.stderr, flush=True)
        raise KeyboardInterrupt(text) from error
    except Exception:
        if start is None and not any(run.checkpoints.glob("*.ckpt")) and process_rank() == 0:
            run.discard()  # a loss that fails at once must not block the folder for the next call
        raise


class _Seeds(Callback):
    """Seed the random generator that layers such as dropout draw from, by the seed and the epoch."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Seed it."""
        key = content_key([self._seed, trainer.current_epoch, trainer.global_rank], 15)
        torch.manual_seed(int(key, 16))


def _check_same_training(run: Run, now: Mapping[str, Any], epochs: int) -> None:
    """Make sure that a run is resumed with the settings it began with; only the number of epochs may grow."""
    before, now = ({**used, "protocol": Protocol.of(used["protocol"]).plain()} for used in (run.settings, now))
    before = {**before, "training": Training.of(before["training"]).plain(), "model": _whole(before["model"])}
    planned = before["training"]["epochs"]
    if before["training"]["optimizer"]["schedule"] != "constant" and planned != epochs:
        raise ConfigError(
            f"the learning rate of {run.folder} was laid out for {planned} epochs: resume with epochs={planned}, or "
            "train another run"
        )
    # The same frames may be named in several ways; how is only worth a word where they are others.
    same_frames = before.get("frames") == now.get("frames")
    free = (*_FREE, "protocol.train", "protocol.validation") if same_frames else _FREE
    for section in _LEARNED:
        old, new = _flat(section, before.get(section)), _flat(section, now.get(section))
        for key in sorted({*old, *new}):
            if old.get(key) != new.get(key) and not key.startswith(free):
                raise ConfigError(
                    f"{run.folder} was trained with {key}={old.get(key)} and cannot be resumed with "
                    f"{key}={new.get(key)}: leave it out, or train another run"
                )
    done = _finished_epochs(run)
    if done > epochs:
        raise ConfigError(f"{run.folder} has {done} epochs already, more than epochs={epochs}: ask for more epochs")
    if done == 0:
        print(f"{run.folder} holds no checkpoint yet: training starts from the beginning", file=sys.stderr)


def _whole(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record of a network with what older ones left out."""
    if "branch" not in model:
        return dict(model)
    return {"outputs": None, "circular": False, "normalize": branch_spec(model["branch"]).normalize, **model}


def _finished_epochs(run: Run) -> int:
    """Count the epochs that the last checkpoint holds."""
    last = run.checkpoints / "last.ckpt"
    return int(read_checkpoint(last, mmap=True)["epoch"]) + 1 if last.is_file() else 0


def _flat(prefix: str, value: Any) -> dict[str, Any]:
    if isinstance(value, Mapping):
        return {key: item for name, part in value.items() for key, item in _flat(f"{prefix}.{name}", part).items()}
    return {prefix: value}


def _protocol(train: FrameTable, validation: FrameTable | None) -> dict[str, Any]:
    """Say which sequences the frames are of, in the words of a protocol."""
    found = {"train": train, "validation": validation}
    roles = {name: {"sequences": list(table.rows_by("sequence"))} for name, table in found.items() if table is not None}
    return {"kind": "cross_run", **roles}


def _frames_key(frames: FrameTable) -> dict[str, Any]:
    """Count frames and hash what they are, wherever their files lie."""
    columns = [frames.sequence, [Path(path).name for path in frames.path.tolist()], frames.xy, frames.place]
    return {"count": len(frames), "key": content_key(columns)}


def _listed(value: Any) -> list[Any]:
    if value is None:
        return []
    return list(value) if isinstance(value, list | tuple) else [value]


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Lightning says about itself off the screen; warnings that concern the user stay."""
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.fabric")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        for text in ("LeafSpec", "does not have many workers", "smaller than the logging interval", "is not empty"):
            warnings.filterwarnings("ignore", message=f".*{text}")
        for logger in loggers:
            logger.setLevel(logging.WARNING)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
