"""A loss or a gradient that is not finite: the training stops, the batch and the last checkpoint are kept."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import siamloc
from foundation.files import read_json
from siamloc.errors import ConfigError, StorageError
from siamloc.models.weights import read_checkpoint
from siamloc.training import guard
from tests.siamloc.training.conftest import SETTINGS, network

PAIRS = {"batch_size": 4, "optimizer": {"name": "adamw"}}


class Bad(torch.autograd.Function):
    """Passes a value on, with a gradient that is not a number."""

    @staticmethod
    def forward(ctx, value):
        return value.clone()

    @staticmethod
    def backward(ctx, grad):
        return grad * float("nan")


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
        return loss * float("inf") if self.what == "loss" else Bad.apply(loss)


@pytest.mark.parametrize("what", ["loss", "gradient"])
def test_the_batch_of_places_that_did_it_is_kept(images, drives, tmp_path, what):
    options = {"augmentation": "lighting", "validation": drives[1], "epochs": 3, **SETTINGS}
    net = network()
    says = {"loss": "the loss is inf", "gradient": r"the gradient is not finite \(the loss is "}[what]
    with pytest.raises(ConfigError, match=rf"the training diverged: {says}.*in epoch 2, step 3; its batch is kept in "):
        siamloc.training.fit(net, images, drives[0], run=tmp_path / "run", loss=Turns(8, what), **options)
    run = siamloc.training.Run(tmp_path / "run")
    kept = np.load(run.folder / "bad_batch.npz", allow_pickle=False)
    assert (kept["epoch"], kept["batch"]) == (1, 2)
    assert np.isfinite(kept["loss"]) == (what == "gradient")
    data = siamloc.training.PlaceDataModule(
        images,
        drives[0],
        places=siamloc.training.PlaceSettings(**SETTINGS["pairs"]),
        augmentation=siamloc.training.BatchAugmentation(
            siamloc.training.fitting.effect_of("lighting", circular=images.circular)[0]
        ),
    )
    expected = data.train_dataloader().dataset[1, 2]
    assert all(np.array_equal(kept[name], value.numpy(), equal_nan=True) for name, value in expected.items())
    assert kept["images_path"].tolist() == drives[0].path[kept["frame"]].tolist()
    # What was learned before is there, in the run and in the network.
    assert read_checkpoint(run.checkpoint("last"))["epoch"] == 0
    assert all(bool(torch.isfinite(weight).all()) for weight in net.parameters())
    assert "bad_batch.npz" in read_json(run.record)["written"]
    again = siamloc.training.fit(network(), images, drives[0], run=run, overwrite=True, epochs=1, **SETTINGS)
    assert not (again.folder / "bad_batch.npz").exists()


def test_the_pairs_that_did_it_are_kept_even_where_there_is_no_checkpoint(images, drives, tmp_path):
    with pytest.raises(ConfigError, match=r"in epoch 1, step 4; its batch is kept in .*bad_batch\.npz"):
        siamloc.training.fit(
            network(), images, drives[0], run=tmp_path / "run", loss=Turns(3), augment_where="gpu", epochs=1, **PAIRS
        )
    kept = np.load(tmp_path / "run" / "bad_batch.npz", allow_pickle=False)
    assert kept["first"].shape == kept["second"].shape == (4, 3, 16, 64)
    for side in ("first", "second"):
        rows = [images.frames.path.tolist().index(path) for path in kept[f"{side}_path"]]
        assert np.array_equal(images.batch(rows), kept[side])
    assert kept["label"].shape == (4,)


def test_what_is_no_number_from_the_start_is_not_blamed_on_the_learning_rate(images, drives, tmp_path):
    with pytest.raises(ConfigError, match=r"epoch 1, step 1, before anything was learned.*kept in") as raised:
        siamloc.training.fit(network(), images, drives[0], run=tmp_path / "run", loss=Turns(0), epochs=1, **PAIRS)
    assert "learning_rate" not in str(raised.value)


def test_a_batch_that_cannot_be_kept_does_not_hide_the_reason(images, drives, tmp_path, monkeypatch):
    def full(*_, **__):
        raise StorageError("no space left")

    monkeypatch.setattr(guard, "atomic_path", full)
    with pytest.raises(ConfigError, match=r"the loss is inf .*its batch could not be kept: no space left"):
        siamloc.training.fit(network(), images, drives[0], run=tmp_path / "run", loss=Turns(1), epochs=1, **PAIRS)


def test_a_file_in_the_way_is_not_replaced(images, drives, tmp_path):
    run = siamloc.training.fit(network(), images, drives[0], run=tmp_path / "run", epochs=1, **PAIRS)
    (run.folder / "bad_batch.npz").write_text("mine")
    with pytest.raises(ConfigError, match=r"bad_batch\.npz would be replaced, but siamloc did not write it"):
        siamloc.training.fit(network(), images, drives[0], run=run, epochs=1, overwrite=True, **PAIRS)
