"""The Lightning module: steps, logs, optimizers."""

from __future__ import annotations

import math

import pytest
import torch
from torch.utils.data import DataLoader

from siamloc.errors import ConfigError, DataError
from siamloc.models import ContrastiveLoss, Optimizer, SiameseModule, as_descriptor, build
from tests.oracles.contrastive import pair_statistics
from tests.siamloc.models.conftest import trainer

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


def as_lists(batches, descriptors):
    label, same = (torch.cat([batch[key] for batch in batches]).tolist() for key in ("label", "same"))
    return descriptors[0].tolist(), descriptors[1].tolist(), label, same


def test_loss_of_a_step_is_that_of_two_separate_passes():
    module, batch = make(), draw_pairs()
    d0, d1 = (module.network(batch[key].float() / 255) for key in ("first", "second"))
    expected = ContrastiveLoss(2.0)(d0, d1, batch["label"])
    torch.testing.assert_close(module.training_step(batch, 1), expected)


def test_both_images_go_through_the_network_in_one_pass():
    module, batch = make(), draw_pairs(count=5)
    seen = []
    module.network.register_forward_pre_hook(lambda network, inputs: seen.append(inputs[0].shape))
    module.training_step(batch, 1)
    assert seen == [(10, 3, *SIZE)]


def test_bytes_and_floating_point_give_one_loss():
    module, batch = make(), draw_pairs()
    as_floats = batch | {key: batch[key].float() / 255 for key in ("first", "second")}
    assert torch.equal(module.training_step(batch, 1), module.training_step(as_floats, 1))


def test_fit_lowers_the_loss_and_logs_finite_figures():
    module = make(learning_rate=0.01)
    batch = draw_pairs(16)
    first_loss = module.training_step(batch, 1).item()
    module.train_statistics.reset()
    training = trainer(max_epochs=15)
    training.fit(module, loader(batch), loader(draw_pairs(16, seed=1)))
    logged = training.callback_metrics
    groups = [f"{name}_{group}" for name in ("accuracy", "distance") for group in ("same", "different")]
    names = ["loss", "active", "accuracy", "spread", *groups]
    assert {f"{stage}/{name}" for stage in ("train", "val") for name in names} | {"loss_step"} == set(logged)
    assert all(math.isfinite(value) for value in logged.values())
    assert logged["train/loss"] < 0.5 * first_loss


def test_validation_figures_are_pooled_over_unequal_batches():
    module = make()
    batches = [draw_pairs(2, 1, same=False), draw_pairs(7, 2), draw_pairs(1, 3, same=True)]
    training = trainer()
    training.validate(module, loader(*batches), verbose=False)
    descriptors = [
        torch.from_numpy(as_descriptor(module).describe(torch.cat([batch[key] for batch in batches])).position)
        for key in ("first", "second")
    ]
    expected = pair_statistics(*as_lists(batches, descriptors), 2.0)
    logged = {name.removeprefix("val/"): value.item() for name, value in training.callback_metrics.items()}
    assert logged == pytest.approx(expected, rel=1e-4)


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
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        Optimizer(**options)


def triplet_like(d0, d1, y):
    return ((d0 - d1).abs().sum(1) * (1 - 2 * y)).mean()


def test_any_function_is_a_loss():
    module, batch = make(loss=triplet_like), draw_pairs()
    training = trainer()
    training.fit(module, loader(batch), loader(draw_pairs(seed=1)))
    d0, d1 = (torch.from_numpy(as_descriptor(module).describe(draw_pairs(seed=1)[key]).position) for key in KEYS)
    logged = training.callback_metrics
    assert logged["val/loss"].item() == pytest.approx(
        triplet_like(d0, d1, draw_pairs(seed=1)["label"]).item(), abs=1e-3
    )
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


def test_a_batch_with_missing_columns_is_refused():
    batch = draw_pairs()
    del batch["same"]
    with pytest.raises(DataError, match="needs first, second, label, same; missing: same"):
        make().training_step(batch, 0)


@pytest.mark.parametrize("stage", ["train", "val"])
def test_a_training_that_diverges_is_stopped_before_its_epoch_is_saved(stage):
    module = make(learning_rate=0.5)
    descriptors = torch.zeros(4, 5)
    loss = torch.tensor(float("nan"))
    getattr(module, f"{stage}_statistics").update(
        descriptors, torch.ones(2), loss, torch.tensor([True, False]), torch.zeros(2)
    )
    end = module.on_train_epoch_end if stage == "train" else module.on_validation_epoch_end
    with pytest.raises(ConfigError, match=f"diverged: {stage}/loss of epoch 1 is nan; .* than 0.5"):
        end()
