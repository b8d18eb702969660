import numpy as np
import pytest

from analytic import AnalyticError, descriptor
from analytic.filters import homomorphic

RNG = np.random.default_rng(7)
LUMA = np.array([0.299, 0.587, 0.114])[:, None, None]


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
    bare, filtered, of_lit = IMAGES, homomorphic(IMAGES), homomorphic(lit)
    for k in range(len(IMAGES)):
        before = np.abs(lit[k] - bare[k]).mean() / bare[k].mean()
        assert np.abs(of_lit[k] - filtered[k]).mean() / filtered[k].mean() < 0.75 * before
        assert np.abs(of_lit[k] - bare[k]).mean() / bare[k].mean() < 0.75 * before
        same = np.corrcoef(lit[k].ravel(), bare[k].ravel())[0, 1]
        assert np.corrcoef(of_lit[k].ravel(), bare[k].ravel())[0, 1] > same


def test_descriptions_stay_closer_when_the_light_changes():
    lit = IMAGES * light()
    params = {"rows": 4, "bins": 8, "window": 8, "orientation_bins": 8}
    apart = {}
    for filtered in (False, True):
        hog = descriptor("hog", **params, homomorphic=filtered)
        apart[filtered] = np.diag(hog.pairwise(hog.describe(lit), hog.describe(IMAGES))).mean()
    assert apart[True] < apart[False]


def test_columns_wrap_around_and_rows_do_not():
    turned = homomorphic(np.roll(IMAGES, 17, axis=-1))
    np.testing.assert_allclose(turned, np.roll(homomorphic(IMAGES), 17, axis=-1), atol=1e-5)
    lifted = homomorphic(np.roll(IMAGES * light(), 7, axis=-2))
    assert np.abs(lifted - np.roll(homomorphic(IMAGES * light()), 7, axis=-2)).max() > 1e-2
    np.testing.assert_allclose(homomorphic(IMAGES[:, ::-1]), homomorphic(IMAGES)[:, ::-1], atol=1e-5)


def test_without_a_circle_the_border_is_a_mirror():
    flat = homomorphic(IMAGES, circular=False)
    np.testing.assert_allclose(homomorphic(IMAGES[..., ::-1], circular=False), flat[..., ::-1], atol=1e-5)
    both = np.concatenate([IMAGES, IMAGES[..., ::-1]], axis=-1)
    np.testing.assert_allclose(homomorphic(both, cutoff=8)[..., :96], flat, atol=1e-5)
    assert np.abs(flat - homomorphic(IMAGES)).max() > 1e-3


def test_gains_of_one_change_nothing_and_a_constant_gets_the_low_gain():
    np.testing.assert_allclose(homomorphic(IMAGES, low=1, high=1), IMAGES, atol=1e-5)
    grey = homomorphic(np.full((8, 16), 0.25 - 1 / 255), low=0.5, high=2)
    np.testing.assert_allclose(grey, 0.5 - 1 / 255, atol=1e-5)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(16, 24), (3, 16, 24), (2, 16, 24), (2, 3, 16, 24)])
def test_shape_and_type_are_kept(shape, dtype):
    images = RNG.integers(0, 256, shape, dtype=np.uint8)
    images = images if dtype == np.uint8 else (images / 255).astype(dtype)
    kept = images.copy()
    found = homomorphic(images)
    assert (found.shape, found.dtype) == (shape, dtype)
    assert np.array_equal(images, kept)
    assert found.max() <= (255 if dtype == np.uint8 else 1)


def test_a_batch_is_its_images_and_types_agree():
    whole = homomorphic(IMAGES)
    for image, filtered in zip(IMAGES, whole, strict=True):
        np.testing.assert_allclose(homomorphic(image), filtered, atol=1e-5)
    bytes_ = np.rint(255 * IMAGES).astype(np.uint8)
    np.testing.assert_allclose(homomorphic(bytes_), 255 * homomorphic(bytes_ / 255), atol=0.51)
    np.testing.assert_allclose(homomorphic(IMAGES.astype(np.float32)), whole, atol=1e-5)


def test_colour_keeps_its_luma_and_its_ratios():
    colour = 0.2 + 0.3 * RNG.uniform(size=(3, 16, 24))
    found = homomorphic(colour, low=0.9)
    np.testing.assert_allclose((found * LUMA).sum(0), homomorphic((colour * LUMA).sum(0), low=0.9), atol=1e-5)
    gain = (found + 1 / 255) / (colour + 1 / 255)
    np.testing.assert_allclose(gain[0], gain[1], rtol=1e-4)


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_stay_finite(value):
    found = homomorphic(np.full((8, 16), value, dtype=np.uint8))
    assert (found == (0 if value == 0 else 255)).all() or found.min() == found.max()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: homomorphic(IMAGES, cutoff=0), "cutoff must be a number above 0, got 0"),
        (lambda: homomorphic(IMAGES, low=-0.1), "0 <= low <= high, got low=-0.1"),
        (lambda: homomorphic(IMAGES, low=1.5), "got low=1.5 and high=1"),
        (lambda: homomorphic(np.full((4, 4), 2.0)), r"values in \[0, 1\]"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
