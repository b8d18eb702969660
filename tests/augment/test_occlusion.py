import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import augment
from tests.augment.pictures import generator

WHITE = torch.full((40, 3, 4, 200), 255, dtype=torch.uint8)


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


def test_level_is_the_grey_of_the_bars():
    out = augment.effect("occlude", share=0.5, level=90)(WHITE, generator())
    assert set(out.unique().tolist()) == {90, 255}


def test_bars_do_not_wrap_where_columns_do_not():
    hidden = augment.effect("occlude", share=0.4, bars=1, circular=False)(WHITE, generator())[:, 0, 0] == 0
    assert not (hidden[:, 0] & hidden[:, -1]).any()


def test_more_bars_than_there_are():
    with pytest.raises(augment.AugmentError, match=r"bars of occlude must lie in \[1, 4\], got 5"):
        augment.effect("occlude", bars=5)
