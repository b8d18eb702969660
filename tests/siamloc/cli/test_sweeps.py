"""Sweeps through the command line: jobs have their own folders, folders of sweeps are accepted, the best is named."""

import csv
import itertools
import shutil
import sys

import pytest

import siamloc
from siamloc.cli import main
from siamloc.maps import VisualMap
from siamloc.results import read_results
from siamloc.runs import Run, runs_in
from siamloc.training.run_folder import stopped
from tests.siamloc.cli.commands import QUICK, SMALL, done, refused

BINS, DISTANCES = (8, 16), ("euclidean", "correlation")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Make an empty folder the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def swept(words, tmp_path_factory):
    """Evaluate one descriptor with several parameters and distances once; the tests inspect the output."""
    run = tmp_path_factory.mktemp("swept") / "run"
    given = [*words, "descriptor=hog", *QUICK, f"run={run}"]
    done("evaluate", "-m", *given, "descriptor.bins=8,16", "distance=euclidean,correlation")
    return run


def train(data, run):
    roles = ["protocol.train.sequences=[first]", "protocol.query.sequences=[second]"]
    return ["train", "-m", "data=manifest", *data, *SMALL, *roles, "pairs=room", "epochs=1", "seed=0,1", f"run={run}"]


@pytest.fixture(scope="module")
def seeds(data, tmp_path_factory):
    """Train two seeds of a small network."""
    sweep = tmp_path_factory.mktemp("seeds") / "sweep"
    done(*train(data, sweep))
    return sweep


def test_each_evaluation_of_a_sweep_has_a_folder_of_its_own(swept):
    found = {path.parent.relative_to(swept).as_posix() for path in swept.rglob("results.json")}
    assert found == {f"evaluation/hog-{name}/descriptor.bins-{bins}" for name in DISTANCES for bins in BINS}
    for name, bins in itertools.product(DISTANCES, BINS):
        folder = swept / "evaluation" / f"hog-{name}" / f"descriptor.bins-{bins}"
        results = read_results(folder)
        assert results["swept"] == {"descriptor.bins": bins, "distance": name}
        assert (results["descriptor"]["bins"], results["distance"]) == (bins, name)
        assert results["name"] == f"hog-{name} descriptor.bins={bins}"
        assert (folder / "queries.csv").is_file()


def test_a_job_of_a_sweep_gives_what_the_same_command_gives_alone(swept, here, words):
    plain = ["descriptor=hog", *QUICK, "run=alone"]
    done("evaluate", *words, *plain, "descriptor.bins=8", "distance=correlation")
    alone = siamloc.evaluation.Result.load("alone/evaluation/hog-correlation")
    job = siamloc.evaluation.Result.load(swept / "evaluation/hog-correlation/descriptor.bins-8")
    assert job.parts == alone.parts
    assert "swept" not in alone.about


def test_where_the_name_says_what_is_swept_nothing_is_added(here, words):
    done("evaluate", "-m", *words, "descriptor=hog,fs", *QUICK, "run=run")
    assert all((Run("run").evaluation(name) / "results.json").is_file() for name in ("hog", "fs"))
    labelled = ["descriptor=hog,fs", "+descriptor.label=same", *QUICK]
    done("evaluate", "-m", *words, *labelled, "run=run")  # the label hides what is swept
    found = sorted(path.parent.name for path in Run("run").evaluation("same").glob("*/results.json"))
    assert found == ["descriptor-fs", "descriptor-hog"]


def test_maps_of_a_sweep_lie_apart_and_are_found_by_an_evaluation(here, words, capfd):
    given = [*words, "descriptor=hog", "descriptor.bins=8,16", "run=run"]
    done("map", "-m", *given, "build=sample", "build.nodes=2")
    for bins in BINS:
        known = VisualMap.load(Run("run").evaluation("hog") / f"descriptor.bins-{bins}" / "map.npz")
        assert known.identity["bins"] == bins
        layer = Run("run").layer("hog", "sample") / f"descriptor.bins-{bins}" / "layer.npz"
        assert len(siamloc.maps.CoarseLayer.load(layer)) == 2
    capfd.readouterr()
    done("evaluate", "-m", *given, "distance=euclidean,correlation", *QUICK)
    assert "describing the map" not in capfd.readouterr().err, "the saved maps were searched"


def test_layers_are_shared_by_jobs_that_search_them_differently(here, words):
    given = ["descriptor=hog", "task=hierarchical", "build=sample", "build.nodes=3", "task.plots=false", "run=run"]
    done("evaluate", "-m", *words, *given, "task.candidates=1,2")
    assert [path.parent.name for path in Run("run").folder.glob("layers/**/layer.npz")] == ["hog-sample"]
    results = sorted(path.parent.name for path in Run("run").folder.rglob("results.json"))
    assert results == ["task.candidates-1", "task.candidates-2"]


