"""Requests that data, runs and maps do not allow: each command answers in one sentence, and writes nothing."""

from __future__ import annotations

import json

import pytest
import torch

from tests.drawn import altered
from tests.siamloc.cli.commands import QUICK, SMALL, done, refused

HIERARCHICAL = "task=hierarchical build=rooms"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("protocol.query.sequences=[]", "selects none of the 96 frames"),
        ("task.error_model=true protocol.validation.sequences=null", "validation.sequences is not"),
        ("task.error_model=true protocol.validation.sequences=[first]", "validate on another sequence"),
        ("task=mapping", "choose one with build=rooms|sample|spectral|som|incremental"),
        (f"{HIERARCHICAL} task.coarse.descriptor=hogg", "did you mean 'hog'"),
        (f"{HIERARCHICAL} task.coarse.descriptor=radon_poc", "task.coarse.by=vote"),
        ("task=robustness task.robustness.effects=[noise]", "'noise' twice"),
        ("descriptor=thumbnail heading=hog data.circular=false", "heading=hog needs columns that are a full turn"),
    ],
)
def test_evaluations_of_a_descriptor(words, tmp_path, capsys, line, says):
    assert says in refused(capsys, "evaluate", *words, "descriptor=hog", f"run={tmp_path}", *line.split())
    assert not list(tmp_path.rglob("results.json"))


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("evaluate model/branch=simple2", "another architecture"),
        ("evaluate unwrap=polar", "images"),
        ("evaluate heading=fs", "name is 'hog' in the map, 'fs' here: make it again with `siamloc map heading=fs`"),
        ("evaluate heading=hog heading.step=2", "step is 4 in the map, 2 here: make it again"),
        ("localize bundle=/nowhere/b images=[camera:0]", "there is no folder /nowhere/b: give that of a bundle"),
        ("live bundle=/nowhere/b images=[camera:0]", "there is no folder /nowhere/b"),
    ],
)
def test_commands_on_a_run(finished, capsys, line, says):
    command, *more = line.split()
    roles = ["protocol.query.sequences=[second]"] if command == "evaluate" else []
    assert says in refused(capsys, command, f"run={finished}", *roles, *more)


def test_a_map_without_headings_asks_for_them(trained, capsys):
    says = "holds nothing to find headings by: make it again with `siamloc map heading=hog`"
    assert says in refused(capsys, "evaluate", f"run={trained}", "protocol.query.sequences=[second]", "heading=hog")


NO_GPU = pytest.mark.skipif(torch.cuda.is_available(), reason="with a GPU")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("protocol.train.sequences=[secund]", "did you mean 'second'"),
        ("protocol.train.sequences=null", "protocol.train.sequences is not set"),
        ("pairs=room loss=cross_entropy", "loss=cross_entropy does not go with these pairs"),
        ("model.branch.weights=/nowhere.pth", "nowhere.pth"),
        ("trainer.accelerator=quantum", "the trainer cannot be set up"),
        pytest.param("trainer.accelerator=gpu", "trainer.accelerator=gpu needs a GPU, and torch finds none here: use "
                     "auto or cpu", marks=NO_GPU),
        ("resume=true", "no run to resume"),
    ],
)  # fmt: skip
def test_trainings(data, tmp_path, capsys, line, says):
    roles = ["protocol.train.sequences=[first]", f"run={tmp_path / 'run'}"]
    assert says in refused(capsys, "train", *data, *SMALL, *roles, *line.split())
    assert not (tmp_path / "run").exists()


def test_runs_that_are_missing_or_not_named(data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "train one first" in refused(capsys, "map")
    assert "nowhere" in refused(capsys, "map", "run=nowhere")
    (tmp_path / "runs/demo").mkdir(parents=True)
    record = {"format": "siamloc-run", "version": 2, "settings": {"data": {"kind": "manifest"}}, "written": []}
    (tmp_path / "runs/demo/run.json").write_text(json.dumps(record))
    for command in ("map", "evaluate", "export"):
        assert "no run is named: give run=FOLDER, such as run=runs/demo" in refused(capsys, command)
    assert "/nowhere" in refused(capsys, "evaluate", "descriptor=hog", "data=folder", "data.root=/nowhere")
    assert "data/freiburg_like" in refused(capsys, "evaluate", "descriptor=hog", "data=freiburg_sim")
    robot, second = "run=runs/robot", "protocol.query.sequences=[second]"
    done("map", robot, "descriptor=hsv", "descriptor.homomorphic=true", *data, "protocol.map.sequences=[first]")
    assert "holds no trained network" in refused(capsys, "map", robot)  # it would be replaced by another
    done("evaluate", robot, second, *QUICK)  # by the only descriptor
    done("report", "out=newest.html")  # of the newest run, trained or not
    assert "hsv" in (tmp_path / "newest.html").read_text()
    done("map", robot, "descriptor=thumbnail", *data, "protocol.map.sequences=[first]")
    said = refused(capsys, "evaluate", robot, second)
    assert "robot holds no trained network, only maps by hsv, thumbnail: choose the descriptor, such as desc" in said


def test_a_current_folder_that_was_removed_is_said(tmp_path, capsys, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    says = "siamloc: the current folder was removed: change to another one"
    assert refused(capsys, "compare", f"runs={tmp_path}") == says


@pytest.mark.parametrize("content", [{"format": "siamloc-run", "version": 1, "settings": {}}, {}, [1], 5, None])
def test_records_of_other_versions_are_refused(tmp_path, capsys, content):
    (tmp_path / "run.json").write_text(json.dumps(content))
    for command in ("map", "evaluate", "export"):
        assert "run.json" in refused(capsys, command, f"run={tmp_path}")


def test_a_table_that_changed_since_its_map_was_made(flat, words, tmp_path, capsys):
    given = [*words, "descriptor=thumbnail", f"run={tmp_path}"]
    done("map", *given)
    moved = altered(flat, "moved.csv", lambda row: {"x": float(row["x"]) + 6} if row["sequence"] == "first" else {})
    fewer = altered(flat, "fewer.csv", lambda row: {"image": row["image"].replace("first/", "third/")})
    for table, says in (
        (moved, "another position or room in the data now"),
        (fewer, "24 of the map's 24 frames are not in the data"),
    ):
        assert says in refused(capsys, "evaluate", *given, f"data.manifest={table}")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            ["report", "runs=[]"],
            "runs must be a list of one name or more, or a text that is not empty, or null, got []",
        ),
        (["evaluate", "run=[a,b]"], "siamloc: run must be a text, got ['a', 'b']"),
        (["demo", "run={file}", "data={data}"], "is a file: choose a new or empty folder as run="),
        *[
            ([*command.split(), "data.manifest={table}", "data.cache={data}"], "a file stands where a folder is needed")
            for command in (
                "map descriptor=hog run={file}/run protocol.map.sequences=[first]",
                "evaluate descriptor=hog run={file}/run protocol.map.sequences=[first] protocol.query.sequences=[dark]",
                "train run={file}/run protocol.train.sequences=[first]",
                "survey out={file}/survey",
            )
        ],
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_written(given, says, flat, tmp_path, capsys):
    file, folder = tmp_path / "file", tmp_path / "data"
    file.write_text("mine")
    assert says in refused(capsys, *(word.format(file=file, data=folder, table=flat) for word in given))
    assert not folder.exists()
