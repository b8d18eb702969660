"""The main task through the command line, on a drawn flat."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from siamloc.cli import main
from tests.drawn import write_manifest

MODEL = ["model/branch=simple1", "model/head=fc500_500_5", "data.image_size=[32,128]"]


def siamloc(*words):
    status = main([str(word) for word in words])
    assert status == 0, f"siamloc {' '.join(map(str, words))} returned {status}"


def curve(run):
    with (run / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """Return a manifest whose images are decoded already: which test comes first must not matter."""
    folder = tmp_path_factory.mktemp("flat")
    made = write_manifest(folder, {"cloudy1": "cloudy", "cloudy2": "cloudy", "night1": "night"}, frames_per_room=8)
    siamloc("prepare", "data=manifest", f"data.manifest={made}", f"data.cache={folder / 'cache'}", MODEL[-1])
    return made


@pytest.fixture
def train_words(flat, tmp_path):
    return [
        "train",
        "data=manifest",
        f"data.manifest={flat}",
        f"data.cache={flat.parent / 'cache'}",
        *MODEL,
        "pairs=room",
        "protocol.train.sequences=[cloudy1]",
        "protocol.query.sequences=[cloudy2]",
        "batch_size=8",
        "trainer.accelerator=cpu",
    ]


@pytest.fixture(scope="module")
def finished(flat, tmp_path_factory):
    """Train, map, evaluate, export and localize once; the tests inspect the output."""
    folder = tmp_path_factory.mktemp("job")
    run = folder / "run"
    data = ["data=manifest", f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}"]
    siamloc(
        *["train", *data, *MODEL, "pairs=room", f"run={run}", "epochs=8", "batch_size=8", "trainer.accelerator=cpu"],
        *["protocol.train.sequences=[cloudy1]", "protocol.validation.sequences=[night1]"],
    )
    siamloc("map", f"run={run}")
    siamloc("evaluate", f"run={run}", "protocol.query.sequences=[cloudy2]")
    siamloc("export", f"run={run}")
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    return run


def test_the_job_leaves_what_each_command_promises(finished):
    for name in ("run.json", "metrics.csv", "checkpoints/best.ckpt", "checkpoints/last.ckpt", "map.npz"):
        assert (finished / name).is_file(), name
    evaluation = finished / "evaluation" / "network"
    assert (evaluation / "results.json").is_file()
    assert len(list(evaluation.glob("*.png"))) >= 3
    assert (finished / "bundle" / "model.onnx").is_file()


def test_results_hold_measures_baselines_and_denominators(finished):
    results = json.loads((finished / "evaluation" / "network" / "results.json").read_text())
    absolute = results["measures"]["absolute"]["overall"]
    assert absolute["queries"] == results["denominators"]["queries"] == 24
    assert absolute["error"]["mean"] == pytest.approx(absolute["floor"]["mean"] + absolute["excess"]["mean"])
    assert set(results["baselines"]) == {"thumbnail", "untrained"}
    assert results["baselines"]["thumbnail"]["absolute"]["overall"]["queries"] == 24
    assert results["measures"]["room_pairs"]["overall"]["n_same"] == 3500
    assert results["protocol"] == "cross_run"
    assert results["config"]["protocol"]["query"]["sequences"] == ["cloudy2"]


def test_the_network_learns_the_rooms(finished):
    rooms = json.loads((finished / "evaluation" / "network" / "results.json").read_text())["measures"]
    assert rooms["room_retrieval"]["overall"]["accuracy"] > 0.9


def test_localize_agrees_with_evaluate(finished):
    with (finished / "evaluation" / "network" / "queries.csv").open(newline="") as file:
        queries = {Path(row["path"]).name: row for row in csv.DictReader(file)}
    with (finished / "locations.csv").open(newline="") as file:
        locations = list(csv.DictReader(file))
    assert len(locations) == len(queries) == 24
    same = [row["match"] == queries[Path(row["image"]).name]["match_path"] for row in locations]
    assert np.mean(same) > 0.95, "the exported network differs by rounding only"
    distances = [
        (float(row["distance"]), float(queries[Path(row["image"]).name]["descriptor_distance"])) for row in locations
    ]
    assert np.abs(np.diff(distances, axis=1)).max() < 1e-3


def test_one_seed_gives_one_loss_curve(train_words, tmp_path):
    siamloc(*train_words, f"run={tmp_path / 'a'}", "epochs=2", "seed=0")
    siamloc(*train_words, f"run={tmp_path / 'b'}", "epochs=2", "seed=0")
    siamloc(*train_words, f"run={tmp_path / 'c'}", "epochs=2", "seed=1")
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert curve(tmp_path / "a") != curve(tmp_path / "c")


@pytest.mark.slow
def test_a_killed_run_goes_on_where_its_last_checkpoint_was(train_words, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    words = [*train_words, "epochs=6", "pairs.epoch_pairs=200"]
    siamloc(*words, f"run={whole}")
    command = [sys.executable, "-m", "siamloc", *words, f"run={killed}"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=os.environ)
    last = killed / "checkpoints" / "last.ckpt"
    deadline = time.monotonic() + 120
    while not (killed / "metrics.csv").is_file() or len(curve(killed)) < 2 or not last.is_file():
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = len(curve(killed))
    assert 2 <= done < 6
    siamloc(*words, f"run={killed}", "resume=true")
    assert curve(killed) == curve(whole)


def test_a_run_is_not_written_over_by_accident(train_words, tmp_path, capsys):
    run = tmp_path / "run"
    siamloc(*train_words, f"run={run}", "epochs=1")
    before = curve(run)
    assert main([*train_words, f"run={run}", "epochs=1"]) == 2
    assert "resume=true" in capsys.readouterr().err
    assert curve(run) == before
    siamloc(*train_words, f"run={run}", "epochs=1", "overwrite=true", "seed=3")
    assert curve(run) != before


@pytest.mark.parametrize(
    ("command", "words", "says"),
    [
        ("train", ["protocol.train.sequences=[cloudy9]"], "did you mean 'cloudy"),
        ("train", ["protocol.train.sequences=null"], "protocol.train.sequences is not set"),
        ("train", ["protocol.validation.sequences=[cloudy1]"], "not be honest"),
        ("train", ["pairs.same_room_share=1.5"], "same_room_share"),
        ("train", ["protocol.train.rooms=[office]", "pairs.same_room_share=0.5"], "one room"),
        ("train", ["batch_size=0"], "batch_size"),
        ("train", ["data.image_size=[32]"], "rows, columns"),
        ("train", ["model.branch.weights=/nowhere.pth"], "nowhere.pth"),
        ("train", ["resume=true"], "no run to resume"),
    ],
)
def test_mistakes_in_training_are_one_line(train_words, tmp_path, command, words, says, capsys):
    assert main([*train_words, f"run={tmp_path / 'run'}", *words]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("command", "words", "says"),
    [
        ("evaluate", ["protocol.query.sequences=[cloudy1]", "overwrite=true"], "not be honest"),
        ("evaluate", ["protocol.query.sequences=[cloudy2]", "model/branch=simple2"], "another architecture"),
        ("evaluate", ["protocol.query.sequences=[cloudy2]", "task.baselines=[thumbnale]"], "did you mean 'thumbnail'"),
        ("localize", ["images=[/nowhere.png]"], "no image /nowhere.png"),
        ("localize", [], "no images given"),
        ("map", ["checkpoint=first"], "best or last"),
    ],
)
def test_mistakes_after_training_are_one_line(finished, command, words, says, capsys):
    assert main([command, f"run={finished}", *words]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error


def test_commands_say_which_run_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["map"]) == 2
    assert "train one first" in capsys.readouterr().err
    assert main(["map", "run=nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_a_sweep_gives_each_job_a_folder_of_its_own(train_words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    siamloc(*train_words, "-m", "epochs=1", "seed=0,1", "run=runs/sweep")
    found = sorted(path.parent.name for path in tmp_path.glob("runs/sweep/*/run.json"))
    assert found == ["seed-0", "seed-1"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs"]
    siamloc("compare", "runs=runs/sweep", "by=train/loss", "out=sweep.csv")
    with (tmp_path / "sweep.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert list(table[0]) == ["seed", "train/loss", "epoch", "finished", "run"]
    assert sorted((row["seed"], row["run"]) for row in table) == [
        ("0", "runs/sweep/seed-0"),
        ("1", "runs/sweep/seed-1"),
    ]
    siamloc("map", "run=runs/sweep/seed-1", "projector=true")
    assert (tmp_path / "runs/sweep/seed-1/tensorboard/projector_config.pbtxt").is_file()
    assert (tmp_path / "runs" / "sweep" / "seed-1" / "map.npz").is_file()


def test_analytic_descriptors_need_no_run(flat, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = [f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}", "data.image_size=[32,128]"]
    roles = ["protocol.map.sequences=[cloudy1]", "protocol.query.sequences=[cloudy2,night1]"]
    siamloc("evaluate", "descriptor=thumbnail", *data, *roles, "task.baselines=[]", "task.plots=false")
    results = json.loads((tmp_path / "runs/manifest/thumbnail/evaluation/thumbnail/results.json").read_text())
    assert set(results["measures"]["absolute"]["lighting"]) == {"cloudy", "night"}
    assert "margin" in results["skipped"]["room_pairs"]


def test_a_folder_with_maps_but_no_network_takes_the_only_descriptor_or_says_which(flat, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    data = [f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}", "data.image_size=[32,128]"]
    siamloc("map", "run=runs/robot", "descriptor=hsv", "protocol.map.sequences=[cloudy1]", *data)
    siamloc("evaluate", "run=runs/robot", "protocol.query.sequences=[cloudy2]", "task.plots=false")
    assert (tmp_path / "runs/robot/evaluation/hsv/results.json").is_file()
    page = tmp_path / "newest.html"
    siamloc("report", f"out={page}")  # of the newest run, trained or not
    assert "hsv" in page.read_text()
    siamloc("map", "run=runs/robot", "descriptor=thumbnail", "protocol.map.sequences=[cloudy1]", *data)
    assert main(["evaluate", "run=runs/robot", "protocol.query.sequences=[cloudy2]"]) == 2
    error = capsys.readouterr().err
    assert "robot holds no trained network, only maps by hsv, thumbnail: choose the descriptor, such as desc" in error


def test_a_trained_run_describes_for_another_folder(finished, tmp_path):
    siamloc("evaluate", f"run={finished}", f"descriptor={finished}", "protocol.query.sequences=[cloudy2]")
    words = ["protocol.map.sequences=[cloudy1]", "protocol.query.sequences=[cloudy2]", "task.baselines=[]"]
    siamloc("evaluate", f"run={tmp_path / 'other'}", f"descriptor={finished}", *words)
    first = json.loads((finished / "evaluation/network/results.json").read_text())["measures"]["absolute"]
    second = json.loads((tmp_path / "other/evaluation/network/results.json").read_text())["measures"]["absolute"]
    assert first["overall"]["error"] == second["overall"]["error"]


def copied(run, tmp_path):
    return Path(shutil.copytree(run, tmp_path / "copy"))


def test_a_bundle_never_takes_the_place_of_other_files(finished, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "precious.txt").write_text("keep")
    assert main(["export", f"run={finished}", f"bundle={mine}"]) == 2
    assert "holds other files, such as precious.txt" in capsys.readouterr().err
    assert (mine / "precious.txt").read_text() == "keep"
    siamloc("export", f"run={finished}", f"bundle={tmp_path / 'new'}")
    siamloc("export", f"run={finished}", f"bundle={tmp_path / 'new'}")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["bundle.json", "map.npz", "model.onnx"]


def test_queries_from_the_run_of_the_map_are_refused_whatever_the_roles_say(finished, tmp_path, capsys):
    run = copied(finished, tmp_path)
    siamloc("map", f"run={run}", "protocol.map.sequences=[cloudy2]")
    queries = [f"run={run}", "protocol.query.sequences=[cloudy2]", "overwrite=true"]
    assert main(["evaluate", *queries]) == 2
    assert "not be honest" in capsys.readouterr().err
    siamloc("evaluate", *queries, "protocol.kind=same_run", "task.baselines=[]", "task.plots=false")
    results = json.loads((run / "evaluation" / "network" / "results.json").read_text())
    assert results["protocol"] == "same_run"
    assert results["measures"]["absolute"]["overall"]["error"]["mean"] == 0


def test_the_choice_of_map_frames_is_handed_on_and_not_changed_in_silence(finished, tmp_path, capsys):
    run = copied(finished, tmp_path)
    siamloc("map", f"run={run}", "protocol.map.every=3")
    words = ["protocol.query.sequences=[cloudy2]", "task.baselines=[thumbnail]", "task.plots=false", "overwrite=true"]
    siamloc("evaluate", f"run={run}", *words)
    results = json.loads((run / "evaluation" / "network" / "results.json").read_text())
    assert results["config"]["protocol"]["map"]["every"] == 3
    assert results["denominators"]["map_frames"] == 8
    assert results["baselines"]["thumbnail"]["absolute"]["map_frames"] == 8
    assert main(["evaluate", f"run={run}", *words, "protocol.map.every=4"]) == 2
    assert "run `siamloc map` again" in capsys.readouterr().err


def test_a_map_of_other_preprocessing_is_refused(finished, capsys):
    assert main(["evaluate", f"run={finished}", "unwrap=polar", "protocol.query.sequences=[cloudy2]"]) == 2
    assert "images" in capsys.readouterr().err


def test_a_map_of_an_older_table_is_refused(flat, tmp_path, capsys):
    table = write_manifest(tmp_path / "flat", {"a": "cloudy", "b": "cloudy"}, frames_per_room=3)
    run = tmp_path / "run"
    data = ["data=manifest", f"data.manifest={table}", f"data.cache={tmp_path / 'cache'}", "batch_size=4", "epochs=1"]
    siamloc("train", *data, *MODEL, f"run={run}", "protocol.train.sequences=[a]", "trainer.accelerator=cpu")
    siamloc("map", f"run={run}")
    moved = table.read_text().replace("a/0000.png,1.", "a/0000.png,7.")
    assert moved != table.read_text()
    table.write_text(moved)
    assert main(["evaluate", f"run={run}", "protocol.query.sequences=[b]"]) == 2
    assert "another position or room in the data now" in capsys.readouterr().err


def test_frames_without_pose_or_room_are_left_out_and_counted(flat, finished, tmp_path, capsys):
    rows = flat.read_text().splitlines()
    holes = [row.split(",") for row in rows]
    query = [row for row in holes if row[5] == "cloudy2"]
    query[0][1] = ""
    query[1][4] = query[2][4] = ""
    table = flat.parent / "holes.csv"
    table.write_text("\n".join(",".join(row) for row in holes) + "\n")
    run = copied(finished, tmp_path)
    words = [f"run={run}", f"data.manifest={table}", "protocol.query.sequences=[cloudy2]", "task.plots=false"]
    siamloc("evaluate", *words)
    results = json.loads((run / "evaluation" / "network" / "results.json").read_text())
    assert results["measures"]["absolute"]["overall"]["queries"] == 23
    assert results["measures"]["room_retrieval"]["overall"]["queries"] == 22
    assert results["skipped"]["absolute, queries"] == "1 of 24 queries have no position"
    assert results["skipped"]["room_retrieval, queries"] == "2 of 24 queries have no room label"
    assert main(["evaluate", *words, "data.on_error=raise"]) == 2
    assert "1 of 24 queries have no position" in capsys.readouterr().err


def test_overwriting_begins_only_when_the_new_training_can(train_words, tmp_path, capsys):
    run = tmp_path / "run"
    siamloc(*train_words, f"run={run}", "epochs=1")
    before = curve(run)
    for wrong in ("pairs.same_room_share=7", "trainer.precision=bf", "model.branch.weights=/nowhere.pth"):
        assert main([*train_words, f"run={run}", "overwrite=true", wrong]) == 2
        assert "Traceback" not in capsys.readouterr().err
    assert curve(run) == before
    assert (run / "checkpoints" / "last.ckpt").is_file()


def test_a_failed_start_leaves_no_run_behind(train_words, tmp_path):
    assert main([*train_words, f"run={tmp_path / 'run'}", "trainer.precision=bf"]) == 2
    siamloc(*train_words, f"run={tmp_path / 'run'}", "epochs=1")


def test_resuming_takes_the_settings_over_and_refuses_others(train_words, tmp_path, capsys):
    run = tmp_path / "run"
    siamloc(*train_words, f"run={run}", "epochs=1")
    for other in ("model/branch=simple2", "optimizer.learning_rate=5", "seed=7", "pairs.same_room_share=0.3"):
        assert main([*train_words, f"run={run}", "resume=true", "epochs=2", other]) == 2
        assert "cannot be resumed with" in capsys.readouterr().err
    siamloc("train", f"run={run}", "resume=true", "epochs=2")
    assert len(curve(run)) == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["epochs=abc"], "epochs must be a whole number from 1 to 10 million, got 'abc'"),
        (["batch_size=1.5"], "batch_size must be a whole number"),
        (["optimizer.learning_rate=abc"], "optimizer.learning_rate must be a number above 0"),
        (["seed=null"], "seed must be a whole number from 0 to 4,294,967,295, got None"),
        (["loader.workers=-1"], "loader.workers must be a whole number from 0"),
        (["model.branch=alexnet"], "model/branch=NAME, with a slash"),
        (["trainer.accelerator=quantum"], "the trainer cannot be set up"),
        pytest.param(
            ["trainer.accelerator=gpu"],
            "trainer.accelerator=gpu needs a GPU, and torch finds none here: use auto or cpu",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="with a GPU"),
        ),
        (["+trainer.max_epochs=2"], "trainer.max_epochs is set by siamloc itself"),
        (["photo.jpeg"], "'photo.jpeg' is not of the form key=value"),
        (["run=a (1)"], "in quotes"),
        (["augment=thesys"], "did you mean 'thesis'"),
    ],
)
def test_wrong_values_are_one_line(train_words, words, says, tmp_path, capsys):
    assert main([*train_words, f"run={tmp_path / 'run'}", *words]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["task.radii=3"], "task.radii must be a list"),
        (["task.radii=[abc]"], "task.radii must be a list"),
        (["device=foo"], "device must be auto, cpu or cuda, got 'foo'"),
        (["device=cuda:97"], "torch cannot compute on device='cuda:97' here: use one of auto, cpu"),
        (["data=folder", "data.root=/nowhere", "overwrite=true"], "/nowhere"),
    ],
)
def test_wrong_values_in_evaluation_are_one_line(finished, words, says, capsys):
    assert main(["evaluate", f"run={finished}", "protocol.query.sequences=[cloudy2]", *words]) == 2
    assert says in capsys.readouterr().err


def test_training_with_augmentation(train_words, tmp_path):
    siamloc(*train_words, f"run={tmp_path / 'a'}", "epochs=1", "augment=thesis")
    siamloc(*train_words, f"run={tmp_path / 'b'}", "epochs=1", "augment=thesis", "augment.where=gpu")
    siamloc(*train_words, f"run={tmp_path / 'c'}", "epochs=1")
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert curve(tmp_path / "a") != curve(tmp_path / "c")


@pytest.mark.slow
def test_two_processes_train_on_what_one_would(train_words, tmp_path):
    words = [sys.executable, "-m", "siamloc", *train_words, "epochs=2", "trainer.log_every_n_steps=1"]
    for run, own in {
        "one": ["batch_size=8"],
        "two": ["batch_size=4", "trainer.devices=2", "trainer.strategy=ddp"],
    }.items():
        command = [*words, f"run={tmp_path / run}", *own]
        done = subprocess.run(command, capture_output=True, text=True, timeout=200)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("next: siamloc map") == 1, "one process speaks"
    one, two = curve(tmp_path / "one"), curve(tmp_path / "two")
    assert [row["step"] for row in one] == [row["step"] for row in two]
    for a, b in zip(one, two, strict=True):
        assert float(a["train/loss"]) == pytest.approx(float(b["train/loss"]), rel=1e-3)


@pytest.mark.slow
def test_joblib_trains_the_jobs_of_a_sweep_side_by_side(train_words, tmp_path, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="the extra `sweeps` is not installed")
    monkeypatch.chdir(tmp_path)
    launcher = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    siamloc(*train_words, "-m", *launcher, "epochs=1", "seed=0,1", "run=runs/sweep")
    assert sorted(path.parent.name for path in tmp_path.glob("runs/sweep/*/run.json")) == ["seed-0", "seed-1"]
