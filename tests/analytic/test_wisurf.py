"""Wi-SURF: wavelets, windows, turns, mistakes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic import AnalyticError, descriptor
from analytic.descriptors.wisurf import wavelets

RNG = np.random.default_rng(3)
IMAGES = RNG.integers(0, 256, (4, 32, 48), dtype=np.uint8)
MADE = descriptor("wisurf", rows=2, windows=12)


def window(image, top, left, side, wraps=True):
    """The 64 values of a window, pixel by pixel."""
    height, width = image.shape
    a = max(1, int(np.floor(side / 20 + 0.5)))
    sigma = 3.3 * side / 20
    weight = np.exp(-((np.arange(side) - (side - 1) / 2) ** 2) / (2 * sigma**2))
    weight /= weight.sum()

    def mean(rows, columns):
        columns = [c % width if wraps else min(max(c, 0), width - 1) for c in columns]
        return image[np.ix_([min(max(r, 0), height - 1) for r in rows], columns)].mean()

    found = np.zeros((4, 4, 4))
    for y in range(side):
        for x in range(side):
            i, j = top + y, left + x
            if not wraps and j >= width:
                continue
            across, along = range(i - a, i + a + 1), range(j - a, j + a + 1)
            dx = mean(across, range(j + 1, j + a + 1)) - mean(across, range(j - a, j))
            dy = mean(range(i + 1, i + a + 1), along) - mean(range(i - a, i), along)
            share = weight[y] * weight[x]
            found[4 * y // side, 4 * x // side] += share * np.array([dx, dy, abs(dx), abs(dy)])
    return found.ravel() / max(np.linalg.norm(found), 1e-6)


def test_the_position_part_is_the_orientation_part():
    found = MADE.describe(IMAGES)
    assert np.array_equal(found.position, found.orientation.reshape(4, -1))


def test_windows_have_length_one_and_flat_ones_zero():
    found = MADE.describe(IMAGES).orientation.reshape(4, 12, 2, 64)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, rtol=1e-5)
    half = IMAGES[0].copy()
    half[16 - 1 :] = 77  # the wavelets of the lower band reach one row into the upper one
    found = MADE.describe(half).orientation.reshape(12, 2, 64)
    assert np.all(found[:, 1] == 0)
    np.testing.assert_allclose(np.linalg.norm(found[:, 0], axis=-1), 1, rtol=1e-5)


@given(st.floats(0, 1, width=32))
@settings(max_examples=25, deadline=None)
def test_constant_images_are_zeros(grey):
    found = MADE.describe(np.full((32, 48), grey, dtype=np.float32))
    assert np.all(found.position == 0)


def test_an_upright_edge_answers_in_dx_and_a_level_one_in_dy():
    across = np.zeros((32, 48), dtype=np.float32)
    across[:, 20:28] = 0.8
    sums = MADE.describe(across).orientation.reshape(12, 2, 4, 4, 4).sum(axis=(1, 2, 3))
    assert np.abs(sums[:, [1, 3]]).max() < 1e-6
    assert sums[2, 0] > 0.5  # columns 8 to 23: only the edge at 20, to the brighter side
    assert sums[6, 0] < -0.5  # columns 24 to 39: only the edge at 28
    level = np.zeros((32, 48), dtype=np.float32)
    level[8:] = 0.8
    sums = MADE.describe(level).orientation.reshape(12, 2, 4, 4, 4).sum(axis=(2, 3))
    assert np.abs(sums[..., [0, 2]]).max() < 1e-6
    assert np.all(sums[:, 0, 1] > 0.5)


def test_contrast_and_offset_do_not_matter():
    dim = 0.2 + 0.4 * (IMAGES / 255)
    np.testing.assert_allclose(MADE.describe(dim).position, MADE.describe(IMAGES).position, atol=1e-5)


def test_the_mirror_image_has_mirrored_windows():
    # Windows [4 j, 4 j + 16) of 48 columns become windows [32 - 4 j, 48 - 4 j).
    here = MADE.describe(IMAGES[0]).orientation.reshape(12, 2, 4, 4, 4)
    mirrored = MADE.describe(IMAGES[0, :, ::-1]).orientation.reshape(12, 2, 4, 4, 4)
    expected = here[(8 - np.arange(12)) % 12][:, :, :, ::-1] * np.array([-1, 1, 1, 1])
    np.testing.assert_allclose(mirrored, expected, atol=1e-5)


@pytest.mark.parametrize("reach", [1, 2, 3, 5, 8, 13])
@pytest.mark.parametrize("wraps", [True, False])
def test_wavelets_of_any_size_are_differences_of_means(reach, wraps):
    image = RNG.random((20, 27))
    dx, dy = wavelets(image.astype(np.float32), reach, wraps)
    sides = np.pad(image, ((0, 0), (reach, reach)), mode="wrap" if wraps else "edge")
    padded = np.pad(sides, ((reach, reach), (0, 0)), mode="edge")
    for i in range(0, 20, 5):
        for j in (0, 11, 26):
            box = padded[i : i + 2 * reach + 1, j : j + 2 * reach + 1]
            assert dx[i, j] == pytest.approx(box[:, reach + 1 :].mean() - box[:, :reach].mean(), abs=1e-6)
            assert dy[i, j] == pytest.approx(box[reach + 1 :].mean() - box[:reach].mean(), abs=1e-6)


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"rows": 0}, "wisurf.rows must be .*, got 0"),
        ({"windows": 1}, "wisurf.windows must be a whole number from 2 to 16,384, got 1"),
        (
            {"rows": 3, "windows": 12},
            "4 subregions each do not fit an image of 32 pixel rows: use other rows, or .* a multiple of 12 rows",
        ),
        ({"rows": 2, "windows": 10}, "does not divide the image's width of 48 pixels: use windows=8 or 12"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("wisurf", **params).describe(IMAGES)


def test_images_that_no_window_fits():
    with pytest.raises(AnalyticError, match="squares of 32 pixels with rows=1, wider than the image of 24 columns"):
        descriptor("wisurf", rows=1, windows=12).describe(IMAGES[:, :, :24])
