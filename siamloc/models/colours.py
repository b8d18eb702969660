"""Colours of an image as numbers alongside the learned ones: histograms, as in the analytic descriptor `hsv`."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from siamloc.errors import ConfigError
from siamloc.models.registry import BANDS, HUES, SATURATIONS, VALUES

WEIGHT = 1.25
"""Weight of the squared distance between colours; that between learned numbers, which have unit length, has 1."""
_OF_VALUES = 0.25  # weight of the values in a band; that of hues and saturations is 1
_TIE = 1e-4  # of a bin; an 8-bit value is exactly on an edge, or further from it than this


class Colours(nn.Module):
    """Describe images by how often each hue, saturation and brightness occurs in each of four horizontal bands.

    The numbers are those of `analytic.descriptor("hsv", rows=4)`, scaled to a length of sqrt(1.25). They do not depend
    on where in a row a pixel is, so a turn of the panorama leaves them exactly as they are. A learned descriptor
    compares places in any light; colours distinguish places that look alike in shape, in the light of the map.

    Args:
        image_size: (H, W) in pixels.

    Raises:
        ConfigError: a height that is no multiple of 4.

    Example:
        >>> Colours((64, 256))(torch.rand(2, 3, 64, 256)).shape
        torch.Size([2, 800])
    """

    def __init__(self, image_size: tuple[int, int]) -> None:
        super().__init__()
        if image_size[0] % BANDS:
            raise ConfigError(
                f"colours=true describes {BANDS} bands of equal height, and the images have {image_size[0]} rows: take "
                f"a multiple of {BANDS}, or set model.colours=false (from Python colours=False)"
            )

    def forward(self, panorama: Tensor) -> Tensor:
        """Return (B, 800) for panoramas (B, 3, H, W), floating point in [0, 1]."""
        bands = panorama.float().unflatten(2, (BANDS, -1)).flatten(3)  # (B, 3, rows, pixels)
        red, green, blue = bands.unbind(1)
        value = torch.maximum(torch.maximum(red, green), blue)
        chroma = value - torch.minimum(torch.minimum(red, green), blue)
        scale = chroma + (chroma == 0)
        hue = torch.where(value == green, (blue - red) / scale + 2, (red - green) / scale + 4)
        hue = torch.where(value == red, (green - blue) / scale, hue) / 6  # -1/6 to 5/6
        saturation = chroma / (value + (value == 0))
        hues = _bins(hue, HUES).remainder(HUES)
        both = _counts(hues * SATURATIONS + _bins(saturation, SATURATIONS), HUES * SATURATIONS)
        counts = torch.cat([both, _OF_VALUES * _counts(_bins(value, VALUES), VALUES)], dim=2)
        return (counts * (WEIGHT / ((1 + _OF_VALUES) * BANDS * bands.shape[3]))).sqrt().flatten(1)


def _bins(share: Tensor, count: int) -> Tensor:
    """Return the bins (B, bands, pixels) of values from 0 to 1; the last bin includes all above it."""
    return (share * count + _TIE).floor().clamp(max=count - 1)


def _counts(bins: Tensor, count: int) -> Tensor:
    """Return how many pixels (B, bands, pixels) are in each bin (B, bands, count): sums of ones, exact in any order."""
    bands = torch.arange(bins.shape[0] * BANDS, device=bins.device)[:, None]
    rows = bins.long().clamp(0, count - 1).flatten(0, 1) + count * bands  # of one long histogram
    empty = bins.new_zeros(bins.shape[0] * BANDS * count)
    return empty.scatter_add(0, rows.flatten(), torch.ones_like(bins).flatten()).view(-1, BANDS, count)
