"""Turn panoramas to a canonical direction, so that turning by whole columns changes nothing afterwards."""

from __future__ import annotations

import torch
from torch import Tensor, nn

_PRECISION = 1 << 20


class Canonical(nn.Module):
    """Turn each panorama by less than the width of a feature column, to the crest of a wave of that length.

    Features computed with strides along the azimuth shift when the robot turns by one of their columns; in between they
    change. Summing all pixels in columns that are one such stride apart gives a signal of one period. Turning the robot
    turns this signal, too, so its first harmonic shows how far to turn back. The nearest whole column is found in whole
    numbers, so that on every machine a panorama and its turned copies become the same, up to turns by whole columns of
    the features, which heads such as `magnitudes` discard.

    Args:
        period: columns of the panorama per column of the features.

    Example:
        >>> panorama = torch.rand(1, 3, 8, 32, generator=torch.Generator().manual_seed(0))
        >>> turn = Canonical(period=4)
        >>> turn.reset()
        >>> (one, turned), (other, further) = turn(panorama), turn(panorama.roll(1, dims=3))
        >>> turned.item(), further.item(), bool((other == one).all())
        (2, 3, True)
    """

    waves: Tensor

    def __init__(self, period: int) -> None:
        super().__init__()
        self.period = period
        self.register_buffer("waves", torch.empty(period, period, dtype=torch.int64), persistent=False)

    def reset(self) -> None:
        """Fill in the waves: one period of a cosine, shifted by each number of columns, in whole numbers."""
        column = torch.arange(self.period)
        angle = ((column[:, None] - column) % self.period).double() * (2 * torch.pi / self.period)
        with torch.no_grad():
            self.waves.copy_((angle.cos() * _PRECISION).round())

    def forward(self, panorama: Tensor) -> tuple[Tensor, Tensor]:
        """Return panoramas (B, 3, H, W) in their canonical direction, and the columns (B,) by which each was turned.

        Column c of a returned panorama is column c + turned of the given one.
        """
        levels = (panorama * 255).round().double()  # sums of whole numbers are the same in any order
        signal = levels.sum(dim=(1, 2)).unflatten(1, (-1, self.period)).sum(dim=1)
        turned = (signal @ self.waves.double()).argmax(dim=1)  # kept as integers, which .half() does not round
        columns = torch.arange(panorama.shape[3], device=panorama.device)
        seen = (columns + turned[:, None]) % panorama.shape[3]
        return panorama.gather(3, seen[:, None, None].expand_as(panorama)), turned


def shifts(columns: int, steps: Tensor) -> Tensor:
    """Return the matrices (S, n, n) that shift periodic signals of n columns by fractions of a column.

    Column c of `signal @ matrix` is the value at c - step of the signal, interpolated by its harmonics.
    """
    column = torch.arange(columns, dtype=torch.float64)
    apart = column - column[:, None] - steps.double()[:, None, None]
    harmonics = torch.arange(1, (columns + 1) // 2, dtype=torch.float64)
    found = 1 + 2 * (apart[..., None] * harmonics * (2 * torch.pi / columns)).cos().sum(dim=-1)
    if columns % 2 == 0:
        found = found + (apart * torch.pi).cos()
    return found / columns
