"""`siamloc evaluate task=robustness`, on a drawn flat."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from siamloc.cli import main
from siamloc.evaluation.disturbed_tables import curves
from siamloc.results import read_rows
from tests.drawn import write_manifest


@pytest.fixture(scope="module")
def words(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flat")
    table = write_manifest(folder, {"cloudy1": "cloudy", "cloudy2": "cloudy"}, frames_per_room=8)
    return [
        *["evaluate", "task=robustness", "descriptor=hog", f"data.manifest={table}", "data.image_size=[32,128]"],
        *[f"data.cache={folder / 'cache'}", "protocol.map.sequences=[cloudy1]", "protocol.query.sequences=[cloudy2]"],
        *["task.baselines=[thumbnail]", "task.robustness.every=3", "task.robustness.turn=[0,90]"],
    ]


@pytest.fixture(scope="module")
def folder(words, tmp_path_factory):
    run = tmp_path_factory.mktemp("run")
    assert main([*words, f"run={run}", "task.robustness.effects=[bulb]", "task.robustness.strengths=[0,1]"]) == 0
    return run / "evaluation" / "robustness-hog"


def test_the_files_hold_every_method_disturbance_and_level(folder):
    results = json.loads((folder / "results.json").read_text())
    found = results["measures"]["robustness"]
    assert results["denominators"] == {"queries": 8, "queries_of_the_role": 24, "map_frames": 24}
    assert list(found["methods"]) == ["hog", "thumbnail"]
    levels = {one["name"]: len(one["levels"]) for one in found["disturbances"]}
    assert levels == {"noise": 6, "occlusion": 5, "turn": 2, "bulb": 2}
    with (folder / "robustness.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * sum(levels.values())
    assert {(row["queries"], row["map_frames"], row["radius"]) for row in rows} == {("8", "24", "0.5")}
    assert (folder / "robustness.png").read_bytes().startswith(b"\x89PNG")


def test_the_aggregates_follow_from_the_answers_exactly(folder):
    answers, table = read_rows(folder, "answers"), read_rows(folder, "robustness")
    again = curves(answers, 0.5, 24)
    assert all(np.array_equal(again[name], table[name], equal_nan=table[name].dtype.kind == "f") for name in table)
    found = json.loads((folder / "results.json").read_text())["measures"]["robustness"]["methods"]
    told = [entry["mean"] for curve in found.values() for entries in curve.values() for entry in entries]
    assert told == again["mean"].tolist()


def test_turns_leave_hog_as_it_is_and_not_the_thumbnail(folder):
    methods = json.loads((folder / "results.json").read_text())["measures"]["robustness"]["methods"]
    first, turned = methods["hog"]["turn"]
    assert turned["mean"] == first["mean"]
    first, turned = methods["thumbnail"]["turn"]
    assert turned["mean"] > first["mean"]
    clean = [entries[0]["mean"] for entries in methods["hog"].values()]
    assert len(set(clean)) == 1, "the lowest level of everything is the clean image"


def test_one_seed_gives_the_same_curves(words, tmp_path):
    few = ["task.baselines=[]", "task.plots=false", "task.robustness.turn=[]", "task.robustness.noise=[0.05]"]
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        assert main([*words, *few, f"run={tmp_path / name}", f"seed={seed}"]) == 0
    tables = [(tmp_path / name / "evaluation/robustness-hog/answers.csv").read_bytes() for name in "abc"]
    assert tables[0] == tables[1]
    assert tables[0] != tables[2]
    assert not list(tmp_path.rglob("*.png"))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["task.robustness.effects=[bulbs]"], "did you mean 'bulb'"),
        (["task.robustness.effects=[noise]"], "'noise' twice"),
        (["task.robustness.effects=bulb"], "must be a list"),
        (["task.robustness.every=0"], "every must be a whole number from 1"),
        (["task.robustness.radius=-1"], "radius must be a number from 0"),
        (["task.robustness.noise=[a]"], "each item a number"),
        (["task.robustness.occlusion=[40]"], "from 0 to 1"),
        (["task.robustness.noise=[]", "task.robustness.occlusion=[]", "task.robustness.turn=[]"], "no levels at all"),
        (["data.circular=false"], "cannot be turned"),
        (["protocol.query.sequences=[cloudy1]"], "not be honest"),
        (["task.baselines=[thumbnale]"], "did you mean 'thumbnail'"),
    ],
)
def test_mistakes_are_one_line(words, tmp_path, more, says, capsys):
    assert main([*words, f"run={tmp_path / 'run'}", *more]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error
