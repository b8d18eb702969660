"""Damage that commands once did to maps, runs and other people's files, and must not do again."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from siamloc.cli import main
from siamloc.cli.help import job_of, keys_of
from siamloc.maps import VisualMap
from tests.drawn import write_manifest


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn")
    return write_manifest(folder, {"first": "cloudy", "second": "cloudy"}, frames_per_room=8)


def words(manifest, *more):
    cache = f"data.cache={manifest.parent / 'store'}"
    roles = ["protocol.map.sequences=[first]", "protocol.query.sequences=[second]"]
    return [f"data.manifest={manifest}", "data.image_size=[32,128]", cache, *roles, *more]


def test_an_evaluation_never_writes_a_map(manifest, tmp_path):
    given = words(manifest, "descriptor=thumbnail", f"run={tmp_path}")
    assert main(["map", *given, "heading=hog", "build=sample", "build.nodes=3"]) == 0
    path, layer = tmp_path / "evaluation/thumbnail/map.npz", tmp_path / "layers/thumbnail-sample/layer.npz"
    before = path.read_bytes(), layer.read_bytes()
    mapping = ["task=mapping", "build=sample", "task.plots=false"]
    assert main(["evaluate", *given, *mapping, "protocol.map.every=2", "build.nodes=3"]) == 0
    assert (path.read_bytes(), layer.read_bytes()) == before
    known = VisualMap.load(path)
    assert len(known) == 24
    assert known.heading is not None
    results = json.loads((tmp_path / "evaluation/mapping-thumbnail-sample/results.json").read_text())
    assert results["measures"]["mapping"]["frames"] == 12


def test_no_command_takes_settings_from_a_run_that_was_not_named(manifest, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs/demo").mkdir(parents=True)
    record = {"format": "siamloc-run", "version": 2, "settings": {"data": {"kind": "manifest"}}, "written": []}
    (tmp_path / "runs/demo/run.json").write_text(json.dumps(record))
    assert main(["evaluate", "descriptor=hog", "data=freiburg_sim"]) == 2
    assert "data/freiburg_like" in capsys.readouterr().err
    for command in ("map", "evaluate", "export"):
        assert main([command]) == 2
        assert "no run is named: give run=FOLDER, such as run=runs/demo" in capsys.readouterr().err
    given = words(manifest, "descriptor=thumbnail", "data.name=flat", "task.baselines=[]", "task.plots=false")
    assert main(["evaluate", *given]) == 0
    assert f"data: flat, {manifest}" in capsys.readouterr().out
    results = json.loads((tmp_path / "runs/flat/thumbnail/evaluation/thumbnail/results.json").read_text())
    assert results["data"]["queries"]["manifest"] == str(manifest)
    assert results["data"]["queries"]["name"] == "flat"


def test_other_data_on_the_command_line_win_or_are_refused(manifest, tmp_path, capsys):
    given = words(manifest, "descriptor=thumbnail", f"run={tmp_path / 'run'}")
    assert main(["map", *given]) == 0
    other = write_manifest(tmp_path / "other", {"first": "cloudy", "second": "cloudy"}, frames_per_room=2)
    quick = ["task.baselines=[]", "task.plots=false"]
    named = ["evaluate", "descriptor=thumbnail", f"run={tmp_path / 'run'}", "protocol.query.sequences=[second]", *quick]
    assert main(named) == 0
    assert str(manifest) in capsys.readouterr().out
    other_data = ["data=manifest", f"data.manifest={other}", "data.image_size=[32,128]", "overwrite=true"]
    assert main([*named, *other_data]) == 2
    assert "24 of the map's 24 frames are not in the data" in capsys.readouterr().err


TRAIN = ["model/branch=simple1", "epochs=1", "batch_size=8", "protocol.train.sequences=[first]"]


def test_people_s_files_are_never_removed(manifest, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mine = tmp_path / "checkpoints" / "thesis.txt"
    mine.parent.mkdir()
    mine.write_text("years of work")
    for run in ("run=", "run=.", f"run={tmp_path}"):
        for more in ([], ["overwrite=true"]):
            assert main(["train", *words(manifest), *TRAIN, run, *more]) == 2
            said = capsys.readouterr().err.splitlines()
            error = said[-1]  # before it, images may have been decoded
            assert [line for line in said if line.startswith("siamloc: ")] == [error]
            assert (
                "run must be the name of a folder" if run == "run=" else "is not a run and holds other files"
            ) in error
    assert mine.read_text() == "years of work"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["checkpoints", "thesis.txt"]


@pytest.mark.parametrize(
    ("name", "content"),
    [("run.json", {"format": "siamloc-run", "version": 1, "settings": {}}), ("run.json", {"overrides": ["data=cold"]})],
)
def test_runs_of_version_0_1_are_refused(tmp_path, capsys, name, content):
    (tmp_path / name).write_text(json.dumps(content))
    for command in ("map", "evaluate", "export"):
        assert main([command, f"run={tmp_path}"]) == 2
        error = capsys.readouterr().err
        assert "run.json" in error
        assert error.count("\n") == 1


@pytest.mark.parametrize("version", [1, 2])
def test_bundles_of_version_0_1_are_refused(tmp_path, capsys, version):
    (tmp_path / "bundle.json").write_text(json.dumps({"format": "siamloc-bundle", "version": version}))
    (tmp_path / "photo.png").write_bytes(b"")
    assert main(["localize", f"bundle={tmp_path}", f"images=[{tmp_path / 'photo.png'}]"]) == 2
    error = capsys.readouterr().err
    assert f"has format version {version}" in error
    assert "export again" in error


def test_stopping_a_training_says_how_to_go_on_once(manifest, tmp_path, capsys, monkeypatch):
    def stopped(*arguments, **keywords):
        print("stopped after 1 of 2 epochs: go on with resume=true", file=sys.stderr)
        raise KeyboardInterrupt("stopped after 1 of 2 epochs: go on with resume=true")

    monkeypatch.setattr("siamloc.training.fit", stopped)
    assert main(["train", *words(manifest), *TRAIN, f"run={tmp_path / 'run'}"]) == 130
    error = capsys.readouterr().err.splitlines()
    assert [line for line in error if "stopped" in line or "interrupted" in line] == [
        "stopped after 1 of 2 epochs: go on with resume=true"
    ]


def complete(line, folder):
    """Return what bash offers after a line, by the script that users load."""
    script = f"""
