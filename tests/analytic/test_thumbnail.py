import numpy as np

from analytic import descriptor

BATCH = np.random.default_rng(0).integers(0, 256, (3, 3, 16, 64), dtype=np.uint8)


def test_a_thumbnail_is_the_mean_of_each_block():
    found = descriptor("thumbnail", rows=4, columns=8).describe(BATCH).position
    weights = np.array([0.299, 0.587, 0.114])
    for image, vector in zip(BATCH, found, strict=True):
        grey = np.einsum("chw,c->hw", image / 255, weights)
        blocks = [grey[4 * r : 4 * r + 4, 8 * c : 8 * c + 8].mean() for r in range(4) for c in range(8)]
        np.testing.assert_allclose(vector, blocks, atol=1e-5)
    assert found.shape == (3, 32)
