"""Optimizer and schedules of a training, step by step."""

from __future__ import annotations

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


def rates(steps, network=None, **options):
    """Train this many steps, and return the learning rates of each."""
    network = build("simple1", "fc500_500_5", SIZE) if network is None else network
    noted = Rates()
    module = SiameseModule(network, optimizer=Optimizer(**options))
    batches = DataLoader([draw_pairs(seed=step) for step in range(steps)], batch_size=None)
    trainer(max_epochs=1, callbacks=[noted]).fit(module, batches, DataLoader([draw_pairs()], batch_size=None))
    return noted.seen


@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("warm_up", [0, 0.2, 0.5, 0.99])
def test_the_shortest_trainings_have_a_schedule_too(steps, warm_up):
    found = rates(steps, learning_rate=0.01, schedule="one_cycle", warm_up=warm_up)
    assert len(found) == steps
    assert all(0 < rate <= 0.01 for (rate,) in found)


def test_a_warm_up_of_the_whole_training_is_refused():
    with pytest.raises(ConfigError, match=r"optimizer\.warm_up must be a number from 0 to below 1, got 1"):
        Optimizer(schedule="one_cycle", warm_up=1)


@pytest.mark.parametrize("schedule", ["constant", "one_cycle"])
def test_the_first_stages_stay_as_they_are(schedule):
    network = build("panoresnet", "flat", SIZE, outputs=4)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    frozen = network.branch.features[:5]
    rates(3, network, learning_rate=0.1, weight_decay=0.1, schedule=schedule, frozen_stages=2)
    same = {name for name, tensor in network.state_dict().items() if torch.equal(tensor, before[name])}
    assert same == {f"branch.features.{name}" for name in frozen.state_dict()} | {"branch.mean", "branch.std"}
    assert all(weight.requires_grad for weight in network.parameters())
    assert all(part.training for part in network.modules())


def test_stages_that_cannot_be_frozen_or_do_not_exist_are_refused():
    network = build("vgg11", "flat", SIZE)
    with pytest.raises(
        ConfigError, match=r"frozen_stages=6 leaves nothing to train: the network has 6 stages, .* 5 at"
    ):
        SiameseModule(network, optimizer=Optimizer(frozen_stages=6))
    with pytest.raises(ConfigError, match="Flatten does not say its stages"):
        SiameseModule(torch.nn.Flatten(), optimizer=Optimizer(frozen_stages=1))


@pytest.mark.parametrize("name", ["sgd", "adam", "adamw"])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_the_fused_optimizer_learns_what_torch_learns_weight_by_weight(name, layout):
    networks = [build("simple1", "fc500_500_5", SIZE).to(memory_format=layout) for _ in range(2)]
    module = SiameseModule(networks[0], optimizer=Optimizer(name, 0.01, momentum=0.7, weight_decay=0.1))
    fused = module.configure_optimizers()
    assert fused.param_groups[0]["fused"]
    options = {"lr": 0.01, "weight_decay": 0.1, "foreach": False}
    options |= {"momentum": 0.7} if name == "sgd" else {"betas": (0.7, 0.999)}
    plain = {"sgd": torch.optim.SGD, "adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[name](
        networks[1].parameters(), **options
    )
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
