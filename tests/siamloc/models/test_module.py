"""Optimizer and schedules of a training, step by step."""

from __future__ import annotations

import math

import pytest
import torch
from torch.utils.data import DataLoader

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models import Optimizer, SiameseModule, build
from tests.siamloc.models.conftest import trainer

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402

SIZE = (32, 64)


class Rates(Callback):
    """Note the learning rates of each step, one for each group of weights."""

    def __init__(self):
        self.seen = []

    def on_train_batch_start(self, trainer, pl_module, batch, batch_idx):
        (optimizer,) = trainer.optimizers
        self.seen.append([group["lr"] for group in optimizer.param_groups])


def draw_pairs(count=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    first, second = torch.rand(2, count, 3, *SIZE, generator=generator)
    same = torch.arange(count) % 2 == 0
    return {"first": first, "second": second, "label": (~same).float(), "same": same}


def rates(steps, network=None, epochs=1, loss=None, **options):
    """Train this many steps, and return the learning rates of each."""
    network = build("simple1", "fc500_500_5", SIZE) if network is None else network
    noted = Rates()
    module = SiameseModule(network, loss, optimizer=Optimizer(**options))
    batches = DataLoader([draw_pairs(seed=step) for step in range(steps // epochs)], batch_size=None)
    trainer(max_epochs=epochs, callbacks=[noted]).fit(module, batches, DataLoader([draw_pairs()], batch_size=None))
    return noted.seen


@pytest.mark.parametrize(("warm_up", "growing"), [(0.2, 4), (0.0, 0), (0.49, 9)])
def test_cosine_grows_evenly_and_falls_along_half_a_cosine(warm_up, growing):
    found = [rate for (rate,) in rates(20, epochs=2, learning_rate=0.01, schedule="cosine", warm_up=warm_up)]
    for step in (0, 1, 3, 4, 5, 10, 19):
        if step < growing:
            expected = 0.01 * (step + 1) / (growing + 1)
        else:
            expected = 0.005 * (1 + math.cos(math.pi * (step - growing) / (20 - growing)))
        assert found[step] == pytest.approx(expected)
    assert max(found) == found[growing] == 0.01
    assert 0 < found[-1] < 0.0003


@pytest.mark.parametrize("schedule", ["cosine", "one_cycle"])
@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("warm_up", [0, 0.2, 0.5, 0.99])
def test_the_shortest_trainings_have_a_schedule_too(schedule, steps, warm_up):
    found = rates(steps, learning_rate=0.01, schedule=schedule, warm_up=warm_up)
    assert len(found) == steps
    assert all(0 < rate <= 0.01 for (rate,) in found)


def test_a_warm_up_of_the_whole_training_is_refused():
    with pytest.raises(ConfigError, match=r"optimizer\.warm_up must be a number from 0 to below 1, got 1"):
        Optimizer(schedule="cosine", warm_up=1)


@pytest.mark.parametrize("schedule", ["constant", "one_cycle", "cosine"])
def test_stages_have_rates_of_their_own(schedule):
    network = build("panoresnet", "flat", SIZE, outputs=4)
    found = rates(4, network, learning_rate=0.01, schedule=schedule, stage_decay=0.5, frozen_stages=2)
    plain = rates(4, build("panoresnet", "flat", SIZE, outputs=4), learning_rate=0.01, schedule=schedule)
    for by_stage, (rate,) in zip(found, plain, strict=True):
        assert by_stage == pytest.approx([rate * 0.5**after for after in (2, 1, 0)])


@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_the_first_stages_stay_as_they_are(schedule):
    network = build("panoresnet", "flat", SIZE, outputs=4)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    frozen = network.branch.features[:5]
    rates(3, network, learning_rate=0.1, weight_decay=0.1, schedule=schedule, frozen_stages=2)
    same = {name for name, tensor in network.state_dict().items() if torch.equal(tensor, before[name])}
    assert same == {f"branch.features.{name}" for name in frozen.state_dict()} | {"branch.mean", "branch.std"}
    assert all(weight.requires_grad for weight in network.parameters())
    assert all(part.training for part in network.modules())


def test_all_weights_are_trained_once_where_stages_have_their_rates():
    loss = torch.nn.PairwiseDistance()
    loss.register_parameter("weight", torch.nn.Parameter(torch.ones(1)))
    for decay, frozen in ((0.5, 0), (1, 1)):
        network = build("alexnet", "fc500_500_5", (64, 64))
        module = SiameseModule(network, loss, Optimizer(name="adamw", stage_decay=decay, frozen_stages=frozen))
        groups = module.configure_optimizers().param_groups
        trained = [weight for group in groups for weight in group["params"]]
        names = [name for name, weight in module.named_parameters() for other in trained if weight is other]
        first = ["network.branch.features.0.weight", "network.branch.features.0.bias"]
        assert [*first[: 2 * frozen], *names] == [name for name, _ in module.named_parameters()]
        assert any(weight is loss.weight for weight in groups[-1]["params"])


def test_stages_that_cannot_be_frozen_or_do_not_exist_are_refused():
    network = build("vgg11", "flat", SIZE)
    with pytest.raises(
        ConfigError, match=r"frozen_stages=6 leaves nothing to train: the network has 6 stages, .* 5 at"
    ):
        SiameseModule(network, optimizer=Optimizer(frozen_stages=6))
    for options in ({"frozen_stages": 1}, {"stage_decay": 0.5}):
        with pytest.raises(ConfigError, match="Flatten does not say its stages"):
            SiameseModule(torch.nn.Flatten(), optimizer=Optimizer(**options))
    for value in (0, 1.5):
        with pytest.raises(ConfigError, match=r"optimizer\.stage_decay must be a number above 0, at most 1"):
            Optimizer(stage_decay=value)


@pytest.mark.parametrize("name", ["sgd", "adam", "adamw"])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_the_fused_optimizer_learns_what_torch_learns_weight_by_weight(name, layout):
    networks = [build("simple1", "fc500_500_5", SIZE).to(memory_format=layout) for _ in range(2)]
    module = SiameseModule(networks[0], optimizer=Optimizer(name=name, learning_rate=0.01, weight_decay=0.1))
    fused = module.configure_optimizers()
    assert fused.param_groups[0]["fused"]
    options = {"lr": 0.01, "weight_decay": 0.1, "foreach": False}
    options |= {"momentum": 0.9} if name == "sgd" else {"betas": (0.9, 0.999)}
    plain = type(fused)(networks[1].parameters(), **options)
    for step in range(3):
        fused.zero_grad()
        module.training_step(draw_pairs(seed=step), 1).backward()
        for one, other in zip(networks[0].parameters(), networks[1].parameters(), strict=True):
            other.grad = one.grad.clone()
        fused.step()
        plain.step()
    for one, other in zip(networks[0].parameters(), networks[1].parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


def test_gradients_are_clipped_in_mixed_precision():
    network = build("simple1", "fc500_500_5", SIZE)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    batches = DataLoader([draw_pairs()], batch_size=None)
    trainer(precision="bf16-mixed", gradient_clip_val=1e-30).fit(SiameseModule(network), batches, batches)
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=1e-20)


def test_a_loss_is_told_how_far_the_training_is():
    told = []

    class Changing(torch.nn.Module):
        def progress(self, share):
            told.append(share)

        def forward(self, d0, d1, y):
            return (d0 - d1).square().mean()

    rates(6, epochs=2, loss=Changing())
    assert told == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1])
    told.clear()
    rates(1, loss=Changing())
    assert told == [0]
