"""The Lightning module: steps, logs, optimizers and schedules; the figures of an epoch against loops."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, DataError
from siamloc.models import ContrastiveLoss, Optimizer, SiameseModule, as_descriptor, build
from siamloc.models.siamese import pair_figures, pair_sums
from tests.oracles.contrastive import pair_statistics
from tests.siamloc.models.conftest import trainer

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402

SIZE = (32, 64)
KEYS = ("first", "second")


def make(branch="simple1", loss=None, **options):
    return SiameseModule(build(branch, "fc500_500_5", SIZE), loss, Optimizer(**options))


def draw_pairs(count=8, seed=0, same=None):
    generator = torch.Generator().manual_seed(seed)
    first, second = torch.randint(0, 256, (2, count, 3, *SIZE), generator=generator, dtype=torch.uint8)
    same = torch.rand(count, generator=generator) < 0.5 if same is None else torch.full((count,), same)
    return {"first": first, "second": second, "label": (~same).float(), "same": same}


def loader(*batches):
    return DataLoader(list(batches), batch_size=None)


def test_loss_of_a_step_is_that_of_two_separate_passes():
    module, batch = make(), draw_pairs()
    d0, d1 = (module.network(batch[key].float() / 255) for key in ("first", "second"))
    expected = ContrastiveLoss(2.0)(d0, d1, batch["label"])
    torch.testing.assert_close(module.training_step(batch, 1), expected)


def test_fit_lowers_the_loss_and_logs_finite_figures():
    module, batch = make(learning_rate=0.01), draw_pairs(16)
    first_loss = make().training_step(batch, 1).item()
    training = trainer(max_epochs=15)
    training.fit(module, loader(batch), loader(draw_pairs(16, seed=1)))
    logged = training.callback_metrics
    groups = [f"{name}_{group}" for name in ("accuracy", "distance") for group in ("same", "different")]
    names = ["loss", "active", "accuracy", "spread", *groups]
    assert {f"{stage}/{name}" for stage in ("train", "val") for name in names} | {"loss_step"} == set(logged)
    assert all(math.isfinite(value) for value in logged.values())
    assert logged["train/loss"] < 0.5 * first_loss


def test_figures_start_again_in_every_epoch():
    module, training = make(), trainer()
    for batch in (draw_pairs(4, same=True), draw_pairs(4, same=False)):
        training.validate(module, loader(batch), verbose=False)
    assert "val/accuracy_same" not in training.callback_metrics


def test_parameters_of_a_loss_are_trained():
    loss = torch.nn.PairwiseDistance()
    loss.register_parameter("weight", torch.nn.Parameter(torch.ones(1)))
    (group,) = make(loss=loss).configure_optimizers().param_groups
    assert any(parameter is loss.weight for parameter in group["params"])


def test_defaults_are_those_of_the_thesis():
    group = make().configure_optimizers().param_groups[0]
    assert (group["lr"], group["momentum"], group["weight_decay"]) == (0.001, 0.9, 0)
    assert make().loss.margin == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "sdg"}, "optimizer.name must be sgd or adam or adamw, got 'sdg'"),
        ({"learning_rate": 0}, "optimizer.learning_rate must be a number above 0"),
        ({"momentum": 1}, "optimizer.momentum must be a number from 0 to below 1"),
        ({"weight_decay": -1}, "optimizer.weight_decay must be a number from 0"),
        ({"schedule": "one_cycle", "warm_up": 1}, r"optimizer\.warm_up must be a number from 0 to below 1, got 1"),
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        Optimizer(**options)


def triplet_like(d0, d1, y):
    return ((d0 - d1).abs().sum(1) * (1 - 2 * y)).mean()


def test_any_function_is_a_loss():
    module, held = make(loss=triplet_like), draw_pairs(seed=1)
    training = trainer()
    training.fit(module, loader(draw_pairs()), loader(held))
    d0, d1 = (torch.from_numpy(as_descriptor(module).describe(held[key]).position) for key in KEYS)
    logged = training.callback_metrics
    assert logged["val/loss"].item() == pytest.approx(triplet_like(d0, d1, held["label"]).item(), abs=1e-3)
    assert "val/accuracy" not in logged
    assert module.content()["loss"] == {"class": "triplet_like"}


def test_a_loss_for_each_pair_and_features_for_each_pixel_are_refused():
    with pytest.raises(DataError, match=r"must give one number, got shape \(8,\)"):
        make(loss=lambda d0, d1, y: (d0 - d1).norm(dim=1)).training_step(draw_pairs(), 0)
    with pytest.raises(DataError, match=r"one descriptor per image, shape \(16, D\), got shape \(16, 3, 32, 64\)"):
        SiameseModule(torch.nn.Identity()).training_step(draw_pairs(), 0)


def test_a_loss_without_a_gradient_is_refused_in_training():
    module = make(loss=lambda d0, d1, y: (d0 - d1).detach().norm())
    with pytest.raises(DataError, match=r"gives a number without a gradient.* without detach\(\), item\(\) or NumPy"):
        module.training_step(draw_pairs(), 0)
    with torch.no_grad():
        module.validation_step(draw_pairs(), 0)


@pytest.mark.parametrize("change", [lambda found: found.detach(), lambda found: found.long()])
def test_a_network_without_a_gradient_is_refused_in_training(change):
    class Changed(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = torch.nn.Linear(3, 2)

        def forward(self, panorama):
            return change(self.layer(panorama.mean((2, 3))))

    with pytest.raises(DataError, match=r"the network gives descriptors .* without a gradient"):
        SiameseModule(Changed(), loss=triplet_like).training_step(draw_pairs(), 0)


def test_a_batch_with_missing_columns_is_refused():
    batch = draw_pairs()
    del batch["same"]
    with pytest.raises(DataError, match="needs first, second, label, same; missing: same"):
        make().training_step(batch, 0)


@pytest.mark.parametrize("stage", ["train", "val"])
def test_a_training_that_diverges_is_stopped_before_its_epoch_is_saved(stage):
    module = make(learning_rate=0.5)
    loss, same = torch.tensor(float("nan")), torch.tensor([True, False])
    module._sums[stage] = pair_sums(torch.zeros(4, 5), loss, same, torch.zeros(2), 2.0)
    end = module.on_train_epoch_end if stage == "train" else module.on_validation_epoch_end
    with pytest.raises(ConfigError, match=f"diverged: {stage}/loss of epoch 1 is nan; .* than 0.5"):
        end()


class Rates(Callback):
    """Note the learning rates of each step, one for each group of weights."""

    def __init__(self):
        self.seen = []

    def on_train_batch_start(self, trainer, pl_module, batch, batch_idx):
        (optimizer,) = trainer.optimizers
        self.seen.append([group["lr"] for group in optimizer.param_groups])


def rates(steps, network=None, **options):
    """Train this many steps, and return the learning rates of each."""
    network = build("simple1", "fc500_500_5", SIZE) if network is None else network
    noted = Rates()
    module = SiameseModule(network, optimizer=Optimizer(**options))
    batches = loader(*(draw_pairs(seed=step) for step in range(steps)))
    trainer(max_epochs=1, callbacks=[noted]).fit(module, batches, loader(draw_pairs()))
    return noted.seen


@pytest.mark.parametrize("steps", [1, 2, 5])
@pytest.mark.parametrize("warm_up", [0, 0.2, 0.5, 0.99])
def test_the_shortest_trainings_have_a_schedule_too(steps, warm_up):
    found = rates(steps, learning_rate=0.01, schedule="one_cycle", warm_up=warm_up)
    assert len(found) == steps
    assert all(0 < rate <= 0.01 for (rate,) in found)


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


def test_the_head_cannot_be_frozen_too():
    network = build("vgg11", "flat", SIZE)
    with pytest.raises(ConfigError, match=r"frozen_stages=6 leaves nothing .* the network has 6 stages, .* 5 at"):
        SiameseModule(network, optimizer=Optimizer(frozen_stages=6))


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
    batches = loader(draw_pairs())
    trainer(precision="bf16-mixed", gradient_clip_val=1e-30).fit(SiameseModule(network), batches, batches)
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=1e-20)


MARGIN = 2.0


def figures(batches):
    """The figures of an epoch of batches (d0, d1, label, same)."""
    losses = [ContrastiveLoss(MARGIN)(d0, d1, label) for d0, d1, label, _ in batches]
    sums = [
        pair_sums(torch.cat([d0, d1]), loss, same, label, MARGIN)
        for loss, (d0, d1, label, same) in zip(losses, batches, strict=True)
    ]
    return pair_figures({name: sum(one[name] for one in sums) for name in sums[0]})


def draw(pairs, dimensions, seed, same_share=0.5):
    generator = torch.Generator().manual_seed(seed)
    d0, d1 = 0.5 * torch.randn(2, pairs, dimensions, generator=generator) + 3
    label = (1.5 * torch.rand(pairs, generator=generator)).clamp(max=1)  # a third of the pairs are dissimilar
    return d0, d1, label, torch.rand(pairs, generator=generator) < same_share


@settings(deadline=None, max_examples=25)
@given(
    batches=st.lists(st.integers(1, 6), min_size=1, max_size=5),
    dimensions=st.integers(1, 8),
    same_share=st.sampled_from([0.0, 0.2, 0.5, 1.0]),
    seed=st.integers(0, 1000),
)
def test_agrees_with_loops_over_all_pairs_whatever_the_batches(batches, dimensions, same_share, seed):
    columns = draw(sum(batches), dimensions, seed, same_share)
    found = figures(list(zip(*(column.split(batches) for column in columns), strict=True)))
    expected = pair_statistics(*(column.tolist() for column in columns), MARGIN)
    assert {name: value.item() for name, value in found.items()} == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_a_collapsed_network_has_no_spread_even_far_from_zero():
    alike = torch.full((50, 3), 12345.678)
    batch = alike, alike, torch.ones(50), torch.zeros(50, dtype=torch.bool)
    assert figures([batch] * 20)["spread"] < 1e-2
