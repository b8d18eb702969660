"""Colour histograms: how often each hue, saturation and brightness occurs in bands and in windows of a panorama."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from analytic.alignment import Turns, whitened_turns
from analytic.description import Description
from analytic.descriptors.base import Cells, ImageDescriptor
from analytic.descriptors.hog import cell_sums, window_sums

_TIE = 1e-4  # of a bin; an 8-bit value is exactly on an edge, or further from it than this


@dataclass(frozen=True, kw_only=True)
class Hsv(ImageDescriptor):
    """Histograms of hue, saturation and value: in horizontal bands for the position, in windows for the heading.

    Colours are converted to the HSV cone: the value v is the largest of red, green and blue, the saturation s = (v - m)
    / v with m the smallest (0 for black), and the hue h in [0, 1) the angle on the colour circle from red by way of
    green and blue, as a share of the circle (0 for grey).

    With n bins, hue is in bin floor(n h), saturation in bin floor(n s) and value in bin floor(n v), or in the last one
    if that is n. Edges are lowered by 1e-4 of a bin, so that rounding does not decide for 8-bit colours on an edge.
    Each band has two histograms, one of hue and saturation together and one of values, as shares of its pixels:

    Position (B, rows * (hues * saturations + values)): band after band from above, first the share of pixels with hue
    bin i and saturation bin j at i * saturations + j, then a quarter of the shares of the value bins. Each entry is the
    square root of that, so that one wide wall does not outweigh the many small things by which two places differ;
    values have little weight because light changes them most.

    Orientation (B, W / step, hues + values): for each window, as high as the image, of the columns k * step to
    k * step + window - 1, which wrap around: the sums of saturation in each hue bin, then the numbers of pixels in each
    value bin, both divided by the number of pixels in a full window. With `circular=False` windows end at the last
    column. The relative heading is found from phases, as in `hog` with `whitened`.

    Hue and saturation do not change with the brightness of the light but with its colour; this is not corrected.
    A grey image has hue and saturation 0, so only values distinguish its place. With `homomorphic` the three channels
    of a pixel get the same gain, which preserves its hue.

    The thesis has no colour descriptor: this one is an addition. Its defaults were chosen on photographs of a
    corridor and in a simulated building; `analytic/descriptors/README.md` has the figures.

    Args:
        rows: horizontal bands. They divide the height of an image.
        hues: number of hue bins.
        saturations: number of saturation bins.
        values: number of value bins.
        window: width of a vertical window in columns.
        step: columns between the windows; it divides the width of an image. It is the angular resolution.

    Example:
        >>> import numpy as np
        >>> red, blue = np.zeros((2, 3, 128, 512))
        >>> red[0], blue[2] = 1, 1
        >>> hsv = Hsv()
        >>> hsv.pairwise(hsv.describe(red), hsv.describe(np.stack([red, blue]))).round(2)
        array([[ 0., 16.]])
    """

    name: ClassVar[str] = "hsv"
    default_distance: ClassVar[str] = "manhattan"
    colour: ClassVar[bool] = True
    divides = (("rows", "height"), ("step", "width"))

    rows: Cells = 8
    hues: Cells = 24
    saturations: Cells = 8
    values: Cells = 8
    window: Cells = 32
    step: Cells = 2

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (rows * (hues * saturations + values),) for the position part, and (W / step, hues + values)."""
        position = self.rows * (self.hues * self.saturations + self.values)
        return (position,), (width // self.step, self.hues + self.values)

    def _best_turns(self, queries: Description, references: Description, steps: int) -> Turns:
        return whitened_turns(queries, references, steps)

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        height, width = image.shape[1:]
        hue, saturation, value = cone(np.broadcast_to(image, (3, height, width)))
        colour = _bins(hue, self.hues) % self.hues
        brightness = np.minimum(_bins(value, self.values), self.values - 1)
        strength = np.minimum(_bins(saturation, self.saturations), self.saturations - 1)
        both = colour * self.saturations + strength
        row, column = np.arange(height)[:, None] // (height // self.rows), np.arange(width)
        of_band = height // self.rows * width
        every = np.ones_like(hue)
        shares = [
            cell_sums(row, self.rows, both, self.hues * self.saturations, every).astype(np.float32) / of_band,
            cell_sums(row, self.rows, brightness, self.values, every).astype(np.float32) / (4 * of_band),
        ]
        columns = [
            cell_sums(column, width, colour, self.hues, saturation),
            cell_sums(column, width, brightness, self.values, every),
        ]
        together = np.concatenate(columns, axis=1).astype(np.float32)
        windows = window_sums(together, self.window, self.step, self.circular)
        return np.sqrt(np.concatenate(shares, axis=1)).reshape(-1), windows / np.float32(height * self.window)


def cone(colours: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Convert an image (3, H, W) to hue in [-1/6, 5/6], saturation and value in [0, 1], (H, W) each.

    Example:
        >>> [float(part[0, 0]) for part in cone(np.array([0.25, 0.5, 0.25], dtype=np.float32).reshape(3, 1, 1))]
        [0.3333333432674408, 0.5, 0.5]
    """
    red, green, blue = colours
    value = colours.max(axis=0)
    chroma = value - colours.min(axis=0)
    scale = chroma + (chroma == 0)
    hue = np.where(value == green, (blue - red) / scale + np.float32(2), (red - green) / scale + np.float32(4))
    hue = np.where(value == red, (green - blue) / scale, hue)
    return hue / np.float32(6), chroma / (value + (value == 0)), value


def _bins(share: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    return np.floor(share * np.float32(count) + np.float32(_TIE)).astype(np.int64)
