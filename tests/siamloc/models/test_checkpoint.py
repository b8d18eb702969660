"""Checkpoints come back as they were, run nothing, and are refused in one sentence when damaged."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import FormatError
from siamloc.models import SiameseModule, build, read_hyperparameters

ensure_torchvision()
from lightning.pytorch import Trainer  # noqa: E402

SIZE = (32, 64)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A module trained for one step, and its checkpoint."""
    path = tmp_path_factory.mktemp("checkpoint") / "last.ckpt"
    module = SiameseModule("vgg11_bn", "fc500_100_10", SIZE, margin=1.5, momentum=0.5, seed=7)
    images = torch.randint(0, 256, (2, 3, 3, *SIZE), dtype=torch.uint8)
    batch = {"first": images[0], "second": images[1], "label": torch.ones(3), "same": torch.zeros(3, dtype=torch.bool)}
    trainer = Trainer(
        accelerator="cpu",
        max_epochs=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(module, DataLoader([batch], batch_size=None), DataLoader([batch], batch_size=None))
    trainer.save_checkpoint(path)
    return module, path


def altered(path, target, **changes):
    content = torch.load(path, weights_only=True)
    torch.save({key: value for key, value in (content | changes).items() if value is not None}, target)
    return target


def test_a_loaded_module_describes_like_the_trained_one(trained):
    module, path = trained
    loaded = SiameseModule.load(path)
    images = np.random.default_rng(0).random((3, 3, *SIZE), dtype=np.float32)
    np.testing.assert_array_equal(loaded.describe(images).position, module.describe(images).position)
    assert loaded.identity == module.identity
    assert dict(loaded.hparams) == dict(module.hparams)
    assert not loaded.training
    assert loaded.loss.margin == 1.5


def test_hyperparameters_are_plain_values(trained):
    _, path = trained
    assert read_hyperparameters(path) == {
        "branch": "vgg11_bn",
        "head": "fc500_100_10",
        "image_size": (32, 64),
        "weights": None,
        "margin": 1.5,
        "optimizer": "sgd",
        "learning_rate": 0.001,
        "momentum": 0.5,
        "weight_decay": 0.0,
        "seed": 7,
    }


def test_lightning_loads_the_checkpoint_as_well(trained):
    module, path = trained
    loaded = SiameseModule.load_from_checkpoint(path, map_location="cpu", weights_only=True)
    assert loaded.identity == module.identity


def test_loading_downloads_and_reads_nothing_else(trained, tmp_path):
    module, path = trained
    for weights in ("imagenet", "/nowhere/weights.pth"):
        hyperparameters = read_hyperparameters(path) | {"weights": weights}
        loaded = SiameseModule.load(altered(path, tmp_path / "a.ckpt", hyper_parameters=hyperparameters))
        assert loaded.identity == module.identity
        assert loaded.hparams["weights"] == weights


def test_training_can_start_from_a_checkpoint(trained):
    module, path = trained
    network = build("vgg11_bn", "fc500_100_10", SIZE, weights=path, seed=1)
    assert network.identity == module.identity


class Attack:
    def __reduce__(self):
        return (Path.touch, (Path("attack"),))


@pytest.mark.parametrize("damage", ["missing", "cut", "empty", "text", "attack"])
@pytest.mark.parametrize("read", [SiameseModule.load, read_hyperparameters])
def test_damaged_files_are_refused_in_one_sentence(trained, tmp_path, monkeypatch, damage, read):
    _, path = trained
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "model.ckpt"
    if damage == "cut":
        file.write_bytes(path.read_bytes()[:-1000])
    elif damage == "empty":
        file.touch()
    elif damage == "text":
        file.write_text("a checkpoint, they said")
    elif damage == "attack":
        file.write_bytes(pickle.dumps({"state_dict": Attack(), "hyper_parameters": {}}))
    with pytest.raises(FormatError, match=r"model\.ckpt (does not exist|cannot be read)") as info:
        read(file)
    assert "\n" not in str(info.value)
    assert not (tmp_path / "attack").exists()


def test_other_files_of_torch_are_no_checkpoints(trained, tmp_path):
    module, path = trained
    torch.save(module.network.state_dict(), tmp_path / "weights.pth")
    with pytest.raises(FormatError, match="no checkpoint of a siamese network"):
        SiameseModule.load(tmp_path / "weights.pth")
    with pytest.raises(FormatError, match="no checkpoint of a siamese network"):
        SiameseModule.load(altered(path, tmp_path / "a.ckpt", hyper_parameters=None))


def test_a_newer_format_is_refused(trained, tmp_path):
    _, path = trained
    with pytest.raises(FormatError, match=r"has format 99, this version of siamloc reads up to 1: update siamloc"):
        SiameseModule.load(altered(path, tmp_path / "a.ckpt", siamloc_format=99))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"branch": "vgg13_bn"}, r"another architecture than its hyper-parameters say \(vgg13_bn \+ fc500_100_10\)"),
        ({"head": "fc500_500_5"}, "another architecture.*of another shape"),
        ({"branch": "resnet50"}, "names a network that cannot be made: unknown branch 'resnet50'"),
        ({"flavour": 3}, "names a network that cannot be made: .*flavour"),
    ],
)
def test_weights_that_do_not_fit_the_hyperparameters_are_refused(trained, tmp_path, changes, message):
    _, path = trained
    hyperparameters = read_hyperparameters(path) | changes
    with pytest.raises(FormatError, match=message):
        SiameseModule.load(altered(path, tmp_path / "a.ckpt", hyper_parameters=hyperparameters))
