"""The Fourier signature of a panorama ([T] 3.2.1 and 3.3.1, [C] 2.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors import circular
from analytic.descriptors.base import Alignment, Description
from analytic.descriptors.image import ImageDescriptor, divisors_near
from analytic.errors import AnalyticError, hint

if TYPE_CHECKING:
    from torch import Tensor

_HEADINGS = ("correlation", "phase_product")
_NOTHING = 1e-6
_CHUNK = 1 << 22  # values held at once


@dataclass(frozen=True, kw_only=True)
class FourierSignature(ImageDescriptor):
    """Low frequencies along the rows: their magnitudes for the position, the complex values for the heading.

    The image (H, W) is averaged down to a few rows: row r is the mean of rows r H / n ... (r + 1) H / n - 1. Each has
    the coefficients F[r, u] = (1 / W) sum_x f[r, x] exp(-2 pi i u x / W), of which u = 0, 1, ... are kept, the mean
    (u = 0) among them. With `circular=False` a row is followed by its mirror image first, W being 2 W then, so that
    the step from its last column to its first is no edge.

    Position (B, rows * columns): value r * columns + u is |F[r, u]|. Orientation (B, orientation_columns,
    orientation_rows), complex64: value [u, r] is F[r, u], of an average to orientation_rows; its argument is the phase
    of [T]. Unlike that of the other descriptors it does not move along an axis when the robot turns left by s columns;
    it is multiplied by exp(-2 pi i u s / W), and `Description.spectrum` has no meaning for it.

    The relative heading is one of `turns` equal parts of a full turn. `heading` says how it is found:

    - "correlation": where the circular cross-correlation of the rows, of which no more is known than the kept
      frequencies, summed over the rows, is largest. By the shift theorem that is, for query Q and reference R,
      c[t] = sum_r sum_u w_u Re(Q[r, u] conj(R[r, u]) exp(2 pi i u t / turns)), w_0 = 1 and all other w_u = 2. With
      `whitened` Q and R are coefficients divided by their magnitudes, and 0 where these are below 1e-6 of the image's
      largest: else the lowest frequencies decide, which something dark in front of the camera changes most. The
      aligned distance is, whitened or not, the Euclidean one of the rows at that turn, divided by sqrt(W), that is
      sqrt(sum w |Q|^2 + sum w |R|^2 - 2 c) with the coefficients themselves.
    - "phase_product": where the sum over all elements of the product of two phase matrices in (-pi, pi] is largest,
      that of the reference and that of the query turned back by t, whose phases are those of
      Q[r, u] exp(2 pi i u t / turns) ([T] eq. 3.3-3.6, read with the matrix of the map's image as the other
      factor). The aligned distance is the Euclidean one of the two phase matrices. Phases next to pi and -pi count as
      far apart, so that noise tells more here, and the largest sum need not be at the true turn.

    Args:
        rows: rows in the position part, k1 in [T] table 3.1. They divide the height of an image.
        columns: frequencies in the position part, k2.
        orientation_rows: rows in the orientation part, k3. They divide the height of an image.
        orientation_columns: frequencies in the orientation part, k4.
        turns: how many turns are compared; a multiple or a divisor of the width of an image, so that whole columns
            are whole turns. [T] compares one for each of its 512 columns.
        heading: "correlation" or "phase_product".
        whitened: whether a correlation is that of phases alone; a product of phases always is. It is an addition to the
            seeds, which bars across the picture mislead much less; False is the plain correlation.

    The defaults are the best of [T] 3.5.1 for the position; for the heading, [T] 3.5.3 only says an intermediate or
    high number of rows.

    Raises:
        AnalyticError: numbers that are not positive, more frequencies than turns can tell, an unknown `heading`.
    """

    name = "fs"
    default_distance = "correlation"

    rows: int = 8
    columns: int = 8
    orientation_rows: int = 16
    orientation_columns: int = 64
    turns: int = 512
    heading: str = "correlation"
    whitened: bool = True

    def resolution(self, width: int) -> float:
        """Return the turn of one column, or that of one of `turns` if there are fewer of these, rad."""
        return 2 * pi / min(width, self.turns)

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (k1, k2) and (k3, k4); the arrays are (B, k1 k2) and (B, k4, k3)."""
        return (self.rows, self.columns), (self.orientation_rows, self.orientation_columns)

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading and the aligned distance of every query to every reference; see the class."""
        self.check_turns()
        self.check(queries, references)
        self._steps(queries, references)  # both have an orientation part
        best = np.zeros((len(queries), len(references)), dtype=np.int64)
        distance = np.zeros(best.shape)
        values = max(len(references), self.orientation_rows * self.orientation_columns)
        for part in _parts(len(queries), _CHUNK // (self.turns * values)):
            some = queries.take(part)
            if self.heading == "correlation":
                best[part], distance[part] = _correlated(some, references, self.turns, self.whitened)
            else:
                best[part], distance[part] = _multiplied(some, references, self.turns)
        return Alignment(circular.heading(best, self.turns), distance)

    def _check_parameters(self) -> None:
        for key in ("rows", "columns", "orientation_rows", "orientation_columns", "turns"):
            if getattr(self, key) < 1:
                raise AnalyticError(f"fs needs {key} of at least 1, got {getattr(self, key)}")
        if 2 * (self.orientation_columns - 1) >= self.turns:
            raise AnalyticError(
                f"fs with turns={self.turns} tells at most {(self.turns + 1) // 2} frequencies apart, got "
                f"orientation_columns={self.orientation_columns}: use more turns or fewer columns"
            )
        if self.heading not in _HEADINGS:
            raise AnalyticError(f"unknown heading {self.heading!r} of fs: {hint(self.heading, _HEADINGS)}")

    def _check_size(self, height: int, width: int) -> None:
        for key in ("rows", "orientation_rows"):
            if height % getattr(self, key):
                raise AnalyticError(
                    f"fs's {key}={getattr(self, key)} do not divide the image's height of {height} pixels: use {key}="
                    f"{divisors_near(height, getattr(self, key))}, or resize the image"
                )
        most = (width + 1) // 2 if self.circular else width
        for key in ("columns", "orientation_columns"):
            if getattr(self, key) > most:
                raise AnalyticError(
                    f"fs's {key}={getattr(self, key)} are more frequencies than an image of {width} columns has: use "
                    f"at most {key}={most}"
                )
        if self.circular and width % self.turns and self.turns % width:
            raise AnalyticError(
                f"fs's turns={self.turns} are neither a multiple nor a divisor of the image's width of {width} "
                f"pixels: use turns={width}, or resize the image"
            )

    def _describe(self, grey: Tensor) -> tuple[Tensor, Tensor]:
        import torch

        kept = _signature(grey, self.orientation_rows, self.circular)
        if self.orientation_rows % self.rows:
            few = _signature(grey, self.rows, self.circular)
        else:  # the transform of a mean is the mean of transforms
            few = kept.unflatten(1, (self.rows, -1)).mean(dim=2)
        orientation = kept[..., : self.orientation_columns].transpose(1, 2)
        return few[..., : self.columns].abs().flatten(1).to(torch.float32), orientation.to(torch.complex64)


def _signature(grey: Tensor, rows: int, wraps: bool) -> Tensor:
    """Return the coefficients (B, rows, W // 2 + 1), complex128, of images (B, H, W)."""
    import torch

    # In double precision a coefficient near zero, too, keeps its magnitude when the robot turns.
    few = grey.unflatten(1, (rows, -1)).mean(dim=2).to(torch.float64)
    if not wraps:
        few = torch.cat([few, few.flip(2)], dim=2)
    return torch.fft.rfft(few, dim=2, norm="forward")


def _correlated(
    queries: Description, references: Description, turns: int, whitened: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the best turn and the aligned distance (n, m) of n and m descriptions."""
    from scipy import fft

    crossed = sought = _crossed(queries, references, _by_frequency)
    if whitened:
        sought = _crossed(queries, references, _white)
    best = fft.irfft(sought, n=turns, axis=2).argmax(axis=2)
    frequencies = np.arange(crossed.shape[2])
    weights = np.where(frequencies, 2, 1) * np.exp(2j * pi * frequencies * np.arange(turns)[:, None] / turns)
    peak = np.einsum("nmu,nmu->nm", crossed, weights.astype(np.complex64)[best]).real
    lengths = _power(queries)[:, None] + _power(references)[None]
    return best, np.sqrt(np.maximum(lengths - 2 * peak, 0))


def _crossed(
    queries: Description, references: Description, values: Callable[[Description], NDArray[np.complex64]]
) -> NDArray[np.complex64]:
    """Return the sum over the rows of Q conj(R), (n, m, U)."""
    # It is conj(R conj(Q)), which needs no conjugate copy of a whole map.
    return (values(references) @ values(queries).conj().transpose(0, 2, 1)).conj().transpose(2, 1, 0)


def _multiplied(
    queries: Description, references: Description, turns: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the best turn and the aligned distance (n, m) by products of phases; arguments as `_correlated`."""
    phases = np.angle(_coefficients(queries))
    turned = np.arange(turns)[:, None, None] * np.arange(phases.shape[1])[:, None] * (2 * pi / turns)
    query = phases[:, None] + turned
    query = (pi - np.mod(pi - query, 2 * pi)).reshape(len(queries), turns, -1).astype(np.float32)
    reference = np.angle(_coefficients(references)).reshape(len(references), -1).astype(np.float32)
    product = (query @ reference.T).transpose(0, 2, 1)
    best = product.argmax(axis=2)
    lengths = np.take_along_axis(_squares(query), best, axis=1) + _squares(reference)[None]
    return best, np.sqrt(np.maximum(lengths - 2 * _at(product, best), 0))


def _coefficients(description: Description) -> NDArray[np.complex64]:
    assert description.orientation is not None
    return description.orientation


def _by_frequency(description: Description) -> NDArray[np.complex64]:
    """Return the coefficients (U, B, R), kept so that a map is put into this order once for all queries."""
    kept: dict[str, Any] = vars(description)
    if "by_frequency" not in kept:
        kept["by_frequency"] = np.ascontiguousarray(_coefficients(description).transpose(1, 0, 2))
    return kept["by_frequency"]


def _at(values: NDArray[np.float32], best: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.take_along_axis(values, best[..., None], axis=2)[..., 0].astype(np.float64)


def _white(description: Description) -> NDArray[np.complex64]:
    """Return the coefficients (U, B, R) with magnitudes of 1, or of 0 where there is next to nothing; kept."""
    kept: dict[str, Any] = vars(description)
    if "white" not in kept:
        values = _by_frequency(description)
        magnitude = np.abs(values)
        least = _NOTHING * magnitude.max(axis=(0, 2), keepdims=True)
        kept["white"] = np.divide(values, magnitude, out=np.zeros_like(values), where=magnitude > least)
    return kept["white"]


def _power(description: Description) -> NDArray[np.float64]:
    """Return the mean squares of rows of which only the kept frequencies are known, summed over the rows (B,)."""
    kept: dict[str, Any] = vars(description)
    if "power" not in kept:
        values = _coefficients(description)
        squares = np.square(np.abs(values), dtype=np.float64).sum(axis=2)
        kept["power"] = 2 * squares.sum(axis=1) - squares[:, 0]
    return kept["power"]


def _squares(values: NDArray[Any]) -> NDArray[np.float64]:
    return np.einsum("...f,...f->...", values, values, dtype=np.float64)


def _parts(number: int, size: int) -> Iterator[slice]:
    size = max(1, size)
    return (slice(start, start + size) for start in range(0, number, size))
