"""The single network of [T] table 5.19 through the command line: trained, mapped, evaluated, exported."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc import models
from siamloc.cli import main
from siamloc.evaluation import hierarchy
from siamloc.maps import CoarseLayer
from siamloc.models import as_descriptor
from siamloc.results import read_results, read_rows
from siamloc.runtime import Bundle, Localizer
from tests.drawn import altered, write_manifest

SMALL = ["model/branch=simple1", "model/head=fc500_500_5", "data.image_size=[32,128]", "trainer.accelerator=cpu"]
ROOMS = ["corridor", "kitchen", "office"]


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    drives = {"first": "cloudy", "second": "cloudy", "third": "cloudy"}
    return write_manifest(tmp_path_factory.mktemp("drawn"), drives, frames_per_room=12)


def words(manifest, run, *more):
    roles = [f"protocol.{role}.sequences=[first]" for role in ("train", "map")]
    roles += ["protocol.query.sequences=[second]", "protocol.validation.sequences=[third]"]
    data = [f"data.manifest={manifest}", f"data.cache={manifest.parent / 'store'}", *roles, f"run={run}"]
    return ["train", "experiment=rooms_classifier", *SMALL, *data, "epochs=5", "pairs.epoch_batches=10", *more]


@pytest.fixture(scope="module")
def run(manifest, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "run"
    assert main(words(manifest, folder)) == 0
    assert main(["map", f"run={folder}", "build=rooms"]) == 0
    return folder


@pytest.mark.slow
def test_the_run_resumes_with_its_rooms(manifest, run, tmp_path, capsys):
    assert main(words(manifest, tmp_path / "run", "epochs=2")) == 0
    assert main(["train", f"run={tmp_path / 'run'}", "resume=true", "epochs=3", "trainer.accelerator=cpu"]) == 0
    assert "val/accuracy" in capsys.readouterr().err
    assert models.load(tmp_path / "run").rooms.names.tolist() == ROOMS


@pytest.mark.parametrize("candidates", [1, 3])
def test_rooms_named_by_the_classifier_come_first(run, candidates, capsys):
    given = ["task=hierarchical", "build=rooms", "task.plots=false", f"task.candidates={candidates}"]
    assert main(["evaluate", f"run={run}", *given, "task.coarse.by=classifier"]) == 0
    assert "network-rooms-classifier" in capsys.readouterr().out
    folder = run / "evaluation" / "hierarchical-network-rooms-classifier"
    columns, measures = read_rows(folder), read_results(folder)["measures"]["hierarchical"]
    again = hierarchy.node_measures(columns, measures["radii"], measures["ks"], 36, measures["unit"])
    assert again["overall"]["coarse"] == measures["overall"]["coarse"]
    assert measures["overall"]["coarse"]["accuracy"] > 0.8
    np.testing.assert_array_equal(columns["comparisons"] - columns["frames_compared"], 3)
    layer = CoarseLayer.load(run / "layers" / "network-rooms" / "layer.npz")
    assert layer.classifier.names.tolist() == layer.names.tolist() == ROOMS
    if candidates == 3:
        np.testing.assert_array_equal(columns["error"], columns["error_absolute"])


def test_the_classifier_chooses_rooms_for_another_descriptor(run, capsys):
    given = ["task=hierarchical", "build=rooms", "task.plots=false", "task.candidates=1", "descriptor=hog"]
    assert main(["evaluate", f"run={run}", *given, f"task.coarse.descriptor={run}", "task.coarse.by=classifier"]) == 0
    assert "hog-network-run-rooms-classifier" in capsys.readouterr().out


def test_the_robot_has_the_classifier(manifest, run, tmp_path):
    search = ["task=hierarchical", "build=rooms", "task.coarse.by=classifier", "task.candidates=1"]
    assert main(["export", f"run={run}", f"bundle={tmp_path / 'bundle'}", *search]) == 0
    layer, _ = Bundle.open(tmp_path / "bundle").load_layer()
    assert layer.classifier.names.tolist() == ROOMS
    localizer, trained = Localizer(tmp_path / "bundle"), as_descriptor(models.load(run))
    for number in (0, 17, 30):
        path = manifest.parent / "second" / f"{number:04d}.png"
        panorama = localizer.bundle.preprocessing.panorama(path)
        assert localizer.locate(path).room == trained.classify(panorama).room[0]


@pytest.mark.parametrize(
    ("room", "given", "says"),
    [
        ("", [], "learns to name rooms, and the training frames have no room labels"),
        ("hall", [], "the training frames are all in one room, hall"),
        (None, ["pairs=room"], "loss=cross_entropy does not go with these pairs"),
        (None, ["loss=triplet", "monitor=accuracy"], "monitor=accuracy is the share of frames whose room is named"),
    ],
)
def test_mistakes_are_one_line(manifest, tmp_path, room, given, says, capsys):
    if room is not None:
        manifest = altered(manifest, f"one{room}.csv", lambda row: {"room": room})
    few = [] if given == ["pairs=room"] else ["pairs.epoch_batches=10"]
    listed = [word for word in words(manifest, tmp_path / "run") if word != "pairs.epoch_batches=10"]
    assert main([*listed, *few, *given]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("siamloc: ")
    assert says in error
    assert not (tmp_path / "run").exists()


def test_a_network_that_names_no_rooms_cannot_rank_them(manifest, tmp_path, capsys):
    given = ["descriptor=hog", "task=hierarchical", "build=rooms", "task.coarse.by=classifier"]
    assert main(["evaluate", *words(manifest, tmp_path / "run")[2:-2], *given]) == 2
    assert "train one with loss=cross_entropy" in capsys.readouterr().err.splitlines()[-1]
