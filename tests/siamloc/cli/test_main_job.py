"""The main path: train, map, evaluate, export and localize, and what these commands keep, replace or refuse."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import siamloc
from siamloc.maps import VisualMap
from siamloc.results import read_results
from siamloc.runtime import Bundle
from siamloc.training import Run
from tests.drawn import altered
from tests.siamloc.cli.commands import QUICK, SMALL, done, main, measures, refused
from tests.siamloc.report.pages import read_page

SECOND = "protocol.query.sequences=[second]"
OWN = """
from dataclasses import dataclass

import numpy as np
from torch import nn


def factory():
    return nn.Conv2d(3, 8, 4, stride=4)


@dataclass(frozen=True)
class Camera:
    shift: float = 0

    def sampling(self, view, image_size):
        rows, columns = np.mgrid[: image_size[0], : image_size[1]].astype(float)
        return (columns + self.shift) % image_size[1], rows
"""


def test_the_job_leaves_what_each_command_promises(finished):
    files = ("run.json", "metrics.csv", "checkpoints/best.ckpt", "checkpoints/last.ckpt", "map.npz", "locations.csv")
    evaluation = finished / "evaluation/network"
    for name in (*files, "evaluation/network/results.json", "bundle/model.onnx"):
        assert (finished / name).is_file(), name
    assert len(list(evaluation.glob("*.png"))) >= 3
    results = read_results(evaluation)
    absolute = results["measures"]["absolute"]["overall"]
    assert absolute["queries"] == results["denominators"]["queries"] == 24
    assert absolute["error"]["mean"] == pytest.approx(absolute["floor"]["mean"] + absolute["excess"]["mean"])
    assert results["measures"]["room_retrieval"]["overall"]["accuracy"] > 0.9, "the network learned the rooms"
    assert set(results["baselines"]) == {"thumbnail", "untrained"}
    assert results["baselines"]["thumbnail"]["absolute"]["overall"]["queries"] == 24
    assert results["measures"]["room_pairs"]["overall"]["n_same"] == 3500
    assert results["protocol"] == "cross_run"
    assert results["config"]["protocol"]["query"]["sequences"] == ["second"]


def train(data, run, *more):
    return ["train", *data, *SMALL, "pairs=room", "protocol.train.sequences=[first]", f"run={run}", *more]


def test_a_training_is_replaced_or_continued_only_when_told(trained, data, tmp_path, capsys):
    run = Run(shutil.copytree(trained, tmp_path / "run"))
    before, again = run.curves(), ["train", f"run={run.folder}"]
    given = train(data, run.folder)
    assert "the trainer cannot be set up" in refused(capsys, *given, "overwrite=true", "trainer.precision=bf")
    assert "resume=true" in refused(capsys, *given)
    for other in ("model/branch=simple2", "optimizer.learning_rate=5", "seed=7", "pairs.same_room_share=0.3"):
        key = other.partition("=")[0].replace("/", ".")
        assert f"cannot be resumed with {key}=" in refused(capsys, *again, "resume=true", "epochs=9", other)
    assert str(run.curves()) == str(before)
    assert (run.folder / "checkpoints/last.ckpt").is_file()
    done(*again, "resume=true", "epochs=9")
    assert run.curves()["epoch"].tolist() == list(range(9))


def test_a_failed_start_leaves_no_run_and_overwriting_starts_again(data, tmp_path, capsys):
    run = Run(tmp_path / "run")
    refused(capsys, *train(data, run.folder, "trainer.precision=bf"))
    for seed in (0, 3):
        done(*train(data, run.folder, "epochs=1", f"seed={seed}", "overwrite=true"))
        assert (len(run.curves()["epoch"]), run.settings["training"]["seed"]) == (1, seed)


def test_a_bundle_names_no_folder_of_this_machine(run, flat, tmp_path):
    done("map", f"run={run}", "protocol.map.sequences=[first,third]", "heading=hog")
    done("evaluate", f"run={run}", SECOND, "task.error_model=true", "overwrite=true", *QUICK)
    done("export", f"run={run}", "thumbnails=true")
    bundle = Bundle.open(run / "bundle")
    known = bundle.load("map.npz")
    assert known.frames.path[[0, -1]].tolist() == ["first/0000.png", "third/0023.png"]
    assert bundle.load("error_model.json").learned_on(known)
    assert bundle.thumbnail(47) is not None
    here = (str(flat.parent), str(run), str(Path(siamloc.__file__).parent))
    texts = [str(known.made).encode(), *((bundle.path / name).read_bytes() for name in ("bundle.json", "model.onnx"))]
    assert not [(folder, text[:99]) for folder in here for text in texts if folder.encode() in text]


def test_files_of_people_are_never_removed(finished, data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mine = tmp_path / "checkpoints/thesis.txt"
    mine.parent.mkdir()
    mine.write_text("years of work")
    for run, says in (("", "run must be the name of a folder"), (".", "is not a run and holds other files")):
        for more in ([], ["overwrite=true"]):
            assert says in refused(capsys, *train(data, run), *more)
    assert "holds other files, such as thesis.txt" in refused(
        capsys, "export", f"run={finished}", f"bundle={mine.parent}"
    )
    assert mine.read_text() == "years of work"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["checkpoints", "thesis.txt"]
    done("export", f"run={finished}", "bundle=new")
    files = {"bundle.json", "map.npz", "model.onnx", "error_model.json"}
    assert {path.name for path in (tmp_path / "new").iterdir()} == files


def test_stopping_a_training_says_how_to_go_on_once(data, tmp_path, capsys, monkeypatch):
    says = "stopped after 1 of 2 epochs: go on with resume=true"

    def stopped(*arguments, **keywords):
        print(says, file=sys.stderr)
        raise KeyboardInterrupt(says)

    monkeypatch.setattr("siamloc.training.fit", stopped)
    assert main(train(data, tmp_path / "run")) == 130
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if "stopped" in line or "interrupted" in line] == [says]


@pytest.mark.slow
def test_of_two_processes_that_train_together_one_speaks(data, tmp_path):
    words = train(data, tmp_path / "run", "epochs=1", "trainer.devices=2", "trainer.strategy=ddp")
    command = [sys.executable, "-m", "siamloc", *words]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=200, env=os.environ)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("next: siamloc map") == 1
    assert len(Run(tmp_path / "run").curves()["epoch"]) == 1


def test_a_trained_run_describes_for_another_folder(finished, tmp_path):
    words = ["protocol.map.sequences=[first]", SECOND, *QUICK]
    done("evaluate", f"run={tmp_path / 'other'}", f"descriptor={finished}", *words)
    first, other = (measures(run / "evaluation/network")["absolute"] for run in (finished, tmp_path / "other"))
    assert first["overall"]["error"] == other["overall"]["error"]


def test_queries_from_the_run_of_the_map_are_refused_whatever_the_roles_say(run, capsys):
    done("map", f"run={run}", "protocol.map.sequences=[second]")
    queries = [f"run={run}", SECOND, "overwrite=true"]
    assert "not be honest" in refused(capsys, "evaluate", *queries)
    done("evaluate", *queries, "protocol.kind=same_run", *QUICK)
    results = read_results(run / "evaluation/network")
    assert results["protocol"] == "same_run"
    assert results["measures"]["absolute"]["overall"]["error"]["mean"] == 0


def test_queries_that_the_network_was_chosen_by_are_named_whatever_the_roles_say(run, flat, tmp_path, capsys):
    dark = [f"run={run}", "protocol.query.sequences=[dark]", f"out={tmp_path}", "overwrite=true", *QUICK]
    assert "not be honest" in refused(capsys, "evaluate", *dark)
    note = "had sequence 'dark' in protocol.validation: as a query it gives better results than a new drive"
    done("evaluate", *dark, "protocol.validation.sequences=[]")
    assert note in capsys.readouterr().out
    other = altered(flat, "other.csv", lambda row: {})
    for same in ([SECOND], [f"data.manifest={other}", "protocol.validation.sequences=[]"]):
        done("evaluate", *dark, *same)
        assert "note: the network" not in capsys.readouterr().out


def test_the_command_after_a_map_works_as_printed(run, words, data, tmp_path, capsys):
    hog = ["descriptor=hog", f"run={tmp_path / 'my map'}"]
    for given, command, says in (
        ([f"run={run}"], "evaluate", 'protocol.query.sequences=["second"]'),
        ([*words, *hog, "protocol.leave_one_out=true"], "evaluate", "protocol.leave_one_out=true"),
        ([*data, *hog, "protocol.map.sequences=[*]"], "export", "descriptor=hog"),
    ):
        done("map", *given)
        name, *follows = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: siamloc "))
        assert name == command
        assert says in follows
        done(name, *follows, *(["overwrite=true", *QUICK] if name == "evaluate" else []))
    assert measures(tmp_path / "my map/evaluation/hog")["absolute"]["overall"]["queries"] == 48


def test_the_command_after_a_map_keeps_its_nodes(words, tmp_path, capfd):
    changed = ["build=spectral", "build.nodes=3", "seed=1", "+build.label=mine"]
    done("map", *words, "descriptor=hog", f"run={tmp_path}", *changed)
    follows = shlex.split(capfd.readouterr().out.splitlines()[-1].removeprefix("next: siamloc "))
    layer = tmp_path / "layers/hog-mine/layer.npz"
    before = layer.read_bytes()
    done(*follows, "task.plots=false")
    assert layer.read_bytes() == before
    assert "replace" not in capfd.readouterr().err


def test_the_commands_that_an_export_proposes_work_as_printed(data, tmp_path, capsys):
    own = ["descriptor=thumbnail", "descriptor.rows=16", f"run={tmp_path / 'my run'}"]
    done("map", *data, *own, "protocol.map.sequences=[first]")
    done("evaluate", *own, "protocol.query.sequences=[dark]", *QUICK)
    errors = "for expected errors, by drives with positions: siamloc evaluate "
    for says in ("for a heading as well: siamloc map ", errors):
        capsys.readouterr()
        done("export", *own)
        (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith(says))
        name, words = says.split()[-1], shlex.split(line.removeprefix(says).removesuffix(", then export again"))
        done(name, *words, *(QUICK if name == "evaluate" else []))
    capsys.readouterr()
    done("export", *own)
    said = capsys.readouterr().out
    assert "expected errors" not in said
    assert """'images=["photo.jpeg"]'""" in said


def test_commands_for_a_network_and_a_camera_of_ones_own_name_them_as_printed(data, tmp_path, capsys, monkeypatch):
    (tmp_path / "siamloc_own_branch.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    own, camera = "model/branch=siamloc_own_branch:factory", "unwrap.kind=siamloc_own_branch:Camera"
    made = [own, "model/head=gem", "unwrap=own", camera, "+unwrap.shift=2"]
    command = train(data, tmp_path / "run", "epochs=1", *made, SECOND)
    for follows in ("map", "evaluate", None):
        monkeypatch.delitem(sys.modules, "siamloc_own_branch", raising=False)  # the next command is another process
        done(*command, *(QUICK if command[0] == "evaluate" else []))
        if follows:
            command = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: siamloc "))
            assert command[0] == follows
            assert {own, camera} <= set(command)
    done("export", f"run={tmp_path / 'run'}", own, camera)
    said = capsys.readouterr().out
    (proposed,) = (line for line in said.splitlines() if "task.error_model=true" in line)
    assert f"evaluate run={tmp_path / 'run'} {camera} {own} " in proposed


def test_the_choice_of_map_frames_is_handed_on_and_not_changed_in_silence(run, capsys):
    done("map", f"run={run}", "protocol.map.every=3")
    words = [f"run={run}", SECOND, "task.baselines=[thumbnail]", "task.plots=false", "overwrite=true"]
    done("evaluate", *words)
    results = read_results(run / "evaluation/network")
    assert results["config"]["protocol"]["map"]["every"] == 3
    assert results["denominators"]["map_frames"] == 8
    assert results["baselines"]["thumbnail"]["absolute"]["map_frames"] == 8
    assert "run `siamloc map` again" in refused(capsys, "evaluate", *words, "protocol.map.every=4")


def test_an_evaluation_uses_the_data_of_its_run_and_never_writes_a_map(flat, words, tmp_path, capsys):
    given = ["descriptor=thumbnail", f"run={tmp_path}"]
    done("map", *words, *given, "heading=hog", "build=sample", "build.nodes=3")
    kept = [tmp_path / "evaluation/thumbnail/map.npz", tmp_path / "layers/thumbnail-sample/layer.npz"]
    before = [path.read_bytes() for path in kept]
    capsys.readouterr()
    mapping = ["task=mapping", "build=sample", "task.plots=false", "protocol.map.every=2", "build.nodes=3"]
    done("evaluate", *words, *given, *mapping)
    assert [path.read_bytes() for path in kept] == before
    assert (len(VisualMap.load(kept[0])), VisualMap.load(kept[0]).heading is None) == (24, False)
    assert measures(tmp_path / "evaluation/mapping-thumbnail-sample")["mapping"]["frames"] == 12
    done("evaluate", *given, SECOND, *QUICK)
    assert f", {flat}" in capsys.readouterr().out


def test_without_a_run_the_folder_is_that_of_the_data_and_the_descriptor(flat, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done("evaluate", *words, "descriptor=thumbnail", "data.name=flat", *QUICK)
    assert f"data: flat, {flat}" in capsys.readouterr().out
    results = read_results(tmp_path / "runs/flat/thumbnail/evaluation/thumbnail")
    assert set(results["measures"]["absolute"]["lighting"]) == {"cloudy", "night"}
    assert "margin" in results["skipped"]["room_pairs"]
    assert (results["data"]["queries"]["manifest"], results["data"]["queries"]["name"]) == (str(flat), "flat")


def test_rooms_alone_have_a_folder_of_their_own(words, tmp_path, capsys):
    given = ["evaluate", *words, "descriptor=thumbnail", f"run={tmp_path}", "task.baselines=[]"]
    done(*given)
    folders = [tmp_path / "evaluation" / name for name in ("thumbnail", "room_retrieval-thumbnail")]
    before = {path.name: path.read_bytes() for path in folders[0].iterdir()}
    done(*given, "task=room_retrieval")
    assert {path.name: path.read_bytes() for path in folders[0].iterdir()} == before
    assert set(measures(folders[1])) == {"room_retrieval"}
    done("report", f"run={tmp_path}")
    headings = [heading.text for heading in read_page(tmp_path / "report.html").all("h2")]
    assert headings == ["thumbnail", "thumbnail, room retrieval"]
    done(*given, "task=absolute")
    assert sorted(path.name for path in folders[0].iterdir() if path.suffix == ".png") == [
        "error_curve.png",
        "floor_plan.png",
    ]


@pytest.mark.slow
def test_results_of_other_queries_are_not_replaced_in_silence(flat, words, tmp_path, capsys):
    given = ["evaluate", *words, "descriptor=thumbnail", f"run={tmp_path / 'run'}", *QUICK]
    path = tmp_path / "run/evaluation/thumbnail/results.json"
    for _ in range(2):  # the same again
        done(*given)
    before = path.read_bytes()
    other = [*given, "protocol.query.every=2"]
    assert "holds results of other frames (protocol.query)" in refused(capsys, *other)
    copied = altered(flat, "copied.csv", lambda row: {})
    assert "holds results of other frames (data)" in refused(capsys, *given, f"data.manifest={copied}")
    assert path.read_bytes() == before
    done(*given, "protocol.validation.sequences=[first]")  # the same queries in the same map
    before = path.read_bytes()
    done(*other, f"out={tmp_path / 'half'}")
    assert path.read_bytes() == before
    assert (tmp_path / "half/results.json").is_file()
    assert "holds results already: choose another out=" in refused(capsys, *given, f"out={tmp_path / 'half'}")
    swept = [word for word in given if not word.startswith("descriptor")]
    done(*swept, "-m", "descriptor=thumbnail,hog", f"out={tmp_path / 'both'}")
    assert len(list((tmp_path / "both").glob("*/results.json"))) == 2
    done(*other, "overwrite=true")
    assert path.read_bytes() != before
    path.write_bytes(before[:100])  # cut short: nothing to lose
    done(*given)


def test_nodes_over_the_training_frames_are_measured_again(data, tmp_path):
    given = [*data, "protocol.train.sequences=[first]", "descriptor=thumbnail", "build=rooms", f"run={tmp_path}"]
    done("map", *given)
    for _ in range(2):
        done("evaluate", *given, "task=mapping", "task.plots=false")
