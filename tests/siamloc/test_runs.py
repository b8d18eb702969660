"""The record of a run: versions, and what may be removed."""

from __future__ import annotations

import json

import pytest

from foundation.files import read_json, write_json
from siamloc.errors import ConfigError, FormatError, OldFormatError
from siamloc.runs import Run, run_with


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path / "run")
    run.start({"training": {"epochs": 3}}, ["metrics.csv"])
    return run


def test_a_record_comes_back(run):
    assert run.settings == {"training": {"epochs": 3}}
    assert read_json(run.record)["written"] == ["metrics.csv"]
    run.record_written(["map.npz", run.folder / "evaluation" / "a.csv", "map.npz"])
    assert read_json(run.record)["written"] == ["evaluation/a.csv", "map.npz", "metrics.csv"]


SECTIONS = ("data", "model", "training", "loss", "augment", "protocol", "trainer")


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("version", 1, "has format version 1, this siamloc reads version 2: train again"),
        ("version", 3, "has format version 3, this siamloc reads version 2: update siamloc"),
        *(("version", value, "has format version") for value in ("x", [9], float("nan"), True, None)),
        ("format", "other", "was not written by siamloc"),
        *(("settings", value, "was altered in settings") for value in (3, [["a"]], None)),
        *(("written", value, "was altered in written") for value in (5, [[1], {}], "a", None)),
        ("created", {}, "was altered in created"),
        ("versions", 3, "was altered in versions"),
        *(("settings", {name: 3}, rf"was altered in settings\.{name}") for name in SECTIONS),
        *(("settings", {name: None}, rf"was altered in settings\.{name}") for name in ("data", "model", "training")),
    ],
)
def test_altered_records_are_refused(run, key, value, says):
    run.record.write_text(json.dumps({**read_json(run.record), key: value}))
    with pytest.raises(FormatError, match=says):
        run.load_record()


def test_a_folder_without_a_record_is_no_run_and_nothing_is_noted_there(tmp_path):
    run = Run(tmp_path)
    run.record_written(["map.npz"])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConfigError, match="is not the folder of a run"):
        run.load_record()


@pytest.mark.parametrize("name", ["../other.txt", "/etc/hostname", ".", "evaluation"])
def test_only_files_inside_the_run_are_noted(run, name):
    (run.folder / "evaluation").mkdir()
    with pytest.raises(ConfigError, match="is not a file inside the run"):
        run.record_written([name])


def test_clearing_never_leaves_the_folder(run, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    for name in ("a.txt", "b.txt"):
        (outside / name).touch()
    (run.folder / "link").symlink_to(outside)
    run.metrics.symlink_to(outside / "b.txt")
    names = ["metrics.csv", "../outside/a.txt", "link/a.txt", str(outside / "a.txt")]
    write_json(run.record, {**read_json(run.record), "written": names})
    run.clear()
    assert sorted(path.name for path in outside.iterdir()) == ["a.txt", "b.txt"]
    assert not run.metrics.is_symlink()
    assert run.record.is_file()


def test_an_empty_name_is_refused():
    with pytest.raises(ConfigError, match="a folder of its own"):
        Run("")


def test_a_run_of_the_first_version_is_cleared_by_its_folders(tmp_path):
    own = ["map.npz", "checkpoints/last.ckpt", "evaluation/hog/results.json", "metrics.csv"]
    for name in (*own, "notes.txt", "photos/a.jpg"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    run = Run(tmp_path)
    write_json(run.record, {"format": "siamloc-run", "version": 1, "overrides": [], "config": {}})
    with pytest.raises(OldFormatError, match="train again, here with overwrite=true"):
        run.load_record()
    assert run.foreign([*own, "notes.txt"]) == ["notes.txt"]
    run.clear()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "photos", "run.json"]
    assert (tmp_path / "photos" / "a.jpg").is_file()


def test_a_number_is_no_folder_of_an_evaluation():
    with pytest.raises(ConfigError, match=r"evaluation must be .*, got 5"):
        run_with(5)
