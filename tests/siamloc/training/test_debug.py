"""Checking a training before it is started: what is reported, and that nothing is left behind."""

from __future__ import annotations

import re
import signal

import pytest
import torch

import siamloc
from siamloc.errors import ConfigError
from tests.siamloc.training.conftest import SETTINGS, network

PLACES = {**SETTINGS, "optimizer": {"name": "adamw", "learning_rate": 0.01}}
CPU = {"accelerator": "cpu"}
PAIRS = {"batch_size": 4, "optimizer": {"name": "adamw", "learning_rate": 0.01}}


@pytest.fixture
def look(images, drives, tmp_path, capfd):
    """A training that is checked, and its report. Whatever it does, the network and the folder stay as they were."""

    def call(debug, **options):
        net = network()
        before = {name: value.clone() for name, value in net.state_dict().items()}
        run = siamloc.training.fit(
            net, images, drives[0], run=tmp_path / "run", debug=debug, trainer={"accelerator": "cpu"}, **options
        )
        assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())
        assert not run.folder.exists()
        return capfd.readouterr().err

    return call


def test_one_batch_shows_the_network_and_its_figures(look, drives):
    said = look("one_batch", validation=drives[1], average=0.9, **PLACES)
    assert re.search(r"one batch, nothing is kept: loss \d\.\d+, val/", said)
    assert "val/error" in said
    assert "params" in said.lower()
    said = look("one_batch", **PAIRS)
    assert "one batch, nothing is kept: loss" in said
    assert "val/" not in said


@pytest.mark.parametrize("options", [PLACES, PAIRS])
def test_a_batch_can_be_learned_by_heart(look, options):
    said = look("overfit", augmentation="lighting", **options)
    assert re.search(r"one batch learned by heart.* at first and .* after 100 steps, as it should", said)


@pytest.mark.parametrize("share", [1.0, 0.95, 0.85])
def test_what_does_not_clearly_learn_is_said(look, share):
    """A loss that falls from 1 to 0.95 of it is not learned; one that falls to 0.85 is."""
    calls = iter(range(100))

    def loss(d0, d1, y):
        return 0 * d0.sum() + (1 if next(calls) < 50 else share)

    said = look("overfit", loss=loss, **PAIRS)
    assert ("as it should" in said) == (share < 0.9)
    assert ("it hardly goes down: look at the labels, loss and learning rate" in said) == (share > 0.9)


def test_a_batch_that_diverges_is_said(look):
    with pytest.raises(ConfigError, match=r"diverged: .* is nan; train again with a smaller optimizer.learning_rate"):
        look("overfit", **{**PAIRS, "optimizer": {"learning_rate": 1e9}})


def test_a_profile_says_where_the_time_goes(look):
    said = look("profile", augmentation="lighting", augment_where="gpu", **PLACES)
    assert "where the time of 20 steps goes" in said
    for part in ("train_dataloader_next", "on_after_batch_transfer", "training_step", "backward", "optimizer_step"):
        assert part in said


def test_what_makes_no_sense_is_refused(look):
    with pytest.raises(ConfigError, match="debug must be overfit or one_batch or profile, or null, got 'fast'"):
        look("fast", **PAIRS)
    with pytest.raises(ConfigError, match="debug=overfit looks at a training from its start: leave out resume=true"):
        look("overfit", resume=True, **PAIRS)


def test_the_gradient_is_cut_as_in_the_training(images, drives, tmp_path, monkeypatch):
    """A batch that is learned only with a short gradient is learned here, too."""
    seen = []
    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", lambda weights, most, **_: seen.append(most))
    siamloc.training.fit(
        network(), images, drives[0], run=tmp_path / "run", debug="one_batch", clip=0.25, trainer=CPU, **PAIRS
    )
    assert seen == [0.25]


def test_ctrl_c_while_looking_is_an_interrupt_and_can_come_again(images, drives, tmp_path):
    class Interrupted(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network, self.calls = network(), 0

        def forward(self, panorama):
            self.calls += 1
            if self.calls == 3:  # the first call comes before the training
                raise KeyboardInterrupt
            return self.network(panorama)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            siamloc.training.fit(
                Interrupted(), images, drives[0], run=tmp_path / "run", debug="overfit", trainer=CPU, **PAIRS
            )
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, handler)
