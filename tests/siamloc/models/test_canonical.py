"""Panoramas in their canonical direction: turning the robot by any whole column changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from siamloc.errors import ConfigError
from siamloc.models import build
from siamloc.models.network import Network
from siamloc.models.orientation import Canonical

SIZE = (32, 128)


def panoramas(count: int = 3) -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.randint(0, 256, (count, 3, *SIZE), generator=generator) / 255


def made(head: str = "fourier", canonical: bool = True) -> Network:
    return build("panoresnet", head, SIZE, circular=True, canonical=canonical).eval()


def test_the_direction_is_that_of_the_crest_of_the_first_harmonic():
    images = panoramas(20)
    turn = Canonical(16)
    turn.reset()
    _, turned = turn(images)
    signal = (images * 255).sum(dim=(1, 2)).reshape(20, -1, 16).sum(dim=1).numpy()
    phase = -np.angle(np.fft.rfft(signal)[:, 1]) * 16 / (2 * np.pi)
    apart = (turned.numpy() - phase + 8) % 16 - 8
    assert np.abs(apart).max() <= 0.5 + 1e-4  # the nearest whole column, and rounding of the transform


@pytest.mark.parametrize("head", ["fourier", "magnitudes", "gem", "bands"])
@pytest.mark.parametrize("columns", [1, 7, 16, 45])
def test_descriptors_stay_when_the_robot_turns(head: str, columns: int):
    images = panoramas()
    with torch.no_grad():
        here, there = (made(head)(one) for one in (images, images.roll(columns, dims=3)))
        without = made(head, canonical=False)
        moved = (without(images) - without(images.roll(columns, dims=3))).abs().max()
    # Sums over turned features round otherwise; without the canonical direction the change is of another order.
    torch.testing.assert_close(there, here, rtol=0, atol=1e-6)
    assert columns % 16 == 0 or moved > 1e-4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"circular": False}, "needs model.circular=true"),
        ({"head": "flat"}, "the head is flat"),
        ({"image_size": (32, 120)}, "the 120 of the panorama become .*15, 8 in panoresnet"),
        ({"image_size": (32, 124)}, "take a power of 2"),
    ],
)
def test_refused_where_it_means_nothing(changes: dict, message: str):
    options = {"branch": "panoresnet", "head": "fourier", "image_size": SIZE, "circular": True, **changes}
    with pytest.raises(ConfigError, match=message):
        build(**options, canonical=True)
