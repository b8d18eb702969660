import numpy as np
import pytest

from analytic import AnalyticError, descriptor

BATCH = np.random.default_rng(0).integers(0, 256, (3, 3, 16, 64), dtype=np.uint8)


def test_a_thumbnail_is_the_mean_of_each_block():
    found = descriptor("thumbnail", rows=4, columns=8).describe(BATCH).position
    weights = np.array([0.299, 0.587, 0.114])
    for image, vector in zip(BATCH, found, strict=True):
        grey = np.einsum("chw,c->hw", image / 255, weights)
        blocks = [grey[4 * r : 4 * r + 4, 8 * c : 8 * c + 8].mean() for r in range(4) for c in range(8)]
        np.testing.assert_allclose(vector, blocks, atol=1e-5)
    assert found.dtype == np.float32
    assert found.shape == (3, 32)


def test_nearest_by_correlation_whatever_the_exposure():
    thumbnail = descriptor("thumbnail")
    darker = (BATCH * 0.5).astype(np.uint8)
    found = thumbnail.pairwise(thumbnail.describe(darker), thumbnail.describe(BATCH))
    assert found.argmin(axis=1).tolist() == [0, 1, 2]
    euclidean = thumbnail.pairwise(thumbnail.describe(BATCH), thumbnail.describe(BATCH), "euclidean")
    assert np.allclose(np.diag(euclidean), 0)


def test_there_is_no_heading():
    thumbnail = descriptor("thumbnail")
    found = thumbnail.describe(BATCH)
    assert not thumbnail.tells_heading
    assert (found.orientation, thumbnail.sizes(16, 64)) == (None, ((8, 32), (0,)))
    with pytest.raises(AnalyticError, match="no orientation part"):
        thumbnail.relative_heading(found, found)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (0, "thumbnail.rows must be .*, got 0"),
        (32, "16 x 64 pixels, fewer than the thumbnail's 32 x 32"),
    ],
)
def test_mistakes_are_one_sentence(rows, says):
    with pytest.raises(AnalyticError, match=says):
        descriptor("thumbnail", rows=rows).describe(BATCH)