eval "$(siamloc completion bash)"
COMP_LINE='{line}'; COMP_POINT={len(line)}
_siamloc
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    (folder / "siamloc").write_text(f'#!/bin/sh\nexec {sys.executable} -m siamloc "$@"\n')
    (folder / "siamloc").chmod(0o755)
    path = f"{folder}:{os.environ['PATH']}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, env={**os.environ, "PATH": path})
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")[:-1]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("siamloc tr", ["train "]),
        ("siamloc augment ", ["expand ", "preview "]),
        ("siamloc train data=", ["cold", "folder", "freiburg_sim", "manifest"]),
        ("siamloc train data=folder pairs.l", ["pairs.label="]),
        ("siamloc map model/he", ["model/head="]),
    ],
)
def test_the_tab_key_completes(tmp_path, line, offered):
    assert complete(line, tmp_path) == offered


def test_completion_of_an_unknown_shell_names_the_known_ones(capsys):
    assert main(["completion", "bush"]) == 2
    assert "did you mean 'bash'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["train", "evaluate", "augment expand", "demo"])
def test_the_help_names_every_key(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    shown = capsys.readouterr().out.split()
    for group, (options, keys) in keys_of(job_of(command)).items():
        assert group.split()[0] in shown or f"{group}=" in shown
        assert {*options, *keys} <= set(shown)
    if command in ("train", "evaluate"):
        assert {"data=", "cold", "freiburg_sim", "data.manifest", "data.root", "protocol.leave_one_out"} <= set(shown)
        assert ("loss.margin" in shown, "build.omega" in shown) == (command == "train", command == "evaluate")


def test_a_training_is_looked_at_by_a_key_and_stops_by_one(manifest, tmp_path, capsys):
    given = ["train", *words(manifest), *TRAIN, f"run={tmp_path / 'run'}"]
    assert main([*given, "debug=one_batch"]) == 0
    said = capsys.readouterr()
    assert "one batch, nothing is kept" in said.err
    assert "checkpoint" not in said.out
    assert not (tmp_path / "run").exists()
    assert main([*given, "debug=on"]) == 2
    assert "debug must be overfit or one_batch or profile, or null" in capsys.readouterr().err
    assert main([*given, "patience=2"]) == 2
    assert "patience=2 counts epochs without a better validation" in capsys.readouterr().err
    assert main([*given, "checkpoint_every=0"]) == 2
    assert "checkpoint_every must be a whole number from 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["train", "--resolve"], "add --cfg job"),
        (["report", "runs=[]"], "runs=[] names no run"),
        (["demo", "run={file}", "data={data}"], "is a file: choose a new or empty folder as run="),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_written(given, says, tmp_path, capsys):
    file, data = tmp_path / "file", tmp_path / "data"
    file.write_text("mine")
    assert main([word.format(file=file, data=data) for word in given]) == 2
    assert says in capsys.readouterr().err
    assert not data.exists()


def test_results_of_other_queries_are_not_replaced_in_silence(manifest, tmp_path, capsys):
    given = ["evaluate", *words(manifest, "descriptor=thumbnail", f"run={tmp_path / 'run'}", "task.plots=false")]
    path = tmp_path / "run/evaluation/thumbnail/results.json"
    assert main(given) == 0
    assert main(given) == 0  # the same again
    before = path.read_bytes()
    other = [*given, "protocol.query.every=2"]
    capsys.readouterr()
    assert main(other) == 2
    assert "holds results of other frames (protocol.query)" in capsys.readouterr().err
    assert path.read_bytes() == before
    copied = tmp_path / "copied"
    shutil.copytree(manifest.parent, copied)
    assert main([word.replace(str(manifest.parent), str(copied)) for word in given]) == 2
    assert "holds results of other frames (data)" in capsys.readouterr().err
    assert main([*given, "protocol.validation.sequences=[first]"]) == 0  # the same queries in the same map
    before = path.read_bytes()
    assert main([*other, f"out={tmp_path / 'half'}"]) == 0
    assert path.read_bytes() == before
    assert (tmp_path / "half/results.json").is_file()
    assert main([*given, f"out={tmp_path / 'half'}"]) == 2
    assert "holds results already: choose another out=" in capsys.readouterr().err
    swept = [word for word in given if not word.startswith("descriptor")]
    assert main([*swept, "-m", "descriptor=thumbnail,hog", f"out={tmp_path / 'both'}"]) == 0
    assert len(list((tmp_path / "both").glob("*/results.json"))) == 2
    assert main([*other, "overwrite=true"]) == 0
    assert path.read_bytes() != before
    path.write_bytes(before[:100])  # cut short: nothing to lose
    assert main(given) == 0
