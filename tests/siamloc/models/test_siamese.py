"""The Lightning module: steps, logs, optimizers, and describing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from analytic import Description, Descriptor
from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, DataError
from siamloc.models import ContrastiveLoss, SiameseModule
from tests.oracles.contrastive import pair_statistics

ensure_torchvision()
from lightning.pytorch import Trainer  # noqa: E402
from lightning.pytorch.callbacks import ModelCheckpoint  # noqa: E402
from lightning.pytorch.loggers import TensorBoardLogger  # noqa: E402

SIZE = (32, 64)


def make(branch="simple1", **options):
    return SiameseModule(branch, "fc500_500_5", SIZE, **options)


def draw_pairs(count=8, seed=0, same=None):
    generator = torch.Generator().manual_seed(seed)
    first, second = torch.randint(0, 256, (2, count, 3, *SIZE), generator=generator, dtype=torch.uint8)
    same = torch.rand(count, generator=generator) < 0.5 if same is None else torch.full((count,), same)
    return {"first": first, "second": second, "label": (~same).float(), "same": same}


def loader(*batches):
    return DataLoader(list(batches), batch_size=None)


def trainer(**options):
    quiet = {
        "accelerator": "cpu",
        "max_epochs": 1,
        "logger": False,
        "enable_checkpointing": False,
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "log_every_n_steps": 1,
    }
    return Trainer(**(quiet | options))


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
    names = ["loss", "accuracy", "accuracy_same", "accuracy_different", "distance_same", "distance_different", "spread"]
    assert {f"{stage}/{name}" for stage in ("train", "val") for name in names} | {"loss_step"} == set(logged)
    assert all(math.isfinite(value) for value in logged.values())
    assert logged["train/loss"] < 0.5 * first_loss


def test_validation_figures_are_pooled_over_unequal_batches():
    module = make()
    batches = [draw_pairs(2, 1, same=False), draw_pairs(7, 2), draw_pairs(1, 3, same=True)]
    training = trainer()
    training.validate(module, loader(*batches), verbose=False)
    descriptors = [
        torch.from_numpy(module.describe(torch.cat([batch[key] for batch in batches])).position)
        for key in ("first", "second")
    ]
    expected = pair_statistics(*as_lists(batches, descriptors), 2.0)
    logged = {name.removeprefix("val/"): value.item() for name, value in training.callback_metrics.items()}
    assert logged == pytest.approx(expected, rel=1e-4)


def test_an_epoch_without_same_room_pairs_logs_no_nan():
    training = trainer()
    training.validate(make(), loader(draw_pairs(3, same=False)), verbose=False)
    assert "val/accuracy_same" not in training.callback_metrics
    assert all(math.isfinite(value) for value in training.callback_metrics.values())


def test_figures_start_anew_in_every_epoch():
    module, training = make(), trainer()
    for batch in (draw_pairs(4, same=True), draw_pairs(4, same=False)):
        training.validate(module, loader(batch), verbose=False)
    assert "val/accuracy_same" not in training.callback_metrics


def test_the_validation_figures_can_be_monitored(tmp_path):
    best = ModelCheckpoint(tmp_path, monitor="val/loss")
    training = trainer(callbacks=[best], enable_checkpointing=True, num_sanity_val_steps=0)
    training.fit(make(), loader(draw_pairs()), loader(draw_pairs(seed=1)))
    assert best.best_model_score == training.callback_metrics["val/loss"]


def test_a_tensorboard_logger_gets_one_picture_of_pairs_per_epoch(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    logger = TensorBoardLogger(tmp_path)
    training = trainer(max_epochs=2, logger=logger)
    training.fit(make(), loader(draw_pairs(8), draw_pairs(8, 1)), loader(draw_pairs(2, 2)))
    logger.finalize("success")
    events = EventAccumulator(logger.log_dir)
    events.Reload()
    assert sorted(events.Tags()["images"]) == ["train/pairs", "val/pairs"]
    for tag, pairs in (("train/pairs", 6), ("val/pairs", 2)):
        pictures = events.Images(tag)
        assert len(pictures) == 2
        assert (pictures[0].width, pictures[0].height) == (64, pairs * (16 + 2 * (32 + 2)))


@pytest.mark.parametrize(
    ("optimizer", "kind"), [("sgd", torch.optim.SGD), ("adam", torch.optim.Adam), ("adamw", torch.optim.AdamW)]
)
def test_optimizers(optimizer, kind):
    module = make(optimizer=optimizer, learning_rate=0.02, momentum=0.7, weight_decay=0.01)
    made = module.configure_optimizers()
    assert type(made) is kind
    group = made.param_groups[0]
    assert (group["lr"], group["weight_decay"]) == (0.02, 0.01)
    assert (group["momentum"] if optimizer == "sgd" else group["betas"][0]) == 0.7
    assert {id(p) for p in group["params"]} == {id(p) for p in module.network.parameters()}


def test_defaults_are_those_of_the_thesis():
    group = make().configure_optimizers().param_groups[0]
    assert (group["lr"], group["momentum"], group["weight_decay"]) == (0.001, 0.9, 0)
    assert make().loss.margin == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"optimizer": "sdg"}, r"unknown optimizer 'sdg': did you mean 'sgd'\?"),
        ({"learning_rate": 0}, "learning_rate must be positive"),
        ({"learning_rate": float("nan")}, "learning_rate must be positive"),
        ({"momentum": 1}, r"momentum must be in \[0, 1\)"),
        ({"momentum": -0.1}, r"momentum must be in \[0, 1\)"),
        ({"weight_decay": -1}, "weight_decay must not be negative"),
        ({"margin": 0}, "margin must be positive"),
        ({"branch": "simple3"}, "unknown branch 'simple3'"),
    ],
)
def test_hyperparameters_out_of_range_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        make(**options)


def test_a_batch_with_missing_columns_is_refused():
    batch = draw_pairs()
    del batch["same"]
    with pytest.raises(DataError, match="needs first, second, label, same; missing: same"):
        make().training_step(batch, 0)


def test_labels_with_a_second_axis_are_refused():
    batch = draw_pairs(4)
    batch["label"] = batch["label"][:, None]
    with pytest.raises(DataError, match=r"got \(4, 1\)"):
        make().training_step(batch, 0)


def test_it_is_a_descriptor():
    module = make()
    assert isinstance(module, Descriptor)
    assert (module.name, module.default_distance) == ("siamese", "euclidean")
    assert module.identity == module.network.identity
    images = draw_pairs()["first"]
    described = module.describe(images)
    assert isinstance(described, Description)
    assert described.orientation is None
    assert described.position.dtype == np.float32
    assert described.position.shape == (len(images), 5)
    apart = module.pairwise(described, described)
    assert apart[1, 2] == pytest.approx(np.linalg.norm(described.position[1] - described.position[2]), rel=1e-5)


@pytest.mark.parametrize("branch", ["simple1", "vgg11_bn"])
def test_a_description_depends_on_no_other_image_of_the_batch(branch):
    module, images = make(branch), draw_pairs(5)["first"]
    together = module.describe(images).position
    singles = np.concatenate([module.describe(image).position for image in images])
    np.testing.assert_allclose(together, singles, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(together, module.describe(images, chunk=2).position, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(together, module.describe(images.flip(0)).position[::-1], rtol=1e-4, atol=1e-5)


def test_arrays_tensors_bytes_and_floating_point_are_described_alike():
    module, images = make(), draw_pairs(3)["first"]
    expected = module.describe(images).position
    for same in (images.numpy(), images.float() / 255, images.numpy() / 255.0, (images / 255).numpy()):
        np.testing.assert_allclose(module.describe(same).position, expected, atol=1e-5)
    np.testing.assert_allclose(module.describe(images[0].numpy()).position, expected[:1], atol=1e-5)


def test_grey_images_are_repeated_over_the_channels():
    module, grey = make(), draw_pairs(2)["first"][:, 0]
    expected = module.describe(grey[:, None].repeat(1, 3, 1, 1)).position
    np.testing.assert_array_equal(module.describe(grey).position, expected)
    np.testing.assert_allclose(module.describe(grey[0]).position, expected[:1], atol=1e-5)


def test_describing_restores_the_mode_of_every_part():
    module = make("vgg11_bn").train()
    frozen = module.network.branch.features[1].eval()
    statistics = module.network.branch.features[5].running_mean.clone()
    module.describe(draw_pairs(2)["first"])
    assert not frozen.training
    assert all(part.training for part in module.modules() if part is not frozen)
    assert torch.equal(module.network.branch.features[5].running_mean, statistics)
    with pytest.raises(DataError):
        module.describe(np.zeros((2, 3, 5, 5), np.uint8))
    assert module.network.training
    module.training_step(draw_pairs(2), 1).backward()
    assert module.network.head.layers[1].weight.grad is not None


def test_describing_is_in_full_precision_under_autocast():
    module, images = make(), draw_pairs(3)["first"]
    expected = module.describe(images).position
    with torch.autocast("cpu", dtype=torch.bfloat16):
        np.testing.assert_array_equal(module.describe(images).position, expected)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (np.zeros((2, 4, *SIZE), np.uint8), "images must have shape"),
        (np.zeros((0, 3, *SIZE), np.uint8), "images must have shape"),
        (np.zeros((2, 3, 64, 32), np.uint8), r"shape \(B, 3, 32, 64\)"),
        (np.zeros((2, 3, *SIZE), np.int64), "uint8 or floating point"),
        (np.full((2, 3, *SIZE), 200.0), r"must lie in \[0, 1\]"),
        (np.full((2, 3, *SIZE), -0.5), r"must lie in \[0, 1\]"),
        (np.full((2, 3, *SIZE), np.nan), r"must lie in \[0, 1\]"),
    ],
)
def test_images_that_cannot_be_described_are_refused(images, message):
    with pytest.raises(DataError, match=message):
        make().describe(images)


@pytest.mark.parametrize("stage", ["train", "val"])
def test_a_training_that_diverges_is_stopped_before_its_epoch_is_saved(stage):
    module = make(learning_rate=0.5)
    descriptors = torch.zeros(4, 5)
    losses = torch.tensor([1.0, float("nan")])
    getattr(module, f"{stage}_statistics").update(descriptors, torch.ones(2), losses, torch.tensor([True, False]))
    end = module.on_train_epoch_end if stage == "train" else module.on_validation_epoch_end
    with pytest.raises(ConfigError, match=f"diverged: {stage}/loss of epoch 1 is nan; .* than 0.5"):
        end()
