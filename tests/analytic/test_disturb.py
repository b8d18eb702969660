import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analytic import AnalyticError
from analytic.disturb import NOISE_LEVELS, OCCLUSION_LEVELS, noise, occlude


def generator(seed=0):
    return np.random.default_rng(seed)


IMAGES = generator(8).integers(1, 256, (4, 16, 60), dtype=np.uint8)


def test_the_levels_are_those_of_the_thesis():
    assert NOISE_LEVELS == (0, 0.0025, 0.005, 0.01, 0.02, 0.05)
    assert OCCLUSION_LEVELS == (0, 0.05, 0.1, 0.2, 0.4)


@pytest.mark.parametrize("variance", NOISE_LEVELS[1:4])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_noise_has_its_variance_and_no_mean(variance, dtype):
    scale = 255 if dtype == np.uint8 else 1
    grey = np.full((100, 400), scale / 2).astype(dtype)
    added = (noise(grey, variance, generator()).astype(float) - grey) / scale
    assert added.mean() == pytest.approx(0, abs=5 * np.sqrt(variance / added.size))
    assert added.var() == pytest.approx(variance, rel=0.05)
    assert abs(np.corrcoef(added[:, 1:].ravel(), added[:, :-1].ravel())[0, 1]) < 0.03


def test_channels_have_noise_of_their_own():
    added = noise(np.full((3, 50, 50), 0.5), 0.005, generator()) - 0.5
    assert abs(np.corrcoef(added[0].ravel(), added[1].ravel())[0, 1]) < 0.1


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


@pytest.mark.parametrize("disturb", [noise, occlude])
def test_nothing_changes_at_level_zero_and_the_draw_is_the_generators(disturb):
    untouched = disturb(IMAGES, 0, generator())
    assert np.array_equal(untouched, IMAGES)
    assert not np.shares_memory(untouched, IMAGES)
    assert np.array_equal(disturb(IMAGES, 0.1, generator(3)), disturb(IMAGES, 0.1, generator(3)))
    assert not np.array_equal(disturb(IMAGES, 0.1, generator(3)), disturb(IMAGES, 0.1, generator(4)))


@given(share=st.floats(0, 1), bars=st.integers(1, 8), circular=st.booleans(), seed=st.integers(0, 99))
def test_bars_cover_their_share_of_the_columns(share, bars, circular, seed):
    found = occlude(IMAGES, share, generator(seed), bars=bars, circular=circular)
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


def test_bars_have_the_value_asked_for_in_every_channel():
    found = occlude(np.zeros((2, 3, 8, 20), dtype=np.uint8), 0.5, generator(), value=0.5)
    assert set(np.unique(found)) == {0, 128}
    assert ((found == 128).all(axis=(1, 2)) == (found == 128).any(axis=(1, 2))).all()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: noise(IMAGES, -0.1, generator()), "variance must be a number from 0, got -0.1"),
        (lambda: noise(IMAGES, 0.1, np.random), "generator must be a Generator"),
        (lambda: noise(np.full((4, 4), 200.0), 0.1, generator()), "between 200 and 200"),
        (lambda: occlude(IMAGES, 1.1, generator()), "share must be a number from 0 to 1, got 1.1"),
        (lambda: occlude(IMAGES, 0.1, generator(), value=-1), r"value .* got -1"),
        (lambda: occlude(IMAGES, 0.1, generator(), bars=0), "bars must be a whole number from 1 to 10 million, got 0"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
