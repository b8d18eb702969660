"""The homomorphic filter, which reduces slow changes of light across an image ([C] 2.4)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analytic.images import luma

_CUTOFF = 4.0  # cycles per image width, where the gain changes from that of slow changes to that of fast ones
_LOW, _HIGH = 0.5, 1.0
_BLACK = np.float32(1 / 255)  # added before the logarithm, so that it exists for black: one 8-bit grey level


def homomorphic(images: NDArray[np.float32], *, circular: bool = True) -> NDArray[np.float32]:
    """Reduce slow changes of light in images (B, C, H, W), float32 in [0, 1], C being 1 or 3.

    What a camera sees is light times reflectance; light changes slowly across an image, reflectance fast. The
    logarithm turns the product into a sum, in which a linear filter can separate slow from fast. For luma Y (BT.601),

        Y' = exp(F^-1(T F(log(Y + 1/255)))) - 1/255,
        T(u, v) = 1/2 + 1/2 (1 - exp(-(D / 4)^2 / 2)), D = W sqrt((u / N)^2 + (v / M)^2).

    F is the discrete Fourier transform of the image, extended by its mirror image in elevation (M = 2 H rows: the
    last row is followed by itself) and, unless columns wrap around (N = W), likewise in azimuth (N = 2 W). u and v are
    signed whole frequencies, so that D is in cycles per image width, the same in both directions. The mean of the
    logarithm (D = 0) is halved, too, which brings exposures closer together.

    A colour image keeps its colours: each channel I becomes (I + 1/255) g - 1/255, clipped to [0, 1], with the gain
    g = (Y' + 1/255) / (Y + 1/255) of its pixel.

    Args:
        images: (B, C, H, W), colour (C = 3) or grey (C = 1).
        circular: whether columns wrap around; otherwise they are extended by their mirror image.

    Example:
        >>> lamp = 0.5 + 0.4 * np.cos(2 * np.pi * np.arange(64) / 64)  # light from one side
        >>> image = np.tile(lamp.astype(np.float32), (1, 1, 16, 1))
        >>> even = homomorphic(image)
        >>> round(float(np.ptp(image)), 2), round(float(np.ptp(even)), 2)
        (0.8, 0.65)
    """
    grey = luma(images)[:, 0]
    height, width = grey.shape[1:]
    log = np.log(grey + _BLACK)
    log = np.concatenate([log, log[:, ::-1]], axis=1)
    if not circular:
        log = np.concatenate([log, log[:, :, ::-1]], axis=2)
    smooth = np.fft.irfft2(np.fft.rfft2(log) * _transfer(*log.shape[1:], width), s=log.shape[1:], axes=(1, 2))
    gain = np.exp(smooth[:, :height, :width]) / (grey + _BLACK)
    return np.asarray(np.clip((images + _BLACK) * gain[:, None] - _BLACK, 0, 1), dtype=np.float32)


@lru_cache(maxsize=8)
def _transfer(rows: int, columns: int, width: int) -> NDArray[np.float32]:
    """Return T (rows, columns // 2 + 1)."""
    v = np.fft.fftfreq(rows, d=1 / width)[:, None]
    u = np.fft.rfftfreq(columns, d=1 / width)[None]
    return (_LOW + (_HIGH - _LOW) * (1 - np.exp(-(u**2 + v**2) / (2 * _CUTOFF**2)))).astype(np.float32)
