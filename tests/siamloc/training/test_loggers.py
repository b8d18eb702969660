"""Where curves and settings go: each logger writes into the run, and a missing one is named."""

from __future__ import annotations

import csv

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from siamloc.data.image_files import size_of
from siamloc.errors import ConfigError
from siamloc.lightning import MLFlowLogger
from siamloc.training import fit, loggers
from siamloc.training.loggers import check_loggers
from tests.siamloc.training.conftest import SETTINGS, network


@pytest.fixture
def train(images, drives, tmp_path):
    """Train a run with a logger, in parts; twice, since a run that replaces another one must remove its files."""

    def train(logger, parts=1):
        quick = {"accelerator": "cpu", "logger": logger, "log_every_n_steps": 2}
        more = {"run": tmp_path / "run", "validation": drives[1], "trainer": quick, **SETTINGS}
        for _ in range(2):
            run = fit(network(), images, drives[0], epochs=2, overwrite=True, **more)
        for part in range(1, parts):
            run = fit(network(), images, drives[0], epochs=2 + part, resume=True, **more)
        return run

    return train


def test_unknown_and_missing_loggers_are_named(monkeypatch):
    with pytest.raises(ConfigError, match=r"unknown trainer.logger 'board': did you mean 'tensorboard'\?"):
        check_loggers("board")
    with pytest.raises(ConfigError, match=r"unknown trainer.logger None: .* or false for none"):
        check_loggers(None)
    monkeypatch.setattr(loggers, "find_spec", lambda package: None)
    for name in ("wandb", "mlflow"):
        with pytest.raises(ConfigError, match=rf"pip install '\.\[{name}\]'"):
            check_loggers([name])
    assert check_loggers(False) == []
    assert check_loggers("csv") == ["csv"]


def test_csv_holds_the_curves_and_the_settings_of_each_part(train):
    run = train("csv", parts=2)
    parts = [run.folder / "csv" / name for name in ("version_0", "version_1")]
    assert sorted((run.folder / "csv").iterdir()) == parts
    rows = [row for part in parts for row in csv.DictReader((part / "metrics.csv").read_text().splitlines())]
    logged = [float(row["train/loss"]) for row in rows if row.get("train/loss")]
    assert logged == pytest.approx(run.curves()["train/loss"].tolist())
    assert "learning_rate: 0.001" in (parts[1] / "hparams.yaml").read_text()
    assert not run.tensorboard.exists()
    rows, columns = size_of(parts[0] / "worst_queries.png")
    assert columns > 3 * 128
    assert rows % 6 == 0
    written = {f"csv/version_1/{name}" for name in ("metrics.csv", "hparams.yaml", "worst_queries.png")}
    assert written <= set(run.load_record()["written"])


def test_tensorboard_gets_the_settings_and_the_worst_queries_and_none_writes_nothing(train):
    folder = train(["tensorboard"]).tensorboard
    assert "branch: simple1" in (folder / "hparams.yaml").read_text()
    events = EventAccumulator(str(folder)).Reload()
    (drawn,) = events.Images("worst_queries")
    assert drawn.width > 3 * 128
    run = train(False)
    assert not any((run.folder / name).exists() for name in ("tensorboard", "csv"))
    assert len(run.curves()["epoch"]) == 2


class Refused(MLFlowLogger):
    """A logger whose server refuses it after a file was written."""

    def __init__(self, folder):
        self._initialized, self._folder = False, folder

    @property
    def experiment(self):
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder / "run.wandb").touch()
        raise PermissionError("no key is configured")


def test_a_logger_that_cannot_start_leaves_the_run_as_it_was(train, tmp_path):
    with pytest.raises(ConfigError, match="a logger of the trainer cannot start: PermissionError: no key is"):
        train(Refused(tmp_path / "run/wandb"))
    run = train(False)
    assert not (run.folder / "wandb").exists()
    before = {path: path.stat().st_mtime_ns for path in run.folder.rglob("*")}
    with pytest.raises(ConfigError, match="a logger of the trainer cannot start: PermissionError: no key is"):
        train(Refused(tmp_path / "server"))
    assert {path: path.stat().st_mtime_ns for path in run.folder.rglob("*")} == before


@pytest.mark.slow
def test_weights_and_biases_offline(train, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    run = train("wandb")
    assert list((run.folder / "wandb").glob("offline-run-*/*.wandb"))
    assert list((run.folder / "wandb").glob("offline-run-*/files/media/images/worst_queries*.png"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of MLflow about itself
def test_mlflow_in_the_folder_of_the_run(train, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    run = train("mlflow")
    client = mlflow.MlflowClient(loggers.loggers_of(run, "mlflow")[0]._tracking_uri)
    (experiment,) = [one for one in client.search_experiments() if one.name == "siamloc"]
    found = client.search_runs([experiment.experiment_id])[0]
    assert found.data.params["model/branch"] == "simple1"
    assert [one.path for one in client.list_artifacts(found.info.run_id)] == ["worst_queries.png"]
    assert found.data.metrics["train/loss"] == pytest.approx(run.curves()["train/loss"][-1])
