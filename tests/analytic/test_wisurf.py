import numpy as np
import pytest

from analytic import descriptor
from analytic.descriptors.wisurf import wavelets


def test_an_upright_edge_answers_in_dx_and_a_level_one_in_dy():
    made = descriptor("wisurf", rows=2, windows=12)
    across = np.zeros((32, 48), dtype=np.float32)
    across[:, 20:28] = 0.8
    sums = made.describe(across).orientation.reshape(12, 2, 4, 4, 4).sum(axis=(1, 2, 3))
    assert np.abs(sums[:, [1, 3]]).max() < 1e-6
    assert sums[2, 0] > 0.5  # columns 8 to 23: only the edge at 20, to the brighter side
    assert sums[6, 0] < -0.5  # columns 24 to 39: only the edge at 28
    level = np.zeros((32, 48), dtype=np.float32)
    level[8:] = 0.8
    sums = made.describe(level).orientation.reshape(12, 2, 4, 4, 4).sum(axis=(2, 3))
    assert np.abs(sums[..., [0, 2]]).max() < 1e-6
    assert np.all(sums[:, 0, 1] > 0.5)


@pytest.mark.parametrize("reach", [1, 2, 3, 5, 8, 13])
@pytest.mark.parametrize("wraps", [True, False])
def test_wavelets_of_any_size_are_differences_of_means(reach, wraps):
    image = np.random.default_rng(3).random((20, 27))
    dx, dy = wavelets(image.astype(np.float32), reach, wraps)
    sides = np.pad(image, ((0, 0), (reach, reach)), mode="wrap" if wraps else "edge")
    padded = np.pad(sides, ((reach, reach), (0, 0)), mode="edge")
    for i in range(0, 20, 5):
        for j in (0, 11, 26):
            box = padded[i : i + 2 * reach + 1, j : j + 2 * reach + 1]
            assert dx[i, j] == pytest.approx(box[:, reach + 1 :].mean() - box[:, :reach].mean(), abs=1e-6)
            assert dy[i, j] == pytest.approx(box[reach + 1 :].mean() - box[:reach].mean(), abs=1e-6)
