"""The folder of a training: whether to write into it, and whether a run can continue with other settings."""

from __future__ import annotations

import multiprocessing
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from foundation.columns import spread_rows
from foundation.files import check_writable, content_key, is_temporary
from foundation.locks import LOCK
from foundation.settings import leaves
from foundation.words import as_words
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.data.reading import path_keys
from siamloc.errors import ConfigError
from siamloc.models.weights import read_checkpoint
from siamloc.runs import Run
from siamloc.training.settings import Monitor, Training

# What may differ when a run is resumed: file locations, speed, length of the training.
_FREE = (
    *("data.cache", "data.name", "data.on_error", *(f"data.{key}" for key in path_keys())),
    *("protocol.map", "protocol.query", "protocol.leave_one_out", "protocol.apart"),
    *("training.epochs", "training.workers", "training.augment_where", "training.compile"),
    *("training.checkpoint_every", "training.patience", "training.recall_radius", "views.processes"),
    *("trainer.processes", "trainer.limit_train_batches", "trainer.max_steps"),  # unless a schedule depends on them
)
_LEARNED = ("data", "views", "protocol", "model", "loss", "training", "augment", "trainer")
_SECTION = re.compile(r"training\.|model\.(?=seed|image_size)")  # of the record, and not of the keys that users give
_ROLES = {"train": "training", "validation": "validation"}
_PICTURES = 8  # examined, spread over the frames
_CELLS = (8, 4)  # columns and rows of their thumbnails
_TOLERANCE = 6  # grey levels in a thumbnail, by which decoders and copies of different quality differ
# The parts of a note in the order of comparison, with their messages.
_WORDS = {
    "names": "the {role} frames differ (sequences and file names)",
    "positions": "the positions of the {role} frames differ",
    "labels": "the labels of the {role} frames differ (room, building or lighting)",
}

EPOCH_SUMS = "epoch_sums"
"""Key in a checkpoint within an epoch: the sums of each process since the epoch began."""


