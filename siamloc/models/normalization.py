"""What happens to panoramas before a network looks at them: brightness and contrast are taken out."""

from __future__ import annotations

import torch
from torch import Tensor

DARK = 1e-3  # keeps an image without contrast from being divided by 0
SURROUNDINGS = 0.15  # how far the surroundings of a pixel reach, in heights of the image
LEAST_CONTRAST = 0.03  # of the surroundings, in units of [0, 1]: below it is noise, which must not be blown up


def by_image(panorama: Tensor) -> Tensor:
    """Give each image (B, 3, H, W) zero mean and unit variance: neither exposure nor contrast matters."""
    centred = panorama - panorama.mean(dim=(1, 2, 3), keepdim=True)
    deviation = centred.square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return centred / (deviation + DARK)


def by_surroundings(panorama: Tensor, circular: bool, *, colours: bool = True) -> Tensor:
    """Give the surroundings of each pixel zero mean and unit contrast: light that varies over the image goes, too.

        (I - m) / (s + s0),   s^2 = mean over the surroundings and the colours of (I - m)^2,

    with m the mean over a square around the pixel that reaches 0.15 H to each side, and s0 = 0.03 ([Jarrett 2009], with
    a square instead of a Gaussian). A room twice as bright looks the same, also where another part of the image keeps
    its brightness. What is left is a picture of edges and textures.

    Args:
        panorama: (B, 3, H, W), floating point in [0, 1].
        circular: whether the columns wrap around; where they do not, and at the top and bottom, the edge is repeated.
        colours: m is the mean of each colour, so that the colour of the light goes as well. Otherwise it is that of
            all three: a coloured wall keeps its colour.
    """
    height, width = panorama.shape[-2:]
    reach = max(round(SURROUNDINGS * height), 1)
    rows = _means(height, reach, False, panorama)
    columns = _means(width, reach, circular, panorama).T
    # The means of a square are products with a matrix from each side, much faster than pooling on a CPU. They stay in
    # full precision: what they are subtracted from is nearly the same.
    with torch.autocast(device_type=panorama.device.type, enabled=False):
        level = panorama if colours else panorama.mean(dim=1, keepdim=True)
        centred = panorama - rows @ (level @ columns)
        square = centred.square().mean(dim=1, keepdim=True)
        return centred / ((rows @ (square @ columns)).clamp(min=0).sqrt() + LEAST_CONTRAST)


def _means(size: int, reach: int, wraps: bool, like: Tensor) -> Tensor:
    """Return the matrix (size, size) that takes the mean of each place and those up to `reach` beside it."""
    beside = torch.arange(size, device=like.device)[:, None] + torch.arange(-reach, reach + 1, device=like.device)
    source = beside % size if wraps else beside.clamp(0, size - 1)
    weight = torch.full(source.shape, 1 / source.shape[1], dtype=like.dtype, device=like.device)
    return torch.zeros(size, size, dtype=like.dtype, device=like.device).scatter_add(1, source, weight)
