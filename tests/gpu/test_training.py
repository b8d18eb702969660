"""Training on a GPU: nothing mixes devices, no step waits, and the weights are those of the CPU."""

from __future__ import annotations

import pytest
import torch

import siamloc
from siamloc.full_precision import full_precision
from siamloc.models.batch_losses import LOSSES, make_loss
from siamloc.models.module import NetworkModule
from siamloc.pretraining import RECIPE, pretrain, view_batches
from siamloc.training import batches
from tests.gpu.trainer import Steps, pretend_trainer
from tests.siamloc.pretraining.test_pretraining import drawn
from tests.siamloc.training.test_stopping import Killed, Stop, kill

SIZE = (16, 64)
PAIRS = {"batch_size": 4, "pairs": {"label": "room", "epoch_pairs": 20}}
PLACES = {"pairs": {"places": 3, "images": 2, "radius": 0.6, "epoch_batches": 5}}
KINDS = pytest.mark.parametrize("settings", [PAIRS, PLACES], ids=["pairs", "places"])
WAITING = ("triplet", "circle", "multi_similarity")


def small(**options):
    return siamloc.models.build("simple1", "flat", SIZE, outputs=16, circular=True, **options)


@pytest.fixture
def fit(images, drives, tmp_path):
    def fit(network, run="run", **more):
        options = {"validation": drives[1], "epochs": 1, "compile": False, "augmentation": "lighting", **more}
        siamloc.training.fit(network, images, drives[0], run=tmp_path / run, **options)
        return network.state_dict()

    return fit


@pytest.fixture
def steps(gpu):
    return Steps(gpu)


@pytest.fixture
def there(steps):
    """What moves a training to the pretended device."""
    trainer = pretend_trainer(callbacks=[steps], log_every_n_steps=1000)
    return {"trainer": trainer, "augment_where": "gpu"}


@pytest.mark.parametrize("where", ["in main memory", "on the device"])
@KINDS
def test_no_step_waits(fit, there, steps, monkeypatch, settings, where):
    monkeypatch.setattr(batches, "room_for", lambda device: (1 << 40) * (where == "on the device"))
    fit(small(), average=0.9, clip=1.0, **there, **settings)
    assert (steps.waits, steps.count) == ({}, 3)


def test_a_step_that_waits_is_noticed(fit, there, steps, monkeypatch):
    monkeypatch.setattr(NetworkModule, "log_step", lambda self, loss: loss.item())
    fit(small(), **there, **PLACES)
    ((place, count),) = steps.waits.items()
    assert count == 3
    assert "at tests/gpu/test_training.py" in place


@pytest.mark.parametrize("loss", LOSSES)
def test_no_loss_waits_except_those_over_near_and_far(fit, there, steps, loss):
    fit(small(), loss=make_loss(loss), **there, **PLACES)
    assert sum(steps.waits.values()) <= (4 * steps.count if loss in WAITING else 0), steps.waits


@pytest.mark.parametrize(
    ("recipe", "model"),
    [("modern", {"relative": True}), ("fine_tuning", {"weights": None}), ("rooms", {"circular": True})],
    ids=["modern", "fine_tuning", "rooms"],
)
def test_no_step_of_a_recipe_waits(fit, there, steps, recipe, model):
    recipe = siamloc.training.recipe(recipe)
    there["trainer"]["precision"] = None  # which the plugin sets
    changes = recipe.options({**there, **PLACES, "epochs": 1, "augmentation": recipe.augmentation})
    fit(recipe.build(SIZE, **model), **changes)
    assert (steps.waits, steps.count) == ({}, 3)


def test_no_step_of_pretraining_waits(there, steps, tmp_path, monkeypatch):
    monkeypatch.setattr(view_batches, "draw_views", drawn)
    monkeypatch.setattr(view_batches, "_VALIDATION_POSES", 4)
    views = {"batches": 2, "held": 2, "together": 1, "lights": 3, "poses": 6, "processes": 0}
    there["trainer"]["precision"] = None
    pretrain(RECIPE.build(SIZE), run=tmp_path / "run", views=views, epochs=1, compile=False, **there, **PLACES)
    assert (steps.waits, steps.count) == ({}, 3)


@KINDS
def test_the_weights_are_those_of_the_cpu_and_of_a_training_that_was_resumed(fit, gpu, settings):
    """Up to the order of sums in the optimizer, and bit for bit."""
    resumed, options = small(), {"augment_where": "gpu", "checkpoint_every": 3, **settings}

    def there(network, callbacks=(), **more):
        return fit(network, trainer=pretend_trainer("32-true", callbacks=list(callbacks)), **options, **more)

    with full_precision():
        whole = there(small(), run="whole")
        with pytest.raises(Killed):
            there(resumed, [Stop(4, kill)])
        there(resumed, resume=True)
        here = fit(small(), run="here", trainer={"accelerator": "cpu"}, **options)
    for name, weight in whole.items():
        assert torch.equal(weight.cpu(), resumed.state_dict()[name].cpu())
        torch.testing.assert_close(weight.cpu(), here[name], rtol=1e-4, atol=1e-6)