def check_script() -> None:
    """Refuse to train in a process that only imports the script of the process that started it.

    Raises:
        ConfigError: this is such a process.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # as multiprocessing itself asks
        raise ConfigError(
            "a process that was started runs the whole script again, as the start method spawn does: put what the "
            'script does under `if __name__ == "__main__":`'
        )


def check_folder(run: Run, resume: bool, overwrite: bool) -> None:
    """Refuse a folder with a run, unless it is to be resumed or overwritten, and a folder with other files.

    Args:
        run: the run.
        resume: the run is to be continued, and must exist.
        overwrite: the run is to be replaced.

    Raises:
        ConfigError: the folder cannot be used in this way.
        StorageError: it cannot be written to, or made.
    """
    if resume and overwrite:
        raise ConfigError("resume=true continues a run, overwrite=true removes it: choose one")
    if resume:
        run.check_resumable()
    elif run.record.is_file():
        if not overwrite:
            raise ConfigError(
                f"{run.folder} holds a run already: go on with it by resume=true, replace it by overwrite=true, "
                "or choose another run="
            )
    elif run.folder.is_dir():
        # A process that was killed right at the start of a run may have left the lock and temporary files.
        others = (path.name for path in run.folder.iterdir() if not is_temporary(path) and path.name != LOCK)
        if (other := min(others, default=None)) is not None:
            raise ConfigError(
                f"{run.folder} is not a run and holds other files, such as {other}: choose a new or empty folder as "
                "run="
            )
    elif run.folder.exists():
        raise ConfigError(f"{run.folder} is a file: choose a new or empty folder as run=")
    check_writable(run.record)
    if foreign := run.foreign(names_written(validated=True)):
        raise ConfigError(
            f"{run.folder / foreign[0]} would be replaced, but siamloc did not write it into this run: move it away, "
            "or choose another run="
        )


def check_same_training(run: Run, now: Mapping[str, Any], epochs: int) -> None:
    """Make sure that a run is resumed with its original settings; only the number of epochs may grow.

    Args:
        run: the run to resume.
        now: its requested settings, as plain values in the form of the run's record.
        epochs: its requested number of epochs.

    Raises:
        ConfigError: settings differ.
    """
    before, now = ({**used, "protocol": Protocol.of(used["protocol"]).plain()} for used in (run.settings, now))
    if before["training"]["monitor"] == "auto":
        before["training"]["monitor"] = now["training"]["monitor"]
    planned = before["training"]["epochs"]
    scheduled = ["learning rate"] if before["training"]["optimizer"]["schedule"] != "constant" else []
    scheduled += [key.removesuffix("_start") for key, value in before["loss"].items() if "_start" in key and value]
    if scheduled and planned != epochs:
        raise ConfigError(
            f"the {scheduled[0]} of {run.folder} was laid out for {planned} epochs: resume with epochs={planned}, or "
            "train another run"
        )
    # The same frames may be named in several ways; report the way only if the frames differ.
    differing = [differing_frames(before["frames"][role], now["frames"][role], name) for role, name in _ROLES.items()]
    other_data = next(filter(None, differing), None)
    free = _FREE if other_data else (*_FREE, "protocol.train", "protocol.validation")
    # A record from before the arguments of `build` were kept for a module that was handed in holds a class alone.
    unknown = before["model"].keys() == {"class"} and "head" in now["model"]
    for section in (one for one in _LEARNED if one != "model" or not unknown):
        old, new = (dict(leaves({section: used.get(section)})) for used in (before, now))
        for key in sorted({*old, *new}):
            told = key in old or section != "trainer"  # older records hold less of the trainer
            if told and old.get(key) != new.get(key) and not key.startswith(free):
                name = _SECTION.sub("", key)
                raise ConfigError(
                    f"{run.folder} was trained with {name}={old.get(key)} and cannot be resumed with "
                    f"{name}={new.get(key)}: leave it as it was, or train another run"
                )
    if other_data:
        raise ConfigError(f"{run.folder} was trained with other data: {other_data}; give it, or train another run")
    if scheduled:
        _check_same_steps(run, before, now, scheduled[0])
    done, steps = progress(run)
    if done + (steps > 0) > epochs:
        has = f"{done} epochs already" if not steps else f"begun epoch {done + 1} already"
        raise ConfigError(f"{run.folder} has {has}, more than epochs={epochs}: ask for more epochs")
    if done == steps == 0:
        print(f"{run.folder} holds no checkpoint yet: training starts from the beginning", file=sys.stderr)


def monitor_before(run: Run, settings: Training) -> Monitor:
    """Return the figure that chose the checkpoints of a run; "auto" if the run used another kind of batches."""
    before = Training.of(run.settings["training"])
    return before.monitor if type(before.pairs) is type(settings.pairs) else "auto"


def _check_same_steps(run: Run, before: Mapping[str, Any], now: Mapping[str, Any], what: str) -> None:
    """Make sure that an epoch has as many steps as before, since a schedule depends on their number."""
    old, new = (settings["trainer"] for settings in (before, now))
    for key in ("processes", "limit_train_batches", "max_steps"):
        if repr(old[key]) == repr(new[key]) or (  # 1 is one batch, 1.0 is all
            key == "processes" and "places" in now["training"]["pairs"]
        ):
            continue  # a batch of places grows with the processes, so the number of batches stays
        name = key if key == "processes" else f"trainer.{key}"
        raise ConfigError(
            f"the {what} of {run.folder} was laid out for the steps of an epoch with {name}={old[key]}, and their "
            f"number would differ with {name}={new[key]}: leave it as it was, or train another run"
        )


def progress(run: Run) -> tuple[int, int]:
    """Return the number of finished epochs in the last checkpoint, and of finished steps in the epoch after them."""
    last = run.checkpoints / "last.ckpt"
    if not last.is_file():
        return 0, 0
    content = read_checkpoint(last, mmap=True)
    if EPOCH_SUMS not in content:
        return int(content["epoch"]) + 1, 0
    return int(content["epoch"]), int(content["loops"]["fit_loop"]["epoch_loop.batch_progress"]["current"]["processed"])


def stopped(run: Run, when: str) -> KeyboardInterrupt:
    """Print how to go on with a training that the user stopped, and return the exception that ends it."""
    swept = (run.folder.parent / "multirun.yaml").is_file()  # where Hydra keeps the words of a sweep
    again = "the same command and resume=true" if swept else f"resume=true, {as_words({'run': run.folder})}"
    text = f"stopped {when}: go on with {again}"
    print(text, file=sys.stderr, flush=True)
    return KeyboardInterrupt(text)


def open_run(run: Run, used: Mapping[str, Any], *, resume: bool, validated: bool) -> None:
    """Prepare the folder of a training: remove the files of an earlier training, and write the record.

    Args:
        run: the run.
        used: all settings of the training, as plain values for the record.
        resume: whether the training continues; its files then stay.
        validated: whether there are validation frames, and so a best checkpoint.
    """
    before = run.load_record() if resume else {}
    if not resume and run.record.is_file():
        run.clear()
    run.start(used, [*before.get("written", []), *names_written(validated=validated)], before.get("created"))


def names_written(*, validated: bool) -> list[str]:
    """Return the names of a training's files, except TensorBoard's, whose names are not known in advance."""
    best = ["checkpoints/best.ckpt"] if validated else []
    return ["metrics.csv", "checkpoints/last.ckpt", *best, "tensorboard/hparams.yaml"]


def note_frames(images: PanoramaLibrary, frames: FrameTable) -> dict[str, Any]:
    """Describe frames for the record: their number, keys of their columns, and thumbnails of some panoramas.

    Args:
        images: decoded panoramas of all frames.
        frames: some of them.

    Returns:
        Plain values; `pictures` holds the thumbnails as hexadecimal digits.
    """
    names = [frames.sequence, [Path(path).name for path in frames.path.tolist()]]
    rows = spread_rows(len(frames), _PICTURES)
    panoramas = images.batch(images.rows(frames.take(rows)))
    thumbnails = [cv2.resize(np.moveaxis(one, 0, -1), _CELLS, interpolation=cv2.INTER_AREA) for one in panoramas]
    return {
        "count": len(frames),
        "names": content_key(names),
        "positions": content_key([frames.xy]),
        "labels": content_key([frames.room, frames.building, frames.lighting]),
        "pictures": np.stack(thumbnails).tobytes().hex(),
    }


def differing_frames(before: Mapping[str, Any] | None, now: Mapping[str, Any] | None, role: str) -> str | None:
    """Return how frames differ from those of an earlier training, in words; None if they are the same.

    Args:
        before: earlier result of `note_frames`; None if there were no frames of this role.
        now: current result of `note_frames`; None if there are none.
        role: "training" or "validation".

    Example:
        >>> differing_frames({"count": 12}, {"count": 6}, "training")
        'there were 12 training frames, and now there are 6'
    """
    counts = [0 if note is None else note["count"] for note in (before, now)]
    if counts[0] != counts[1]:
        return f"there were {counts[0]} {role} frames, and now there are {counts[1]}"
    if before is None or now is None:
        return None
    for part, words in _WORDS.items():
        if before[part] != now[part]:
            return words.format(role=role)
    thumbnails = [np.frombuffer(bytes.fromhex(note["pictures"]), np.uint8).astype(np.int64) for note in (before, now)]
    if np.abs(thumbnails[0] - thumbnails[1]).max(initial=0) > _TOLERANCE:
        return f"the images of the {role} frames differ (their file names and labels are the same)"
    return None
