"""Disturb test images with noise and occlusion ([T] 3.4.2). Maps are made from clean images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError
from analytic.images import unit, with_channels
from foundation.settings import Count, NotNegative, Share, checked

NOISE_LEVELS = (0.0, 0.0025, 0.005, 0.01, 0.02, 0.05)
OCCLUSION_LEVELS = (0.0, 0.05, 0.1, 0.2, 0.4)


def noise(batch: ArrayLike, variance: float, generator: np.random.Generator) -> NDArray[Any]:
    """Return images with white Gaussian noise of mean 0, drawn separately for each channel of each pixel.

    Args:
        batch: (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1].
        variance: variance of the noise for images in [0, 1]; [T] uses NOISE_LEVELS.
        generator: source of the random numbers.

    Returns:
        The same number of images, of the same shape and type; values are clipped to the range, uint8 is rounded.

    Raises:
        AnalyticError: a wrong shape or type, values out of range, or a variance that is negative or not finite.

    Example:
        >>> image = np.full((128, 512), 128, dtype=np.uint8)
        >>> noisy = noise(image, 0.0025, np.random.default_rng(0))
        >>> noisy.dtype, round(float(noisy.std() / 255), 3)
        (dtype('uint8'), 0.05)
    """
    images = _images(batch, generator)
    checked(variance, NotNegative, "variance", AnalyticError)
    if variance == 0:
        return images.copy()
    scale = 255 if images.dtype == np.uint8 else 1
    noisy = generator.normal(0, scale * np.sqrt(variance), images.shape) + images
    if scale == 255:
        np.rint(noisy, out=noisy)
    return np.clip(noisy, 0, scale, out=noisy).astype(images.dtype)


def occlude(
    batch: ArrayLike,
    share: float,
    generator: np.random.Generator,
    *,
    bars: int = 4,
    value: float = 0.0,
    circular: bool = True,
) -> NDArray[Any]:
    """Return images with vertical bars over a share of the columns, at different places in each image.

    The bars are as high as the image, of equal widths up to one column, and do not overlap, so that they cover
    round(share * W) columns exactly. Every set of gaps between them is equally likely.

    Args:
        batch: (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1].
        share: share of the columns to cover, in [0, 1]; [T] uses OCCLUSION_LEVELS.
        generator: source of the random numbers.
        bars: number of bars; fewer if there are fewer columns to cover.
        value: grey value of a bar, in [0, 1]: 0 is black.
        circular: whether a bar may continue across the seam of a panorama.

    Returns:
        The same number of images, of the same shape and type.

    Raises:
        AnalyticError: a wrong shape or type, values out of range, a share or value outside [0, 1], or no bars.

    Example:
        >>> hidden = occlude(np.ones((128, 512)), 0.25, np.random.default_rng(0))
        >>> float(hidden.mean())
        0.75
    """
    images = _images(batch, generator)
    for key, number, kind in (("share", share, Share), ("value", value, Share), ("bars", bars, Count)):
        checked(number, kind, key, AnalyticError)
    hidden = images.copy()
    fill = np.rint(255 * value) if images.dtype == np.uint8 else value
    for image in with_channels(hidden):
        image[..., _covered(images.shape[-1], share, bars, circular, generator)] = fill
    return hidden


def _covered(width: int, share: float, bars: int, circular: bool, generator: np.random.Generator) -> NDArray[np.bool_]:
    """Return which columns (W,) the bars of one image cover."""
    total = round(share * width)
    bars = min(bars, total)
    covered = np.zeros(width, dtype=bool)
    if not bars:
        return covered
    edges = np.arange(bars + 1) * total // bars
    # Sorted places among the free columns: where bars of zero width would be.
    starts = np.sort(generator.integers(0, width - total + 1, bars)) + edges[:-1]
    for start, length in zip(starts, np.diff(edges), strict=True):
        covered[start : start + length] = True
    return np.roll(covered, generator.integers(width)) if circular else covered


def _images(batch: ArrayLike, generator: np.random.Generator) -> NDArray[Any]:
    checked(generator, np.random.Generator, "generator", AnalyticError)
    unit(with_channels(batch))  # refuses values out of range
    return np.asarray(batch)
