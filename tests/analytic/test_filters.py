import numpy as np

from analytic import descriptor

RNG = np.random.default_rng(7)


def textured(count, height=32, width=96):
    """Pictures with structure at every scale, away from black and white."""
    i, j = np.mgrid[:height, :width]
    waves = sum(
        0.25 / n * np.cos(2 * np.pi * (n * 3 * j / width + RNG.uniform(0, 1, (count, 1, 1)))) * np.cos(n * i / 5)
        for n in range(1, 6)
    )
    return (0.45 + 0.5 * waves + RNG.normal(0, 0.03, (count, height, width))).clip(0.05, 0.95)


IMAGES = textured(4)


def light(width=96):
    azimuth = 2 * np.pi * np.arange(width) / width
    elevation = np.linspace(-1, 1, 32)[:, None]
    return 0.6 + 0.3 * np.cos(azimuth - 1) + 0.1 * elevation


def test_descriptions_stay_closer_when_the_light_changes():
    lit = IMAGES * light()
    params = {"rows": 4, "bins": 8, "window": 8, "orientation_bins": 8}
    apart = {}
    for even in (False, True):
        hog = descriptor("hog", **params, homomorphic=even)
        apart[even] = np.diag(hog.pairwise(hog.describe(lit), hog.describe(IMAGES))).mean()
    assert apart[True] < apart[False]
