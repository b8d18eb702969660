import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic import AnalyticError, Description, descriptor

RNG = np.random.default_rng(6)
IMAGES = RNG.integers(0, 256, (4, 16, 48), dtype=np.uint8)
SMALL = {"rows": 4, "columns": 5, "orientation_rows": 8, "orientation_columns": 20, "turns": 48}


def test_rows_of_the_parts_need_not_fit_each_other():
    apart = descriptor("fs", **{**SMALL, "orientation_rows": 2}).describe(IMAGES)
    fitting = descriptor("fs", **SMALL).describe(IMAGES)
    np.testing.assert_allclose(apart.position, fitting.position, atol=1e-6)


def test_a_wave_has_its_amplitude_and_its_phase():
    x = 2 * np.pi * np.arange(48) / 48
    image = np.tile(0.5 + 0.4 * np.cos(3 * x - 1), (16, 1))
    found = descriptor("fs", **SMALL).describe(image)
    np.testing.assert_allclose(found.position.reshape(4, 5), [[0.5, 0, 0, 0.2, 0]] * 4, atol=1e-6)
    np.testing.assert_allclose(np.angle(found.orientation[0, 3]), -1, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(turn=st.integers(0, 47))
def test_a_turn_multiplies_the_coefficients(turn):
    fs = descriptor("fs", **SMALL)
    here, there = fs.describe(IMAGES), fs.describe(np.roll(IMAGES, turn, axis=-1))
    factor = np.exp(-2j * np.pi * turn * np.arange(20) / 48)
    np.testing.assert_allclose(there.orientation, here.orientation * factor[:, None], atol=1e-6)
    np.testing.assert_allclose(there.position, here.position, rtol=1e-5)
    heading = fs.relative_heading(there, here)
    assert np.allclose(np.exp(1j * heading), np.exp(2j * np.pi * turn / 48))


@pytest.mark.parametrize("heading", ["correlation", "phase_product"])
def test_many_queries_are_aligned_as_one(monkeypatch, heading):
    fs = descriptor("fs", **SMALL, heading=heading)
    queries, references = fs.describe(np.roll(IMAGES, 8, axis=-1)), fs.describe(IMAGES)
    whole = fs.align(queries, references)
    monkeypatch.setattr("analytic.descriptors.fourier._CHUNK", 1)
    monkeypatch.setattr("analytic.alignment._VALUES", 1)
    parts = fs.align(queries, references)
    assert np.array_equal(whole.heading, parts.heading)
    np.testing.assert_allclose(whole.distance, parts.distance, rtol=1e-3, atol=1e-3)


def test_values_do_not_depend_on_the_size_of_the_image():
    fs = descriptor("fs", **{**SMALL, "columns": 4, "orientation_columns": 6, "turns": 96})
    x = 2 * np.pi * np.arange(96) / 96
    wide = np.tile(0.5 + 0.2 * np.cos(2 * x) + 0.1 * np.sin(3 * x), (32, 1))
    one, other = fs.describe(wide), fs.describe(wide[::2, ::2])
    np.testing.assert_allclose(one.position, other.position, atol=1e-6)
    np.testing.assert_allclose(fs.align(one, other).distance, 0, atol=2e-3)


def test_an_ordinary_camera_has_no_seam():
    flat = descriptor("fs", **SMALL, circular=False)
    slope = np.tile(np.linspace(0.2, 0.8, 48), (16, 1))
    twice = np.concatenate([slope, slope[:, ::-1]], axis=1)
    expected = np.abs(np.fft.fft(twice[0])[:5]) / 96
    np.testing.assert_allclose(flat.describe(slope).position.reshape(4, 5), [expected] * 4, atol=1e-6)
    with pytest.raises(AnalyticError, match="no relative heading"):
        flat.relative_heading(flat.describe(slope), flat.describe(slope))
    assert descriptor("fs", **{**SMALL, "turns": 50}, circular=False).describe(slope).position.shape == (1, 20)


def test_a_description_without_orientation_tells_no_heading():
    fs = descriptor("fs", **SMALL)
    position = Description(fs.describe(IMAGES).position)
    with pytest.raises(AnalyticError, match="no orientation part"):
        fs.align(position, position)


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"columns": 0}, "fs.columns must be .*, got 0"),
        ({"turns": 38}, "turns=38 resolves at most 19 frequencies, got orientation_columns=20"),
        ({"heading": "phase"}, "fs.heading must be correlation or phase_product, got 'phase'"),
        ({"rows": 5}, "rows=5 .* height of 16 pixels: use rows=4 or 8"),
        ({"orientation_rows": 32}, "orientation_rows=32 .* height of 16 pixels: use orientation_rows=16"),
        ({"columns": 25}, "columns=25 .* 48 columns has: use at most columns=24"),
        ({"turns": 64}, "turns=64 .* width of 48 pixels: use turns=48"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("fs", **{**SMALL, **params}).describe(IMAGES)
