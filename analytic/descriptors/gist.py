"""Gist: how strongly a bank of Gabor filters responds, in bands and in windows ([T] 3.2.3, 3.3.3; [I] 3.2; [C] 2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, cos, floor, pi, sin
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Cells, ImageDescriptor
from analytic.errors import AnalyticError

LEVELS = 2
CENTRE = 0.25  # cycles per pixel of the level's image
_FLOOR = 2.0**-9
_FAINT = 1e-3

Places = tuple[list[int], list[int]]


@dataclass(frozen=True, kw_only=True)
class Gist(ImageDescriptor):
    """Mean magnitude of Gabor responses at two resolutions: in horizontal bands, and in vertical windows.

    The image, H rows i counted downwards and W columns j, is extended in elevation by reflection, with each end row
    repeated once (row -1 - i is row i, row 2 H - 1 - i is row i: a period of 2 H rows), and wraps around in azimuth.
    With `circular=False` it is reflected in the same way in azimuth (a period of 2 W columns). All filters act on the
    periodic image, through its discrete Fourier transform, so nothing else is assumed at the borders.

    Filter k of m has the orientation theta = pi k / m, k = 0 ... m - 1, and the centre frequency f (cos theta,
    sin theta) in cycles per pixel to the right and downwards: theta = 0 responds to upright edges. Its transfer
    function is a round (aspect ratio 1) Gaussian about this centre, one octave wide at half its height, lowered so
    that it is 0 from the distance f on, and so for a constant image:

        G(d) = 2 max(0, (2^(-9 (d / f)^2) - 2^-9) / (1 - 2^-9)),    d = distance to the centre in the frequency plane,

    at the frequencies u / 2H and v / W (v / 2W) in [-1/2, 1/2). It passes one of each pair of opposite frequencies, so
    the response is complex, with the even filter as its real part and the odd one as its imaginary part. A wave at the
    centre frequency with amplitude a has a response of magnitude a.

    Level 0 is the image itself, with f = 1/4. Level 1 is the image at half resolution, without its frequencies from
    1/4 on, with a filter of 1/4 cycles per pixel there, that is f = 1/8 here; as this filter passes nothing above 1/4,
    filtering the image itself with f = 1/8 gives the same response. It is read at all H x W pixels, as at level 0: a
    turn by any number of columns then only moves it, whereas the image of W / 2 columns would change.

    With R(level, k; i, j) the magnitude of the response:

    Position (2 * blocks * orientations,): value (level * blocks + b) * orientations + k is the mean of R, filter k of
    `orientations`, over the rows b H / blocks ... (b + 1) H / blocks - 1 and all columns.
    Orientation (W / step, orientation_levels * orientation_filters): value [n, level * orientation_filters + k] is
    the mean of R, filter k of `orientation_filters`, over all rows and the columns n step ... n step + window - 1,
    which wrap around. With `circular=False` windows end at the last column, and the mean is over the columns they have.
    With `normalized` the values o of each window n become (o - m) / sqrt(|o - m|^2 + 0.001^2), m being the mean of
    the window's values and |.| the Euclidean length: this leaves which orientations prevail in a window. All
    filters respond to noise alike, and the edge of an obstacle counts like any other edge, in the few windows that
    contain it; with plain means both can outweigh the rest of the image.

    The position part, and plain means, scale with contrast and ignore an offset of the grey values. [T] 3.5.1 has its
    best result with Pearson's correlation, the default distance, which also ignores contrast.

    Args:
        blocks: horizontal bands, k7 of [T] table 3.1. They divide the height of an image.
        orientations: filters of the position part, m1, for 0 to 180 degrees.
        window: width of a vertical window in columns, l2. Wide windows, which [T] 3.5.3 finds best for plain
            means, blur the heading of normalized ones.
        step: columns between the windows, d2; it divides the width of an image. It is the angular resolution.
        orientation_filters: filters of the orientation part, m2.
        orientation_levels: 1 (level 0 alone) or 2.
        normalized: whether the windows of the orientation part are normalized.

    The defaults are the best of [T] 3.5.1 for the position, and those of [I] 6.1 for the heading, whose
    mapper has blocks=16 and orientations=16. The time grows with the number of different orientations.

    Raises:
        AnalyticError: more than 2 levels, or a single filter in normalized windows,
            which would leave nothing.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> gist = analytic.descriptor("gist", orientations=8)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = gist.describe(panoramas), gist.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(gist.relative_heading(turned, known))
        array([-90., -90.])
    """

    name = "gist"
    default_distance = "correlation"
    divides = (("blocks", "height"), ("step", "width"))

    blocks: Cells = 32
    orientations: Cells = 256
    window: Cells = 8
    step: Cells = 2
    orientation_filters: Cells = 16
    orientation_levels: Literal[1, 2] = 1
    normalized: bool = True

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (2 k7 m1,) for the position part, and (W / step, levels m2) for the orientation part."""
        position = (LEVELS * self.blocks * self.orientations,)
        return position, (width // self.step, self.orientation_levels * self.orientation_filters)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.normalized and self.orientation_filters == 1:
            raise AnalyticError("gist needs 2 orientation_filters or more, got 1: use more, or normalized=False")

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        height, width = image.shape
        angles, needed, of_position, of_orientation = choose(self.orientations, self.orientation_filters)
        tall = np.concatenate([image, image[::-1]])
        picture = tall if self.circular else np.concatenate([tall, tall[:, ::-1]], axis=1)
        transformed = cv2.dft(picture, flags=cv2.DFT_COMPLEX_OUTPUT).view(np.complex64)[..., 0]
        # The inverse transform equals the forward one of the conjugate, up to scale and what a magnitude does not show.
        spectrum = np.fft.fftshift(transformed.conj())
        rows = np.empty((LEVELS, len(angles), 2 * height), dtype=np.float32)
        columns: list[NDArray[np.float32]] = []
        for level in range(LEVELS):
            values, corners = bank(*picture.shape, CENTRE / 2**level, angles)
            down, right = values.shape[1:]
            product = np.zeros_like(spectrum)
            for a, (top, left) in enumerate(corners):
                seen = spectrum[top : top + down, left : left + right]
                np.multiply(seen, values[a], out=product[:down, :right])
                answer = cv2.dft(product.view(np.float32).reshape(*product.shape, 2))
                magnitude = np.abs(answer.view(np.complex64)[:, :width, 0])
                rows[level, a] = magnitude[: 2 * height].mean(axis=1)
                if level < self.orientation_levels and a in needed:
                    halves = magnitude[: 2 * height].reshape(2, height, width)
                    columns.append(halves.mean(axis=1))
        scale = np.float32(1 / picture.size)
        both = np.stack([rows[..., :height], rows[..., : height - 1 : -1]], axis=2) * scale
        bands = both.reshape(LEVELS, len(angles), 2, self.blocks, -1).mean(axis=4)
        position = bands[:, of_position[0], of_position[1]].transpose(0, 2, 1)
        upright = np.stack(columns).reshape(self.orientation_levels, len(needed), 2, width) * scale
        means = upright[:, of_orientation[0], of_orientation[1]].reshape(-1, width)
        orientation = (means @ windows(width, self.window, self.step, self.circular)).T
        if self.normalized:
            orientation = orientation - orientation.mean(axis=1, keepdims=True)
            squares = np.square(orientation).sum(axis=1, keepdims=True)
            orientation = orientation / np.sqrt(squares + np.float32(_FAINT**2))
        return position.reshape(-1).astype(np.float32), orientation.astype(np.float32)


@lru_cache(maxsize=32)
def choose(orientations: int, orientation_filters: int) -> tuple[tuple[float, ...], list[int], Places, Places]:
    """Choose the filters to compute for two sets of orientations.

    The image is its own reflection, so the response of the orientation pi - theta in its rows is that of theta in the
    reflected rows, up to the sign of its phase: one transform of the 2 H rows gives two orientations.

    Returns:
        The angles to compute, in rad in [0, pi / 2], the others being reflections of these; the indices of the angles
        that the orientation part needs; for each filter of the position part the index of its angle, and 1 if it is the
        reflected one; and the same for the orientation part, among the angles that it needs.
    """
    counts = orientations, orientation_filters
    folded = [[min(k, count - k) / count for k in range(count)] for count in counts]
    reflected = [[int(2 * k > count) for k in range(count)] for count in counts]
    computed, few = sorted({*folded[0], *folded[1]}), sorted(set(folded[1]))
    of_position = [computed.index(share) for share in folded[0]], reflected[0]
    of_orientation = [few.index(share) for share in folded[1]], reflected[1]
    return tuple(share * pi for share in computed), [computed.index(s) for s in few], of_position, of_orientation


@lru_cache(maxsize=8)
def bank(
    height: int, width: int, frequency: float, angles: tuple[float, ...]
) -> tuple[NDArray[np.float32], list[tuple[int, int]]]:
    """Return the transfer functions of some orientations, cut out around the centre of each.

    Args:
        height: rows of the periodic image.
        width: columns of the periodic image.
        frequency: centre frequency of the filters in cycles per pixel.
        angles: orientations of the filters in rad, in [0, pi / 2].

    Returns:
        The values of the cut-outs (filters, rows, columns), and the row and column where each begins in the
        frequency plane of a periodic image (height, width) with frequency zero in the middle, as fftshift returns it.
    """
    sides = (height, width)
    cut = [min(side, floor(2 * frequency * side) + 1) for side in sides]
    values, corners = [], []
    for angle in angles:
        squares, corner = [], []
        for side, size, centre in zip(sides, cut, (frequency * sin(angle), frequency * cos(angle)), strict=True):
            lowest = min(ceil((centre - frequency) * side) + side // 2, side - size)
            corner.append(lowest)
            squares.append(((np.arange(lowest, lowest + size) - side // 2) / side - centre) ** 2)
        apart = np.add.outer(*squares) / frequency**2
        values.append((2 * np.maximum(0, (2.0 ** (-9 * apart) - _FLOOR) / (1 - _FLOOR))).astype(np.float32))
        corners.append((corner[0], corner[1]))
    return np.stack(values), corners


@lru_cache(maxsize=8)
def windows(width: int, window: int, step: int, circular: bool) -> NDArray[np.float32]:
    """Return the matrix (W, W / step) that turns the values of W columns into the means of windows.

    Args:
        width: W, the number of columns.
        window: width of a window in columns.
        step: columns between the first columns of two windows.
        circular: whether windows wrap around; otherwise they end at the last column.
    """
    column, first = np.arange(width)[:, None], np.arange(0, width, step)[None]
    inside: NDArray[np.bool_] = (column - first) % width < window
    if not circular:
        inside &= column >= first
    return np.asarray(inside / inside.sum(axis=0), dtype=np.float32)
