"""`Run`: the folder of a training, with its settings, checkpoints, curves and everything made from it."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import check_version, expanded, plain, read_json, real_path, storage_errors, write_json
from foundation.locks import locked
from foundation.ordering import by_numbers
from foundation.settings import checked, misfit
from foundation.words import as_words
from siamloc.errors import ConfigError, FormatError, OldFormatError
from siamloc.results import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "siamloc-run"
VERSION = 2
_OF_VERSION_1 = ("checkpoints", "tensorboard", "bundle", "evaluation", "layers")
_CHECKPOINTS = {"best": ("best", "last"), "last": ("last",)}


@dataclass(frozen=True, repr=False)
class Run:
    """The folder of a run. Its properties give the paths inside; nothing is read or created until it is needed.

    `run.json` holds the settings and the names of the files that siamloc wrote into the run. Only those are ever
    removed: everything else in the folder stays.

    Args:
        folder: folder of the run; it need not exist yet.

    Raises:
        ConfigError: an empty name, which would be the current folder.

    Example:
        >>> Run("runs/robot").checkpoints.as_posix()
        'runs/robot/checkpoints'
        >>> Run("runs/robot")
        Run('runs/robot': nothing trained yet)
    """

    folder: Path

    def __post_init__(self) -> None:
        checked(self.folder, str | Path, "the folder of a run")
        if str(self.folder).strip() == "":
            raise ConfigError("a run needs a folder of its own, such as run='runs/robot'; got an empty name")
        object.__setattr__(self, "folder", expanded(self.folder))

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {self._summary()})"

    @property
    def record(self) -> Path:
        """File with the settings of the run and the names of the files written into it."""
        return self.folder / "run.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints `best.ckpt` and `last.ckpt`."""
        return self.folder / "checkpoints"

    @property
    def map(self) -> Path:
        """File of the visual map."""
        return self.folder / "map.npz"

    @property
    def weights(self) -> Path:
        """File with the weights alone, which pretraining writes."""
        return self.folder / "weights.safetensors"

    @property
    def bundle(self) -> Path:
        """Folder of the bundle that the robot needs."""
        return self.folder / "bundle"

    @property
    def metrics(self) -> Path:
        """File of the training curves, a row per epoch."""
        return self.folder / "metrics.csv"

    @property
    def tensorboard(self) -> Path:
        """Folder of the curves and images for TensorBoard."""
        return self.folder / "tensorboard"

    @typed
    def evaluation(self, descriptor: str) -> Path:
        """Return the folder of the results of a descriptor."""
        return self.folder / "evaluation" / descriptor

    @typed
    def layer(self, descriptor: str, build: str) -> Path:
        """Return the folder of a coarse layer: `layer.npz`, and for an incremental map `mapper.npz` and its log.

        Args:
            descriptor: title of the descriptor whose map is grouped, such as "network" or "hog".
            build: title of the way in which frames are grouped, such as "spectral".
        """
        return self.folder / "layers" / f"{descriptor}-{build}"

    @typed
    def checkpoint(self, which: str = "best") -> Path:
        """Find the checkpoint called "best" or "last"; best falls back to last if nothing was validated.

        Raises:
            ConfigError: another name, or no checkpoint yet.
        """
        if which not in _CHECKPOINTS:
            raise ConfigError(f"which must be best or last, got {which!r}")
        for name in _CHECKPOINTS[which]:
            path = self.checkpoints / f"{name}.ckpt"
            if path.is_file():
                return path
            if path.exists() or path.is_symlink():
                raise FormatError(f"{path} is not a regular file: train again, or put the checkpoint itself there")
        raise ConfigError(
            f"{self.folder} holds no checkpoint: train it first with `siamloc train {as_words({'run': self.folder})}`"
        )

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the training: plain values under data, protocol, model, training, augment and more.

        Settings that siamloc got after the run was trained have the values that the training used.

        Raises:
            ConfigError, FormatError: as `load_record`.
        """
        found = dict(self.load_record()["settings"])
        if found.get("views"):
            found["views"] = {"worlds": "offices", "imaging": "plain", **found["views"]}
        if (found.get("loss") or {}).get("name") == "soft_contrastive":
            found["loss"] = {"beyond": [], **found["loss"]}
        return found

    def curves(self) -> dict[str, NDArray[np.float64]]:
        """Return the training curves: an array over the epochs by name, such as "train/loss"; NaN for a gap.

        Raises:
            ConfigError: no epoch has finished.
            FormatError: the file was altered.
        """
        if not self.metrics.is_file():
            raise ConfigError(f"{self.folder} has no training curves: no epoch has been finished there")
        try:
            with self.metrics.open(encoding="utf-8", newline="") as file:
                rows = list(csv.DictReader(file))
            names = ["epoch", *(name for name in rows[0] if name != "epoch")]
            curves = {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}
            epochs, values = curves["epoch"], np.concatenate(list(curves.values()))
            if not np.isfinite(epochs).all() or (epochs < 0).any() or (np.diff(epochs) <= 0).any():
                raise ValueError("its epochs do not grow from row to row")
            if (np.abs(values[np.isfinite(values)]) > 1e12).any():
                raise ValueError("a value is beyond 1e12")
            return curves
        except (ValueError, TypeError, LookupError, csv.Error, UnicodeDecodeError) as error:
            raise FormatError(f"{self.metrics} is not a table of training curves ({error}): train again") from error

    def plot(self) -> Figure:
        """Plot the training curves, a panel for each figure.

        Raises:
            ConfigError, FormatError: as `curves`.
        """
        from siamloc.report.draw.training import training_curves

        return training_curves(self.curves())

    def start(self, settings: Mapping[str, Any], names: Iterable[str], created: str | None = None) -> None:
        """Write the record of a training that is about to begin, or to go on.

        Args:
            settings: what the run is trained with, as plain values.
            names: names of the files that the training will write, relative to the folder; recorded before they exist,
                so that nothing of a killed training is left behind.
            created: when a training that goes on began; now if None.
        """
        write_json(
            self.record,
            {
                "format": FORMAT,
                "version": VERSION,
                "created": created or time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "settings": plain(dict(settings)),
                "versions": versions(),
                "written": sorted(set(names)),
            },
        )

    def check_resumable(self) -> None:
        """Raise ConfigError if there is no run in the folder that a training could go on with."""
        if not self.record.is_file():
            raise ConfigError(f"there is no run to resume in {self.folder}: leave out resume=true to start one")

    def load_record(self) -> dict[str, Any]:
        """Read the record: `settings`, `written`, `versions`, `created`, and after `pairs.by=steps` its `check`.

        Raises:
            ConfigError: the folder is not a run.
            FormatError: the record is of another version or cut short.
        """
        if not self.record.is_file():
            raise ConfigError(f"{self.folder} is not the folder of a run: it holds no {self.record.name}")
        record = read_json(self.record)
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise FormatError(f"{self.record} was not written by siamloc")
        check_version(record.get("version"), VERSION, str(self.record), "train again, here with overwrite=true")
        wrong = misfit(record, _KINDS) or misfit(
            record["settings"], {name: _SECTIONS[name] for name in _SECTIONS if name in record["settings"]}, "settings."
        )
        if wrong is not None:
            raise FormatError(f"{self.record} is not whole, or was altered in {wrong}: train again")
        return record

    def record_written(self, names: Iterable[str | Path]) -> None:
        """Record which files siamloc wrote into the run, so that `clear` may remove them.

        If the folder has no record, nothing is noted, and nothing is ever removed.

        Args:
            names: names of files, relative to the folder or inside it.

        Raises:
            ConfigError: a name outside the folder, or a folder.
        """
        if not self.record.is_file():
            return
        with locked(self.folder / ".run.lock"):  # several commands may work on a run at once
            record = self.load_record()
            written = {*record["written"], *(self._inside(name) for name in names)}
            if written != set(record["written"]):
                write_json(self.record, {**record, "written": sorted(written)})

    def record_check(self, check: Mapping[str, Any]) -> None:
        """Add the result of the check that chose the weights, as plain values, to the record; it is its `check`."""
        with locked(self.folder / ".run.lock"):
            write_json(self.record, {**self.load_record(), "check": plain(dict(check))})

    def clear(self) -> None:
        """Remove the files that siamloc wrote; the record and all other files stay.

        Raises:
            FormatError: as `written`.
            StorageError: removing is not permitted.
        """
        names = [name for name in self.written() if self._holds(name)]
        for name in names:
            _remove(self.folder / name)
        # Folders from the inside out, and only if empty.
        folders = {parent for name in names for parent in Path(name).parents if parent != Path()}
        for folder in sorted((self.folder / folder for folder in folders), key=lambda path: -len(path.parts)):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def discard(self) -> None:
        """Remove the run: the files that siamloc wrote, the record, and the folder if nothing else is in it."""
        self.clear()
        _remove(self.record)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def foreign(self, names: Iterable[str]) -> list[str]:
        """Return which of the given files exist although siamloc did not write them into this run."""
        written = self.written()
        return [name for name in names if (self.folder / name).exists() and name not in written]

    def written(self) -> set[str]:
        """Return the names of the files that siamloc wrote into the run; none without a record.

        A run of siamloc 0.1.0 recorded no files, but had folders to itself: then all files in those folders count.

        Raises:
            FormatError: as `load_record`, for other runs.
        """
        if not self.record.is_file():
            return set()
        try:
            return set(self.load_record()["written"])
        except OldFormatError:
            inside = [path for name in _OF_VERSION_1 for path in (self.folder / name).rglob("*")]
            files = [*inside, *(self.folder / name for name in ("map.npz", "metrics.csv", "locations.csv"))]
            return {path.relative_to(self.folder).as_posix() for path in files if path.is_file() or path.is_symlink()}

    def _inside(self, name: str | Path) -> str:
        path = Path(name)
        if path.is_absolute() or path.parts[: len(self.folder.parts)] == self.folder.parts:
            path = path.relative_to(self.folder) if path.is_relative_to(self.folder) else path
        if not self._holds(str(path)) or (self.folder / path).is_dir():
            raise ConfigError(f"{name} is not a file inside the run {self.folder}")
        return path.as_posix()

    def _holds(self, name: str) -> bool:
        """Whether a name stays inside the folder, with links to folders resolved."""
        inside = real_path((self.folder / name).parent).is_relative_to(real_path(self.folder))
        return inside and Path(name) != Path() and not (self.folder / name).is_dir()

    def _summary(self) -> str:
        try:
            model = self.settings["model"]
            name = f"{model['branch']} + {model['head']}" if "branch" in model else str(model.get("class"))
            curves = self.curves()
        except (ConfigError, FormatError, KeyError) as error:
            return "nothing trained yet" if not self.record.is_file() else str(error)
        losses = [f"{key} {curves[key][-1]:.4g}" for key in ("train/loss", "val/loss") if key in curves]
        epochs = len(curves["epoch"])
        return ", ".join([name, f"{epochs} epoch{'s' if epochs != 1 else ''}", *losses])


def _remove(path: Path) -> None:
    with storage_errors(path):
        path.unlink(missing_ok=True)


_SECTIONS: dict[str, Any] = {
    **dict.fromkeys(("data", "model", "training", "protocol", "trainer", "views"), dict),
    **dict.fromkeys(("loss", "augment"), dict | None),
}
_KINDS = {"settings": dict, "written": list[str], "created": str | None, "versions": dict | None}


def newest_run(*, trained: bool = True) -> Run:
    """Return the run under the folder `runs` that was trained last, or with `trained=False` trained or evaluated last.

    Raises:
        ConfigError: there is none.
    """
    found = [(record, record.parent) for record in Path("runs").glob("**/run.json")]
    if not trained:
        found += [(results, results.parents[2]) for results in Path("runs").glob("**/evaluation/*/results.json")]
    if not found:
        raise ConfigError("there is no run under runs/: train one first, or name it with run=FOLDER")
    return Run(max(found, key=lambda one: one[0].stat().st_mtime_ns)[1])


def suggested_run(otherwise: str) -> str:
    """Return the newest run as a suggestion for the end of an error message; without runs, another suggestion."""
    try:
        return f"give run=FOLDER, such as {as_words({'run': newest_run().folder})}, the newest one"
    except ConfigError:
        return otherwise


@typed
def runs_in(folder: str | Path) -> list[Run]:
    """Return the runs of a sweep: the runs directly inside a folder; none if the folder is a run itself.

    Example:
        >>> runs_in("nowhere")
        []
    """
    if Run(Path(folder)).record.is_file():
        return []
    return [Run(record.parent) for record in sorted(Run(Path(folder)).folder.glob("*/run.json"), key=by_numbers)]


@typed
def run_with(evaluation: str | Path) -> Run | None:
    """Return the run that contains an evaluation; None if the folder is not inside a run.

    Example:
        >>> run_with("runs/robot/evaluation/hog/descriptor.bins-8")
        Run('runs/robot': nothing trained yet)
    """
    folder = Path(evaluation)
    inside = [path for path in (folder, *folder.parents)[:3] if path.name == "evaluation"]
    return Run(inside[0].parent) if inside else None


def higher_is_better(figure: str) -> bool:
    """Whether a higher value of a training figure, such as "val/recall", is better; otherwise a lower value is.

    Example:
        >>> higher_is_better("val/room"), higher_is_better("val/error")
        (True, False)
    """
    return figure.rpartition("/")[2].startswith(("accuracy", "recall", "room", "spread", "distance_different"))
