"""Where curves, settings and pictures of a training go: TensorBoard, CSV, Weights & Biases or MLflow, by Lightning."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.extras import installing
from foundation.files import write_picture
from siamloc.errors import ConfigError, explained, hint
from siamloc.lightning import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from siamloc.runs import Run

LOGGERS = ("tensorboard", "csv", "wandb", "mlflow")
"""Names of the loggers, and of their folders in a run."""
_FAILED = "a logger of the trainer cannot start"


def check_loggers(chosen: Any) -> list[str | Logger]:
    """Return a choice of loggers as a list.

    Args:
        chosen: a name in `LOGGERS`, a logger of Lightning, or a list of them; False for none.

    Raises:
        ConfigError: something else, or a logger whose package is not installed.
    """
    found: list[Any] = [None] if chosen is None else [] if chosen is False else listed(chosen)
    for one in found:
        if isinstance(one, Logger):
            continue
        if one not in LOGGERS:
            raise ConfigError(f"unknown trainer.logger {one!r}: {hint(str(one), LOGGERS)}, or false for none")
        if one in ("wandb", "mlflow") and find_spec(one) is None:
            raise ConfigError(f"trainer.logger={one} needs the package {one}: {installing(one)}")
    return found


def listed(value: Any) -> list[Any]:
    """Return an argument of `lightning.Trainer` that is one object, a list of them or None as a list."""
    if value is None:
        return []
    return list(value) if isinstance(value, list | tuple) else [value]


def loggers_of(run: Run, chosen: Any) -> list[Logger]:
    """Make the loggers of a run, which write into its folder.

    Weights & Biases and MLflow take their server from their own variables, such as WANDB_MODE=offline and
    MLFLOW_TRACKING_URI; without the latter, MLflow writes into the folder of the run.

    Args:
        run: the run.
        chosen: as for `check_loggers`.

    Raises:
        ConfigError: as `check_loggers`, or a logger that cannot start.
    """
    return [one if isinstance(one, Logger) else _made(one, run.folder) for one in check_loggers(chosen)]


@explained(_FAILED)
def begin_records(loggers: list[Logger]) -> None:
    """Begin the records of a training at Weights & Biases and MLflow, whose servers may refuse it.

    Raises:
        ConfigError: a logger that cannot start, such as without a key of its server.
    """
    for logger in loggers:
        if isinstance(logger, WandbLogger | MLFlowLogger):
            _ = logger.experiment


@contextmanager
def beginning(run: Run) -> Iterator[None]:
    """Remove what loggers left in the folder of a run, if it fails to begin and the folder holds no other one."""
    try:
        yield
    except BaseException:
        if not run.record.is_file():
            for name in LOGGERS:
                shutil.rmtree(run.folder / name, ignore_errors=True)
        raise


@explained(_FAILED)
def _made(name: str, folder: Path) -> Logger:
    if name == "tensorboard":
        return TensorBoardLogger(folder, name="tensorboard", version="", default_hp_metric=False)
    if name == "csv":
        return CSVLogger(folder, name="csv")  # a version for each part of a run: it empties folders that it finds
    title = folder.absolute().name
    if name == "wandb":
        project = os.environ.get("WANDB_PROJECT", "siamloc")
        folder.mkdir(parents=True, exist_ok=True)
        return _Wandb(name=title, project=project, save_dir=folder)
    if server := os.environ.get("MLFLOW_TRACKING_URI"):
        return MLFlowLogger("siamloc", run_name=title, tracking_uri=server)
    here = folder.absolute() / "mlflow"
    here.mkdir(parents=True, exist_ok=True)
    return MLFlowLogger(
        "siamloc", run_name=title, tracking_uri=f"sqlite:///{here / 'mlflow.db'}", artifact_location=str(here / "files")
    )


class _Wandb(WandbLogger):
    """Weights & Biases for one training: the next one in the same process gets a run of its own."""

    def finalize(self, status: str) -> None:
        super().finalize(status)
        if self._experiment is not None:
            self._experiment.finish()
            self._experiment = None


def log_settings(loggers: list[Logger], used: Mapping[str, Any]) -> None:
    """Give loggers the resolved settings of a training, as in the record of its run."""
    for logger in loggers:
        logger.log_hyperparams({key: value for key, value in used.items() if key != "frames"})


def log_picture(loggers: list[Logger], name: str, picture: NDArray[np.uint8], step: int) -> None:
    """Give a picture (rows, columns, 3), uint8, RGB, to the loggers that take pictures; CSV gets a PNG file."""
    for logger in loggers:
        if isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(name, picture, step, dataformats="HWC")
        elif isinstance(logger, CSVLogger):
            write_picture(Path(logger.log_dir) / f"{name}.png", picture)
        elif isinstance(logger, WandbLogger):
            logger.log_image(name, [picture])
        elif isinstance(logger, MLFlowLogger):
            logger.experiment.log_image(logger.run_id, picture, f"{name}.png")


def files_logged(run: Run) -> set[Path]:
    """Return the files in the folders of the loggers that the run's record does not list."""
    known = run.written()
    found = [path for name in LOGGERS for path in (run.folder / name).rglob("*")]
    files = {path for path in found if path.is_file() and not path.is_symlink()}
    return {path for path in files if path.relative_to(run.folder).as_posix() not in known}