def test_a_map_that_was_made_for_one_setting_stands_in_no_sweeps_way(here, words):
    plain = [*QUICK, "descriptor=hog", "run=run"]
    done("map", *words, "descriptor=hog", "run=run")
    done("evaluate", "-m", *words, *plain, "descriptor.bins=8,16", "protocol.map.every=1,2")
    counts = {
        path.parent.name: read_results(path.parent)["denominators"]["map_frames"]
        for path in Run("run").folder.rglob("results.json")
    }
    assert counts == {
        f"descriptor.bins-{bins}_protocol.map.every-{every}": 24 // every for bins in BINS for every in (1, 2)
    }


def test_a_sweep_ends_with_the_first_job_that_fails_in_one_sentence(here, words, capsys):
    swept = ["map", "-m", *words, "run=run", "descriptor=thumbnail", "data.manifest=none.csv,neither.csv"]
    assert main(swept) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("siamloc: ")
    assert "none.csv" in lines[0]
    assert lines[0].endswith("(at data.manifest=none.csv, which ended the sweep; jobs not run: 1)")


def test_stopping_a_sweep_says_how_to_go_on_with_it(data, here, capsys, monkeypatch):
    def fit(*arguments, run, **keywords):
        if run.name == "seed-1":
            raise stopped(Run(run), "after 0 of 1 epochs")
        return Run(run)

    monkeypatch.setattr("siamloc.training.fit", fit)
    assert main(["seed=0,1,2,3" if word == "seed=0,1" else word for word in train(data, "sweep")]) == 130
    assert capsys.readouterr().err.endswith(
        "stopped after 0 of 1 epochs: go on with the same command and resume=true\n"
    )


@pytest.mark.slow
def test_an_interrupted_sweep_goes_on(seeds, data, here, capsys):
    shutil.copytree(seeds / "seed-0", here / "sweep" / "seed-0")
    before = (here / "sweep" / "seed-0" / "checkpoints" / "last.ckpt").read_bytes()
    assert "holds a run already" in refused(capsys, *train(data, here / "sweep"))
    done(*train(data, here / "sweep"), "resume=true")
    assert (here / "sweep" / "seed-0" / "checkpoints" / "last.ckpt").read_bytes() == before
    assert (here / "sweep" / "seed-1" / "checkpoints" / "last.ckpt").is_file()
    alone = [word for word in train(data, here / "alone") if word not in ("-m", "seed=0,1")]
    assert "there is no run to resume" in refused(capsys, *alone, "resume=true")


@pytest.mark.slow
def test_map_evaluate_and_report_take_the_folder_of_a_sweep(seeds, capsys):
    done("map", f"run={seeds}")
    assert capsys.readouterr().out.count("next: ") == 2
    runs = runs_in(seeds)
    assert [run.folder.name for run in runs] == ["seed-0", "seed-1"]
    assert all(run.map.is_file() for run in runs)
    done("evaluate", "-m", f"run={seeds}", *QUICK, "distance=null,cosine")
    found = {path.parent.relative_to(seeds).as_posix() for path in seeds.rglob("results.json")}
    names = ("network", "network-cosine")
    assert found == {f"{run.folder.name}/evaluation/{name}" for run in runs for name in names}
    done("report", f"run={seeds}")
    page = (seeds / "report.html").read_text(encoding="utf-8")
    assert all(f"{run.folder.name} · network" in page for run in runs)
    capsys.readouterr()
    done("compare", f"runs={seeds}", "by=train/loss", f"out={seeds / 'losses.csv'}")
    assert f"siamloc compare runs={seeds} by=error" in capsys.readouterr().out
    assert (seeds / "losses.png").is_file()
    done("compare", f"runs={seeds}", "by=error")
    shown = capsys.readouterr().out
    assert shown.split("\n")[0].split()[:3] == ["distance", "seed", "error"]
    assert "best: distance=" in shown
    assert (seeds / "evaluations.csv").is_file()
    assert (seeds / "evaluations.png").is_file()


