import numpy as np

from analytic import descriptor


def test_descriptions_stay_closer_when_the_light_changes():
    images = np.random.default_rng(7).uniform(0.2, 0.8, (4, 32, 96))
    light = 0.6 + 0.3 * np.cos(2 * np.pi * np.arange(96) / 96) + 0.1 * np.linspace(-1, 1, 32)[:, None]
    apart = []
    for filtered in (False, True):
        hog = descriptor("hog", rows=4, bins=8, window=8, orientation_bins=8, homomorphic=filtered)
        apart.append(np.diag(hog.pairwise(hog.describe(images * light), hog.describe(images))))
    assert (apart[1] < apart[0]).all()
