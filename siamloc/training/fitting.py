"""`fit`: train a network on pairs or batches of frames, from scratch or from the last checkpoint of its run."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import nn

import augment
from augment.base import on_host
from foundation.calls import OF_FIELDS, takes
from foundation.files import plain
from foundation.locks import alone
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSettings
from siamloc.data.protocol import Protocol
from siamloc.lightning import Trainer
from siamloc.memory import kept_memory
from siamloc.models.checkpoint import check_architecture, load
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.losses import ContrastiveLoss
from siamloc.models.module import NetworkModule
from siamloc.models.network import Network
from siamloc.models.places import BatchLoss, PlaceModule
from siamloc.models.siamese import Loss, SiameseModule
from siamloc.progress import shown
from siamloc.runs import Run
from siamloc.training.adapting import Adapting
from siamloc.training.batches import BatchAugmentation, EpochDataModule
from siamloc.training.checks import (
    check_batches,
    check_headings,
    check_loss,
    check_network,
    check_rooms,
    check_weights,
    monitored,
    usable,
)
from siamloc.training.loggers import begin_records, beginning, listed, log_settings
from siamloc.training.pair_batches import PairDataModule
from siamloc.training.place_batches import PlaceDataModule, rooms_of, validation_drive
from siamloc.training.run_folder import (
    check_folder,
    check_same_training,
    check_script,
    monitor_before,
    note_frames,
    open_run,
    progress,
    stopped,
)
from siamloc.training.settings import Training
from siamloc.training.stopping import StepCheckpoints, interrupts_raised, stopped_by_signals
from siamloc.training.trainer import computing, on_gpu, quiet, recorded, run_trainer
from siamloc.training.worst_queries import WorstQueries


@takes(Training)
@on_host()
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
    settings: Training = OF_FIELDS,
    **fields: Any,
) -> Run:
    """Train a network on pairs of frames, or on batches of places, in place.

    Afterwards the network holds the same weights as `siamloc.models.load(run)`: the best by the validation, chosen by
    `Training.monitor`, or the last if nothing is validated. Everything that can be checked is checked before the run's
    folder is touched. torch's random generators are left as they were. If several processes train together
    (`trainer={"devices": 2, "strategy": "ddp"}`, torchrun, SLURM), each calls `fit`, and only the first writes.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        images: decoded panoramas of all frames.
        frames: training frames, among those of the library.
        run: folder of the run, a new or empty one.
        validation: frames for choosing the checkpoint, different from `frames`.
        loss: for pairs, (d0 (B, D), d1 (B, D), y (B,)) -> scalar, the mean over the pairs, `ContrastiveLoss(margin)` if
            None; for batches of places, (descriptors (N, D), `Origins`) -> scalar, `SoftContrastiveLoss()` if None.
        augmentation: how training images are augmented: an effect or a policy of `augment`, a policy's name, or plain
            values as in a policy file; none if None.
        trainer: further arguments of `lightning.Trainer`, such as {"accelerator": "gpu"}. Callbacks and plugins are
            added to those of the training. {"precision": "auto"} is the fastest precision of the device: bfloat16 for
            most of the network if it has instructions for that.
        resume: continue from the last checkpoint of the run; only `epochs`, `workers` and file locations may differ.
            The training ends as one that never stopped: on a CPU bit for bit, on a GPU with {"deterministic": True}
            in `trainer`.
        overwrite: replace a run: files that siamloc wrote into the folder are removed, all other files stay.
        protocol: roles of the data, as plain values, recorded for reference; the sequences of the frames if None.
        settings: all fields of `Training` together, instead of one keyword each: epochs, batch_size, seed, workers,
            pairs, optimizer, and all others.

    Returns:
        The run.

    Raises:
        ConfigError: settings that are invalid or contradict each other, a folder that holds a run or other files, a run
            with other settings to resume, or a training whose loss or gradient is not finite.
        DataError: frames that give no pairs, or images that the network cannot take.
        KeyboardInterrupt: the user stopped the training. It finished its step and wrote a checkpoint first; a second
            Ctrl-C stops at once, and leaves the previous checkpoint.
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
    check_script()
    run = run if isinstance(run, Run) else Run(run)  # type: ignore[arg-type]
    if process_rank() == 0:
        check_folder(run, resume, overwrite)
    train, validated = usable(images, frames, validation, settings)
    adapting = Adapting.begun(network, images, train, validation, run if resume else None, settings)
    if adapting is None:
        check_headings(network, train, settings)
    change, augmented = augmentation_of(augmentation, images.circular, settings, trainer)
    if resume and settings.monitor == "auto":
        settings = replace(settings, monitor=monitor_before(run, settings))
    monitor = monitored(settings, train, validated, network, loss)
    settings = settings if monitor is None else replace(settings, monitor=monitor)
    learned = train if adapting is None else adapting.learned
    data, module = _parts(network, images, learned, validated, loss, change, settings)
    width = check_network(network, images.batch([0]), images.circular, unit=getattr(module.loss, "unit_length", False))
    if isinstance(network, Network) and (elevations := images.preprocessing.elevations) is not None:
        network.settings["elevations"] = list(elevations)
    if isinstance(module.loss, CrossEntropyLoss):
        module.loss.open(rooms_of(train), width, settings.seed)
    check_weights(module)
    about = {
        "data": {**train.source, "unit": train.unit, **images.settings()},
        "protocol": Protocol.of(_protocol(train, validated)).plain() if protocol is None else dict(protocol),
        "augment": augmented,
        "frames": {
            "train": note_frames(images, train),
            "validation": None if validated is None else note_frames(images, validated),
        },
    }
    if validated is not None:
        pictures = WorstQueries(run, images, train, validated)
        trainer = {**(trainer or {}), "callbacks": [*listed((trainer or {}).get("callbacks")), pictures]}
    with nullcontext() if adapting is None else adapting.comparison_kept(network):
        learn(
            module,
            data,
            run,
            about,
            settings,
            trainer,
            monitor=monitor,
            what=f"{len(learned)} frames, {data.sampler.summary()} per epoch",
            resume=resume,
            overwrite=overwrite,
            notes=[*data.notes(), *_notes(settings, train, validated, loss)],
        )
    if adapting is not None:
        adapting.keep_the_better(network, images, change, run, writes=process_rank() == 0)
    return run


