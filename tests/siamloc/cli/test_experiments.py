"""One step of every experiment, on a few small drawn pictures: its own network, loss, batches, optimizer,
augmentation and protocol. A new one is tested without any change here. `adapt` needs a longer drive."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from foundation.settings import leaves
from siamloc import models
from siamloc.cli import main
from siamloc.cli.compose import composed
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.jobs.options import choices, groups
from siamloc.training import Run
from tests.drawn import write_cold, write_manifest

EXPERIMENTS = [name for name in choices("experiment") if name != "adapt"]
RESULTS = Path(__file__).parents[3] / "docs/results"
PUBLISHED = RESULTS / "published.md"
DRIVES = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2", "sunny3")


@pytest.fixture(scope="module")
def cold(tmp_path_factory):
    """Draw all drives through a part of Freiburg in COLD's layout, with a few small pictures each."""
    root = tmp_path_factory.mktemp("cold")
    seeds = {drive: number for number, drive in enumerate(DRIVES)}
    write_cold(root / "freiburg" / "part_a", seeds, frames_per_room=11, size=(64, 64))
    return root


def small_data(experiment, cold, folder):
    """Return the words that name a small data set with the sequences of the experiment's protocol."""
    words = [f"experiment={experiment}", "data.manifest=x"]
    try:
        config = composed("train", words)
    except ConfigError:  # COLD has no manifest
        return [f"data.root={cold}", "unwrap=polar"]
    protocol = config.protocol.plain()
    named = {name for role in ("train", "validation", "map", "query") for name in protocol[role]["sequences"] or []}
    manifest = write_manifest(folder, dict.fromkeys(sorted(named) or ["monday"], "cloudy"))
    return [f"data.manifest={manifest}", *([] if named else ["protocol.train.sequences=[monday]"])]


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_step_of_every_experiment(experiment, cold, tmp_path):
    data = [*small_data(experiment, cold, tmp_path / "data"), f"data.cache={tmp_path / 'cache'}"]
    words = [f"experiment={experiment}", *data, f"run={tmp_path / 'run'}", "data.image_size=[64,64]", "epochs=1"]
    config = composed("train", words)
    if isinstance(config.pairs, PlaceSettings):
        words += ["pairs.places=4", "pairs.images=2", "pairs.radius=2", "pairs.epoch_batches=1"]
    else:
        words += ["batch_size=4", "pairs.epoch_pairs=4"]
    words += ["trainer.accelerator=cpu", "model.branch.weights=null"]  # pretrained weights would have to be fetched
    assert main(["train", *words]) == 0

    run = Run(tmp_path / "run")
    used, wanted = run.settings, config.plain()
    assert [used["model"][key] for key in ("branch", "head")] == [
        wanted["model"][key]["name"] for key in ("branch", "head")
    ]
    assert used["loss"].get("name", "contrastive") == wanted["loss"]["name"]
    assert used["augment"] == {key: value for key, value in wanted["augment"].items() if key != "where"}
    assert used["training"]["optimizer"] == wanted["optimizer"]
    curves = run.curves()
    assert curves["step"].tolist() == [1]
    assert all(np.isfinite(values).all() for values in curves.values())
    trained, fresh = (dict(models.load(run, which=which).named_parameters()) for which in ("last", "untrained"))
    unchanged = [name for name in fresh if torch.equal(trained[name], fresh[name])]
    assert len(unchanged) < 0.2 * len(fresh), unchanged  # a rectifier may be shut for all of a small batch


def test_adapting_asks_for_a_longer_drive(tmp_path, capsys):
    manifest = write_manifest(tmp_path / "data", {"monday": "cloudy"})
    words = ["experiment=adapt", f"data.manifest={manifest}", "protocol.train.sequences=[monday]"]
    assert main(["train", *words, f"run={tmp_path / 'run'}"]) == 2
    assert "learns from the order of 50 frames of a drive or more, and there are 18" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def published_rows():
    """Return the words of all rows of the page's tables, each with its experiment."""
    experiment, found = "", []
    for line in PUBLISHED.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if header := re.search(r"words after `(experiment=\w+)`", line):
            experiment = header[1]
        elif len(cells) > 4 and re.fullmatch(r"5\.\d+", cells[1]):
            found.append([experiment, *cells[3].strip("`").split()])
    return found


def test_every_published_row_can_be_trained():
    rows = published_rows()
    published = [name for name in EXPERIMENTS if name.startswith("thesis")]
    assert {row[0].removeprefix("experiment=") for row in rows} == set(published)
    for name in published:
        config = composed("train", [f"experiment={name}", "data.root=x"])
        assert (config.data.kind, config.optimizer.name, config.loss.name) == ("cold", "sgd", "contrastive")
        assert config.monitor == "loss"
        for word in (word for row in rows if row[0] == f"experiment={name}" for word in row[1:]):
            key, _, value = word.partition("=")
            if key in groups():
                assert value in choices(key), word
            else:
                assert type(dict(leaves(config.plain()))[key]) in (int, float, str), word


def test_every_row_of_what_to_expect_can_be_trained():
    text = (RESULTS / "index.md").read_text(encoding="utf-8")
    table = text.partition("## What to expect of a rerun")[2].partition("\n## ")[0]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| `")][1:]
    assert len(rows) > 3
    for row in rows:
        words = re.findall(r"`([^`]+)`", row[0])[0].split()
        words += [word for part in re.findall(r"`([^`]+=[^`]+)`", row[1]) for word in part.split()]
        name = words[0]
        needs = [] if any(word.startswith("data=") for word in words) else ["data.manifest=x"]
        config = composed("train", [f"experiment={name}", *words[1:], *needs])
        assert config.epochs > 0, words
        assert re.search(r"\d", row[3]), row
        assert float(row[4].split()[0]) > 0, row
