import numpy as np

from analytic import descriptor

RNG = np.random.default_rng(8)
IMAGES = RNG.integers(1, 100, (4, 3, 16, 48), dtype=np.uint8)
SMALL = {"rows": 4, "hues": 6, "saturations": 4, "values": 4, "window": 6, "step": 2}


def shares(found):
    """Position parts as shares of pixels (B, rows, bins): colours, and values by their full weight."""
    squared = found.position.reshape(len(found), SMALL["rows"], -1).astype(np.float64) ** 2
    return squared[:, :, :24], 4 * squared[:, :, 24:]


def test_the_brightness_of_the_light_changes_values_alone():
    made = descriptor("hsv", **SMALL)
    dim, bright = made.describe(IMAGES), made.describe(2 * IMAGES)
    for one, other, same in zip(shares(dim), shares(bright), (True, False), strict=True):
        assert np.allclose(one, other, atol=1e-6) == same


def test_two_rooms_alike_but_for_the_paint_are_told_apart():
    grey = RNG.uniform(0.3, 0.6, (16, 48))
    paints = np.array([[1.0, 0.9, 0.7], [0.7, 0.9, 1.0], [0.8, 1.0, 0.8]])
    rooms = paints[:, :, None, None] * grey
    rooms /= np.einsum("bchw,c->bhw", rooms, [0.299, 0.587, 0.114])[:, None] / grey  # of one luma
    seen = np.clip(1.2 * rooms + RNG.normal(0, 0.01, rooms.shape), 0, 1)
    made = descriptor("hsv", **SMALL)
    assert made.localize(made.describe(seen), made.describe(rooms)).index.tolist() == [0, 1, 2]