def test_a_run_that_fails_stops_no_other(seeds, tmp_path, capsys):
    (tmp_path / "sweep" / "broken").mkdir(parents=True)
    (tmp_path / "sweep" / "broken" / "run.json").write_text("{}")
    (tmp_path / "sweep" / "good").symlink_to(seeds / "seed-0", target_is_directory=True)
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
    swept_settings = {(int(row["descriptor.bins"]), row["distance"]) for row in table}
    assert swept_settings == {(bins, name) for bins in BINS for name in DISTANCES}
    assert (tmp_path / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_a_report_shows_the_evaluations_of_a_sweep(swept, tmp_path):
    done("report", f"run={swept}", f"out={tmp_path / 'all.html'}")
    done("report", f"run={swept / 'evaluation' / 'hog-euclidean'}", f"out={tmp_path / 'some.html'}")
    every, some = ((tmp_path / f"{name}.html").read_text(encoding="utf-8") for name in ("all", "some"))
    for name, bins in itertools.product(DISTANCES, BINS):
        assert f"hog-{name} descriptor.bins={bins}" in every
        assert (f"hog-{name} descriptor.bins={bins}" in some) == (name == "euclidean")
    folders = [swept / "evaluation" / f"hog-{name}" / "descriptor.bins-8" for name in DISTANCES]
    done("report", "-m", f"run={','.join(map(str, folders))}", f"out={tmp_path / 'page.html'}")
    assert len(list(tmp_path.glob("page-run-*.html"))) == 2


def test_mistakes_in_comparisons_are_one_sentence(swept, tmp_path, capsys):
    assert "did you mean 'recall@1'" in refused(capsys, "compare", f"runs={swept}", "by=recall")
    assert f"{tmp_path} holds neither runs nor evaluations" in refused(capsys, "compare", f"runs={tmp_path}")


def test_a_sweep_of_evaluations_leaves_the_notes_of_the_trainings_alone(seeds):
    before = (seeds / "multirun.yaml").read_bytes()
    assert b"seed=0,1" in before
    done("evaluate", "-m", f"run={seeds}", "distance=cosine", *QUICK)
    assert (seeds / "multirun.yaml").read_bytes() == before


def test_long_words_make_names_that_file_systems_take(here, words):
    given = ["descriptor=hog", *QUICK, "run=run"]
    one, other = (f"[{','.join(['dark'] * count)}]" for count in (80, 81))
    done("evaluate", "-m", *words, *given, f"protocol.query.sequences={one},{other}")
    assert len(list(Run("run").evaluation("hog").glob("*/results.json"))) == 2


def test_data_that_have_moved_are_named_by_their_keys(here, capsys):
    settings = {"data": {"kind": "cold", "root": "moved"}, "model": {"branch": "simple1", "head": "gem"}}
    Run("sweep/seed-0").start(settings, [])
    says = "moved is not a folder: give data.root=FOLDER, or one list as data.places=FILE"
    assert refused(capsys, "map", "descriptor=hog", "run=sweep/seed-0").startswith(f"siamloc: {says}")
    assert main(["map", "descriptor=hog", "run=sweep"]) == 2
    assert capsys.readouterr().err.count(says) == 2


@pytest.mark.slow
def test_joblib_trains_the_jobs_of_a_sweep_side_by_side(here, data):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="the extra `sweeps` is not installed")
    done(*train(data, "runs/sweep"), "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert sorted(path.parent.name for path in here.glob("runs/sweep/*/run.json")) == ["seed-0", "seed-1"]
    assert sorted(path.name for path in here.iterdir()) == ["runs"]


def test_a_sweep_over_a_branch_of_ones_own_and_another_is_mapped_at_once(data, here, monkeypatch, capsys):
    code = "from torch import nn\ndef factory():\n    return nn.Conv2d(3, 4, 5, stride=4)\n"
    (here / "swept_branches.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(here)
    given = [word for word in train(data, here / "sweep") if not word.startswith(("seed=", "model"))]
    done(*given, "model/branch=swept_branches:factory,simple1", "model/head=gem")
    for key, name in (("model/branch", "%s"), ("model/branch", '"%s"'), ("model.branch.name", "%s")):
        monkeypatch.delitem(sys.modules, "swept_branches")
        done("map", f"run={here / 'sweep'}", f"{key}={name % 'swept_branches:factory'}")
        assert [run.map.is_file() for run in runs_in(here / "sweep")] == [True, True]
        for run in runs_in(here / "sweep"):
            run.map.unlink()
    given = "map", f"run={here / 'sweep'}", "model/branch=swept_branches:other"
    assert "has this branch: leave it out" in refused(capsys, *given)


def test_swept_folders_may_have_any_letters_and_lie_at_home(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    for folder, path in ("runs/hög", "runs/hög"), ("~/hog", tmp_path / "hog"):
        says = f"there is no folder {path}: name that of a sweep"
        assert says in refused(capsys, "compare", "-m", f"runs={folder},runs/a")
