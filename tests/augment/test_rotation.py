import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import augment
from tests.augment.pictures import generator, panoramas


def turned(batch, columns):
    effect = augment.effect("rotate")
    count = len(batch)
    return effect.apply(batch, {"shift": [columns] * count, "heading": [0.0] * count})


@given(st.integers(-200, 200), st.sampled_from([torch.uint8, torch.float32]))
def test_there_and_back_is_exact(columns, dtype):
    batch = panoramas(2, 4, 16, dtype=dtype)
    out = turned(batch, columns)
    assert torch.equal(out, batch.roll(columns, 3))
    assert torch.equal(turned(out, -columns), batch)


def test_a_turn_to_the_left_moves_the_content_right_and_adds_to_the_heading():
    effect, batch = augment.effect("rotate", degrees=90), panoramas(1, 8, 64)
    params = effect.draw(generator(), batch)
    assert params["shift"].tolist() == [16]
    assert float(params["heading"]) == pytest.approx(math.pi / 2)
    assert torch.equal(effect.apply(batch, params), batch.roll(16, 3))


def test_headings_lie_in_the_half_open_turn_and_fit_the_shift():
    params = augment.effect("rotate").draw(generator(), panoramas(2000, 1, 512))
    shift, heading = params["shift"], params["heading"]
    assert 15 <= int(shift.min()) < 18  # 10 degrees are 14.2 columns
    assert 495 < int(shift.max()) <= 497  # 350 degrees are 497.8
    assert -math.pi < float(heading.min()) <= float(heading.max()) <= math.pi + 1e-6
    apart = torch.remainder(shift * 2 * math.pi / 512 - heading, 2 * math.pi)
    assert float(torch.minimum(apart, 2 * math.pi - apart).max()) < 1e-5


def test_half_a_turn_is_plus_pi():
    params = augment.effect("rotate", degrees=180).draw(generator(), panoramas(1, 1, 64))
    assert float(params["heading"]) == pytest.approx(math.pi)


def test_a_range_narrower_than_a_column_is_the_nearest_column():
    params = augment.effect("rotate", degrees=(44, 45)).draw(generator(), panoramas(5, 1, 36))
    assert set(params["shift"].tolist()) == {4}


def test_an_ordinary_camera_is_not_turned():
    params = augment.effect("rotate", circular=False).draw(generator(), panoramas(5))
    assert not params["shift"].any()
    assert not params["heading"].any()
