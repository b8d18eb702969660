"""What CONTRIBUTING.md says under "Adding things", done word by word: the tests over the registries then pass."""

from __future__ import annotations

import importlib
import re
import sys
import types
from pathlib import Path

import pytest

import analytic
from siamloc import models
from siamloc.cli.compose import composed
from siamloc.jobs.options import choices, options
from tests.analytic import test_descriptors
from tests.augment import test_every_effect
from tests.siamloc.models import test_batch_losses, test_network_stages

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Adding things")[2]
STEP = re.compile(r"^In (?:`(\w+)` of )?`([\w/]+\.py)`,.*?\n```python\n(.*?)```", flags=re.MULTILINE | re.DOTALL)
DATA = ["data=cold", "data.root=x"]


@pytest.fixture
def follow(monkeypatch):
    """Return a function that does what a section says, in this process alone."""

    def done(section):
        steps = STEP.findall(TEXT.partition(f"### {section}\n")[2].partition("\n### ")[0])
        assert steps
        for registry, path, code in steps:
            name = path.removesuffix(".py").replace("/", ".")
            if not (ROOT / path).is_file():
                monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
            module = importlib.import_module(name)
            if not registry:
                before = set(vars(module))
                exec(compile(code, path, "exec"), vars(module))
                for new in set(vars(module)) - before:
                    monkeypatch.setattr(module, new, vars(module)[new])
                continue
            table = getattr(module, registry)
            for key, value in eval(f"{{{code}}}", vars(module)).items():
                monkeypatch.setitem(table, key, value)
        options.cache_clear()

    yield done
    options.cache_clear()


def test_a_loss(follow):
    follow("A loss")
    job = composed("train", [*DATA, "pairs=in_batch", "loss=decorrelating", "loss.radius=0.2"])
    assert job.make_loss().settings == {"name": "decorrelating", "radius": 0.2}
    assert choices("loss")["decorrelating"].startswith("Neighbours alike")
    test_batch_losses.test_every_loss_brings_neighbours_together("decorrelating")
    test_batch_losses.test_images_that_nobody_knows_a_place_of_cost_nothing("decorrelating")


def test_a_descriptor(follow):
    follow("A descriptor")
    job = composed("evaluate", [*DATA, "descriptor=profile", "descriptor.bands=4"])
    assert job.make_descriptor() == analytic.descriptor("profile", bands=4)
    assert choices("descriptor")["profile"].startswith("Mean brightness")
    registered = [test_descriptors.every.mark], [test_descriptors.oriented.mark]
    tests = [test for name, test in vars(test_descriptors).items() if name.startswith("test_")]
    marks = {test: [mark for mark in getattr(test, "pytestmark", []) if mark.name != "data"] for test in tests}
    alone = [test for test in tests if marks[test] in registered]
    assert test_descriptors.test_the_heading_survives_bars_and_noise_on_photographs in alone
    assert len(alone) > 9
    for test in alone:
        test("profile")


def test_a_head(follow):
    follow("A head")
    job = composed("train", [*DATA, "model/head=peaks", "model/branch=simple1", "model.head.outputs=8"])
    network = models.build(**job.model.arguments(), image_size=(32, 128))
    assert network.outputs == 8
    test_network_stages.test_a_head_with_weights_is_the_last_stage("peaks")


def test_an_effect(follow, monkeypatch):
    follow("An effect")
    monkeypatch.setattr("augment.registry.EFFECTS", tuple(sys.modules["augment.registry"]._HOMES))
    for test in (
        test_every_effect.test_changes_pictures_at_full_strength_and_leaves_them_at_zero,
        test_every_effect.test_keeps_shape_dtype_range_and_the_batch_given,
    ):
        for dtype in test_every_effect.DTYPES:
            test("fade", dtype)
    test_every_effect.test_replay_from_plain_values_is_exact("fade", test_every_effect.DTYPES[0])
    test_every_effect.test_8_bit_and_float_follow_one_formula_for_every_camera("fade", True)
