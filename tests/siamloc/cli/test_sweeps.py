"""Sweeps through the command line: jobs have their own folders, folders of sweeps are accepted, the best is named."""

import csv
import json
from pathlib import Path

import pytest

import siamloc
from siamloc.cli import main
from siamloc.maps import VisualMap
from siamloc.training import Run
from tests.drawn import write_manifest

BINS, DISTANCES = (8, 16), ("euclidean", "correlation")


def done(*words):
    assert main([str(word) for word in words]) == 0, words


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    return write_manifest(tmp_path_factory.mktemp("flat"), {"day": "cloudy", "again": "cloudy", "dark": "night"})


@pytest.fixture(scope="module")
def data(flat):
    return ["data=manifest", f"data.manifest={flat}", "data.image_size=[32,128]", f"data.cache={flat.parent / 'cache'}"]


@pytest.fixture
def words(data, tmp_path, monkeypatch):
    """Name data and roles of a command, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return [*data, "protocol.map.sequences=[day]", "protocol.query.sequences=[again,dark]"]


@pytest.fixture(scope="module")
def swept(data, tmp_path_factory):
    """Evaluate one descriptor with several parameters and distances once; the tests inspect the output."""
    run = tmp_path_factory.mktemp("swept") / "run"
    roles = ["protocol.map.sequences=[day]", "protocol.query.sequences=[again,dark]"]
    given = [*data, *roles, "descriptor=hog", "task.plots=false", "task.baselines=[]", f"run={run}"]
    done("evaluate", "-m", *given, "descriptor.bins=8,16", "distance=euclidean,correlation")
    return run


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """Train two seeds of a small network."""
    sweep = tmp_path_factory.mktemp("trained") / "sweep"
    done(
        *["train", "-m", *data, "model/branch=simple1", "model/head=fc500_500_5", "pairs=room", "epochs=1"],
        *["protocol.train.sequences=[day]", "protocol.query.sequences=[again]", "batch_size=8"],
        *["trainer.accelerator=cpu", "seed=0,1", f"run={sweep}"],
    )
    return sweep


def test_each_evaluation_of_a_sweep_has_a_folder_of_its_own(swept):
    found = {path.parent.relative_to(swept).as_posix() for path in swept.rglob("results.json")}
    assert found == {f"evaluation/hog-{name}/descriptor.bins-{bins}" for name in DISTANCES for bins in BINS}
    for name in DISTANCES:
        for bins in BINS:
            folder = swept / "evaluation" / f"hog-{name}" / f"descriptor.bins-{bins}"
            results = json.loads((folder / "results.json").read_text())
            assert results["swept"] == {"descriptor.bins": bins, "distance": name}
            assert (results["descriptor"]["bins"], results["distance"]) == (bins, name)
            assert results["name"] == f"hog-{name} descriptor.bins={bins}"
            assert (folder / "queries.csv").is_file()


def test_a_job_of_a_sweep_gives_what_the_same_command_gives_alone(swept, words):
    plain = ["descriptor=hog", "task.plots=false", "task.baselines=[]", "run=alone"]
    done("evaluate", *words, *plain, "descriptor.bins=8", "distance=correlation")
    alone = siamloc.evaluation.Result.load("alone/evaluation/hog-correlation")
    job = siamloc.evaluation.Result.load(swept / "evaluation/hog-correlation/descriptor.bins-8")
    assert job.parts == alone.parts
    assert "swept" not in alone.about


def test_where_the_name_says_what_is_swept_nothing_is_added(words):
    done("evaluate", "-m", *words, "descriptor=hog,fs", "task.plots=false", "task.baselines=[]", "run=run")
    assert all((Run("run").evaluation(name) / "results.json").is_file() for name in ("hog", "fs"))
    labelled = ["descriptor=hog,fs", "+descriptor.label=same", "task.plots=false", "task.baselines=[]"]
    done("evaluate", "-m", *words, *labelled, "run=run")  # the label hides what is swept
    found = sorted(path.parent.name for path in Run("run").evaluation("same").glob("*/results.json"))
    assert found == ["descriptor-fs", "descriptor-hog"]


def test_maps_of_a_sweep_lie_apart_and_are_found_by_an_evaluation(words, capfd):
    given = [*words, "descriptor=hog", "descriptor.bins=8,16", "run=run"]
    done("map", "-m", *given, "build=sample", "build.nodes=2")
    for bins in BINS:
        known = VisualMap.load(Run("run").evaluation("hog") / f"descriptor.bins-{bins}" / "map.npz")
        assert known.identity["bins"] == bins
        layer = Run("run").layer("hog", "sample") / f"descriptor.bins-{bins}" / "layer.npz"
        assert len(siamloc.maps.CoarseLayer.load(layer)) == 2
    capfd.readouterr()
    plain = ["task.plots=false", "task.baselines=[]"]
    done("evaluate", "-m", *given, "distance=euclidean,correlation", *plain)
    assert "describing the map" not in capfd.readouterr().err, "the saved maps were searched"


def test_layers_are_shared_by_jobs_that_search_them_differently(words):
    given = ["descriptor=hog", "task=hierarchical", "build=sample", "build.nodes=3", "task.plots=false", "run=run"]
    done("evaluate", "-m", *words, *given, "task.candidates=1,2")
    assert [path.parent.name for path in Run("run").folder.glob("layers/**/layer.npz")] == ["hog-sample"]
    results = sorted(path.parent.name for path in Run("run").folder.rglob("results.json"))
    assert results == ["task.candidates-1", "task.candidates-2"]


def test_a_map_that_was_made_for_one_setting_stands_in_no_sweeps_way(words):
    plain = ["task.plots=false", "task.baselines=[]", "descriptor=hog", "run=run"]
    done("map", *words, "descriptor=hog", "run=run")
    done("evaluate", "-m", *words, *plain, "descriptor.bins=8,16", "protocol.map.every=1,2")
    counts = {
        path.parent.name: json.loads(path.read_text())["denominators"]["map_frames"]
        for path in Run("run").folder.rglob("results.json")
    }
    assert counts == {
        f"descriptor.bins-{bins}_protocol.map.every-{every}": 18 // every for bins in BINS for every in (1, 2)
    }


@pytest.mark.slow
def test_map_evaluate_and_report_take_the_folder_of_a_sweep(trained, capsys):
    done("map", f"run={trained}")
    assert capsys.readouterr().out.count("next: ") == 2
    runs = siamloc.runs.runs_in(trained)
    assert [run.folder.name for run in runs] == ["seed-0", "seed-1"]
    assert all(run.map.is_file() for run in runs)
    done("evaluate", "-m", f"run={trained}", "task.plots=false", "task.baselines=[]", "distance=null,cosine")
    found = {path.parent.relative_to(trained).as_posix() for path in trained.rglob("results.json")}
    names = ("network", "network-cosine")
    assert found == {f"{run.folder.name}/evaluation/{name}" for run in runs for name in names}
    done("report", f"run={trained}")
    page = (trained / "report.html").read_text(encoding="utf-8")
    assert all(f"{run.folder.name} · network" in page for run in runs)
    capsys.readouterr()
    done("compare", f"runs={trained}", "by=train/loss", f"out={trained / 'losses.csv'}")
    assert f"siamloc compare runs={trained} by=error" in capsys.readouterr().out
    assert (trained / "losses.png").is_file()
    done("compare", f"runs={trained}", "by=error")
    shown = capsys.readouterr().out
    assert shown.split("\n")[0].split()[:3] == ["distance", "seed", "error"]
    assert "best: distance=" in shown
    assert (trained / "evaluations.csv").is_file()
    assert (trained / "evaluations.png").is_file()


def test_a_run_that_fails_stops_no_other(trained, tmp_path, capsys):
    (tmp_path / "sweep" / "broken").mkdir(parents=True)
    (tmp_path / "sweep" / "broken" / "run.json").write_text("{}")
    (tmp_path / "sweep" / "good").symlink_to(trained / "seed-0", target_is_directory=True)
    assert main(["map", f"run={tmp_path / 'sweep'}"]) == 2
    shown = capsys.readouterr()
    assert "1 of 2 runs failed, the first is" in shown.err
    assert "run 2 of 2" in shown.out
    assert "map: " in shown.out


def test_the_table_of_a_sweep_names_the_best(swept, tmp_path, capsys):
    done("compare", f"runs={swept}", "by=recall@1", f"out={tmp_path / 'sweep.png'}")
    shown = capsys.readouterr().out.split("\n")
    assert shown[0].split()[:3] == ["descriptor.bins", "distance", "recall@1_0.25"]
    assert any(line.startswith("best: descriptor.bins=") for line in shown)
    with (tmp_path / "sweep.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    recalls = [float(row["recall@1_0.25"]) for row in table]
    assert recalls == sorted(recalls, reverse=True)
    assert {(int(row["descriptor.bins"]), row["distance"]) for row in table} == {
        (bins, name) for bins in BINS for name in DISTANCES
    }
    for row in table:
        held = json.loads((Path(row["folder"]) / "results.json").read_text())["measures"]["absolute"]
        assert float(row["error"]) == held["overall"]["error"]["mean"]
        assert float(row["error.night"]) == held["lighting"]["night"]["error"]["mean"]
        assert float(row["hit_rate"]) == held["overall"]["hit_rate"][0]["rate"]
    assert (tmp_path / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_a_report_shows_the_evaluations_of_a_sweep(swept, tmp_path):
    done("report", f"run={swept}", f"out={tmp_path / 'all.html'}")
    done("report", f"run={swept / 'evaluation' / 'hog-euclidean'}", f"out={tmp_path / 'some.html'}")
    every, some = ((tmp_path / f"{name}.html").read_text(encoding="utf-8") for name in ("all", "some"))
    for name in DISTANCES:
        for bins in BINS:
            assert f"hog-{name} descriptor.bins={bins}" in every
            assert (f"hog-{name} descriptor.bins={bins}" in some) == (name == "euclidean")


def test_reports_of_a_sweep_lie_apart(swept, tmp_path):
    folders = [swept / "evaluation" / f"hog-{name}" / "descriptor.bins-8" for name in DISTANCES]
    done("report", "-m", f"run={','.join(map(str, folders))}", f"out={tmp_path / 'page.html'}")
    assert len(list(tmp_path.glob("page-run-*.html"))) == 2


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["by=eror"], "did you mean 'error'"),
        (["by=recall"], "did you mean 'recall@1'"),
        (["by=absolute.overall.eror.median"], "did you mean 'absolute.overall.error.median'"),
    ],
)
def test_an_unknown_measure_is_answered_with_the_nearest(swept, capsys, given, sentence):
    assert main(["compare", f"runs={swept}", *given]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_a_folder_without_results_is_named(tmp_path, capsys):
    assert main(["compare", f"runs={tmp_path}"]) == 2
    assert f"{tmp_path} holds neither runs nor evaluations" in capsys.readouterr().err
    assert main(["compare", f"runs={tmp_path / 'nowhere'}"]) == 2
    assert "there is no folder" in capsys.readouterr().err


def test_a_sweep_of_evaluations_leaves_the_notes_of_the_trainings_alone(trained):
    before = (trained / "multirun.yaml").read_bytes()
    assert b"seed=0,1" in before
    done("evaluate", "-m", f"run={trained}", "distance=cosine", "task.plots=false", "task.baselines=[]")
    assert (trained / "multirun.yaml").read_bytes() == before


def test_long_words_make_names_that_file_systems_take(words):
    given = ["descriptor=hog", "task.plots=false", "task.baselines=[]", "run=run"]
    one, other = (f"[{','.join(['dark'] * count)}]" for count in (80, 81))
    done("evaluate", "-m", *words, *given, f"protocol.query.sequences={one},{other}")
    assert len(list(Run("run").evaluation("hog").glob("*/results.json"))) == 2
