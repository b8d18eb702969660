"""Gist: sizes, what it responds to, turns, disturbances, mistakes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from analytic import AnalyticError, descriptor

SMALL = {"blocks": 4, "orientations": 6, "window": 6, "step": 3, "orientation_filters": 4}
RNG = np.random.default_rng(0)
BATCH = cv2.GaussianBlur(RNG.random((24, 60, 3)), (0, 0), 1).transpose(2, 0, 1).astype(np.float32)[:, None].repeat(3, 1)


def magnitude(picture, theta, frequency):
    """Return the magnitude of a filter's response, written out: the frequency plane and its inverse sum."""
    height, width = picture.shape
    tall = np.concatenate([picture, picture[::-1]])
    u, v = np.fft.fftfreq(2 * height)[:, None], np.fft.fftfreq(width)[None]
    squared = (v - frequency * np.cos(theta)) ** 2 + (u - frequency * np.sin(theta)) ** 2
    transfer = 2 * np.clip((2 ** (-9 * squared / frequency**2) - 2**-9) / (1 - 2**-9), 0, None)
    return np.abs(np.fft.ifft2(np.fft.fft2(tall) * transfer))[:height]


def test_a_wave_at_the_centre_of_a_filter_has_its_amplitude():
    column = np.arange(64)
    upright = np.tile(0.5 + 0.3 * np.cos(2 * np.pi * column / 4), (16, 1))
    position = descriptor("gist", blocks=2, orientations=8).describe(upright).position.reshape(2, 2, 8)
    np.testing.assert_allclose(position[0, :, 0], 0.3, rtol=1e-5)
    assert position[0].argmax(axis=-1).tolist() == [0, 0]
    slow = np.tile(0.5 + 0.3 * np.cos(2 * np.pi * column / 8), (16, 1))
    position = descriptor("gist", blocks=2, orientations=8).describe(slow).position.reshape(2, 2, 8)
    np.testing.assert_allclose(position[1, :, 0], 0.3, rtol=1e-5)
    level = np.tile((0.5 + 0.3 * np.cos(2 * np.pi * (np.arange(16) + 0.5) / 4))[:, None], (1, 64))
    position = descriptor("gist", blocks=2, orientations=8).describe(level).position.reshape(2, 2, 8)
    assert position[0].argmax(axis=-1).tolist() == [4, 4]


def test_a_turn_by_a_single_column_leaves_the_position():
    made = descriptor("gist", **SMALL)
    found = made.describe(np.roll(BATCH, 1, axis=-1)).position
    np.testing.assert_allclose(found, made.describe(BATCH).position, rtol=1e-4)


@pytest.mark.parametrize("grey", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("circular", [True, False])
def test_a_constant_image_answers_to_nothing(grey, circular):
    found = descriptor("gist", **SMALL, circular=circular).describe(np.full((24, 60), grey))
    np.testing.assert_allclose(found.position, 0, atol=1e-6)
    np.testing.assert_allclose(found.orientation, 0, atol=1e-2)


def test_contrast_scales_and_an_offset_does_nothing():
    made = descriptor("gist", **SMALL, normalized=False)
    whole, half = made.describe(BATCH), made.describe(0.5 * BATCH + 0.3)
    np.testing.assert_allclose(half.position, whole.position / 2, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(half.orientation, whole.orientation / 2, rtol=1e-4, atol=1e-6)
    assert np.diag(made.pairwise(half, whole)).max() < 1e-6


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"blocks": 0}, "gist.blocks must be .*, got 0"),
        ({"step": -1}, "gist.step must be .*, got -1"),
        ({"orientation_levels": 3}, "gist.orientation_levels must be 1 or 2, got 3"),
        ({"orientation_filters": 1}, "normalized=False"),
        ({"blocks": 5}, "blocks=5 does not divide the image's height of 24 pixels: use blocks=4 or 6"),
        ({"step": 7, "blocks": 4}, "step=7 does not divide the image's width of 60 pixels: use step=6 or 10"),
        ({"window": 61, "blocks": 4}, "wider than the image of 60 columns: use at most window=60"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("gist", **params).describe(BATCH)
