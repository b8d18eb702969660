"""Disturb test images with noise and occlusion ([T] 3.4.2). Maps are made from clean images."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError
from analytic.images import unit, with_channels
from foundation.settings import Count, NotNegative, Share, checked

NOISE_LEVELS = (0.0, 0.0025, 0.005, 0.01, 0.02, 0.05)
OCCLUSION_LEVELS = (0.0, 0.05, 0.1, 0.2, 0.4)

BarColour = Literal["black", "grey", "mean"]
"""Colour of a bar: black, the middle grey, or the mean colour of the image behind it."""


def noise(batch: ArrayLike, variance: float, generator: np.random.Generator) -> NDArray[Any]:
    """Return images with white Gaussian noise of mean 0, drawn for each pixel and added to all its channels.

    The channels of a pixel share one draw, so that the grey image has exactly this variance, as [T]'s grey images do,
    and a network on colours sees noise of the same strength. Noise of its own in each channel would leave luma only
    0.447 of the variance. The effect `noise` of `augment`, which only has to vary images, draws for each channel.

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
    planes = with_channels(images)
    drawn = generator.normal(0, scale * np.sqrt(variance), (len(planes), 1, *planes.shape[2:]))
    noisy = (drawn + planes).reshape(images.shape)
    if scale == 255:
        np.rint(noisy, out=noisy)
    return np.clip(noisy, 0, scale, out=noisy).astype(images.dtype)


def occlude(
    batch: ArrayLike,
    share: float,
    generator: np.random.Generator,
    *,
    bars: int = 1,
    colour: BarColour = "black",
    place: float | None = None,
    circular: bool = True,
) -> NDArray[Any]:
    """Return images with vertical bars over a share of the columns.

    The bars are as high as the image, of equal widths up to one column, and do not overlap, so that they cover
    round(share * W) columns exactly. [T] gives neither their number nor their colour nor their places.

    Args:
        batch: (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1].
        share: share of the columns to cover, in [0, 1]; [T] uses OCCLUSION_LEVELS.
        generator: source of the random numbers.
        bars: number of bars, at most W; a share of fewer columns than bars is that many bars of one column.
        colour: "black", "grey" (0.5), or "mean", the mean colour of each image.
        place: where each bar stands in its own part of the image, which is divided into as many equal parts as there
            are bars: 0 is the left end, 0.5 the middle, 1 the right end. If None, places are drawn for each image, and
            every set of gaps between the bars is equally likely.
        circular: whether a bar at a drawn place may continue across the seam of a panorama.

    Returns:
        The same number of images, of the same shape and type.

    Raises:
        AnalyticError: a wrong shape or type, values out of range, a share or place outside [0, 1], no bars or more than
            the image has columns, an unknown colour, or a `circular` that is not a bool.

    Example:
        >>> hidden = occlude(np.ones((128, 512)), 0.25, np.random.default_rng(0))
        >>> float(hidden.mean())
        0.75
    """
    images = _images(batch, generator)
    values, kinds = (share, bars, colour, place, circular), (Share, Count, BarColour, Share | None, bool)
    for key, value, kind in zip(("share", "bars", "colour", "place", "circular"), values, kinds, strict=True):
        checked(value, kind, key, AnalyticError)
    if bars > images.shape[-1]:
        raise AnalyticError(f"bars must be at most the number of columns, {images.shape[-1]}, got {bars}")
    hidden = images.copy()
    full = 255 if images.dtype == np.uint8 else 1
    for image in with_channels(hidden):
        mean = image.mean(axis=(1, 2), dtype=np.float64)
        fill = {"black": np.zeros_like(mean), "grey": np.full_like(mean, full / 2), "mean": mean}[colour]
        fill = np.rint(fill) if full == 255 else fill
        image[..., _covered(images.shape[-1], share, bars, place, circular, generator)] = fill[:, None, None]
    return hidden


def _covered(
    width: int, share: float, bars: int, place: float | None, circular: bool, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Return which columns (W,) the bars of one image cover."""
    total = round(share * width)
    bars, free = min(bars, total), width - total
    covered = np.zeros(width, dtype=bool)
    if not bars:
        return covered
    edges = np.arange(bars + 1) * total // bars
    # Places among the free columns, from left to right: where bars of zero width would be.
    if place is None:
        gaps = np.sort(generator.integers(0, free + 1, bars))
    else:
        gaps = np.rint(free * (np.arange(bars) + place) / bars).astype(np.int64)
    for start, length in zip(gaps + edges[:-1], np.diff(edges), strict=True):
        covered[start : start + length] = True
    return np.roll(covered, generator.integers(width)) if circular and place is None else covered


def _images(batch: ArrayLike, generator: np.random.Generator) -> NDArray[Any]:
    checked(generator, np.random.Generator, "generator", AnalyticError)
    planes = with_channels(batch)
    unit(planes)  # refuses values out of range
    return planes.reshape(np.shape(batch))
