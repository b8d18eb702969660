"""The folder of a training: whether to write into it, and whether a run can continue with other settings."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from foundation.files import is_temporary
from foundation.locks import LOCK
from foundation.settings import defaults_of
from siamloc.data.places import PlaceSettings
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError
from siamloc.models.checkpoint_file import read_checkpoint
from siamloc.models.registry import LOSSES
from siamloc.runs import Run
from siamloc.training.seen_frames import differing_frames
from siamloc.training.settings import Monitor, Training

# What may differ when a run is resumed: file locations, speed, length of the training.
_FREE = (
    *("data.cache", "data.manifest", "data.root", "data.places", "data.name", "data.on_error"),
    *("protocol.map", "protocol.query", "protocol.leave_one_out", "protocol.apart"),
    *("training.epochs", "training.workers", "training.augment_where", "training.compile"),
    *("training.checkpoint_every", "training.patience", "training.recall_radius", "views.processes"),
)
_LEARNED = ("data", "views", "protocol", "model", "loss", "training", "augment")
_ROLES = {"train": "training", "validation": "validation"}

KEPT = "bad_batch*.npz"
"""Files of a run with the batch that stopped a training."""

EPOCH_SUMS = "epoch_sums"
"""Key in a checkpoint within an epoch: the sums of each process since the epoch began."""


def bad_batch(rank: int) -> str:
    """Return the name of that file for a process."""
    return KEPT.replace("*", f"_{rank}" if rank else "")


def check_folder(run: Run, resume: bool, overwrite: bool) -> None:
    """Refuse to overwrite a run unless requested, and anything else in any case."""
    if resume and overwrite:
        raise ConfigError("resume=true continues a run, overwrite=true removes it: choose one")
    if run.record.is_file():
        if not resume and not overwrite:
            raise ConfigError(
                f"{run.folder} holds a run already: go on with it by resume=true, replace it by overwrite=true, "
                "or choose another run="
            )
    elif resume:
        raise ConfigError(f"there is no run to resume in {run.folder}: leave out resume=true to start one")
    elif run.folder.is_dir() and (others := _others(run)):
        raise ConfigError(
            f"{run.folder} is not a run and holds other files, such as {others[0]}: choose a new or empty folder as "
            "run="
        )
    elif run.folder.exists() and not run.folder.is_dir():
        raise ConfigError(f"{run.folder} is a file: choose a new or empty folder as run=")
    kept = [path.name for path in run.folder.glob(KEPT)]
    foreign = run.foreign([*names_written(validated=True), *kept])
    if foreign:
        raise ConfigError(
            f"{run.folder / foreign[0]} would be replaced, but siamloc did not write it into this run: move it away, "
            "or choose another run="
        )


def _others(run: Run) -> list[str]:
    """Return the contents of a folder, except leftovers of a process that was killed right at the start of a run."""
    return sorted(path.name for path in run.folder.iterdir() if not is_temporary(path) and path.name != LOCK)


def check_same_training(run: Run, now: Mapping[str, Any], epochs: int) -> None:
    """Make sure that a run is resumed with its original settings; only the number of epochs may grow."""
    before, now = ({**used, "protocol": Protocol.of(used["protocol"]).plain()} for used in (run.settings, now))
    before["training"] = Training.of(before["training"]).plain()
    before["training"]["monitor"] = then if (then := monitor_of(run)) != "auto" else now["training"]["monitor"]
    if before["loss"].get("name") in LOSSES:  # with the keys that were not given
        before["loss"] = {**defaults_of(LOSSES[before["loss"]["name"]][0]), **before["loss"]}
    planned = before["training"]["epochs"]
    scheduled = {
        "learning rate": before["training"]["optimizer"]["schedule"] != "constant",
        **{key.removesuffix("_start"): True for key, value in before["loss"].items() if "_start" in key and value},
    }
    if any(scheduled.values()) and planned != epochs:
        what = next(name for name, changes in scheduled.items() if changes)
        raise ConfigError(
            f"the {what} of {run.folder} was laid out for {planned} epochs: resume with epochs={planned}, or "
            "train another run"
        )
    # The same frames may be named in several ways; report the way only if the frames differ.
    noted = before["frames"], now["frames"]
    differing = [differing_frames(noted[0][role], noted[1][role], words) for role, words in _ROLES.items()]
    same_frames = not any(differing)
    free = (*_FREE, "protocol.train", "protocol.validation") if same_frames else _FREE
    for section in _LEARNED:
        old, new = _flat(section, before.get(section)), _flat(section, now.get(section))
        for key in sorted({*old, *new}):
            if old.get(key) != new.get(key) and not key.startswith(free):
                raise ConfigError(
                    f"{run.folder} was trained with {key}={old.get(key)} and cannot be resumed with "
                    f"{key}={new.get(key)}: leave it out, or train another run"
                )
    if not same_frames:
        what = next(filter(None, differing))
        raise ConfigError(f"{run.folder} was trained with other data: {what}; give the same, or train another run")
    if any(scheduled.values()):
        _check_same_steps(run, before, now, next(name for name, changes in scheduled.items() if changes))
    done, steps = progress(run)
    if done + (steps > 0) > epochs:
        has = f"{done} epochs already" if not steps else f"begun epoch {done + 1} already"
        raise ConfigError(f"{run.folder} has {has}, more than epochs={epochs}: ask for more epochs")
    if done == steps == 0:
        print(f"{run.folder} holds no checkpoint yet: training starts from the beginning", file=sys.stderr)


def same_kind_of_pairs(run: Run, settings: Training) -> bool:
    """Whether a run uses the same kind of pairs as these settings: pairs, or batches of places."""
    return ("places" in run.settings["training"].get("pairs", {})) == isinstance(settings.pairs, PlaceSettings)


def monitor_of(run: Run) -> Monitor:
    """Return the figure that chooses the checkpoint of a run, as `Training.monitor`; "auto" if still undecided."""
    return Training.of(run.settings["training"]).monitor


def _check_same_steps(run: Run, before: Mapping[str, Any], now: Mapping[str, Any], what: str) -> None:
    """Make sure that an epoch has as many steps as before, since a schedule depends on their number."""
    old, new = (settings["trainer"] for settings in (before, now))
    for key in sorted(old.keys() & new.keys() - {"precision"}):
        if repr(old[key]) == repr(new[key]) or (  # 1 is one batch, 1.0 is all
            key == "processes" and "places" in now["training"]["pairs"]
        ):
            continue  # a batch of places grows with the processes, so the number of batches stays
        if key == "processes":
            used, meant, advice = f"{old[key]} processes", f"{new[key]}", "train with as many (trainer.devices)"
        else:
            used, meant, advice = f"trainer.{key}={old[key]}", f"trainer.{key}={new[key]}", "leave it as it was"
        raise ConfigError(
            f"the {what} of {run.folder} was laid out for the steps of an epoch with {used}, and their number would "
            f"differ with {meant}: {advice}, or train another run"
        )


def progress(run: Run) -> tuple[int, int]:
    """Return the number of finished epochs in the last checkpoint, and the steps of the epoch after them."""
    last = run.checkpoints / "last.ckpt"
    if not last.is_file():
        return 0, 0
    content = read_checkpoint(last, mmap=True)
    if EPOCH_SUMS not in content:
        return int(content["epoch"]) + 1, 0
    return int(content["epoch"]), int(content["loops"]["fit_loop"]["epoch_loop.batch_progress"]["current"]["processed"])


def _flat(prefix: str, value: Any) -> dict[str, Any]:
    if isinstance(value, Mapping):
        return {key: item for name, part in value.items() for key, item in _flat(f"{prefix}.{name}", part).items()}
    return {prefix: value}


def open_run(run: Run, used: Mapping[str, Any], *, resume: bool, validated: bool) -> None:
    """Prepare the folder: remove the files of an earlier training, and write the record of settings."""
    if resume:
        written = run.load_record()["written"]
        run.start(used, [*written, *(name for name in names_written(validated=validated) if name not in written)])
    else:
        names = names_written(validated=validated)
        if run.record.is_file():
            run.clear()
        run.start(used, names)


def names_written(*, validated: bool) -> list[str]:
    """Return the files that a training writes, except TensorBoard's, whose names are not known in advance."""
    best = ["checkpoints/best.ckpt"] if validated else []
    return ["metrics.csv", "checkpoints/last.ckpt", *best, "tensorboard/hparams.yaml"]
