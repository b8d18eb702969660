"""Orientation parts, which find headings from features along the azimuth; and turning to a canonical direction."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from siamloc.models.heads import random_signs

VALUES = 64
_SMALLEST = 1e-12
_PRECISION = 1 << 20


class Orientation(nn.Module):
    """Turn the features of a panorama into an orientation part: a few numbers per column that move with the robot.

    All channels and rows of a column are mixed into 64 sums with random signs, which nearly preserves the correlations
    between columns [Achlioptas 2003] at a fraction of the size. Then the mean over the columns is subtracted,
    neighbouring columns are averaged, which fades out the high frequencies that alias on coarse columns, and everything
    is scaled to a mean square of 1. Nothing in it is trained, and the signs are the same on every machine.

    With `trained=True` the sums are learned together with `siamloc.models.relative`, which estimates displacements from
    them, and neighbouring columns are not averaged. This does not train the features themselves.

    Args:
        level: number of layers of the branch up to the features.
        shape: (C, h, w) of the features.
        grid: rows and columns to which larger features are averaged.
        canonical: columns of the panorama, if it is first turned to its canonical direction, which is undone here.
        trained: whether the sums are learned; they start with random signs.

    Example:
        >>> from siamloc.models import build
        >>> network = build("panoresnet", "fourier", (64, 256), circular=True).eval()
        >>> position, orientation = network.with_orientation(torch.rand(2, 3, 64, 256))
        >>> position.shape, orientation.shape
        (torch.Size([2, 256]), torch.Size([2, 32, 64]))
    """

    signs: Tensor | nn.Parameter
    back: Tensor | None

    def __init__(
        self,
        level: int,
        shape: tuple[int, int, int],
        grid: tuple[int, int],
        canonical: int | None = None,
        trained: bool = False,
    ) -> None:
        super().__init__()
        self.level = level
        self.trained = trained
        self.columns = grid[1], canonical
        self.grid = grid if shape[1:] != grid else None
        signs = torch.empty(VALUES, shape[0] * grid[0])
        if trained:
            self.signs = nn.Parameter(signs)
        else:
            self.register_buffer("signs", signs, persistent=False)
        back = None if canonical is None else torch.empty(2 * canonical // grid[1], grid[1], grid[1])
        self.register_buffer("back", back, persistent=False)

    def reset(self) -> None:
        """Fill in the random signs, and the matrices that undo the turn to the canonical direction."""
        columns, canonical = self.columns
        with torch.no_grad():
            if self.back is not None and canonical is not None:
                self.back.copy_(shifts(columns, torch.arange(len(self.back)) * (columns / canonical)))
            self.signs.copy_(random_signs(*self.signs.shape))
            if self.trained:
                self.signs /= self.signs.shape[1] ** 0.5

    def forward(self, features: Tensor, turned: Tensor | None = None) -> Tensor:
        """Return the orientation parts (B, columns, 64) of features (B, C, h, w).

        Args:
            features: features of the branch after `level` layers.
            turned: number of columns (B,) by which the panoramas were turned first, see `Canonical`.
        """
        if self.grid is not None:
            features = F.adaptive_avg_pool2d(features, self.grid)
        if self.trained:
            features = features.detach()
        mixed = self.signs @ features.flatten(1, 2)
        if self.back is not None and turned is not None:
            mixed = mixed @ self.back[turned]
        if not self.trained:
            mixed = mixed + mixed.roll(1, dims=2)
        mixed = mixed - mixed.mean(dim=2, keepdim=True)
        square = mixed.square().mean(dim=(1, 2), keepdim=True)
        return (mixed / (square + _SMALLEST).sqrt()).transpose(1, 2)


class Canonical(nn.Module):
    """Turn each panorama to a direction that its own content determines, by less than a feature column's width.

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
        """Fill in the waves: a period of a cosine at each shift by whole columns, in whole numbers."""
        column = torch.arange(self.period)
        angle = ((column[:, None] - column) % self.period).double() * (2 * torch.pi / self.period)
        with torch.no_grad():
            self.waves.copy_((angle.cos() * _PRECISION).round())

    def forward(self, panorama: Tensor) -> tuple[Tensor, Tensor]:
        """Return panoramas (B, 3, H, W) in their canonical direction, and the columns (B,) by which each was turned.

        Column c of a returned panorama is column c + turned of the given one.
        """
        levels = (panorama * 255).round().float()  # sums of whole numbers are the same in any order
        signal = levels.sum(dim=(1, 2)).double().unflatten(1, (-1, self.period)).sum(dim=1)
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
