"""Tables of several runs: what differs, which epoch was the best, and which run comes first."""

from __future__ import annotations

import csv

import pytest

from siamloc.errors import ConfigError
from siamloc.training import Run, compare

SETTINGS = {
    "data": {"name": "robot", "cache": "a"},
    "model": {"branch": "alexnet", "head": "flat", "seed": 0},
    "training": {"seed": 0, "pairs": {"places": 16}},
    "frames": {"train": "1f"},
}


def make(folder, curves, **changes):
    """Write a run with these curves, a list over the epochs for each figure."""
    run = Run(folder)
    seed = changes.get("seed", 0)
    model = {**SETTINGS["model"], "branch": changes.get("branch", "alexnet"), "seed": seed}
    run.start({**SETTINGS, "data": {"cache": folder.name}, "model": model, "training": {"seed": seed}}, [])
    if curves:
        rows = [dict(zip(curves, values, strict=True)) for values in zip(*curves.values(), strict=True)]
        with run.metrics.open("w", newline="") as file:
            writer = csv.DictWriter(file, ["epoch", *curves])
            writer.writeheader()
            writer.writerows({"epoch": number, **row} for number, row in enumerate(rows))
    return run


def test_rows_hold_what_differs_and_the_best_epoch_and_the_best_run_comes_first(tmp_path):
    make(tmp_path / "a", {"train/loss": [3, 2, 1], "val/error": [0.9, 0.5, 0.7]})
    make(tmp_path / "b", {"train/loss": [3, 2, 1], "val/error": [0.9, 0.8, 0.3]}, seed=1, branch="vgg16")
    found = compare(tmp_path)
    assert found.by == "val/error"
    assert found.differing == ("model.branch", "seed")
    keys = ["model.branch", "seed", "val/error", "epoch", "finished", "run"]
    folders = [(tmp_path / name).as_posix() for name in ("b", "a")]
    expected = [("vgg16", 1, 0.3, 3, 3, folders[0]), ("alexnet", 0, 0.5, 2, 3, folders[1])]
    assert [dict(row) for row in found.rows] == [dict(zip(keys, row, strict=True)) for row in expected]


def test_of_rooms_and_accuracies_the_highest_is_the_best(tmp_path):
    make(tmp_path / "a", {"val/room": [0.2, 0.9, 0.4], "val/accuracy": [0.1, 0.2, 0.3]})
    make(tmp_path / "b", {"val/room": [0.5, 0.6, 0.7], "val/accuracy": [0.9, 0.8, 0.3]}, seed=1)
    assert [(row["seed"], row["val/room"], row["epoch"]) for row in compare(tmp_path).rows] == [
        (0, 0.9, 2),
        (1, 0.7, 3),
    ]
    found = compare(tmp_path, by="val/accuracy").rows
    assert [(row["seed"], row["val/accuracy"], row["epoch"]) for row in found] == [(1, 0.9, 1), (0, 0.3, 3)]


@pytest.mark.parametrize(
    ("losses", "differing"),
    [
        ([{"class": "A", "name": "a", "near": 1, "margin": 2}, {"class": "B", "name": "b", "near": 1}], ("loss.name",)),
        ([{"name": "a", "near": 1}, {"name": "b", "near": 3}], ("loss.name", "loss.near")),
        (
            [{"name": "a", "margin": 2}, {"name": "a", "margin": 3}, {"name": "b"}],
            ("loss.name", "loss.margin"),
        ),
        ([{"class": "A", "name": "a"}, {"class": "Own"}], ("loss.class", "loss.name")),
    ],
    ids=["of one loss alone", "of both losses", "two values for one loss", "a loss without a name"],
)
def test_parameters_that_each_loss_has_for_itself_make_no_columns(losses, differing, tmp_path):
    for number, loss in enumerate(losses):
        run = make(tmp_path / f"{number}", {"val/error": [0.9]})
        run.start({**run.settings, "loss": loss}, [])
    assert compare(tmp_path).differing == differing


def test_sweeps_and_runs_are_compared_together(tmp_path):
    for seed, name in enumerate(("sweep/a", "sweep/b", "further/c")):
        make(tmp_path / name, {"val/error": [0.9, 0.5 + seed]}, seed=seed)
    single = make(tmp_path / "d", {"val/error": [0.1]}, seed=3)
    found = compare([tmp_path / "sweep", tmp_path / "sweep/a", tmp_path / "further", single])
    assert [row["seed"] for row in found.rows] == [3, 0, 1, 2]
    make(tmp_path / "sweep/a/fine", {"val/error": [0.1]}, seed=4)
    found = compare([tmp_path / "sweep/a", tmp_path / "sweep/../sweep/a", tmp_path / "sweep/b"])
    assert [row["seed"] for row in found.rows] == [0, 1]


def test_a_run_without_a_figure_comes_last(tmp_path):
    runs = [make(tmp_path / "a", {}), make(tmp_path / "b", {"val/loss": ["", 0.5]}, seed=1)]
    found = compare(runs)
    assert [(row["seed"], row["epoch"], row["finished"]) for row in found.rows] == [(1, 2, 2), (0, None, 0)]
    saved = found.save(tmp_path / "table.csv").read_text().splitlines()
    assert saved[0] == "seed,val/loss,epoch,finished,run"
    assert saved[1:] == [f"1,0.5,2,2,{runs[1].folder.as_posix()}", f"0,,,0,{runs[0].folder.as_posix()}"]
    assert [line.split() for line in found.table().splitlines()][1][:4] == ["1", "0.5", "2", "2"]


def test_runs_that_have_not_finished_their_epochs_are_named(tmp_path):
    for seed, finished in enumerate((3, 1, 2)):
        run = make(tmp_path / f"{seed}", {"val/error": [0.9 - seed / 10] * finished}, seed=seed)
        run.start({**run.settings, "training": {"seed": seed, "epochs": 3}}, [])
    one, two = ((tmp_path / f"{seed}").as_posix() for seed in (1, 2))
    (said,) = compare(tmp_path).verdict().splitlines()[1:]
    assert said == f"unfinished, or ended early: {one} (1 of 3 epochs), {two} (2 of 3 epochs)"


def test_mistakes_are_named(tmp_path):
    for runs, says in (("nowhere", "is no folder nowhere: name"), (tmp_path, "no runs to"), ([], "compare: name")):
        with pytest.raises(ConfigError, match=says):
            compare(runs)
    make(tmp_path / "a", {})
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"no runs to compare in the folder .*empty"):
        compare([tmp_path / "a", tmp_path / "empty"])
    with pytest.raises(ConfigError, match="finished an epoch"):
        compare(tmp_path)
    make(tmp_path / "b", {"val/error": [1, 2]}, seed=1)
    with pytest.raises(ConfigError, match="did you mean 'val/error'"):
        compare(tmp_path, by="val/eror")
    only_trained = [make(tmp_path / f"t{seed}", {"train/loss": [2, 1]}, seed=seed) for seed in (0, 1)]
    with pytest.raises(ConfigError, match="no figure in common by which checkpoints are chosen"):
        compare(only_trained)
    assert [row["train/loss"] for row in compare(only_trained, by="train/loss").rows] == [1, 1]
    make(tmp_path / "c", {"val/loss": [1, 2]}, seed=2)
    with pytest.raises(ConfigError, match="no figure in common"):
        compare(tmp_path)
