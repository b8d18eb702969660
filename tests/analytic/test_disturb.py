import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from analytic import AnalyticError
from analytic.disturb import NOISE_LEVELS, noise, occlude
from analytic.images import luma, unit, with_channels


def generator(seed=0):
    return np.random.default_rng(seed)


IMAGES = generator(8).integers(1, 256, (4, 16, 60), dtype=np.uint8)


@pytest.mark.parametrize("variance", NOISE_LEVELS[1:4])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_noise_has_its_variance_and_no_mean_and_is_drawn_for_every_pixel_of_every_image(variance, dtype):
    scale = 255 if dtype == np.uint8 else 1
    grey = np.full((2, 100, 400), scale / 2).astype(dtype)
    added = (noise(grey, variance, generator()).astype(float) - grey) / scale
    assert added.mean() == pytest.approx(0, abs=5 * np.sqrt(variance / added.size))
    assert added.var() == pytest.approx(variance, rel=0.05)
    for one, other in ((added[..., 1:], added[..., :-1]), added):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03


@pytest.mark.parametrize("shape", [(200, 200), (3, 200, 200), (2, 3, 100, 200)])
def test_the_grey_image_has_the_variance_whatever_the_channels(shape):
    noisy = noise(np.full(shape, 128, dtype=np.uint8), 0.0025, generator())
    # Of 40,000 draws the variance has a standard deviation of 0.7 %.
    assert luma(unit(with_channels(noisy))).var() == pytest.approx(0.0025, rel=0.03)
    channels = with_channels(noisy)
    assert (channels == channels[:, :1]).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(16, 24), (3, 16, 24), (4, 16, 24), (2, 3, 16, 24)])
def test_shape_range_and_type_are_kept_and_the_input_too(shape, dtype):
    images = generator().integers(0, 256, shape, dtype=np.uint8)
    images = images if dtype == np.uint8 else (images / 255).astype(dtype)
    kept = images.copy()
    for found in (noise(images, 0.05, generator()), occlude(images, 0.4, generator())):
        assert (found.shape, found.dtype) == (shape, dtype)
        assert found.min() >= 0
        assert found.max() <= (255 if dtype == np.uint8 else 1)
        assert not np.array_equal(found, images)
    assert np.array_equal(images, kept)
    if images.dtype != np.uint8:
        learned = torch.from_numpy(images).requires_grad_()
        assert np.array_equal(noise(learned, 0.05, generator()), noise(images, 0.05, generator()))


@pytest.mark.parametrize("disturb", [noise, occlude])
def test_nothing_changes_at_level_zero_and_the_draw_is_the_generators(disturb):
    untouched = disturb(IMAGES, 0, generator())
    assert np.array_equal(untouched, IMAGES)
    assert not np.shares_memory(untouched, IMAGES)
    assert np.array_equal(disturb(IMAGES, 0.1, generator(3)), disturb(IMAGES, 0.1, generator(3)))
    assert not np.array_equal(disturb(IMAGES, 0.1, generator(3)), disturb(IMAGES, 0.1, generator(4)))


@given(
    share=st.floats(0, 1),
    bars=st.integers(1, 8),
    place=st.none() | st.floats(0, 1),
    circular=st.booleans(),
    seed=st.integers(0, 99),
)
def test_bars_cover_their_share_of_the_columns(share, bars, place, circular, seed):
    found = occlude(IMAGES, share, generator(seed), bars=bars, place=place, circular=circular)
    for image, before in zip(found, IMAGES, strict=True):
        covered = (image == 0).all(axis=0)
        assert covered.sum() == round(share * 60)
        assert np.array_equal(image[:, ~covered], before[:, ~covered])
        starts = covered & ~np.roll(covered, 1) if circular else np.diff(covered, prepend=False) & covered
        assert starts.sum() <= bars


def test_bars_stand_elsewhere_in_each_image_and_everywhere_in_the_end():
    covered = (occlude(np.ones((2000, 4, 20)), 0.2, generator(), bars=2) == 0).all(axis=1)
    assert len(np.unique(covered, axis=0)) > 50
    np.testing.assert_allclose(covered.mean(axis=0), 0.2, atol=0.05)
    assert covered[(covered[:, 0] & covered[:, -1])].any()  # a bar across the seam


@pytest.mark.parametrize(
    ("bars", "place", "starts"),
    [(1, 0, [0]), (1, 0.5, [24]), (1, 1, [48]), (2, 0.5, [12, 42]), (3, 0, [0, 20, 40]), (3, 1, [16, 36, 56])],
)
def test_a_place_is_the_same_in_every_image(bars, place, starts):
    found = occlude(IMAGES, 0.2, generator(), bars=bars, place=place)
    covered = (found == 0).all(axis=(0, 1))
    assert np.flatnonzero(covered).tolist() == [start + i for start in starts for i in range(12 // bars)]


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_bars_have_the_colour_asked_for(dtype):
    images = generator().integers(0, 256, (2, 3, 8, 20), dtype=np.uint8)
    full = 255 if dtype == np.uint8 else 1
    images = images if full == 255 else (images / 255).astype(dtype)
    means = images.mean(axis=(2, 3), keepdims=True, dtype=float)
    for colour, wanted in (("black", np.zeros_like(means)), ("grey", np.full_like(means, full / 2)), ("mean", means)):
        found = occlude(images, 0.5, generator(), colour=colour)
        covered = (found != images).any(axis=(1, 2), keepdims=True)
        assert covered.sum(axis=-1).tolist() == [[[10]], [[10]]]
        apart = np.abs(np.where(covered, found - wanted, 0)).max()
        assert apart <= (0.5 if full == 255 else 1e-6), colour  # half a grey level


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: noise(IMAGES, -0.1, generator()), "variance must be a number from 0, got -0.1"),
        (lambda: noise(IMAGES, np.nan, generator()), "variance must be a number from 0, got nan"),
        (lambda: noise(IMAGES, 0.1, np.random), "generator must be a Generator"),
        (lambda: occlude(IMAGES, 1.1, generator()), "share must be a number from 0 to 1, got 1.1"),
        (lambda: occlude(IMAGES, 0.1, generator(), colour="red"), "colour must be black or grey or mean, got 'red'"),
        (lambda: occlude(IMAGES, 0.1, generator(), place=2), "place must be a number from 0 to 1, or null, got 2"),
        (lambda: occlude(IMAGES, 0.1, generator(), place=np.nan), "place must be a number from 0 to 1, .*, got nan"),
        (lambda: occlude(IMAGES, 0.1, generator(), bars=0), "bars must be a whole number from 1 to 10 million, got 0"),
        (lambda: occlude(IMAGES, 0.1, generator(), bars=2.0), "bars must be a whole number .*, got 2.0"),
        (lambda: occlude(IMAGES, 0.1, generator(), bars=61), "bars must be at most the number of columns, 60, got 61"),
        (lambda: occlude(IMAGES, 0.1, generator(), circular="no"), "circular must be true or false, got 'no'"),
        (lambda: noise(IMAGES[:0], 0.1, generator()), r"above 0, got \(0, 16, 60\)"),
        (lambda: occlude(IMAGES.astype(int), 0.1, generator()), "uint8 or floating point in .*, got int64"),
        (lambda: noise("a.png", 0.1, generator()), "uint8 or floating point in .*, got <U5"),
        (lambda: occlude(np.full((4, 4), 1e300), 0.1, generator()), "between 1e[+]300 and 1e[+]300"),
        (lambda: noise(torch.ones(4, 4).bfloat16(), 0.1, generator()), "numpy cannot read .*: give uint8 or float32"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
