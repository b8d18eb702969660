import numpy as np

from analytic import descriptor

SMALL = {"rows": 4, "columns": 5, "orientation_rows": 8, "orientation_columns": 20, "turns": 48}


def test_values_do_not_depend_on_the_size_of_the_image():
    fs = descriptor("fs", **{**SMALL, "columns": 4, "orientation_columns": 6, "turns": 96})
    x = 2 * np.pi * np.arange(96) / 96
    wide = np.tile(0.5 + 0.2 * np.cos(2 * x) + 0.1 * np.sin(3 * x), (32, 1))
    one, other = fs.describe(wide), fs.describe(wide[::2, ::2])
    np.testing.assert_allclose(one.position, other.position, atol=1e-6)
    np.testing.assert_allclose(fs.align(one, other).distance, 0, atol=2e-3)
