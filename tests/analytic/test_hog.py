import numpy as np
import pytest

from analytic import descriptor


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
