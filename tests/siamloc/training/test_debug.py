"""Checking a training before it is started: what is reported, and that nothing is left behind."""

from __future__ import annotations

import json
import re
import signal

import pytest
import torch

import siamloc
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.files import read_json
from siamloc.models.origins import Origins
from siamloc.training.debug.overfit import verdict
from tests.siamloc.training.test_place_batches import SETTINGS, network

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
        assert debug == "profile" or not run.folder.exists()
        return capfd.readouterr().err

    return call


def test_one_batch_shows_shapes_figures_and_times(look, drives):
    said = look("one_batch", validation=drives[1], average=0.9, **PLACES)
    assert re.search(r"network +[\d,]+ weights, [\d,]+ trained, on cpu in 32-true", said)
    assert re.search(r"training +images 8 x 3 x 16 x 64 uint8, xy 8 x 2 float32", said)
    assert re.search(r"descriptors 8 x 16, loss \d\.\d+, length of the gradient \d", said)
    assert re.search(r"validation +images 32 x 3 x 16 x 64 uint8", said)
    assert "val/error" in said
    assert "an epoch has 6 such steps" in said
    said = look("one_batch", **PAIRS)
    assert "first 4 x 3 x 16 x 64 uint8" in said
    assert "validation" not in said


@pytest.mark.parametrize("options", [PLACES, PAIRS])
def test_a_batch_can_be_learned_by_heart(look, options):
    said = look("overfit", augmentation="lighting", **options)
    assert "one batch learned by heart, without augmentation, at most 100 steps" in said
    assert "step   1   loss" in said
    assert "it learns: the loss went from" in said


def test_what_does_not_learn_is_said(look):
    said = look("overfit", **{**PAIRS, "optimizer": {"learning_rate": 1e-12}})
    assert "it does not learn: the loss went from" in said
    assert "try another optimizer.learning_rate than 1e-12" in said
    said = look("overfit", **{**PAIRS, "optimizer": {"learning_rate": 1e9}})
    assert re.search(r"the loss is not finite at step \d+: try a smaller optimizer.learning_rate than 1", said)


@pytest.mark.parametrize(
    ("losses", "lowest", "says"),
    [
        ([2.0, 1.7, 1.6, 1.6, 1.6, 1.6, 1.6], 0.0, r"it learns slowly: .* 20 % of the way to 0; try a larger"),
        ([2.0, 1.7, 1.6, 1.6, 1.6, 1.6, 1.6], 1.5, r"it learns: .* 80 % of the way to 1\.5, as it should"),
        ([2.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0], 0.0, r"it does not learn: .* from 2 to 3"),
        ([0.0] * 7, 0.0, r"nothing to learn in this batch: its loss is 0"),
        ([float("nan")] * 3, 0.0, r"not finite from the start: look at what"),
        ([-1.0, *[-5.0] * 6], 0.0, r"from -1 to -5 in 7 steps; what it should reach is not known"),
    ],
)
def test_the_verdict(losses, lowest, says):
    assert re.search(says, verdict(losses, lowest, 0.1))


@pytest.mark.parametrize("rooms", [[0, 0, 1, 1], [0, -1, 0, -1]])
def test_the_lowest_loss_of_a_batch_is_that_of_what_is_wanted(rooms):
    xy = torch.tensor([[0.0, 0.0], [0.4, 0.0], [5.0, 0.0], [5.2, 0.0]])
    origins = Origins(xy, torch.zeros(4), torch.tensor(rooms), torch.arange(4))
    loss = siamloc.models.SoftContrastiveLoss(room=0.3)
    descriptors = torch.nn.Parameter(torch.randn(4, 4, generator=torch.Generator().manual_seed(0)))
    optimizer = torch.optim.Adam([descriptors], lr=0.05)
    for _ in range(300):
        optimizer.zero_grad()
        found = loss(torch.nn.functional.normalize(descriptors), origins)
        found.backward()
        optimizer.step()
    assert loss.lowest(origins) <= found.item() == pytest.approx(loss.lowest(origins), abs=0.02)


def test_a_profile_says_where_the_time_goes_and_does_not_block_the_training(look, images, drives, tmp_path):
    said = look("profile", augmentation="lighting", **PLACES)
    parts = {
        name: (float(took), int(share))
        for name, took, share in re.findall(r"^  (\w[\w ]*?) +([\d.]+) ms +(\d+) %", said, flags=re.MULTILINE)
    }
    names = ["waiting for data", "augmentation", "forward", "backward", "optimizer"]
    assert sum(parts[name][0] for name in names) == pytest.approx(parts["together"][0], abs=0.3)
    assert parts["backward"][0] > 0
    assert "operators that take most of it" in said
    run = siamloc.training.Run(tmp_path / "run")
    trace = json.loads((run.folder / "profile.json").read_text())
    assert {"forward", "backward", "optimizer"} <= {event.get("name") for event in trace["traceEvents"]}
    assert read_json(run.record)["written"] == ["profile.json"]
    options = {"epochs": 1, "pairs": PlaceSettings(places=4, images=2, epoch_batches=1)}
    siamloc.training.fit(network(), images, drives[0], run=run, **options)
    assert {"profile.json", "metrics.csv"} <= set(read_json(run.record)["written"])
    assert (run.folder / "profile.json").is_file()


@pytest.mark.parametrize("workers", [0, 1])
def test_a_profile_times_what_augments_on_the_device(look, workers):
    said = look("profile", augmentation="lighting", augment_where="gpu", workers=workers, **PLACES)
    assert float(re.search(r"augmentation +([\d.]+) ms", said)[1]) > 0


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
