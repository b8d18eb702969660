"""Normalize panoramas for a network: remove brightness and contrast."""

from __future__ import annotations

import torch
from torch import Tensor

DARK = 1e-3  # avoids division by 0 for an image without contrast
SURROUNDINGS = 0.15  # reach of the surroundings of a pixel, in image heights
LEAST_CONTRAST = 0.03  # of the surroundings, in units of [0, 1]: anything below is noise, which must not be amplified


def by_image(panorama: Tensor) -> Tensor:
    """Give each image (B, 3, H, W) zero mean and unit variance: neither exposure nor contrast matters."""
    centred = panorama - panorama.mean(dim=(1, 2, 3), keepdim=True)
    deviation = centred.square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return centred / (deviation + DARK)


def by_surroundings(panorama: Tensor, circular: bool, *, colours: bool = True) -> Tensor:
    """Give the surroundings of each pixel zero mean and unit contrast: removes even light that varies over the image.

        (I - m) / (s + s0),   s^2 = mean over the surroundings and the colours of (I - m)^2,

    with m the mean over a square around the pixel that reaches 0.15 H to each side, and s0 = 0.03 ([Jarrett 2009], with
    a square instead of a Gaussian). A room twice as bright looks the same, even if another part of the image keeps its
    brightness. The result shows edges and textures.

    Args:
        panorama: (B, 3, H, W), floating point in [0, 1].
        circular: whether the columns wrap around; if not, and at the top and bottom, the edge is repeated.
        colours: if True, m is the mean of each colour, which also removes the colour of the light. Otherwise m is the
            mean of all three: a coloured wall keeps its colour.
    """
    height, width = panorama.shape[-2:]
    reach = max(round(SURROUNDINGS * height), 1)
    rows = _means(height, reach, False, panorama)
    columns = _means(width, reach, circular, panorama).T
    # The means of a square are products with a matrix from each side, much faster than pooling on a CPU. They stay in
    # full precision, since they are subtracted from nearly equal numbers.
    with torch.autocast(device_type=panorama.device.type, enabled=False):
        level = panorama if colours else panorama.mean(dim=1, keepdim=True)
        centred = panorama - rows @ (level @ columns)
        square = centred.square().mean(dim=1, keepdim=True)
        return centred / ((rows @ (square @ columns)).clamp(min=0).sqrt() + LEAST_CONTRAST)


def _means(size: int, reach: int, wraps: bool, like: Tensor) -> Tensor:
    """Return the matrix (size, size) that averages each place with those up to `reach` away."""
    beside = torch.arange(size, device=like.device)[:, None] + torch.arange(-reach, reach + 1, device=like.device)
    source = beside % size if wraps else beside.clamp(0, size - 1)
    weight = torch.full(source.shape, 1 / source.shape[1], dtype=like.dtype, device=like.device)
    return torch.zeros(size, size, dtype=like.dtype, device=like.device).scatter_add(1, source, weight)
