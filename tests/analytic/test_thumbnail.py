import numpy as np
import pytest

from analytic import AnalyticError, Thumbnail
from analytic.images import as_grey

BATCH = np.random.default_rng(0).integers(0, 256, (3, 3, 16, 64), dtype=np.uint8)


def test_a_thumbnail_is_the_mean_of_each_block():
    found = Thumbnail(4, 8).describe(BATCH).position
    weights = np.array([0.299, 0.587, 0.114])
    for image, vector in zip(BATCH, found, strict=True):
        grey = np.einsum("chw,c->hw", image / 255, weights)
        blocks = [grey[4 * r : 4 * r + 4, 8 * c : 8 * c + 8].mean() for r in range(4) for c in range(8)]
        np.testing.assert_allclose(vector, blocks, atol=1e-5)
    assert found.dtype == np.float32
    assert found.shape == (3, 32)


def test_a_batch_is_its_images_and_types_agree():
    thumbnail = Thumbnail()
    whole = thumbnail.describe(BATCH).position
    for row, image in enumerate(BATCH):
        assert np.array_equal(thumbnail.describe(image).position[0], whole[row])
    np.testing.assert_allclose(thumbnail.describe(BATCH.astype(np.float32) / 255).position, whole, atol=1e-6)
    grey = as_grey(BATCH)
    np.testing.assert_allclose(thumbnail.describe(grey[:2]).position, whole[:2], atol=1e-6)
    np.testing.assert_allclose(thumbnail.describe(grey[0]).position, whole[:1], atol=1e-6)


def test_nearest_by_correlation_whatever_the_exposure():
    thumbnail = Thumbnail()
    darker = (BATCH * 0.5).astype(np.uint8)
    found = thumbnail.pairwise(thumbnail.describe(darker), thumbnail.describe(BATCH))
    assert found.argmin(axis=1).tolist() == [0, 1, 2]
    assert len(thumbnail.describe(BATCH)) == 3
    euclidean = thumbnail.pairwise(thumbnail.describe(BATCH), thumbnail.describe(BATCH), "euclidean")
    assert np.allclose(np.diag(euclidean), 0)


def test_identity_tells_what_may_be_compared():
    assert Thumbnail(8, 32).identity == {"name": "thumbnail", "rows": 8, "columns": 32}
    assert Thumbnail(8, 32).identity != Thumbnail(8, 16).identity


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Thumbnail(0, 8), "whole numbers from 1 to 16,384, got 0 x 8"),
        (lambda: Thumbnail(32, 32).describe(BATCH), "16 x 64 pixels, fewer than the thumbnail's 32 x 32"),
        (lambda: as_grey(np.zeros((2, 5, 4, 4))), r"got \(2, 5, 4, 4\)"),
        (lambda: as_grey(np.zeros((4, 4), dtype=np.int64)), "got int64"),
        (lambda: as_grey(np.full((4, 4), np.nan)), "not finite"),
        (lambda: as_grey(np.zeros((0, 3, 4, 4))), "got \\(0, 3, 4, 4\\)"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
