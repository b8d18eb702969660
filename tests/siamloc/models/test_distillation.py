"""Distillation: what the loss rewards, that the teacher stays as it is, and that a student learns from it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader

from siamloc.errors import DataError
from siamloc.models import DistillationLoss, Optimizer, Origins, PlaceModule, build
from siamloc.models.registry import LOSSES
from tests.siamloc.models.conftest import trainer

SIZE = (16, 64)


def teacher():
    return nn.Sequential(nn.AdaptiveAvgPool2d((2, 4)), nn.Flatten())


def origins(count, **further):
    """Origins without positions or rooms."""
    nowhere = torch.full((count, 2), torch.nan)
    return Origins(nowhere, torch.zeros(count), torch.full((count,), -1), torch.arange(count), **further)


def unit(count=5, width=7, seed=0):
    return nn.functional.normalize(torch.randn(count, width, generator=torch.Generator().manual_seed(seed)), dim=1)


def test_the_loss_is_one_minus_the_cosine_of_rows_of_similarities():
    student, taught = unit(seed=1), unit(width=3, seed=2)
    expected = []
    for row in range(5):
        others = [other for other in range(5) if other != row]
        mine, theirs = ([float(one[row] @ one[other]) for other in others] for one in (student, taught))
        mine, theirs = (np.array(one) - np.mean(one) for one in (mine, theirs))
        expected.append(1 - mine @ theirs / np.linalg.norm(mine) / np.linalg.norm(theirs))
    found = DistillationLoss(teacher())(student, origins(5, taught=taught))
    assert found.item() == pytest.approx(np.mean(expected), abs=1e-5)


def test_the_best_student_is_the_teacher_turned_and_the_worst_its_opposite():
    loss, taught = DistillationLoss(teacher()), unit()
    turn = torch.linalg.qr(torch.randn(7, 7, generator=torch.Generator().manual_seed(3))).Q
    assert loss(taught @ turn, origins(5, taught=taught)).item() == pytest.approx(0, abs=1e-5)
    assert loss(unit(seed=9), origins(5, taught=taught)) > 0.1


def test_what_is_missing_is_said():
    loss = DistillationLoss(teacher())
    with pytest.raises(DataError, match="taught="):
        loss(unit(), origins(5))
    assert loss.lacks(origins(2)) is not None
    assert loss.lacks(origins(3)) is None


def test_the_teacher_is_neither_trained_nor_stored():
    own = build("simple1", "gem", SIZE)
    loss = DistillationLoss(own)
    assert list(loss.parameters()) == []
    assert loss.state_dict() == {}
    assert own.training
    assert not any(weight.requires_grad for weight in own.parameters())
    larger = torch.rand(2, 3, 32, 128)  # is scaled to the size of the teacher
    assert loss.teach(larger).shape == (2, 256)


def test_the_shipped_network_teaches_by_default():
    loss = DistillationLoss()
    assert loss.settings == {"name": "distillation", **LOSSES["distillation"][0]().plain()}
    assert loss.teach(torch.rand(2, 3, *SIZE)).shape[0] == 2


@pytest.mark.filterwarnings("ignore:You defined a `validation_step`")
def test_a_student_comes_nearer_to_its_teacher():
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(12, 3, 4, 8, generator=generator).repeat_interleave(4, 2).repeat_interleave(8, 3)
    batch = {"images": images, "xy": torch.full((12, 2), torch.nan), "frame": torch.arange(12)}
    batch |= {"building": torch.zeros(12, dtype=torch.long), "room": torch.full((12,), -1)}
    network, loss = build("simple1", "flat", SIZE), DistillationLoss(teacher())
    module = PlaceModule(network, loss, Optimizer(name="adam", learning_rate=0.003))

    def apart():
        with torch.no_grad():
            return loss(network.eval()(images), origins(12, taught=loss.teach(images))).item()

    before = apart()
    network.train()
    trainer(max_epochs=20).fit(module, DataLoader([batch], batch_size=None))
    assert apart() < 0.5 * before
