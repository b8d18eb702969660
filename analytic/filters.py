"""The homomorphic filter, which reduces slow changes of light across an image ([C] 2.4)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError
from analytic.images import luma, unit, with_channels
from foundation.settings import Positive, checked

CUTOFF = 4.0
LOW = 0.5
HIGH = 1.0
_BLACK = np.float32(1 / 255)  # added before the logarithm, so that it exists for black: one 8-bit grey level


def homomorphic(
    batch: ArrayLike, cutoff: float = CUTOFF, low: float = LOW, high: float = HIGH, *, circular: bool = True
) -> NDArray[Any]:
    """Reduce slow changes of light in images; see `filtered`.

    Args:
        batch: (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1].
        cutoff: where the filter changes from `low` to `high`, in cycles per image width.
        low: gain of what changes slowly, at least 0; below 1 weakens it.
        high: gain of what changes fast, at least `low`; above 1 sharpens.
        circular: whether columns wrap around; otherwise they are extended by their mirror image.

    Returns:
        The same number of images, of the same shape and type; values are clipped to the range, uint8 is rounded.

    Raises:
        AnalyticError: a wrong shape or type, values out of range, a cutoff that is not positive, or gains out of order.

    Example:
        >>> lamp = 0.5 + 0.4 * np.cos(2 * np.pi * np.arange(64) / 64)  # light from one side
        >>> image = np.tile(lamp, (16, 1))
        >>> even = homomorphic(image)
        >>> round(float(np.ptp(image)), 2), round(float(np.ptp(even)), 2)
        (0.8, 0.65)
    """
    checked(cutoff, Positive, "cutoff", AnalyticError)
    if not 0 <= low <= high < np.inf:
        raise AnalyticError(f"the homomorphic filter needs gains 0 <= low <= high, got low={low} and high={high}")
    images = with_channels(batch)
    found = filtered(unit(images), cutoff, low, high, circular=circular)
    if images.dtype == np.uint8:
        found = np.rint(255 * found)
    return found.astype(images.dtype).reshape(np.shape(batch))


def filtered(
    images: NDArray[np.float32], cutoff: float = CUTOFF, low: float = LOW, high: float = HIGH, *, circular: bool
) -> NDArray[np.float32]:
    """Return images (B, C, H, W), float32 in [0, 1], after the filter.

    What a camera sees is light times reflectance; light changes slowly across an image, reflectance fast. The
    logarithm turns the product into a sum, in which a linear filter can separate slow from fast. For luma Y (BT.601),

        Y' = exp(F^-1(T F(log(Y + 1/255)))) - 1/255,
        T(u, v) = low + (high - low) (1 - exp(-(D / cutoff)^2 / 2)), D = W sqrt((u / N)^2 + (v / M)^2).

    F is the discrete Fourier transform of the image, extended by its mirror image in elevation (M = 2 H rows: the
    last row is followed by itself) and, unless columns wrap around (N = W), likewise in azimuth (N = 2 W). u and v are
    signed whole frequencies, so that D is in cycles per image width, the same in both directions. The mean of the
    logarithm (D = 0) also has the gain `low`, which brings exposures closer together.

    A colour image keeps its colours: each channel I becomes (I + 1/255) g - 1/255, clipped to [0, 1], with the gain
    g = (Y' + 1/255) / (Y + 1/255) of its pixel.
    """
    grey = luma(images)[:, 0]
    height, width = grey.shape[1:]
    log = np.log(grey + _BLACK)
    log = np.concatenate([log, log[:, ::-1]], axis=1)
    if not circular:
        log = np.concatenate([log, log[:, :, ::-1]], axis=2)
    transfer = _transfer(log.shape[1], log.shape[2], width, cutoff, low, high)
    smooth = np.fft.irfft2(np.fft.rfft2(log) * transfer, s=log.shape[1:], axes=(1, 2))
    gain = np.exp(smooth[:, :height, :width]) / (grey + _BLACK)
    return np.asarray(np.clip((images + _BLACK) * gain[:, None] - _BLACK, 0, 1), dtype=np.float32)


@lru_cache(maxsize=8)
def _transfer(rows: int, columns: int, width: int, cutoff: float, low: float, high: float) -> NDArray[np.float32]:
    """Return T (rows, columns // 2 + 1)."""
    v = np.fft.fftfreq(rows, d=1 / width)[:, None]
    u = np.fft.rfftfreq(columns, d=1 / width)[None]
    return (low + (high - low) * (1 - np.exp(-(u**2 + v**2) / (2 * cutoff**2)))).astype(np.float32)
