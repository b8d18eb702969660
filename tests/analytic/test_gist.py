import numpy as np

from analytic import descriptor


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
