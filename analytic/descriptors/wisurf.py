"""Wi-SURF: upright SURF descriptors of windows that cover the whole panorama ([T] 3.2.4, 3.3.4)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import pi
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import AlignedDescriptor, Part, divisors_near
from analytic.errors import AnalyticError

if TYPE_CHECKING:
    from torch import Tensor

CELLS = 4  # subregions along each side of a window
VALUES = 4 * CELLS * CELLS
_SIGMA = 3.3 / 20  # SURF's Gaussian, in sides of its window
_LEAST = 1e-6  # the vector of a window with less contrast than this stays shorter than 1
_PIXELS = {"cpu": 1 << 18}  # processed at once: those that stay in the cache
_PIXELS_ELSEWHERE = 1 << 23


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

    SURF's wavelet, at the scale at which SURF's window has h pixels, has h / 10 pixels; this one has 2 a + 1, without
    the middle one. Boxes reach into the bands above and below. Beyond the first and the last row of the image, that row
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

    With `circular=False` the first and the last column are repeated beyond the borders for the wavelets, pixels of a
    window beyond the last column count as having no response, and descriptions are compared without any turn.

    Args:
        rows: horizontal bands, k9 of [T] table 3.1; 4 * rows divides the height of an image.
        windows: windows per band, w1, at least 2; it divides the width, and the step between windows is sp1. The
            angular resolution is one window.

    The defaults are the best of [T] 3.5.1, which recommends 128 windows or more; size and time grow with their number.

    Raises:
        AnalyticError: fewer than 1 x 2 windows.

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

    rows: int = 4
    windows: int = 512

    def resolution(self, width: int) -> float:
        """Return the angle of one window, rad."""
        return 2 * pi / self.windows

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (k9 w1 64,) and (w1, k9 64)."""
        return (self.rows * self.windows * VALUES,), (self.windows, self.rows * VALUES)

    def _check_parameters(self) -> None:
        if self.rows < 1 or self.windows < 2:
            raise AnalyticError(f"wisurf needs at least 1 band of 2 windows, got {self.rows} of {self.windows}")

    def _check_size(self, height: int, width: int) -> None:
        if height % (CELLS * self.rows):
            raise AnalyticError(
                f"wisurf's rows={self.rows} bands of {CELLS} subregions each do not fit an image of {height} pixel "
                f"rows: {_heights(height, self.rows)}"
            )
        if width % self.windows:
            raise AnalyticError(
                f"wisurf's windows={self.windows} do not divide the image's width of {width} pixels: use windows="
                f"{divisors_near(width, self.windows)}, or resize the image"
            )
        side = height // self.rows
        if side > width:
            raise AnalyticError(
                f"wisurf's windows are squares of {side} pixels with rows={self.rows}, wider than the image of {width} "
                "columns: use more rows, or resize the image"
            )

    def _describe(self, grey: Tensor) -> tuple[Part, Part]:
        count, height, width = grey.shape
        values = grey.new_empty((count, self.windows, self.rows * VALUES))
        some = max(1, _PIXELS.get(grey.device.type, _PIXELS_ELSEWHERE) // (height * width))
        for start in range(0, count, some):
            values[start : start + some] = self._vectors(grey[start : start + some])
        return values.flatten(1), values

    def _vectors(self, grey: Tensor) -> Tensor:
        """Return the vectors (B, windows, rows * 64) of images (B, H, W)."""
        import torch

        count, height, width = grey.shape
        side, step = height // self.rows, width // self.windows
        cut = _cut(side, str(grey.device))
        dx, dy = wavelets(grey, max(1, int(side / 20 + 0.5)), self.circular)
        answers = [answer.unflatten(1, (self.rows, side)) for answer in (dx, dy, dx.abs(), dy.abs())]
        strips = torch.stack([cut @ answer for answer in answers], dim=1)  # (B, 4, rows, CELLS, W)
        columns = strips.flatten(1, 3).transpose(1, 2)
        wide = columns.new_zeros((count, width + side - 1, columns.shape[2]))
        wide[:, :width] = columns
        if self.circular:
            wide[:, width:] = wide[:, : side - 1]
        windows = wide.unfold(1, side, step)  # (B, windows, 4 * rows * CELLS, h), each pixel still stored once
        sums = (cut @ windows.transpose(2, 3)).reshape(count, self.windows, CELLS, 4, self.rows, CELLS)
        vectors = sums.permute(0, 1, 4, 5, 2, 3).reshape(count, self.windows, self.rows, VALUES)
        return vectors.div_(vectors.norm(dim=-1, keepdim=True).clamp_min_(_LEAST)).flatten(2)

    def _describe_plainly(self, grey: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        count, height, width = grey.shape
        side, step = height // self.rows, width // self.windows
        cut = _weights(side)
        dx, dy = _plain_wavelets(grey, max(1, int(side / 20 + 0.5)), self.circular)
        answers = np.stack([dx, dy, np.abs(dx), np.abs(dy)], axis=1)
        strips = cut @ answers.reshape(count, 4, self.rows, side, width)  # (B, 4, rows, CELLS, W)
        columns = strips.reshape(count, 4 * self.rows * CELLS, width)
        wide = np.pad(columns, ((0, 0), (0, 0), (0, side - 1)), mode="wrap" if self.circular else "constant")
        windows = np.lib.stride_tricks.sliding_window_view(wide, side, axis=2)[:, :, ::step]
        sums = windows @ cut.T  # (B, 4 rows CELLS, windows, CELLS)
        parts = sums.reshape(count, 4, self.rows, CELLS, self.windows, CELLS)
        vectors = parts.transpose(0, 4, 2, 3, 5, 1).reshape(count, self.windows, self.rows, VALUES)
        vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32(_LEAST))
        values = np.ascontiguousarray(vectors.reshape(count, self.windows, self.rows * VALUES), dtype=np.float32)
        return values.reshape(count, -1), values


def _plain_wavelets(
    grey: NDArray[np.float32], reach: int, circular: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return what `wavelets` returns, without torch."""
    a, b = reach, 2 * reach + 1
    height, width = grey.shape[1:]
    wide = np.pad(grey, ((0, 0), (0, 0), (a, a)), mode="wrap" if circular else "edge")
    tall = np.pad(wide, ((0, 0), (a, a), (0, 0)), mode="edge")
    halves = _plain_runs(tall, a, 2)
    dx = _plain_runs(halves[:, :, a + 1 :] - halves[:, :, :width], b, 1)
    halves = _plain_runs(tall, a, 1)
    dy = _plain_runs(halves[:, a + 1 :] - halves[:, :height], b, 2)
    return dx * np.float32(1 / (a * b)), dy * np.float32(1 / (a * b))


def _plain_runs(values: NDArray[np.float32], length: int, axis: int) -> NDArray[np.float32]:
    """Return what `_runs` returns, without torch."""
    total = np.cumsum(values, axis=axis, dtype=np.float64)
    total = np.concatenate([np.zeros_like(total.take([0], axis=axis)), total], axis=axis)
    return np.asarray(
        np.take(total, range(length, total.shape[axis]), axis=axis)
        - np.take(total, range(total.shape[axis] - length), axis=axis),
        dtype=np.float32,
    )


def wavelets(grey: Tensor, reach: int, circular: bool) -> tuple[Tensor, Tensor]:
    """Return the Haar responses dx and dy (B, H, W) of images (B, H, W); see `WiSurf`.

    Args:
        grey: images.
        reach: a, how far a box reaches from the middle in pixels.
        circular: whether columns wrap around.
    """
    import torch

    a, b = reach, 2 * reach + 1
    height, width = int(grey.shape[1]), int(grey.shape[2])
    if circular:
        left, right = grey[:, :, -a:], grey[:, :, :a]
    else:
        left, right = grey[:, :, :1].expand(-1, -1, a), grey[:, :, -1:].expand(-1, -1, a)
    wide = torch.cat([left, grey, right], dim=2)
    tall = torch.cat([wide[:, :1].expand(-1, a, -1), wide, wide[:, -1:].expand(-1, a, -1)], dim=1)
    halves = _runs(tall, a, 2)
    dx = _runs(halves[:, :, a + 1 :] - halves[:, :, :width], b, 1)
    halves = _runs(tall, a, 1)
    dy = _runs(halves[:, a + 1 :] - halves[:, :height], b, 2)
    return dx.mul_(1 / (a * b)), dy.mul_(1 / (a * b))


def _runs(values: Tensor, length: int, dim: int) -> Tensor:
    """Return the sums of every `length` neighbours along an axis, which becomes shorter by length - 1.

    Sums of 2, 4, 8 ... neighbours are combined, so that the work grows with the logarithm of the length.
    """
    size = values.shape[dim] - length + 1
    total, start, power = None, 0, 1
    while length:
        if length & 1:
            part = values.narrow(dim, start, size)
            total = part if total is None else total + part
            start += power
        length >>= 1
        if length:
            short = values.shape[dim] - power
            values = values.narrow(dim, 0, short) + values.narrow(dim, power, short)
            power *= 2
    assert total is not None
    return total


def _heights(height: int, rows: int) -> str:
    """Return the advice for a height that 4 * rows does not divide."""
    unit = CELLS * rows
    below = height // unit * unit
    sizes = " or ".join(str(size) for size in (below, below + unit) if size)
    if height % CELLS:
        return f"resize it to {sizes} rows"
    return f"use rows={divisors_near(height // CELLS, rows)}, or resize it to {sizes} rows"


@lru_cache(maxsize=8)
def _weights(side: int) -> NDArray[np.float32]:
    """Return the Gaussian weights of a window's pixels along one side, row u being those of subregion u (4, h)."""
    place = np.arange(side)
    weight = np.exp(-((place - (side - 1) / 2) ** 2) / (2 * (_SIGMA * side) ** 2))
    mine = place[None] // (side // CELLS) == np.arange(CELLS)[:, None]
    return (weight / weight.sum() * mine).astype(np.float32)


@lru_cache(maxsize=8)
def _cut(side: int, device: str) -> Tensor:
    import torch

    return torch.from_numpy(_weights(side)).to(device)
