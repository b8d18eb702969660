"""The single network of [T] table 5.19 through the command line: trained, mapped, evaluated, exported."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc import models
from siamloc.evaluation import hierarchy
from siamloc.maps import CoarseLayer
from siamloc.models import as_descriptor
from siamloc.results import read_results, read_rows
from siamloc.runtime import Bundle, Localizer
from tests.siamloc.cli.commands import done

ROOMS = ["corridor", "kitchen", "office"]
SEARCH = ["task=hierarchical", "build=rooms", "task.coarse.by=classifier"]


@pytest.fixture(scope="module")
def run(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("classifier") / "run"
    roles = [f"protocol.{role}.sequences=[first]" for role in ("train", "map")]
    roles += ["protocol.query.sequences=[second]", "protocol.validation.sequences=[third]"]
    small = ["model/branch=simple1", "model/head=fc500_500_5", "trainer.accelerator=cpu", "pairs.epoch_batches=10"]
    done("train", "experiment=rooms_classifier", *small, *data, *roles, "epochs=4", f"run={folder}")
    done("train", f"run={folder}", "resume=true", "epochs=5", "trainer.accelerator=cpu")
    done("map", f"run={folder}", "build=rooms")
    return folder


@pytest.mark.parametrize("candidates", [1, 3])
def test_rooms_named_by_the_classifier_come_first(run, candidates, capsys):
    assert models.load(run).rooms.names.tolist() == ROOMS
    done("evaluate", f"run={run}", *SEARCH, "task.plots=false", f"task.candidates={candidates}")
    assert "network-rooms-classifier" in capsys.readouterr().out
    folder = run / "evaluation/hierarchical-network-rooms-classifier"
    columns, measures = read_rows(folder), read_results(folder)["measures"]["hierarchical"]
    again = hierarchy.node_measures(columns, measures)
    assert again["overall"]["coarse"] == measures["overall"]["coarse"]
    assert measures["overall"]["coarse"]["accuracy"] > 0.8
    np.testing.assert_array_equal(columns["comparisons"] - columns["frames_compared"], 3)
    layer = CoarseLayer.load(run / "layers/network-rooms/layer.npz")
    assert layer.classifier.names.tolist() == layer.names.tolist() == ROOMS
    if candidates == 3:
        np.testing.assert_array_equal(columns["error"], columns["error_absolute"])


def test_the_classifier_chooses_rooms_for_another_descriptor(run, capsys):
    other = ["descriptor=hog", f"task.coarse.descriptor={run}", "task.candidates=1", "task.plots=false"]
    done("evaluate", f"run={run}", *SEARCH, *other)
    assert "hog-network-run-rooms-classifier" in capsys.readouterr().out


def test_the_robot_has_the_classifier(flat, run, tmp_path):
    done("export", f"run={run}", f"bundle={tmp_path / 'bundle'}", *SEARCH, "task.candidates=1")
    layer = Bundle.open(tmp_path / "bundle").load("layer.npz")
    assert layer.classifier.names.tolist() == ROOMS
    localizer, trained = Localizer(tmp_path / "bundle"), as_descriptor(models.load(run))
    for number in (0, 11, 20):
        path = flat.parent / "second" / f"{number:04d}.png"
        panorama = localizer.bundle.preprocessing.panorama(path)
        assert localizer.locate(path).room == trained.classify(panorama).room[0]
