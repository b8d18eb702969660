"""What happens to panoramas before a network looks at them: brightness and contrast are taken out."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

DARK = 1e-3  # keeps an image without contrast from being divided by 0
SURROUNDINGS = 0.15  # how far the surroundings of a pixel reach, in heights of the image
LEAST_CONTRAST = 0.03  # of the surroundings, in units of [0, 1]: below it is noise, which must not be blown up


def by_image(panorama: Tensor) -> Tensor:
    """Give each image (B, 3, H, W) zero mean and unit variance: neither exposure nor contrast matters."""
    centred = panorama - panorama.mean(dim=(1, 2, 3), keepdim=True)
    deviation = centred.square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return centred / (deviation + DARK)


def by_surroundings(panorama: Tensor, circular: bool) -> Tensor:
    """Give the surroundings of each pixel zero mean and unit contrast: light that varies over the image goes, too.

        (I - m) / (s + s0),   s^2 = mean over the surroundings and the colours of (I - m)^2,

    with m the mean of each colour over a square around the pixel that reaches 0.15 H to each side, and s0 = 0.03
    ([Jarrett 2009], with a square instead of a Gaussian). A room twice as bright looks the same, also where another
    part of the image keeps its brightness. What is left is a picture of edges and textures.

    Args:
        panorama: (B, 3, H, W), floating point in [0, 1].
        circular: whether the columns wrap around; where they do not, and at the top and bottom, the edge is repeated.
    """
    reach = max(round(SURROUNDINGS * panorama.shape[-2]), 1)
    centred = panorama - _mean_around(panorama, reach, circular)
    square = centred.square().mean(dim=1, keepdim=True)
    return centred / (_mean_around(square, reach, circular).sqrt() + LEAST_CONTRAST)


def _mean_around(values: Tensor, reach: int, circular: bool) -> Tensor:
    """Return the means over squares of 2 reach + 1 rows and columns: of rows first, then of columns."""
    columns = (reach, reach, 0, 0)
    if circular and reach <= values.shape[-1]:
        values = torch.cat([values[..., -reach:], values, values[..., :reach]], dim=-1)
    else:
        values = F.pad(values, columns, mode="replicate")
    values = F.pad(values, (0, 0, reach, reach), mode="replicate")
    window = 2 * reach + 1
    return F.avg_pool2d(F.avg_pool2d(values, (1, window), stride=1), (window, 1), stride=1)
