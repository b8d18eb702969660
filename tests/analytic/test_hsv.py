import numpy as np
import pytest

from analytic import AnalyticError, descriptor

RNG = np.random.default_rng(8)
IMAGES = RNG.integers(1, 100, (4, 3, 16, 48), dtype=np.uint8)
SMALL = {"rows": 4, "hues": 6, "saturations": 4, "values": 4, "window": 6, "step": 2}


def plain(red, green, blue):
    return np.broadcast_to(np.array([red, green, blue], dtype=np.float64)[:, None, None], (3, 16, 48))


def shares(found):
    """Position parts as shares of pixels (B, rows, bins): colours, and values by their full weight."""
    squared = found.position.reshape(len(found), SMALL["rows"], -1).astype(np.float64) ** 2
    return squared[:, :, :24], 4 * squared[:, :, 24:]


@pytest.mark.parametrize(
    ("colour", "hue", "saturation", "value"),
    [
        ((1, 0, 0), 0, 3, 3),
        ((1, 1, 0), 1, 3, 3),
        ((0, 0.5, 0), 2, 3, 2),
        ((0, 0.5, 0.5), 3, 3, 2),
        ((0.2, 0.2, 0.4), 4, 2, 1),
        ((0.8, 0.6, 0.8), 5, 1, 3),
        ((1, 0.9, 0.95), 5, 0, 3),
        ((0.3, 0.3, 0.3), 0, 0, 1),
        ((0, 0, 0), 0, 0, 0),
    ],
)
def test_a_colour_falls_into_its_bins(colour, hue, saturation, value):
    colours, values = shares(descriptor("hsv", **SMALL).describe(plain(*colour)))
    assert colours.argmax(axis=2).tolist() == [[hue * 4 + saturation] * 4]
    assert values.argmax(axis=2).tolist() == [[value] * 4]


def test_each_band_counts_its_pixels_once():
    colours, values = shares(descriptor("hsv", **SMALL).describe(IMAGES))
    np.testing.assert_allclose(colours.sum(axis=2), 1, rtol=1e-5)
    np.testing.assert_allclose(values.sum(axis=2), 1, rtol=1e-5)
    half = np.concatenate([plain(1, 0, 0)[:, :8], plain(0, 0, 1)[:, 8:]], axis=1)
    colours, _ = shares(descriptor("hsv", **SMALL).describe(half))
    assert colours[0].argmax(axis=1).tolist() == [3, 3, 19, 19]


def test_the_brightness_of_the_light_changes_values_alone():
    made = descriptor("hsv", **SMALL)
    dim, bright = made.describe(IMAGES), made.describe(2 * IMAGES)
    for one, other, same in zip(shares(dim), shares(bright), (True, False), strict=True):
        assert np.allclose(one, other, atol=1e-6) == same


def test_windows_wrap_around_only_where_columns_do():
    image = np.array(plain(0.5, 0.5, 0.5))
    image[:, :, 0] = [[1], [0], [0]]  # red in the first column
    ring, flat = (descriptor("hsv", **SMALL, circular=wraps).describe(image).orientation[0] for wraps in (True, False))
    assert np.flatnonzero(ring[:, 0]).tolist() == [0, 22, 23]
    assert np.flatnonzero(flat[:, 0]).tolist() == [0]
    np.testing.assert_allclose(ring[0, 0], 1 / 6, rtol=1e-6)
    np.testing.assert_allclose(ring[:, 6:].sum(axis=1), 1, rtol=1e-6)


def test_two_rooms_alike_but_for_the_paint_are_told_apart():
    grey = RNG.uniform(0.3, 0.6, (16, 48))
    paints = np.array([[1.0, 0.9, 0.7], [0.7, 0.9, 1.0], [0.8, 1.0, 0.8]])
    rooms = paints[:, :, None, None] * grey
    rooms /= np.einsum("bchw,c->bhw", rooms, [0.299, 0.587, 0.114])[:, None] / grey  # of one luma
    seen = np.clip(1.2 * rooms + RNG.normal(0, 0.01, rooms.shape), 0, 1)
    made = descriptor("hsv", **SMALL)
    assert made.localize(made.describe(seen), made.describe(rooms)).index.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"rows": 0}, "hsv.rows must be .*, got 0"),
        ({"hues": -1}, "hsv.hues must be .*, got -1"),
        ({"rows": 5}, "hsv's rows=5 .* height of 16 pixels: use rows=4 or 8"),
        ({"step": 5}, "hsv's step=5 .* width of 48 pixels: use step=4 or 6"),
        ({"window": 49}, "hsv's window=49 .* 48 columns: use at most window=48"),
    ],
)
def test_mistakes_are_one_sentence(params, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("hsv", **{**SMALL, **params}).describe(IMAGES)
