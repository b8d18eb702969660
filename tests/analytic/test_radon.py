"""The Radon transform, its Fourier signature and its phase-only correlation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic import AnalyticError, descriptor
from tests.analytic.radon_lines import radon_transform

RNG = np.random.default_rng(4)
IMAGES = RNG.integers(0, 256, (4, 12, 64), dtype=np.uint8)
SQUARES = RNG.integers(0, 256, (4, 32, 32), dtype=np.uint8)
FOURIER = descriptor("radon_fourier", step=360 / 64, size=32, lines=4, orientation_lines=8)
POC = descriptor("radon_poc", step=360 / 32, size=32)
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


def test_a_left_turn_moves_the_orientations_on():
    here = radon_transform(IMAGES, step=360 / 16, size=32)
    there = radon_transform(np.roll(IMAGES, 12, axis=-1), step=360 / 16, size=32)
    np.testing.assert_allclose(there, np.roll(here, 3, axis=1), atol=1e-4)
    here = radon_transform(SQUARES, step=360 / 16, size=32, source="omnidirectional")
    there = radon_transform(np.rot90(SQUARES, axes=(1, 2)), step=360 / 16, size=32, source="omnidirectional")
    np.testing.assert_allclose(there, np.roll(here, 4, axis=1), atol=1e-4)


def test_both_sources_agree_on_one_scene():
    # Beyond the ring the scene is empty, so that a panorama shows all of it.
    polar = radon_transform(ring(), step=3, size=128)
    square = radon_transform(disc(), step=3, size=128, source="omnidirectional")
    assert np.abs(polar - square).max() < 0.01 * square.max()
    one = descriptor("radon_fourier", step=3, size=128)
    other = descriptor("radon_fourier", step=3, size=128, source="omnidirectional")
    a, b = one.describe(ring()).position[0], other.describe(disc()).position[0]
    assert np.linalg.norm(a - b) < 0.01 * np.linalg.norm(b)


def test_the_upper_row_lies_outside():
    top = np.zeros((12, 64))
    top[0] = 1
    found = radon_transform(top, step=10, size=32)[0]
    # Only lines that leave the ring's outermost row miss nothing of it; near the rim they run along it.
    assert found[0, 15] > 2 * found[0, 0] > 0
    bottom = np.zeros((12, 64))
    bottom[-1] = 1
    found = radon_transform(bottom, step=10, size=32)[0]
    assert np.all(found[:, 6:] < 1e-6)  # the lowest row reaches from 3.2 to 5.3 pixels
    assert found[0, 3] > 1


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


def test_an_image_is_like_itself_and_like_its_other_exposures():
    here = POC.describe(IMAGES)
    apart = POC.pairwise(here, here)
    np.testing.assert_allclose(np.diag(apart), 0, atol=1e-5)
    assert apart[~np.eye(4, dtype=bool)].min() > 0.3
    dark = POC.describe(0.5 * (IMAGES / 255))
    np.testing.assert_allclose(np.diag(POC.pairwise(dark, here)), 0, atol=1e-4)


@pytest.mark.parametrize("made", [FOURIER, POC])
def test_black_is_zero_and_grey_is_finite(made):
    black = made.describe(np.zeros((12, 64), dtype=np.uint8))
    assert not black.position.any()
    assert not black.orientation.any()
    grey = made.describe(np.full((12, 64), 0.3))
    assert np.isfinite(grey.position).all()
    assert np.ptp(grey.orientation, axis=1).max() < 1e-4  # nothing turns


def test_an_ordinary_camera_has_no_seam():
    step = np.zeros((12, 64))
    step[:, 32:] = 1
    for flat in (
        descriptor("radon_fourier", step=10, size=32, lines=4, orientation_lines=4, circular=False),
        descriptor("radon_poc", step=10, size=32, circular=False),
    ):
        # Followed by its mirror image, the image and its mirror image differ by half a turn alone.
        one, other = flat.describe(step), flat.describe(np.ascontiguousarray(step[:, ::-1]))
        assert np.linalg.norm(np.roll(one.orientation, 18, axis=1) - other.orientation) < 1e-3
        with pytest.raises(AnalyticError, match="no relative heading"):
            flat.relative_heading(one, other)


@pytest.mark.parametrize(
    ("name", "params", "says"),
    [
        (
            "radon_fourier",
            {"step": 7},
            "radon_fourier.step must be degrees that divide 360, at most 120, such as 1, 4 or 11.25, got 7",
        ),
        ("radon_poc", {"step": 0}, "radon_poc.step must be .*, got 0"),
        ("radon_poc", {"step": float("nan")}, "radon_poc.step must be .*, got nan"),
        ("radon_poc", {"step": 180}, "radon_poc.step must be .*, got 180"),
        ("radon_poc", {"size": 33}, "radon_poc.size must be an even number from 2 to 16,384, got 33"),
        ("radon_fourier", {"lines": 33}, "lines=33 must divide the 128 lines of size=256: use lines=32 or 64"),
        ("radon_fourier", {"orientation_lines": 0}, "radon_fourier.orientation_lines must be .*, got 0"),
        ("radon_poc", {"source": "disc"}, "radon_poc.source must be panorama or omnidirectional, got 'disc'"),
        ("radon_poc", {"source": "omnidirectional"}, "takes square images .* got 12 x 64 pixels: crop them to 12 x 12"),
    ],
)
def test_mistakes_are_one_sentence(name, params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor(name, **params).describe(IMAGES)
