import numpy as np

from analytic import descriptor


def test_upright_and_level_edges_lie_in_the_middle_of_a_bin_despite_noise():
    hog = descriptor("hog", rows=1, bins=8, window=4, step=4, orientation_bins=8, circular=False)
    noise = np.random.default_rng(0).normal(0, 1e-3, (16, 32))
    for middle, place in ((0, np.arange(-16, 16)), (2, np.arange(-8, 8)[:, None])):
        share = hog.describe(0.5 + 0.01 * place + noise).orientation[0, 2]  # columns 8 to 11, far from the borders
        assert share[middle] > 0.95 * share.sum()
