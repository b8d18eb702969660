"""A global descriptor for RTAB-Map: describes its images with a bundle of siamloc, see docs/howto/rtabmap.md.

RTAB-Map imports this file (`PyDescriptor/Path`), calls `init` once, and `extract` for each image.
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from siamloc.runtime import Localizer

BUNDLE = "SIAMLOC_BUNDLE"  # the environment variable with the folder of the bundle

_localizer: Localizer | None = None


def init(dim: int) -> None:
    """Open the bundle.

    Args:
        dim: `PyDescriptor/Dim`: the numbers in a descriptor.

    Raises:
        ValueError: no bundle is named, or its descriptors have another length.
    """
    global _localizer
    if BUNDLE not in os.environ:
        raise ValueError(f"no bundle is named: set {BUNDLE} to its folder before RTAB-Map starts")
    localizer = Localizer(os.environ[BUNDLE])
    if dim != localizer.map.width:
        raise ValueError(
            f"{localizer.bundle.path} describes images by {localizer.map.width} numbers: set PyDescriptor/Dim"
        )
    _localizer = localizer


def extract(image: NDArray[np.int8]) -> NDArray[np.float32]:
    """Describe an image (rows, columns, 3), BGR, or (rows, columns, 1), whose bytes RTAB-Map gives as signed.

    Returns:
        The descriptor (1, dim), of unit length.

    Raises:
        ValueError: `init` was not called, or the image does not suit the camera of the bundle.
    """
    if _localizer is None:
        raise ValueError("init(dim) opens the bundle: call it first")
    pixels = np.ascontiguousarray(np.broadcast_to(image.view(np.uint8)[:, :, ::-1], (*image.shape[:2], 3)))
    panorama = _localizer.bundle.preprocessing.prepare(pixels)
    found = _localizer.describe(panorama[None]).position
    return np.ascontiguousarray(found / max(float(np.linalg.norm(found)), 1e-12), dtype=np.float32)
