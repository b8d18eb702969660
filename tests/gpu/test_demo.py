"""The commands of `siamloc demo` on a GPU, from the training to the report."""

from __future__ import annotations

import sys

import pytest

from siamloc.cli import main
from siamloc.training import trainer
from tests.drawn import write_manifest
from tests.gpu.pretend import NAME
from tests.gpu.trainer import Trainer, pretend_trainer

DRIVES = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2")


@pytest.fixture
def _everything_there(gpu, monkeypatch):
    """Choose the pretended GPU where nothing else is asked for."""

    def made(plugins=(), precision=None, **options):
        there = pretend_trainer()
        return Trainer(**{**options, **there, "plugins": [*plugins, *there["plugins"]]})

    monkeypatch.setattr(trainer, "Trainer", made)
    for module in [module for module in sys.modules.values() if hasattr(module, "chosen_device")]:
        monkeypatch.setattr(module, "chosen_device", lambda _: NAME)


@pytest.mark.slow
@pytest.mark.usefixtures("_everything_there")
def test_the_demo_runs_to_its_report(tmp_path, capsys):
    flat = write_manifest(tmp_path, {name: name[:-1] for name in DRIVES}, frames_per_room=4)
    data = ["data=manifest", f"data.manifest={flat}", f"data.cache={tmp_path / 'cache'}", "data.image_size=[16,64]"]
    short = ["model/branch=simple1", "epochs=1", "pairs.epoch_batches=2", "pairs.places=4"]
    for words in (
        ["train", "experiment=demo", *data, *short, "augment.where=gpu"],
        ["map"],
        ["evaluate", "task.radii=[0.5]", "task.baselines=[untrained]", "task.error_model=true"],
        ["export", "thumbnails=true"],
        ["localize", f"images=['{tmp_path / 'night2'}']"],
        ["report"],
    ):
        assert main([*words, f"run={tmp_path / 'run'}"]) == 0, capsys.readouterr().err
    assert (tmp_path / "run" / "report.html").is_file()
