"""A picture of example pairs with their labels and distances, for TensorBoard."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_CAPTION_ROWS = 16
_GAP = 2


def pair_picture(
    first: NDArray[Any], second: NDArray[Any], label: NDArray[Any], distance: NDArray[Any]
) -> NDArray[np.uint8]:
    """Draw pairs below each other, each with its caption over the first image and the second image.

    Args:
        first: (B, 3, H, W), uint8, or floating point in [0, 1].
        second: the same.
        label: (B,), dissimilarity in [0, 1].
        distance: (B,), distance of the descriptors.

    Returns:
        (rows, columns, 3) uint8, RGB.
    """
    rows = [_row(*pair) for pair in zip(first, second, label, distance, strict=True)]
    return np.concatenate(rows, axis=0)


def _row(first: NDArray[Any], second: NDArray[Any], label: float, distance: float) -> NDArray[np.uint8]:
    images = [_as_picture(first), _as_picture(second)]
    gap = np.full((_GAP, images[0].shape[1], 3), 255, np.uint8)
    caption = np.full((_CAPTION_ROWS, images[0].shape[1], 3), 255, np.uint8)
    text = f"y={float(label):.2f} d={float(distance):.2f}"
    cv2.putText(caption, text, (2, _CAPTION_ROWS - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([caption, images[0], gap, images[1], gap], axis=0)


def _as_picture(image: NDArray[Any]) -> NDArray[np.uint8]:
    picture = np.moveaxis(image, 0, -1)
    if picture.dtype != np.uint8:
        picture = (np.clip(picture, 0, 1) * 255).round().astype(np.uint8)
    return np.ascontiguousarray(picture)
