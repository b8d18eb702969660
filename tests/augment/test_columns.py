import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import augment
from tests.augment.pictures import generator, panoramas

WHITE = torch.full((40, 3, 4, 200), 255, dtype=torch.uint8)


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
    half = augment.effect("rotate", degrees=180).draw(generator(), panoramas(1, 1, 64))
    assert float(half["heading"]) == pytest.approx(math.pi)
    apart = torch.remainder(shift * 2 * math.pi / 512 - heading, 2 * math.pi)
    assert float(torch.minimum(apart, 2 * math.pi - apart).max()) < 1e-5


def test_a_range_narrower_than_a_column_is_the_nearest_column():
    params = augment.effect("rotate", degrees=(44, 45)).draw(generator(), panoramas(5, 1, 36))
    assert set(params["shift"].tolist()) == {4}


def test_an_ordinary_camera_is_not_turned():
    params = augment.effect("rotate", circular=False).draw(generator(), panoramas(5))
    assert not params["shift"].any()
    assert not params["heading"].any()


@given(st.sampled_from([0.05, 0.1, 0.2, 0.4, 1.0]), st.integers(1, 4), st.integers(0, 99))
def test_hides_the_share_in_so_many_bars(share, bars, seed):
    effect = augment.effect("occlude", share=share, bars=bars)
    out = effect(WHITE, generator(seed))
    hidden = out[:, 0, 0] == 0
    assert torch.equal(hidden[:, None, None].expand_as(out), out == 0)
    assert float((hidden.sum(1) - 200 * share).abs().max()) <= bars / 2 + 1e-6
    edges = (hidden != hidden.roll(1, 1)).sum(1)
    assert bool((edges <= 2 * bars).all())


def test_bars_stand_everywhere_and_differ_between_frames():
    hidden = augment.effect("occlude", share=0.3)(WHITE, generator())[:, 0, 0] == 0
    assert bool(hidden.any(0).all())
    assert len({tuple(row.tolist()) for row in hidden}) == 40


def test_bars_do_not_wrap_where_columns_do_not():
    hidden = augment.effect("occlude", share=0.4, bars=1, circular=False)(WHITE, generator())[:, 0, 0] == 0
    assert not (hidden[:, 0] & hidden[:, -1]).any()
