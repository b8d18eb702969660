"""The Radon transform, its Fourier signature and its phase-only correlation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic import descriptor
from tests.analytic.radon_lines import radon_transform

RNG = np.random.default_rng(4)
IMAGES = RNG.integers(0, 256, (4, 12, 64), dtype=np.uint8)
SQUARES = RNG.integers(0, 256, (4, 32, 32), dtype=np.uint8)
# amplitude, radius, angle from straight down counter-clockwise, standard deviation; in pixels of a disc of 128
BLOBS = [(0.3, 40, 0.3, 5.0), (0.25, 30, 2.1, 4.0), (0.2, 44, 3.9, 4.5), (0.3, 36, 5.5, 5.0), (0.2, 50, 5.1, 3.5)]


def blobs(right, down):
    """A smooth picture at points of the disc."""
    found = np.zeros(np.broadcast(right, down).shape)
    for amplitude, radius, angle, sigma in BLOBS:
        squared = (right - radius * np.sin(angle)) ** 2 + (down - radius * np.cos(angle)) ** 2
        found += amplitude * np.exp(-squared / (2 * sigma**2))
    return found


def lines_through_blobs(orientations):
    """Their integrals along lines of all orientations at the distances 1/2 ... 63 1/2."""
    phi = 2 * np.pi * np.arange(orientations)[:, None] / orientations
    distance = np.arange(64) + 0.5
    found = np.zeros((orientations, 64))
    for amplitude, radius, angle, sigma in BLOBS:
        off = distance - radius * np.cos(angle - phi)
        found += amplitude * np.sqrt(2 * np.pi) * sigma * np.exp(-(off**2) / (2 * sigma**2))
    return found


def disc():
    place = np.arange(128) + 0.5 - 64
    return blobs(place[None, :], place[:, None])


def ring(height=96, width=320):
    radius = 64 - (np.arange(height)[:, None] + 0.5) * 0.8 * 64 / height
    angle = 2 * np.pi * (np.arange(width) + 0.5) / width
    return blobs(radius * np.sin(angle), radius * np.cos(angle))


@pytest.mark.parametrize(("source", "image"), [("omnidirectional", disc()), ("panorama", ring())])
@pytest.mark.parametrize("step", [1.0, 2.0, 4.0])
def test_line_integrals_of_a_smooth_picture_are_the_exact_ones(source, image, step):
    found = radon_transform(image, step=step, size=128, source=source)
    expected = lines_through_blobs(round(360 / step))
    assert found.shape == (1, *expected.shape)
    assert np.abs(found[0] - expected).max() < 0.01 * expected.max()


@given(st.integers(0, 63))
@settings(max_examples=15, deadline=None)
def test_any_turn_by_columns_leaves_the_magnitudes(turn):
    made = descriptor("radon_fourier", step=10, size=32, lines=4, orientation_lines=8)
    here, there = made.describe(IMAGES), made.describe(np.roll(IMAGES, turn, axis=-1))
    np.testing.assert_allclose(there.position, here.position, rtol=1e-4, atol=1e-5)
    off = made.relative_heading(there, here) - 2 * np.pi * turn / 64
    assert np.abs(np.angle(np.exp(1j * off))).max() <= made.resolution(64) / 2 + 1e-6


@pytest.mark.parametrize("name", ["radon_fourier", "radon_poc"])
def test_a_turned_omnidirectional_image_gives_back_its_quarter_turns(name):
    made = descriptor(name, step=3, size=64, source="omnidirectional")
    here = made.describe(SQUARES)
    for quarters in (1, 2, 3):
        there = made.describe(np.rot90(SQUARES, quarters, axes=(1, 2)))
        off = made.relative_heading(there, here) - quarters * np.pi / 2
        assert np.abs(np.angle(np.exp(1j * off))).max() < 1e-6
        np.testing.assert_allclose(made.pairwise(there, here), made.pairwise(here, here), rtol=1e-4, atol=1e-4)
