"""`descriptor=pretrained` and `descriptor=frozen`: map, evaluation, bundle and localization without any training."""

from __future__ import annotations

import shlex

import numpy as np
import pytest
import torch

import siamloc
from augment.torchvision_compat import ensure_torchvision
from siamloc.cli.compose import composed
from siamloc.data import PanoramaLibrary
from siamloc.maps import VisualMap
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.results import read_results
from tests.siamloc.cli.commands import done, refused

MAP = "evaluation/pretrained/map.npz"


@pytest.fixture
def given(flat, tmp_path):
    roles = ["protocol.map.sequences=[first]", "protocol.query.sequences=[second]"]
    cache = f"data.cache={flat.parent / 'cache'}"
    return [f"data.manifest={flat}", cache, "descriptor=pretrained", *roles, f"run={tmp_path}"]


@pytest.mark.slow
def test_from_a_map_to_a_located_photograph(flat, given, tmp_path, capsys):
    done("map", *given)
    known = VisualMap.load(tmp_path / MAP)
    assert known.width == 2848
    assert known.heading_by_network
    done("evaluate", *given, "task.baselines=[hog]", "task.plots=false")
    results = read_results(tmp_path / "evaluation/pretrained")
    assert results["measures"]["absolute"]["overall"]["heading_error"]["count"] == 24
    assert list(results["baselines"]) == ["hog"]
    capsys.readouterr()
    done("export", f"run={tmp_path}", "descriptor=pretrained")
    said = capsys.readouterr().out
    assert "the robot gets: position, heading" in said
    (proposed,) = (line for line in said.splitlines() if "task.error_model=true" in line)
    assert f"siamloc evaluate run={tmp_path} descriptor=pretrained " in proposed
    assert "for poses finer than the map: export again with task.refine=relative" in said
    done("export", f"run={tmp_path}", "descriptor=pretrained", "task.refine=relative")
    said = capsys.readouterr().out
    assert "the robot gets: position (by comparison with 3 map frames), heading" in said
    assert "for poses finer" not in said
    done("localize", f"run={tmp_path}", f"images=['{flat.parent / 'first/0000.png'}']")
    assert "heading" in capsys.readouterr().out


@pytest.mark.slow
def test_a_published_network_describes_as_it_is(flat, words, tmp_path, capsys):
    ensure_torchvision()
    from torchvision import models

    torch.manual_seed(0)
    torch.save(models.mobilenet_v3_small().state_dict(), tmp_path / "published.pth")
    name, run = "descriptor.branch=torchvision/mobilenet_v3_small", tmp_path / "run"
    frozen = ["descriptor=frozen", name, f"descriptor.weights={tmp_path / 'published.pth'}"]
    done("map", *words, *frozen, f"run={run}")
    command = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: siamloc "))
    assert set(frozen) <= set(command)
    done(*command, "task.baselines=[]", "task.plots=false")
    assert read_results(run / "evaluation/frozen")["measures"]["absolute"]["overall"]["queries"] == 48
    done("export", f"run={run}", *frozen)
    capsys.readouterr()
    done("localize", f"run={run}", f"images=['{flat.parent / 'first/0000.png'}']")
    assert "1 of 1 images located" in capsys.readouterr().out


def test_python_makes_the_same_map_and_an_ordinary_camera_has_no_heading(flat, given, tmp_path):
    done("map", *given)
    frames = siamloc.data.read("manifest", manifest=flat)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=PRETRAINED_SIZE)
    made = siamloc.maps.build("pretrained", images, frames.select(sequence="first"), progress=False)
    np.testing.assert_array_equal(made.descriptors, VisualMap.load(tmp_path / MAP).descriptors)
    done("map", *given, "data.circular=false")
    assert VisualMap.load(tmp_path / MAP).heading is None


def test_panoramas_of_another_size_are_refused_and_that_of_the_weights_is_the_default(flat, given, tmp_path, capsys):
    says = "takes panoramas of 64 x 256, and data.image_size says [32, 128]: leave it out"
    assert says in refused(capsys, "map", *given, "data.image_size=[32,128]")
    frames = siamloc.data.read("manifest", manifest=flat)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(32, 128))
    with pytest.raises(siamloc.SiamlocError, match=r"image_size=\(64, 256\)"):
        siamloc.maps.build("pretrained", images, frames, progress=False)
    assert list(composed("map", ["descriptor=pretrained", "data.manifest=x"]).data.image_size) == list(PRETRAINED_SIZE)
    assert siamloc.models.pretrained().image_size == PRETRAINED_SIZE
    with pytest.raises(siamloc.SiamlocError, match="this network finds no headings"):
        siamloc.models.pretrained(circular=False).with_orientation(None)


def test_training_starts_from_it(capsys):
    shipped = siamloc.models.pretrained().state_dict()
    compares = ("orientation.", "relative.")  # is asked for by model.relative=true
    ready = {name: value for name, value in shipped.items() if not name.startswith(compares)}
    for experiment, what, held in (("modern", "branch alone", ready), ("fine_tuning", "whole network", shipped)):
        like = ["model/branch=panoresnet_wide", "model.normalize=local_and_colours"]
        words = [f"experiment={experiment}", "data.manifest=x", "model.branch.weights=siamloc", *like]
        config = composed("train", words)
        started = siamloc.models.build(**config.model.arguments(), image_size=(64, 256)).state_dict()
        assert all((started[name] == value).all() for name, value in held.items())
        assert f"the {what} starts from the network that ships with siamloc" in capsys.readouterr().err
