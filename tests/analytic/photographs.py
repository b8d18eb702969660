"""Real photographs of a corridor."""

from pathlib import Path

import cv2
import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "../shared/data/corridor/ref"


def photographs(numbers=(40, 90), size=(128, 32)):
    """Return photographs (B, 3, H, W); the test is skipped where they are missing."""
    paths = [FOLDER / f"{number:07d}.jpg" for number in numbers]
    if not all(path.exists() for path in paths):
        pytest.skip("needs the photographs of ../shared/data/corridor")
    bgr = [cv2.resize(cv2.imread(str(path)), size, interpolation=cv2.INTER_AREA) for path in paths]
    return np.stack([image[..., ::-1].transpose(2, 0, 1) for image in bgr])
