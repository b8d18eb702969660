"""A loss or a gradient that is not finite: the training stops, the last checkpoint is kept."""

from __future__ import annotations

import pytest
import torch

import siamloc
from siamloc.errors import ConfigError
from siamloc.models.weights import read_checkpoint
from tests.siamloc.training.conftest import network


class Turns(torch.nn.Module):
    """A loss of pairs or of places that is not finite, or has no finite gradient, in one step."""

    def __init__(self, step, what="loss"):
        super().__init__()
        self.step, self.what, self.steps = step, what, 0

    def forward(self, descriptors, *more):
        self.steps += 1
        loss = descriptors.square().mean()
        if self.steps <= self.step:
            return loss
        return loss * float("inf") if self.what == "loss" else loss + (0 * loss).sqrt()  # whose slope is 0 / 0


@pytest.mark.parametrize(("what", "says"), [("loss", "the loss is inf"), ("gradient", "the gradient is not finite")])
def test_a_training_on_places_stops_there_and_keeps_what_was_learned_before(train, drives, tmp_path, what, says):
    net = network()
    with pytest.raises(ConfigError, match=rf"the training diverged: {says} in epoch 2, step 3; train again"):
        train(net, validation=drives[1], epochs=3, loss=Turns(8, what))
    run = siamloc.training.Run(tmp_path / "run")
    assert read_checkpoint(run.checkpoint("last"))["epoch"] == 0
    assert all(bool(torch.isfinite(weight).all()) for weight in net.parameters())


def test_what_is_no_number_from_the_start_is_not_blamed_on_the_learning_rate(images, drives, tmp_path):
    pairs = {"batch_size": 4, "optimizer": {"name": "adamw"}}
    with pytest.raises(ConfigError, match=r"epoch 1, step 1, before anything was learned") as raised:
        siamloc.training.fit(network(), images, drives[0], run=tmp_path / "run", loss=Turns(0), epochs=1, **pairs)
    assert "learning_rate" not in str(raised.value)
    assert not (tmp_path / "run").exists()
