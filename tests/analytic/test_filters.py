import numpy as np

from analytic import descriptor
from analytic.filters import homomorphic
from analytic.images import unit, with_channels

RNG = np.random.default_rng(7)
LUMA = np.array([0.299, 0.587, 0.114])[:, None, None]


def filtered(images, **options):
    return homomorphic(unit(with_channels(images)), **options).reshape(np.shape(images))


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


def test_light_is_taken_off():
    lit = IMAGES * light()
    bare, even, of_lit = IMAGES, filtered(IMAGES), filtered(lit)
    for k in range(len(IMAGES)):
        before = np.abs(lit[k] - bare[k]).mean() / bare[k].mean()
        assert np.abs(of_lit[k] - even[k]).mean() / even[k].mean() < 0.75 * before
        assert np.abs(of_lit[k] - bare[k]).mean() / bare[k].mean() < 0.75 * before
        same = np.corrcoef(lit[k].ravel(), bare[k].ravel())[0, 1]
        assert np.corrcoef(of_lit[k].ravel(), bare[k].ravel())[0, 1] > same


def test_descriptions_stay_closer_when_the_light_changes():
    lit = IMAGES * light()
    params = {"rows": 4, "bins": 8, "window": 8, "orientation_bins": 8}
    apart = {}
    for even in (False, True):
        hog = descriptor("hog", **params, homomorphic=even)
        apart[even] = np.diag(hog.pairwise(hog.describe(lit), hog.describe(IMAGES))).mean()
    assert apart[True] < apart[False]


def test_colour_keeps_its_luma_and_its_ratios():
    colour = 0.2 + 0.3 * RNG.uniform(size=(3, 16, 24))
    found = filtered(colour)
    np.testing.assert_allclose((found * LUMA).sum(0), filtered((colour * LUMA).sum(0)), atol=1e-5)
    gain = (found + 1 / 255) / (colour + 1 / 255)
    np.testing.assert_allclose(gain[0], gain[1], rtol=1e-4)