@on_host()
def learn(
    module: NetworkModule,
    data: EpochDataModule,
    run: Run,
    about: Mapping[str, Any],
    settings: Training,
    trainer: Mapping[str, Any] | None,
    *,
    monitor: str | None,
    what: str,
    resume: bool,
    overwrite: bool = False,
    notes: Sequence[str] = (),
) -> None:
    """Train a module, from scratch or from the last checkpoint of its run; afterwards it holds the best weights.

    Args:
        module: the training module with the network.
        data: batches for the module.
        run: run for checkpoints and curves.
        about: data, protocol, augmentation and frames as plain values, for the run's record.
        settings: settings of the training.
        trainer: further arguments of `lightning.Trainer`.
        monitor: validation figure by which the checkpoint is chosen; None if nothing is validated.
        what: description of the training data, for a printed line, such as "412 frames".
        resume: continue from the last checkpoint.
        overwrite: replace an existing run.
        notes: notes for the user, printed once everything is checked.
    """
    network, first = module.network, process_rank() == 0
    last = run.checkpoints / "last.ckpt"
    with quiet(), alone(run.folder) if first else nullcontext():
        if first:
            check_folder(run, resume, overwrite)  # once more: another process may have trained here by now
        with beginning(run) if first else nullcontext():
            lightning = run_trainer(run, settings, trainer, monitor and f"val/{monitor}")
            check_batches(data, module.loss, lightning.world_size)
            content = module.content()
            used = {
                **about,
                **{"model": content["model"], "loss": content["loss"], "training": settings.plain()},
                "trainer": recorded(lightning, trainer),
            }
            if resume and first:
                check_same_training(run, plain(used), settings.epochs)
                if last.is_file():
                    check_architecture(last, module)
            begin_records(lightning.loggers)
        if first:
            open_run(run, used, resume=resume, validated=monitor is not None)
            model = content["model"]
            name = model.get("class") or f"{model['branch']} + {model['head']}"
            for text in notes:
                print(f"note: {text}", file=sys.stderr)
            epochs = settings.epochs
            said = f"training {name} on {what}, epochs: {epochs}, into {run.folder}"
            if resume and progress(run) == (epochs, 0):
                said = f"{run.folder} was trained for all its epochs already ({epochs}): nothing is left to train"
            if shown():
                print(said, file=sys.stderr)
        log_settings(lightning.loggers, plain(used))
        start = last if resume and last.is_file() else None
        with computing(module, settings, trainer):
            _train(lightning, module, data, run, start)
    load(run, network=network)


def _notes(settings: Training, train: FrameTable, validated: FrameTable | None, loss: object) -> list[str]:
    """Return notes on rooms that the frames lack, and on drives of which only the order of the frames is used."""
    notes, by_rooms = [], bool(getattr(loss, "room", 0))
    if by_rooms and (unknown := int((train.room == "").sum())):
        notes.append(
            f"{unknown} of {len(train)} training frames have no room label: the loss learns rooms only from the others"
        )
    if isinstance(loss, CrossEntropyLoss) and validated is not None:
        others = sorted(set(rooms_of(validated)) - set(rooms_of(train)))
        if frames := int(np.isin(validated.place, others).sum()):
            notes.append(
                f"{frames} of {len(validated)} validation frames are in rooms that the training frames lack "
                f"({', '.join(others)}): they count as wrong"
            )
    drives = len(set(train.sequence.tolist()))
    if isinstance(settings.pairs, PlaceSettings) and settings.pairs.by == "sequence" and drives > 1 and not by_rooms:
        notes.append(
            f"{drives} drives are used by the order of their frames alone, so that a place in two of them counts as "
            "two: if they share places, give positions (pairs.by=position), or also learn from rooms "
            "(experiment=rooms, or loss.room=0.5)"
        )
    return notes


