"""`descriptor=pretrained`: map, evaluation, bundle and localization without any training."""

from __future__ import annotations

import json

import numpy as np
import pytest

import siamloc
from siamloc.cli import main
from siamloc.cli.compose import composed
from siamloc.data import PanoramaLibrary
from siamloc.maps import VisualMap
from siamloc.models.registry import PRETRAINED_SIZE
from tests.drawn import write_manifest


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn")
    return write_manifest(folder, {"first": "cloudy", "second": "cloudy"}, frames_per_room=6)


def words(manifest, run, *more):
    common = [f"data.manifest={manifest}", f"data.cache={manifest.parent / 'store'}", "descriptor=pretrained"]
    return [*common, "protocol.map.sequences=[first]", "protocol.query.sequences=[second]", f"run={run}", *more]


@pytest.mark.slow
def test_from_a_map_to_a_located_photograph(manifest, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["map", *words(manifest, run)]) == 0
    file = run / "evaluation" / "pretrained" / "map.npz"
    known = VisualMap.load(file)
    assert known.width == 2048
    assert known.heading is not None
    assert known.heading.own
    assert main(["evaluate", *words(manifest, run, "task.baselines=[hog]", "task.plots=false")]) == 0
    results = json.loads((run / "evaluation" / "pretrained" / "results.json").read_text())
    assert results["measures"]["absolute"]["overall"]["heading_error"]["count"] == 18
    assert list(results["baselines"]) == ["hog"]
    capsys.readouterr()
    assert main(["export", f"run={run}", "descriptor=pretrained"]) == 0
    said = capsys.readouterr().out
    assert "the robot gets: position, heading" in said
    assert f"siamloc evaluate run={run} descriptor=pretrained task.error_model=true" in said
    photograph = sorted(manifest.parent.rglob("*.png"))[0]
    assert main(["localize", f"run={run}", f"images=['{photograph}']"]) == 0
    assert "heading" in capsys.readouterr().out


def test_python_makes_the_same_map(manifest, tmp_path):
    assert main(["map", *words(manifest, tmp_path)]) == 0
    frames = siamloc.data.read("manifest", manifest=manifest)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=PRETRAINED_SIZE)
    made = siamloc.maps.build("pretrained", images, frames.select(sequence="first"), progress=False)
    known = VisualMap.load(tmp_path / "evaluation" / "pretrained" / "map.npz")
    np.testing.assert_array_equal(made.descriptors, known.descriptors)


def test_an_ordinary_camera_has_no_heading_and_says_so(manifest, tmp_path, capsys):
    given = words(manifest, tmp_path, "data.circular=false")
    assert main(["map", *given]) == 0
    assert VisualMap.load(tmp_path / "evaluation" / "pretrained" / "map.npz").heading is None
    assert main(["map", *given, "heading=hog"]) == 2
    said = capsys.readouterr().err
    assert "needs columns that are a full turn, and data.circular is false" in said
    with pytest.raises(siamloc.SiamlocError, match="this network finds no headings"):
        siamloc.models.pretrained(circular=False).with_orientation(None)


def test_panoramas_of_another_size_are_refused_in_one_sentence(manifest, tmp_path, capsys):
    assert main(["map", *words(manifest, tmp_path, "data.image_size=[32,128]")]) == 2
    said = capsys.readouterr().err
    assert "takes panoramas of 64 x 256, and data.image_size says [32, 128]: leave it out" in said
    assert said.count("\n") == 1
    frames = siamloc.data.read("manifest", manifest=manifest)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(32, 128))
    with pytest.raises(siamloc.SiamlocError, match=r"image_size=\(64, 256\)"):
        siamloc.maps.build("pretrained", images, frames, progress=False)


def test_the_size_is_that_of_the_weights_unless_it_is_said():
    assert list(composed("map", ["descriptor=pretrained", "data.manifest=x"]).data.image_size) == list(PRETRAINED_SIZE)
    network = siamloc.models.pretrained()
    assert network.image_size == PRETRAINED_SIZE


def test_training_starts_from_it(capsys):
    shipped = siamloc.models.pretrained().state_dict()
    compares = ("orientation.", "relative.")  # is asked for by model.relative=true
    ready = {name: value for name, value in shipped.items() if not name.startswith(compares)}
    for experiment, what, held in (("modern", "branch alone", ready), ("fine_tuning", "whole network", shipped)):
        config = composed("train", [f"experiment={experiment}", "data.manifest=x", "model.branch.weights=siamloc"])
        started = siamloc.models.build(**config.model.arguments(), image_size=(64, 256)).state_dict()
        assert all((started[name] == value).all() for name, value in held.items())
        assert f"the {what} starts from the weights that ship with siamloc" in capsys.readouterr().err
