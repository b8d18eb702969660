"""What a network finds headings by: its features along the azimuth, at twice as many columns as the head sees."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

VALUES = 64
_SMALLEST = 1e-12


class Orientation(nn.Module):
    """The features of a panorama as an orientation part: few numbers for each column, which move when the robot turns.

    All channels and rows of a column are mixed into 64 sums with random signs, which nearly keeps the correlations
    between columns [Achlioptas 2003] at a small part of the size. Then the mean over the columns is taken away,
    neighbouring columns are averaged, which fades out the high frequencies that coarse columns show wrongly, and all is
    scaled to a mean square of 1. Nothing in it is trained, and the signs are the same on every machine.

    Args:
        level: how many layers of the branch give the features.
        shape: (C, h, w) of the features.
        grid: rows and columns to which they are averaged where they have more.

    Example:
        >>> from siamloc.models import build
        >>> network = build("panoresnet", "fourier", (64, 256), circular=True).eval()
        >>> position, orientation = network.with_orientation(torch.rand(2, 3, 64, 256))
        >>> position.shape, orientation.shape
        (torch.Size([2, 256]), torch.Size([2, 32, 64]))
    """

    signs: Tensor

    def __init__(self, level: int, shape: tuple[int, int, int], grid: tuple[int, int]) -> None:
        super().__init__()
        self.level = level
        self.grid = grid if shape[1:] != grid else None
        self.register_buffer("signs", torch.empty(VALUES, shape[0] * grid[0]), persistent=False)

    def reset(self) -> None:
        """Fill in the signs."""
        with torch.no_grad():
            # Raw bits, because their order is promised for all versions of NumPy: maps keep what they make.
            bits = np.random.PCG64(0).random_raw(self.signs.numel()) >> np.uint64(63)
            self.signs.copy_(torch.from_numpy(bits.astype(np.float32) * 2 - 1).view(self.signs.shape))

    def forward(self, features: Tensor) -> Tensor:
        """Return the orientation parts (B, columns, 64) of features (B, C, h, w)."""
        if self.grid is not None:
            features = F.adaptive_avg_pool2d(features, self.grid)
        mixed = self.signs @ features.flatten(1, 2)
        mixed = mixed + mixed.roll(1, dims=2)
        mixed = mixed - mixed.mean(dim=2, keepdim=True)
        square = mixed.square().mean(dim=(1, 2), keepdim=True)
        return (mixed / (square + _SMALLEST).sqrt()).transpose(1, 2)
