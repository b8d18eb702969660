import pytest
import torch

import augment
from tests.augment.pictures import generator, panoramas

GREY = torch.full((1, 3, 128, 512), 100, dtype=torch.uint8)


def placed(name, column, row, intensity=100.0, **params):
    effect = augment.effect(name, radius=30, intensity=intensity, **params)
    drawn = effect.at(1, GREY)
    drawn["column"][0], drawn["row"][0] = column, row
    return effect.apply(GREY, drawn)[0, 0].int()


@pytest.mark.parametrize("name", ["bulb", "square", "trapezoid"])
def test_without_wrapping_a_spot_ends_at_the_border(name):
    across = placed(name, 3, 64, circular=False)
    assert across[64, 0] > 100
    assert (across[:, 256:] == 100).all()


def test_tone_any_draws_both():
    batch = panoramas(64, 8, 16)
    light = augment.effect("square").draw(generator(), batch)["light"]
    assert 15 < int(light.sum()) < 49
    assert augment.effect("square", tone="dark").draw(generator(), batch)["light"].sum() == 0
