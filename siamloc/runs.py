"""The folder of a run: what it was made with, its checkpoints, its map and its results."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from siamloc.errors import ConfigError, FormatError
from siamloc.files import read_json, write_json
from siamloc.results import versions

FORMAT = "siamloc-run"
VERSION = 1
DEFAULT_FOLDER = Path("runs")


@dataclass(frozen=True)
class Run:
    """Paths inside a run folder."""

    folder: Path

    @property
    def record(self) -> Path:
        """The overrides and the configuration that made the run."""
        return self.folder / "run.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints `best.ckpt` and `last.ckpt`."""
        return self.folder / "checkpoints"

    @property
    def map(self) -> Path:
        """The visual map."""
        return self.folder / "map.npz"

    @property
    def bundle(self) -> Path:
        """Folder with what the robot needs."""
        return self.folder / "bundle"

    @property
    def metrics(self) -> Path:
        """Training curves, a row per epoch."""
        return self.folder / "metrics.csv"

    def evaluation(self, descriptor: str) -> Path:
        """Folder of the results of a descriptor."""
        return self.folder / "evaluation" / descriptor

    def layer(self, descriptor: str, build: str) -> Path:
        """Folder of a coarse layer: `layer.npz`, and for an incremental map `mapper.npz` and what it did."""
        return self.folder / "layers" / f"{descriptor}-{build}"

    def checkpoint(self, which: str) -> Path:
        """Return the checkpoint called "best" or "last"; best falls back to last where nothing was validated.

        Raises:
            ConfigError: another name, or no checkpoint yet.
        """
        if which not in ("best", "last"):
            raise ConfigError(f"checkpoint must be best or last, got {which!r}")
        candidates = [self.checkpoints / f"{name}.ckpt" for name in (["best", "last"] if which == "best" else ["last"])]
        for path in candidates:
            if path.is_file():
                return path
        raise ConfigError(f"{self.folder} holds no checkpoint: train it first with `siamloc train run={self.folder}`")

    def clear(self) -> None:
        """Remove what an earlier training of this run left, its record first."""
        for path in (self.record, self.map, self.metrics, self.folder / "locations.csv"):
            path.unlink(missing_ok=True)
        for folder in (
            self.checkpoints,
            self.folder / "tensorboard",
            self.bundle,
            self.folder / "evaluation",
            self.folder / "layers",
        ):
            shutil.rmtree(folder, ignore_errors=True)

    def save_record(self, overrides: Sequence[str], config: dict[str, Any]) -> None:
        """Write down what the run was made with."""
        write_json(
            self.record,
            {
                "format": FORMAT,
                "version": VERSION,
                "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "overrides": list(overrides),
                "config": config,
                "versions": versions(),
            },
        )

    def load_record(self) -> dict[str, Any]:
        """Read what the run was made with.

        Raises:
            ConfigError: the folder is no run.
            FormatError: the record is of a newer version or cut short.
        """
        if not self.record.is_file():
            raise ConfigError(f"{self.folder} is not the folder of a run: it holds no {self.record.name}")
        record = read_json(self.record)
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise FormatError(f"{self.record} was not written by siamloc")
        if not {"version", "overrides", "config"} <= set(record):
            raise FormatError(f"{self.record} is not whole: train the run anew")
        if record["version"] > VERSION:
            raise FormatError(
                f"{self.record} has version {record['version']}, this siamloc reads up to {VERSION}: update siamloc"
            )
        return record


def newest_run(folder: Path = DEFAULT_FOLDER) -> Run:
    """Return the run under a folder whose record is the newest.

    Raises:
        ConfigError: there is none.
    """
    records = sorted(folder.glob("**/run.json"), key=lambda path: path.stat().st_mtime_ns)
    if not records:
        raise ConfigError(f"there is no run under {folder}/: train one first, or name it with run=FOLDER")
    return Run(records[-1].parent)
