import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import augment
from augment.ranges import Range, spread


@given(st.integers(-50, 50), st.integers(0, 6))
def test_whole_numbers_come_evenly_with_both_ends(low, length):
    uniform = ((torch.arange(7000) + 0.5) / 7000)[:, None]
    values = spread(uniform, {"a": Range(low, low + length, whole=True)})["a"]
    assert values.dtype == torch.int64
    found, counts = values.unique(return_counts=True)
    assert found.tolist() == list(range(low, low + length + 1))
    assert int(counts.max() - counts.min()) <= 2


def test_the_largest_uniform_number_stays_inside():
    almost_one = torch.full((1, 1), 1 - 2**-24)
    for high in (63, 511, 2**21 - 1):
        assert int(spread(almost_one, {"a": Range(0, high, whole=True)})["a"]) == high
    assert int(spread(almost_one, {"a": Range(2**20, 2**21 - 1, whole=True)})["a"]) == 2**21 - 1


def test_logarithmic_ranges_have_their_geometric_middle_in_the_middle():
    values = spread(torch.tensor([[0.0], [0.5]]), {"a": Range(0.5, 2.0, log=True)})["a"]
    assert values.tolist() == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize(
    ("name", "params", "message"),
    [
        ("bulb", {"radius": (40, 15)}, r"radius of bulb must lie in .*, lower first, got \(40, 15\)"),
        ("bulb", {"intensity": 300}, r"intensity of bulb must lie in \[0, 255\], .*, got 300"),
        ("bulb", {"tone": "lihgt"}, "unknown tone 'lihgt' of bulb: did you mean 'light'"),
        ("gamma", {"gamma": "high"}, "gamma of gamma must be a number or a pair of them .low, high., got 'high'"),
        ("gamma", {"gamma": (1, 2, 3)}, "must be a number or a pair"),
        ("gamma", {"gamma": True}, "must be a number or a pair"),
        ("gamma", {"gamma": float("nan")}, "must be a number or a pair"),
        ("brighten", {"amount": 3.5}, "amount of brighten must be a whole number or a pair of them .*, got 3.5"),
        ("occlude", {"bars": 5}, r"bars of occlude must lie in \[1, 4\], .* got 5"),
        ("blur", {"size": 4}, "size of blur must be an odd number of pixels, got 4"),
        ("blur", {"circular": 1}, "circular of blur must be true or false, got 1"),
    ],
)
def test_ranges_that_make_no_sense(name, params, message):
    with pytest.raises(augment.AugmentError, match=message):
        augment.effect(name, **params)
