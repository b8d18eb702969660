"""Histograms of oriented gradients of a whole panorama ([T] 3.2.2, [I] 3.1, [C] 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.alignment import Turns, whitened_turns
from analytic.arrays import Floats, Integers
from analytic.description import Description
from analytic.descriptors.base import Cells, ImageDescriptor


@dataclass(frozen=True, kw_only=True)
class Hog(ImageDescriptor):
    """Histograms of gradient directions: in horizontal bands for the position, in vertical windows for the heading.

    Gradients are central differences of the grey values f (row i, column j): Dx = (f[i, j + 1] - f[i, j - 1]) / 2 and
    Dy = (f[i + 1, j] - f[i - 1, j]) / 2, rows counted downwards. The first and the last column are neighbours;
    the first and the last row are repeated beyond the border, so that Dy is half the difference of two rows there.
    With `circular=False` the first and the last column are repeated as well.

    Each pixel adds its magnitude |G| = sqrt(Dx^2 + Dy^2) ([T] eq. 3.1) to one bin, that of its direction
    theta = atan2(Dy, Dx) over 360 degrees: of b bins it is bin floor(theta b / (2 pi) + 1 / 2) mod b. Bin t is
    therefore centred on 2 pi t / b, and bin 0 on a gradient to the right. The most common edges of a building, upright
    and horizontal ones, fall in the middle of a bin and not on the border of two, where rounding or the slightest noise
    would decide. A pixel without gradient adds nothing. Nothing is interpolated or normalized; the default distance,
    Pearson's, with which [T] 3.5.1 has its best result, ignores gain and offset.

    Position (B, rows * bins): value r * bins + t is the sum over bin t in band r, bands counted from above, each
    H / rows rows high and as wide as the image. Orientation (B, W / step, orientation_bins): value [k, t] is the sum
    over bin t in window k, as high as the image: columns k * step to k * step + window - 1, which wrap around. With
    `circular=False` windows end at the last column.

    The relative heading is the turn, in steps of windows, at which the circular correlation of the two orientation
    parts along the windows, summed over the bins, is largest: the scalar product of [T] 3.3.2. With `whitened` it uses
    phases: the discrete Fourier transform of each bin along the windows, divided by its magnitude at each frequency,
    replaces the histograms; magnitudes below 1e-5 of the image's largest count as zero. No part of the image then
    outweighs the others, as the upright edge of a person in front of the camera otherwise would. The aligned distance
    is the Euclidean one of the histograms at that turn, whitened or not.

    Args:
        rows: horizontal bands, k5 in [T] table 3.1. They divide the height of an image.
        bins: directions in the position part, b1.
        window: width of a vertical window in columns, l1. [T] 3.5.3 finds wide windows best.
        step: columns between the windows, d1; it divides the width of an image. It is the angular resolution.
        orientation_bins: directions in the orientation part, b2.
        whitened: whether the heading comes from phases alone. This addition to the papers is much less misled by
            bars across the image; False is the scalar product of [T] 3.3.2.

    The defaults are the best of [T] 3.5.1 for the position, and step and bins of [I] 6.1 for the heading; neither gives
    the width of its windows. The mapper of [I] 6.1 and [T] 4.5.1 has rows=16, bins=16, step=2, orientation_bins=16.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> hog = analytic.descriptor("hog")
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = hog.describe(panoramas), hog.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(hog.relative_heading(turned, known))
        array([-90., -90.])
    """

    name = "hog"
    default_distance = "correlation"
    divides = (("rows", "height"), ("step", "width"))

    rows: Cells = 8
    bins: Cells = 32
    window: Cells = 32
    step: Cells = 2
    orientation_bins: Cells = 16
    whitened: bool = True

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the shapes (k5 b1,) of the position part and (k6, b2) of the orientation part, k6 = width / step."""
        return (self.rows * self.bins,), (width // self.step, self.orientation_bins)

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        height, width = image.shape
        wide = np.pad(image, ((0, 0), (1, 1)), mode="wrap" if self.circular else "edge")
        tall = np.pad(image, ((1, 1), (0, 0)), mode="edge")
        across, down = wide[:, 2:] - wide[:, :-2], tall[2:] - tall[:-2]  # 2 Dx and 2 Dy
        magnitude = np.sqrt(across * across + down * down).astype(np.float64)  # as the sums need it
        angle = np.arctan2(down, across)
        band = np.arange(height)[:, None] // (height // self.rows)
        position = _histograms(band, self.rows, angle, self.bins, magnitude)
        columns = _histograms(np.arange(width), width, angle, self.orientation_bins, magnitude)
        return position.reshape(-1), window_sums(columns, self.window, self.step, self.circular)

    def _best_turns(self, queries: Description, references: Description, steps: int) -> Turns:
        find = whitened_turns if self.whitened else super()._best_turns
        return find(queries, references, steps)


def window_sums(columns: NDArray[np.float32], window: int, step: int, circular: bool) -> NDArray[np.float32]:
    """Return the sums (W / step, F) of F values per column (W, F) over windows of columns.

    Example:
        >>> window_sums(np.arange(4.0).reshape(4, 1), window=2, step=1, circular=True).ravel()
        array([1., 3., 5., 3.], dtype=float32)
    """
    width = len(columns)
    # The running sum starts with a column of zeros, which counts in no window.
    ends = columns[:window] if circular else np.zeros_like(columns[:window])
    total = np.concatenate([np.zeros_like(columns[:1]), columns, ends]).cumsum(axis=0, dtype=np.float64)
    return (total[window : window + width : step] - total[:width:step]).astype(np.float32)


def cell_sums(cell: Integers, cells: int, place: Integers, bins: int, weight: NDArray[np.floating]) -> Floats:
    """Return the sums (cells, bins) of the weights of the pixels in each cell and bin.

    Args:
        cell: cell of each pixel, (H, 1) or (W,).
        cells: number of cells.
        place: (H, W) bin of each pixel.
        bins: number of bins.
        weight: (H, W) weight of each pixel.
    """
    sums = np.bincount((cell * bins + place).ravel(), weight.ravel(), cells * bins)
    return np.asarray(sums.reshape(cells, bins), dtype=np.float64)


def _histograms(
    cell: Integers, cells: int, angle: NDArray[np.float32], bins: int, magnitude: Floats
) -> NDArray[np.float32]:
    """Return half the sums of magnitudes by cell and bin of the direction (cells, bins).

    Bins are counted from the direction -pi, which is also pi: this bin is cut in two, and its other half, one bin more
    after the last, is added to it.
    """
    place = (angle * np.float32(bins / (2 * pi)) + np.float32(bins // 2 + 0.5)).astype(np.int64)
    sums = cell_sums(cell, cells, place, bins + 1, magnitude) / 2
    sums[:, 0] += sums[:, bins]
    return np.roll(sums[:, :bins], -(bins // 2), axis=1).astype(np.float32)