def process_rank() -> int:
    """Return the rank of this process among those that train together; 0 if it is the only process."""
    for name in ("RANK", "SLURM_PROCID", "LOCAL_RANK"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def _parts(
    network: nn.Module,
    images: PanoramaLibrary,
    train: FrameTable,
    validated: FrameTable | None,
    loss: Loss | BatchLoss | None,
    augmentation: BatchAugmentation | None,
    settings: Training,
) -> tuple[PairDataModule | PlaceDataModule, NetworkModule]:
    """Make the data module and the training module: for pairs, or for places with all their pairs."""
    common: dict[str, Any] = {"workers": settings.workers, "augmentation": augmentation, "seed": settings.seed}
    if isinstance(settings.pairs, PlaceSettings):
        check_loss(loss, 2)
        check_rooms(loss, train, validated)
        places = PlaceDataModule(images, train, validated, places=settings.pairs, **common)
        return places, PlaceModule(network, cast("BatchLoss | None", loss), settings.optimizer, settings.recall_radius)
    check_loss(loss, 3)
    if validated is not None and settings.monitor not in ("loss", "auto"):
        common["drive"] = validation_drive(images, train, validated)
    pairs = PairDataModule(images, train, validated, pairs=settings.pairs, batch_size=settings.batch_size, **common)
    chosen = ContrastiveLoss(settings.margin) if loss is None else cast(Loss, loss)
    return pairs, SiameseModule(network, chosen, settings.optimizer, settings.recall_radius)


def augmentation_of(
    given: augment.Effect | Mapping[str, Any] | str | None,
    circular: bool,
    settings: Training,
    trainer: Mapping[str, Any] | None,
) -> tuple[BatchAugmentation | None, dict[str, Any]]:
    """Make the augmentation of the training images; also return its description in plain values.

    Args:
        given: the `augmentation` of `fit`.
        circular: whether the columns of images wrap around.
        settings: gives the seed, and where images are augmented.
        trainer: arguments of `lightning.Trainer`, which tell "auto" whether there is a GPU.
    """
    effect, described = effect_of(given, circular)
    where = settings.augment_where if settings.augment_where != "auto" else "gpu" if on_gpu(trainer) else "cpu"
    return None if effect is None else BatchAugmentation(effect, where, settings.seed), described


def effect_of(
    given: augment.Effect | Mapping[str, Any] | str | None, circular: bool
) -> tuple[augment.Effect | None, dict[str, Any]]:
    """Make the effect of an augmentation, None for none; also return its description in plain values.

    Args:
        given: an effect or a policy of `augment`, a policy's name, or plain values as in a policy file; None for none.
        circular: whether the columns of images wrap around, unless plain values say otherwise.
    """
    if isinstance(given, augment.Policy):
        effects = [f"{step.probability:g} {step.effect!r}" for step in given.slots]
        return given if given.slots else None, {"name": given.name, "effects": effects}
    if isinstance(given, augment.Effect):
        return given, {"name": given.name, "effects": [repr(given)]}
    described = dict(given) if isinstance(given, Mapping) else {"name": "none" if given is None else given}
    policy = augment.policy_from_config({"circular": circular, **described})
    return policy if policy.slots else None, described


def _train(trainer: Trainer, module: NetworkModule, data: EpochDataModule, run: Run, start: Path | None) -> None:
    """Fit; if the user stops the training, print how to continue.

    Raises:
        KeyboardInterrupt: the user stopped the training.
    """
    try:
        steps = next(one for one in trainer.checkpoint_callbacks if isinstance(one, StepCheckpoints))
        # With several processes, one could stop a step before the others, which would then wait for it.
        stops = stopped_by_signals(steps) if trainer.world_size == 1 else nullcontext()
        device = trainer.strategy.root_device
        with kept_memory(), interrupts_raised(), torch.random.fork_rng([device] * (device.type == "cuda")), stops:
            trainer.fit(module, datamodule=data, ckpt_path=start, weights_only=True)
        if steps.asked:  # in the last epoch, when nothing was left to stop
            raise KeyboardInterrupt(f"the training finished before it could be stopped: {run.folder}")
    except KeyboardInterrupt as error:
        if not trainer.interrupted:
            raise
        done, more = progress(run)
        within = f" and {more} of {trainer.num_training_batches} steps" if more else ""
        raise stopped(run, f"after {done} of {trainer.max_epochs} epochs{within}") from error
    except Exception:
        if start is None and process_rank() == 0 and not any(run.checkpoints.glob("*.ckpt")):
            run.discard()  # a loss that fails at once must not block the folder for the next call
        raise
    finally:
        module.teardown("fit")  # Lightning skips this and the next one on failure
        data.teardown("fit")


def _protocol(train: FrameTable, validation: FrameTable | None) -> dict[str, Any]:
    """Return the sequences of the frames in the form of a protocol."""
    found = {"train": train, "validation": validation}
    roles = {name: {"sequences": list(table.rows_by("sequence"))} for name, table in found.items() if table is not None}
    return {"kind": "cross_run", **roles}
