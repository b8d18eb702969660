"""The picture of pairs for TensorBoard."""

from __future__ import annotations

import numpy as np

from siamloc.models.siamese import pair_picture


def test_shows_every_image_unaltered_with_a_caption_of_its_own():
    images = np.random.default_rng(0).integers(0, 256, (2, 2, 3, 20, 90), dtype=np.uint8)
    picture = pair_picture(*images, np.array([0.0, 1.0]), np.array([0.25, 1.5]))
    assert picture.dtype == np.uint8
    height = len(picture) // 2
    for number in range(2):
        row = picture[number * height : (number + 1) * height]
        np.testing.assert_array_equal(row[16:36], images[0, number].transpose(1, 2, 0))
        np.testing.assert_array_equal(row[38:58], images[1, number].transpose(1, 2, 0))
        assert row[:16].min() < 100, "the caption is written in black"
    assert (picture[:16] != picture[height : height + 16]).any(), "the captions differ"


def test_floating_point_looks_like_bytes():
    images = np.random.default_rng(0).integers(0, 256, (2, 3, 3, 16, 64), dtype=np.uint8)
    label = distance = np.zeros(3)
    from_bytes = pair_picture(*images, label, distance)
    from_floats = pair_picture(*(images / np.float32(255)), label, distance)
    np.testing.assert_array_equal(from_bytes, from_floats)
