"""Check batches of images and bring them into a common shape, for descriptors, filters and disturbances."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError

LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601


def with_channels(images: ArrayLike) -> NDArray[Any]:
    """Return images with unchanged values and shape (B, C, H, W), C being 1 or 3.

    Three planes (3, H, W) are one colour image, not three grey ones. A torch tensor is copied to main memory.

    Raises:
        AnalyticError: any other shape or no image, images of different sizes, neither uint8 nor floating point, or
            what numpy cannot read.

    Example:
        >>> with_channels(np.zeros((128, 512))).shape, with_channels(np.zeros((3, 128, 512), dtype=np.uint8)).shape
        ((1, 1, 128, 512), (1, 3, 128, 512))
    """
    try:
        array = np.asarray(images.detach().cpu() if hasattr(images, "detach") else images)
    except ValueError as error:
        raise AnalyticError("the images of a batch must have the same size: resize them first") from error
    except (TypeError, RuntimeError) as error:  # such as torch's bfloat16
        raise AnalyticError(f"numpy cannot read the images ({error}): give uint8 or float32") from error
    if array.dtype != np.uint8 and array.dtype.kind != "f":
        raise AnalyticError(f"images must be uint8 or floating point in [0, 1], got {array.dtype}")
    shape = array.shape
    if array.ndim == 2:
        array = array[None, None]
    elif array.ndim == 3:
        if shape[2] == 3 and shape[0] != 3:
            raise AnalyticError(f"a colour image must have its channels first, (3, H, W), got {shape}: transpose it")
        array = array[None] if shape[0] == 3 else array[:, None]
    if array.ndim != 4 or array.shape[1] not in (1, 3) or 0 in shape:
        raise AnalyticError(
            f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), above 0, got {shape}"
        )
    return array


def unit(images: NDArray[Any]) -> NDArray[np.float32]:
    """Return images of `with_channels` as float32 in [0, 1].

    Raises:
        AnalyticError: floating-point values out of range or not finite.

    Example:
        >>> unit(with_channels(np.full((1, 2), 51, dtype=np.uint8))).round(3)
        array([[[[0.2, 0.2]]]], dtype=float32)
    """
    if images.dtype == np.uint8:
        return images * np.float32(1 / 255)
    with np.errstate(over="ignore"):  # float64 may be too large
        values = images.astype(np.float32)
    if not (values.min() >= 0 and values.max() <= 1):
        low, high = float(images.min()), float(images.max())
        bad = "not finite" if not np.isfinite(low + high) else f"between {low:g} and {high:g}"
        raise AnalyticError(f"floating-point images must have values in [0, 1], got values {bad}")
    return values


def luma(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the BT.601 luma (B, 1, H, W) of images (B, C, H, W): 0.299 R + 0.587 G + 0.114 B.

    The values keep their range, such as [0, 1].

    Args:
        images: RGB in this order (C = 3), or grey (C = 1), which is returned unchanged.
    """
    if images.shape[1] == 1:
        return images
    red, green, blue = (images[:, channel, None] * np.float32(LUMA[channel]) for channel in range(3))
    return red + green + blue
