"""Checkpoints on a disk that refuses, and what a killed run leaves."""

from __future__ import annotations

import resource
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch

import siamloc
from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, StorageError
from siamloc.training.callbacks import AtomicCheckpoints

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Let the operating system cut files short, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_fills_up_is_one_sentence_and_leaves_the_checkpoint_before(tmp_path):
    path = tmp_path / "last.ckpt"
    AtomicCheckpoints().save_checkpoint({"epoch": 1}, path)
    with files_of_at_most(1 << 16), pytest.raises(StorageError) as raised:
        AtomicCheckpoints().save_checkpoint({"epoch": 2, "weights": torch.zeros(1 << 20)}, path)
    assert str(raised.value) == (
        f"the checkpoint {path} could not be written whole: free some space on the disk or write elsewhere"
    )
    assert torch.load(path, weights_only=True) == {"epoch": 1}
    assert list(tmp_path.iterdir()) == [path]


class Fixed(torch.nn.Module):
    """A network that learns nothing: a row of pixels, of length 1 or times a scale."""

    def __init__(self, scale=None):
        super().__init__()
        self.weight, self.scale = torch.nn.Parameter(torch.ones(1)), scale

    def forward(self, panorama):
        row = panorama[:, 0, :1].flatten(1) * (1 + 0 * self.weight)
        return torch.nn.functional.normalize(row) if self.scale is None else self.scale * row


ONE_BATCH = {"epoch_batches": 1}


def test_a_training_without_progress_stops_early_and_says_so(train, drives, capfd):
    def fit(**more):
        return train(Fixed(), validation=drives[1], epochs=9, pairs=ONE_BATCH, **more)

    assert fit(patience=2).curves()["epoch"].tolist() == [0, 1, 2]
    said = capfd.readouterr().err
    assert "stopped early after epoch 3 of 9, none of the last 2 was better, best epoch 1 by val/error" in said
    # It has finished, unless it is given more time.
    assert len(fit(patience=2, resume=True).curves()["epoch"]) == 3
    assert len(fit(patience=4, resume=True).curves()["epoch"]) == 5
    assert "stopped early after epoch 5 of 9" in capfd.readouterr().err


def test_epochs_without_validation_have_no_figures_of_it_and_do_not_count_for_patience(train, drives, capfd):
    options = {"validation": drives[1], "epochs": 9, "patience": 1, "trainer": {"check_val_every_n_epoch": 2}}
    run = train(Fixed(), pairs=ONE_BATCH, **options)
    assert np.isfinite(run.curves()["val/error"]).tolist() == [False, True, False, True]
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("epoch ")]
    assert ["val/error" in line for line in said] == [False, True, False, True]


def test_a_run_that_was_moved_still_knows_its_best_epoch(train, drives, tmp_path):
    run = train(Fixed(), validation=drives[1], run="here", pairs=ONE_BATCH)
    moved = run.folder.rename(tmp_path / "there")
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*dirpath has changed")
        run = train(Fixed(), validation=drives[1], run=moved, epochs=3, resume=True, pairs=ONE_BATCH)
    assert len(run.curves()["epoch"]) == 3
    assert torch.load(run.checkpoint("best"), weights_only=True)["epoch"] == 0
    assert not (tmp_path / "here").exists()


@pytest.mark.parametrize("loss", [None, lambda d0, d1, y: (y * (d0 - d1).square().sum(1)).mean()])
def test_pairs_that_come_to_nothing_are_said(images, drives, tmp_path, capfd, loss):
    """By the margin, or without one by how far apart the descriptors have been."""
    network = Fixed(1e-4 if loss is None else 1.0)
    monday, shrink = drives[0], Shrink(1e-4)
    options = {"loss": loss, "trainer": {"accelerator": "cpu", "callbacks": [shrink]}, "epochs": 2}
    siamloc.training.fit(network, images, monday, run=tmp_path / "run", **options)
    warnings = [line for line in capfd.readouterr().err.splitlines() if line.startswith("warning")]
    assert len(warnings) == (2 if loss is None else 1)
    assert warnings[-1].startswith("warning: the network gives nearly every image the same descriptor, train/spread is")
    assert "or with more pairs of different places" in warnings[-1]


class Shrink(Callback):
    """Let descriptors fall together after the first epoch."""

    def __init__(self, factor):
        self.factor = factor

    def on_train_epoch_end(self, trainer, pl_module):
        pl_module.network.scale *= self.factor


def test_pairs_that_have_nothing_left_to_teach_are_said(images, drives, tmp_path, capfd):
    options = {"trainer": {"accelerator": "cpu"}, "epochs": 1, "pairs": {"label": "room"}}
    siamloc.training.fit(
        Fixed(1e3), images, drives[0], run=tmp_path / "run", optimizer={"learning_rate": 1e-9}, **options
    )
    said = capfd.readouterr().err
    assert "train/active 0.0000" in said
    assert "warning: hardly any pairs of different places contribute to the loss, train/active is 0.00%: if the" in said


def test_patience_needs_a_validation(train, tmp_path):
    with pytest.raises(ConfigError, match="patience=3 counts epochs without a better validation, and nothing is valid"):
        train(Fixed(), patience=3)
    assert not (tmp_path / "run").exists()


def test_an_average_follows_its_formula_step_by_step(train):
    class Noted(Callback):
        """Must stand before the average among the callbacks."""

        def __init__(self):
            self.weights = []

        def on_train_batch_end(self, trainer, pl_module, *_):
            self.weights.append([weight.detach().clone() for weight in pl_module.parameters()])

    noted = Noted()
    net = siamloc.models.build("simple1", "flat", (16, 64), outputs=16, seed=0)
    train(net, average=0.9, trainer={"callbacks": [noted]})
    average, *later = noted.weights
    for now in later:
        average = [held + (1 - 0.9) * (weight - held) for held, weight in zip(average, now, strict=True)]
    assert len(later) == 5
    assert all(torch.equal(*pair) for pair in zip(average, net.parameters(), strict=True))


def test_an_average_leaves_what_does_not_change_exactly_as_it_is(train):
    """Frozen stages stay as they were, to the last bit, even if the weights that are kept are an average."""
    optimizer = {"name": "adamw", "learning_rate": 0.01, "frozen_stages": 1}
    net = siamloc.models.build("simple1", "flat", (16, 64), outputs=16, seed=0)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    train(net, epochs=3, average=0.98, optimizer=optimizer)
    after = net.state_dict()
    assert all(torch.equal(after[name], before[name]) for name in before if name.startswith("branch."))
    assert not torch.equal(after["head.layer.weight"], before["head.layer.weight"])
