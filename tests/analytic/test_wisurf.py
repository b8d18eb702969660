import cv2
import numpy as np

from analytic import descriptor
from analytic.disturb import noise


def test_surfs_samples_turn_with_the_image_and_reach_all_around_it():
    made = descriptor("wisurf", rows=1, windows=64, sampling="surf")  # the largest windows, as close as they can be
    panorama = np.random.default_rng(5).random((64, 128))
    here, there = (made.describe(one).orientation[0] for one in (panorama, np.roll(panorama, 10, axis=1)))
    np.testing.assert_allclose(there, np.roll(here, 5, axis=0), atol=1e-6)


def test_noise_changes_surfs_samples_more_than_those_at_every_pixel():
    panorama = cv2.resize(np.random.default_rng(6).random((8, 32)), (256, 64), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    noisy = noise(panorama, 0.0005, np.random.default_rng(0))
    changes = []
    for sampling in ("pixels", "surf"):
        made = descriptor("wisurf", rows=8, windows=32, sampling=sampling)
        changes.append(float(made.pairwise(made.describe(noisy), made.describe(panorama), "euclidean")[0, 0]))
    assert changes[1] > 1.3 * changes[0]  # 1.5 times with any panorama
