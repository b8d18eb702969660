"""The homomorphic filter, which reduces slow changes of light across an image ([C] 2.4)."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError
from analytic.images import grey_array, grey_tensor, unit_array, with_channels

if TYPE_CHECKING:
    from torch import Tensor

CUTOFF = 4.0
LOW = 0.5
HIGH = 1.0
_BLACK = 1 / 255  # added before the logarithm, so that it exists for black: one 8-bit grey level


def homomorphic(
    batch: ArrayLike, cutoff: float = CUTOFF, low: float = LOW, high: float = HIGH, *, circular: bool = True
) -> NDArray[Any]:
    """Reduce slow changes of light in images; see `homomorphic_tensor`.

    A colour image keeps its colours: each channel I becomes (I + 1/255) g - 1/255, the gain g being that of the
    pixel's luma (BT.601).

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
        >>> filtered = homomorphic(image)
        >>> round(float(np.ptp(image)), 2), round(float(np.ptp(filtered)), 2)
        (0.8, 0.65)
    """
    _check(cutoff, low, high)
    images = with_channels(batch)
    grey = grey_array(unit_array(batch))
    bright = homomorphic_array(grey, circular=circular, cutoff=cutoff, low=low, high=high, clip=False)
    gain = _gain(bright, grey)[:, None]
    scale = 255 if images.dtype == np.uint8 else 1
    found = np.clip((images + _BLACK * scale) * gain - _BLACK * scale, 0, scale)
    if scale == 255:
        found = np.rint(found)
    return found.astype(images.dtype).reshape(np.shape(batch))


def homomorphic_tensor(
    grey: Tensor, *, circular: bool, cutoff: float = CUTOFF, low: float = LOW, high: float = HIGH, clip: bool = True
) -> Tensor:
    """Return grey images (B, H, W), float32 in [0, 1], after the filter.

    What a camera sees is light times reflectance; light changes slowly across an image, reflectance fast. The
    logarithm turns the product into a sum, in which a linear filter can separate slow from fast:

        exp(F^-1(T F(log(I + 1/255)))) - 1/255, clipped to [0, 1],
        T(u, v) = low + (high - low) (1 - exp(-(D / cutoff)^2 / 2)), D = W sqrt((u / N)^2 + (v / M)^2).

    F is the discrete Fourier transform of the image, extended by its mirror image in elevation (M = 2 H rows: the
    last row is followed by itself) and, unless columns wrap around (N = W), likewise in azimuth (N = 2 W). u and v are
    signed whole frequencies, so that D is in cycles per image width, the same in both directions. The mean of the
    logarithm (D = 0) also has the gain `low`, which brings exposures closer together.
    """
    import torch

    _check(cutoff, low, high)
    height, width = int(grey.shape[1]), int(grey.shape[2])
    log = torch.log(grey + _BLACK)
    log = torch.cat([log, log.flip(1)], dim=1)
    if not circular:
        log = torch.cat([log, log.flip(2)], dim=2)
    transfer = _transfer_on(int(log.shape[1]), int(log.shape[2]), width, cutoff, low, high, str(grey.device))
    smooth = torch.fft.irfft2(torch.fft.rfft2(log) * transfer, s=log.shape[1:])
    filtered = torch.exp(smooth[:, :height, :width]) - _BLACK
    return filtered.clamp_(0, 1) if clip else filtered


def homomorphic_array(
    grey: NDArray[np.float32],
    *,
    circular: bool,
    cutoff: float = CUTOFF,
    low: float = LOW,
    high: float = HIGH,
    clip: bool = True,
) -> NDArray[np.float32]:
    """Return what `homomorphic_tensor` returns, without torch."""
    height, width = grey.shape[1:]
    log = np.log(grey + np.float32(_BLACK))
    log = np.concatenate([log, log[:, ::-1]], axis=1)
    if not circular:
        log = np.concatenate([log, log[:, :, ::-1]], axis=2)
    transfer = _transfer(log.shape[1], log.shape[2], width, cutoff, low, high)
    smooth = np.fft.irfft2(np.fft.rfft2(log) * transfer, s=log.shape[1:], axes=(1, 2))
    filtered = np.exp(smooth[:, :height, :width]) - _BLACK
    return np.asarray(np.clip(filtered, 0, 1) if clip else filtered, dtype=np.float32)


def homomorphic_colours(images: Tensor, *, circular: bool) -> Tensor:
    """Return colour images (B, 3, H, W), float32 in [0, 1], after the filter; see `homomorphic`."""
    grey = grey_tensor(images)
    gain = _gain(homomorphic_tensor(grey, circular=circular, clip=False), grey)[:, None]
    return ((images + _BLACK) * gain).sub_(_BLACK).clamp_(0, 1)


def homomorphic_colours_array(images: NDArray[np.float32], *, circular: bool) -> NDArray[np.float32]:
    """Return what `homomorphic_colours` returns, without torch."""
    grey = grey_array(images)
    gain = _gain(homomorphic_array(grey, circular=circular, clip=False), grey)[:, None]
    return np.asarray(np.clip((images + _BLACK) * gain - _BLACK, 0, 1), dtype=np.float32)


def _gain(filtered: Any, grey: Any) -> Any:
    """Return the factor that the filter multiplies each pixel of grey images (B, H, W) by, arrays or tensors."""
    return (filtered + _BLACK) / (grey + _BLACK)


@lru_cache(maxsize=8)
def _transfer(rows: int, columns: int, width: int, cutoff: float, low: float, high: float) -> NDArray[np.float32]:
    """Return T (rows, columns // 2 + 1)."""
    v = np.fft.fftfreq(rows, d=1 / width)[:, None]
    u = np.fft.rfftfreq(columns, d=1 / width)[None]
    return (low + (high - low) * (1 - np.exp(-(u**2 + v**2) / (2 * cutoff**2)))).astype(np.float32)


@lru_cache(maxsize=8)
def _transfer_on(rows: int, columns: int, width: int, cutoff: float, low: float, high: float, device: str) -> Tensor:
    import torch

    return torch.from_numpy(_transfer(rows, columns, width, cutoff, low, high)).to(device)


def _check(cutoff: float, low: float, high: float) -> None:
    if not (np.isfinite(cutoff) and cutoff > 0):
        raise AnalyticError(f"the homomorphic filter needs a cutoff above 0 cycles per image width, got {cutoff}")
    if not 0 <= low <= high < np.inf:
        raise AnalyticError(f"the homomorphic filter needs gains 0 <= low <= high, got low={low} and high={high}")
