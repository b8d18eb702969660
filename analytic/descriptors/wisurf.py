"""WI-SURF: upright SURF descriptors of windows that cover the whole panorama ([T] 3.2.4, 3.3.4)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import AlignedDescriptor, Cells, Several, divisors_near
from analytic.errors import AnalyticError

CELLS = 4  # subregions along each side of a window
VALUES = 4 * CELLS * CELLS
SAMPLES = 20  # along each side of a window, by SURF's own sampling
_SIGMA = 3.3 / 20  # SURF's Gaussian, in sides of its window
_LEAST = 1e-6  # the vector of a window with less contrast than this stays shorter than 1


@dataclass(frozen=True, kw_only=True)
class WiSurf(AlignedDescriptor):
    """A SURF vector of 64 values for each square window in a row of windows, in each of several horizontal bands.

    An image (H, W) is cut into `rows` bands of h = H / rows pixel rows. Band r has `windows` windows of h x h pixels:
    window j covers the pixel rows r h ... (r + 1) h - 1 and the columns j step ... j step + h - 1, step = W / windows,
    which wrap around. Windows of one band overlap if step < h.

    Haar wavelets are evaluated at every pixel. With a = max(1, floor(h / 20 + 1/2)), f the grey value in [0, 1],
    i counting rows downwards and j columns to the right, and m(i1 ... i2, j1 ... j2) the mean of f over a box with
    both ends included,

        dx(i, j) = m(i - a ... i + a, j + 1 ... j + a) - m(i - a ... i + a, j - a ... j - 1),
        dy(i, j) = m(i + 1 ... i + a, j - a ... j + a) - m(i - a ... i - 1, j - a ... j + a).

    SURF's wavelet, at the scale at which SURF's window has h pixels, has h / 10 pixels; ours has 2 a + 1, without the
    middle pixel. Boxes reach into the bands above and below. Beyond the first and the last row of the image, that row
    is repeated; columns wrap around. The sums over boxes are those of an integral image, but are combined from sums of
    neighbours: the total of an image costs them no precision, a flat wall has the response 0, and a turn moves the
    responses without changing them.

    A window has 4 x 4 subregions of h / 4 x h / 4 pixels. Pixel (y, x) of a window, both from 0 to h - 1, has the
    weight w(y) w(x), w(x) proportional to exp(-(x - (h - 1) / 2)^2 / (2 sigma^2)), where w(x) sums to 1 over
    the window and sigma = 0.165 h, which is SURF's 3.3 of 20. Subregion (u, v), u counted downwards and v to the right,
    gives four sums over its pixels: of weight * dx, weight * dy, weight * |dx|, weight * |dy|. They are the values
    4 (4 u + v) + 0, 1, 2, 3 of the window's vector z, which is divided by max(|z|, 1e-6), |z| being its Euclidean
    length: the length becomes 1, or 0 for a window without contrast.

    Orientation (windows, rows * 64): value [j, r * 64 + k] is value k of window j in band r.
    Position (windows * rows * 64,): the same values in the same order, value (j * rows + r) * 64 + k. `pairwise`,
    `align` and `localize` first turn each pair to its largest correlation. The default distance, Manhattan's, is the
    best of [T] 3.5.1, followed by "correlation".

    `sampling="surf"` is the sampling of SURF [Bay 2008], to which [T] refers: 20 x 20 regularly spaced samples in each
    window, 5 x 5 in a subregion, s = h / 20 pixels apart, and wavelets of 2 s x 2 s pixels in two halves of s x 2 s.
    Samples lie (n + 1/2) s from the edge of the window, n = 0 ... 19; means go over areas, so that s may be a fraction
    of a pixel; weights are those above with 20 samples in place of h pixels. Both samplings find places equally well in
    clean images. SURF's wavelets cover fewer pixels, which average out less noise: under noise, its errors are larger.

    With `circular=False` the first and the last column are repeated beyond the borders for the wavelets, pixels of a
    window beyond the last column count as having no response (by "surf", that column is repeated there as well), and
    descriptions are compared without any turn.

    Args:
        rows: horizontal bands, k9 of [T] table 3.1; 4 * rows divides the height of an image.
        windows: windows per band, w1, at least 2; it divides the width, and the step between windows is sp1. The
            angular resolution is one window.
        sampling: "pixels", as above, or "surf".

    The defaults are the best of [T] 3.5.1, which recommends 128 windows or more; size and time grow with their number.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> wisurf = analytic.descriptor("wisurf", windows=32)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = wisurf.describe(panoramas), wisurf.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(wisurf.relative_heading(turned, known))
        array([-90., -90.])
    """

    name: ClassVar[str] = "wisurf"
    default_distance: ClassVar[str] = "manhattan"
    divides = (("windows", "width"),)

    rows: Cells = 4
    windows: Several = 512
    sampling: Literal["pixels", "surf"] = "pixels"

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (k9 w1 64,) and (w1, k9 64)."""
        return (self.rows * self.windows * VALUES,), (self.windows, self.rows * VALUES)

    def _check_size(self, height: int, width: int) -> None:
        if height % (CELLS * self.rows):
            other = "" if height % CELLS else f"use rows={divisors_near(height // CELLS, self.rows)}, or "
            raise AnalyticError(
                f"wisurf's rows={self.rows} bands of {CELLS} subregions each do not fit an image of {height} pixel "
                f"rows: {other}resize it to a multiple of {CELLS * self.rows} rows"
            )
        super()._check_size(height, width)
        side = height // self.rows
        if side > width:
            raise AnalyticError(f"wisurf's windows of {side} x {side} are wider than {width} columns: use more rows")

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        vectors = self._sampled(image) if self.sampling == "surf" else self._at_every_pixel(image)
        vectors /= np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32(_LEAST))
        return vectors.reshape(-1), vectors.reshape(self.windows, -1)

    def _at_every_pixel(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sums (windows, rows, 64) over all pixels."""
        height, width = image.shape
        side, step, part = height // self.rows, width // self.windows, height // self.rows // CELLS
        weight = _weights(side)
        dx, dy = wavelets(image, max(1, int(side / 20 + 0.5)), self.circular)
        answers = np.stack([dx, dy, np.abs(dx), np.abs(dy)], axis=1)  # (H, 4, W)
        weighted = answers.reshape(self.rows, side, 4, width) * weight[:, None, None]
        strips = weighted.reshape(self.rows * CELLS, part, 4, width).sum(axis=1)
        wide = np.pad(strips, ((0, 0), (0, 0), (0, side - 1)), mode="wrap" if self.circular else "constant")
        sums = np.zeros((CELLS, self.rows * CELLS, 4, self.windows), dtype=np.float32)
        for x in range(side):
            sums[x // part] += weight[x] * wide[..., x : x + width : step]
        return sums.transpose(3, 1, 0, 2).reshape(self.windows, self.rows, VALUES)

    def _sampled(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sums (windows, rows, 64) over SURF's samples."""
        height, width = image.shape
        side, step = height // self.rows, width // self.windows
        margin = ceil(side / SAMPLES)
        tall = np.pad(image, ((margin, margin), (0, 0)), mode="edge")
        around = np.pad(tall, ((0, 0), (margin, side + margin)), mode="wrap" if self.circular else "edge")
        strips = _areas(around.T, side, side, self.rows).transpose(1, 2, 0)
        areas = _areas(strips, side, step, self.windows)  # (rows, 21, windows, 21), each of s x s pixels
        to_right, down = np.diff(areas, axis=3), np.diff(areas, axis=1)
        dx, dy = (to_right[:, 1:] + to_right[:, :-1]) / 2, (down[..., 1:] + down[..., :-1]) / 2
        weight = np.repeat(np.eye(CELLS, dtype=np.float32), SAMPLES // CELLS, axis=0) * _weights(SAMPLES)[:, None]
        answers = (dx, dy, np.abs(dx), np.abs(dy))  # each (rows, 20, windows, 20)
        sums = [weight.T @ (one @ weight).reshape(self.rows, SAMPLES, -1) for one in answers]
        found = np.stack(sums, axis=-1).reshape(self.rows, CELLS, self.windows, -1)
        return found.transpose(2, 0, 1, 3).reshape(self.windows, self.rows, VALUES)


def wavelets(image: NDArray[np.float32], reach: int, circular: bool) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the Haar responses dx and dy (H, W) of an image (H, W); see `WiSurf`.

    Args:
        image: grey values.
        reach: a, how far a box reaches from the middle in pixels.
        circular: whether columns wrap around.
    """
    a, b = reach, 2 * reach + 1
    height, width = image.shape
    wide = np.pad(image, ((0, 0), (a, a)), mode="wrap" if circular else "edge")
    tall = np.pad(wide, ((a, a), (0, 0)), mode="edge")
    halves = _runs(tall, a, 1)
    dx = _runs(halves[:, a + 1 :] - halves[:, :width], b, 0)
    halves = _runs(tall, a, 0)
    dy = _runs(halves[a + 1 :] - halves[:height], b, 1)
    return dx * np.float32(1 / (a * b)), dy * np.float32(1 / (a * b))


def _runs(values: NDArray[np.float32], length: int, axis: int) -> NDArray[np.float32]:
    """Return the sums of every `length` neighbours along an axis, which becomes shorter by length - 1."""
    values = values.swapaxes(0, axis)
    size = len(values) - length + 1
    total = np.zeros_like(values[:size])
    for start in range(length):
        total += values[start : start + size]
    return total.swapaxes(0, axis)


def _areas(values: NDArray[np.float32], side: int, step: int, count: int) -> NDArray[np.float32]:
    """Return the means of values (..., n) over the stretches (..., count, 21) between the samples of windows.

    Window i begins at value ceil(s) + i * step; it has 20 samples, s = side / 20 values apart.
    """
    length = side / SAMPLES
    total = np.pad(values.cumsum(axis=-1, dtype=np.float64), [(0, 0)] * (values.ndim - 1) + [(1, 0)])
    ends = ceil(length) + step * np.arange(count)[:, None] + length * (np.arange(SAMPLES + 2) - 0.5)
    before = ends.astype(np.int64)
    below = total[..., before]
    below += (ends - before) * (total[..., before + 1] - below)
    return (np.diff(below, axis=-1) / length).astype(np.float32)


@lru_cache(maxsize=8)
def _weights(side: int) -> NDArray[np.float32]:
    """Return the Gaussian weights (h,) of a window's pixels along one side."""
    weight = np.exp(-((np.arange(side) - (side - 1) / 2) ** 2) / (2 * (_SIGMA * side) ** 2))
    return (weight / weight.sum()).astype(np.float32)
