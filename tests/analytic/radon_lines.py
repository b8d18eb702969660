"""The Radon transform behind the descriptors, for a batch of images."""

import numpy as np

from analytic.descriptors.radon_transform import harmonics, orientations, steps
from analytic.images import luma, unit, with_channels


def radon_transform(batch, *, step, size, source="panorama"):
    grey = luma(unit(with_channels(batch)))[:, 0]
    found = [orientations(harmonics(image, step, size, size // 2, source), steps(step)) for image in grey]
    return np.stack(found).astype(np.float32)
