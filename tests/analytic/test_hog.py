import numpy as np
import pytest

from analytic import AnalyticError, descriptor

RNG = np.random.default_rng(5)
IMAGES = RNG.integers(0, 256, (4, 16, 48), dtype=np.uint8)
SMALL = {"rows": 4, "bins": 8, "window": 6, "step": 2, "orientation_bins": 12}


def ramp(angle):
    """A picture in the middle of which every gradient has that direction."""
    i, j = np.mgrid[:16, :32]
    return (0.5 + 0.01 * (np.cos(angle) * (j - 16) + np.sin(angle) * (i - 8))).astype(np.float32)


@pytest.mark.parametrize("bins", [3, 4, 7, 8, 16, 32])
def test_directions_fall_into_bins_centred_on_their_multiples(bins):
    hog = descriptor("hog", rows=1, bins=bins, window=4, step=4, orientation_bins=bins, circular=False)
    for wanted in range(bins):
        for off in (-0.4, 0.4):
            part = hog.describe(ramp(2 * np.pi * (wanted + off) / bins)).orientation[0]
            inner = part[2]  # columns 8 to 11; only the first and the last row see a border
            assert inner.argmax() == wanted
            assert inner[wanted] >= 0.01 * 4 * 14 * 0.99


def test_upright_and_level_edges_lie_in_the_middle_of_a_bin_despite_noise():
    hog = descriptor("hog", rows=1, bins=8, window=4, step=4, orientation_bins=8, circular=False)
    noisy = ramp(0) + np.random.default_rng(0).normal(0, 1e-3, (16, 32)).astype(np.float32)
    share = hog.describe(noisy).orientation[0, 2]
    assert share[0] > 0.95 * share.sum()


def test_many_queries_are_aligned_as_one(monkeypatch):
    hog = descriptor("hog", **SMALL)
    queries, references = hog.describe(np.roll(IMAGES, 8, axis=-1)), hog.describe(IMAGES)
    whole = hog.align(queries, references)
    monkeypatch.setattr("analytic.alignment._VALUES", 1)
    parts = hog.align(queries, references)
    assert np.array_equal(whole.heading, parts.heading)
    np.testing.assert_allclose(whole.distance, parts.distance, rtol=1e-4, atol=0.05)


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"rows": 0}, "hog.rows must be a whole number from 1 to 16,384, got 0"),
        ({"orientation_bins": -1}, "hog.orientation_bins must be .*, got -1"),
        ({"rows": 5}, "rows=5 .* height of 16 pixels: use rows=4 or 8"),
        ({"rows": 17}, "height of 16 pixels: use rows=16"),
        ({"step": 5}, "step=5 .* width of 48 pixels: use step=4 or 6"),
        ({"window": 49}, "window=49 .* 48 columns: use at most window=48"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("hog", **{**SMALL, **params}).describe(IMAGES)
