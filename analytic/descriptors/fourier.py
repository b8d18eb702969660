"""The Fourier signature of a panorama ([T] 3.2.1 and 3.3.1, [C] 2.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from analytic.alignment import best_turns, directly, euclidean, norm, whitened
from analytic.alignment import heading as angle
from analytic.arrays import Floats, Integers
from analytic.description import Alignment, Description
from analytic.descriptors.base import Cells, ImageDescriptor
from analytic.errors import AnalyticError

_NOTHING = 1e-6


@dataclass(frozen=True, kw_only=True)
class FourierSignature(ImageDescriptor):
    """Low frequencies along the rows: their magnitudes for the position, the complex values for the heading.

    The image (H, W) is averaged down to a few rows: row r is the mean of rows r H / n ... (r + 1) H / n - 1. Each has
    the coefficients F[r, u] = (1 / W) sum_x f[r, x] exp(-2 pi i u x / W), of which u = 0, 1, ... are kept, including
    the mean (u = 0). With `circular=False` each row is first extended by its mirror image, which makes W twice as
    large, so that the step from its last column to its first is no edge.

    Position (B, rows * columns): value r * columns + u is |F[r, u]|. Orientation (B, orientation_columns,
    orientation_rows), complex64: value [u, r] is F[r, u] of the image averaged to orientation_rows; its argument is the
    phase of [T]. Unlike that of the other descriptors it does not move along an axis when the robot turns left by s
    columns; it is multiplied by exp(-2 pi i u s / W), and `Description.spectrum` has no meaning for it.

    The relative heading is a multiple of 1 / `turns` of a full turn. `heading` selects how it is found:

    - "correlation": where the circular cross-correlation of the rows, known only by their kept frequencies, summed
      over the rows, is largest. By the shift theorem that is, for query Q and reference R,
      c[t] = sum_r sum_u w_u Re(Q[r, u] conj(R[r, u]) exp(2 pi i u t / turns)), w_0 = 1 and all other w_u = 2. With
      `whitened` Q and R are coefficients divided by their magnitudes, and 0 where these are below 1e-6 of the image's
      largest: otherwise the lowest frequencies dominate, which change most when something dark is in front of the
      camera. The aligned distance, whitened or not, is the Euclidean one of the rows at that turn, divided by sqrt(W),
      that is sqrt(sum w |Q|^2 + sum w |R|^2 - 2 c) with the coefficients themselves.
    - "phase_product": where the sum over all elements of the product of two phase matrices in (-pi, pi] is largest,
      that of the reference and that of the query turned back by t, whose phases are those of
      Q[r, u] exp(2 pi i u t / turns) ([T] eq. 3.3-3.6, read with the matrix of the map's image as the other
      factor). The aligned distance is the Euclidean one of the two phase matrices. Phases close to pi and -pi count
      as far apart, so noise matters more here, and the largest sum need not be at the true turn.

    Args:
        rows: rows in the position part, k1 in [T] table 3.1. They divide the height of an image.
        columns: frequencies in the position part, k2.
        orientation_rows: rows in the orientation part, k3. They divide the height of an image.
        orientation_columns: frequencies in the orientation part, k4.
        turns: number of turns compared; a multiple or a divisor of the width of an image, so that whole columns
            are whole turns. [T] compares one for each of its 512 columns.
        heading: "correlation" or "phase_product".
        whitened: whether the correlation uses phases alone; a product of phases always does. This addition to the
            papers is much less misled by bars across the image; False is the plain correlation.

    The defaults are the best of [T] 3.5.1 for the position; for the heading, [T] 3.5.3 only recommends an intermediate
    or high number of rows.

    Raises:
        AnalyticError: more frequencies than turns can resolve.

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> fs = analytic.descriptor("fs", turns=256)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = fs.describe(panoramas), fs.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(fs.relative_heading(turned, known))
        array([-90., -90.])
    """

    name = "fs"
    default_distance = "correlation"
    divides = (("rows", "height"), ("orientation_rows", "height"))

    rows: Cells = 8
    columns: Cells = 8
    orientation_rows: Cells = 16
    orientation_columns: Cells = 64
    turns: Cells = 512
    heading: Literal["correlation", "phase_product"] = "correlation"
    whitened: bool = True

    def resolution(self, width: int) -> float:
        """Return the step in rad between headings: one column of the image, or 2 pi / `turns` if that is larger."""
        return 2 * pi / min(width, self.turns)

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the sizes (k1, k2) and (k3, k4) of [T]; the parts are (B, k1 k2) and (B, k4, k3)."""
        return (self.rows, self.columns), (self.orientation_rows, self.orientation_columns)

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading in rad and the aligned distance (n, m) of each query to each reference."""
        self.check(queries, references)
        self._steps(queries)  # refuses images whose columns are no full turn
        step, distance = (self._correlated if self.heading == "correlation" else self._multiplied)(queries, references)
        return Alignment(angle(step, self.turns), distance)

    def _correlated(self, queries: Description, references: Description) -> tuple[Integers, Floats]:
        """Return the best turn and the aligned distance (n, m) by correlation of the rows."""
        rows = queries.kept("rows", _by_frequency), references.kept("rows", _by_frequency)
        white = [made.kept("white", _white) for made in (queries, references)] if self.whitened else rows
        found = best_turns(white[0], white[1], self.turns, product=rows if self.whitened else None)
        turn = 2j * pi / self.turns * np.arange(len(rows[0]))[:, None]

        def turned(row: int) -> Callable[[int], NDArray[Any]]:
            return lambda step: queries.turnable[row] * np.exp(turn * step).astype(np.complex64)

        lengths = queries.kept("power", _power)[:, None] + references.kept("power", _power)
        # The inverse transform divides by the number of turns.
        apart, close = euclidean(self.turns * found.peak, lengths)
        return found.step, directly(apart, close, found.step, turned, references.turnable, _between_rows)

    def _multiplied(self, queries: Description, references: Description) -> tuple[Integers, Floats]:
        """Return the best turn and the aligned distance (n, m) by products of phases."""
        step = np.zeros((len(queries), len(references)), dtype=np.int64)
        distance = np.zeros(step.shape)
        known = references.kept("phases", _flat_phases)
        frequency = np.arange(queries.turnable.shape[1])[:, None]
        turns = np.arange(self.turns)[:, None, None] * frequency * (2 * pi / self.turns)
        for row, phases in enumerate(np.angle(queries.turnable.astype(np.complex128))):
            query = _in_half_turn(phases + turns).reshape(self.turns, -1).astype(np.float32)
            step[row] = (query @ known.T).argmax(axis=0)
            distance[row] = np.linalg.norm(query[step[row]] - known, axis=1)
        return step, distance

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.orientation_columns > (most := (self.turns + 1) // 2):
            raise AnalyticError(
                f"fs with turns={self.turns} resolves at most {most} frequencies, got "
                f"orientation_columns={self.orientation_columns}: use more turns or fewer columns"
            )

    def _check_size(self, height: int, width: int) -> None:
        super()._check_size(height, width)
        most = (width + 1) // 2 if self.circular else width
        for key in ("columns", "orientation_columns"):
            if (value := getattr(self, key)) > most:
                raise AnalyticError(
                    f"fs's {key}={value} is above the {most} frequencies of {width} columns: use at most {key}={most}"
                )
        if self.circular and width % self.turns and self.turns % width:
            raise AnalyticError(
                f"fs's turns={self.turns} is no multiple or divisor of {width} columns: use turns={width}, or resize "
                "the image"
            )

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        position = np.abs(self._signature(image, self.rows)[:, : self.columns])
        orientation = self._signature(image, self.orientation_rows)[:, : self.orientation_columns]
        return position.reshape(-1).astype(np.float32), orientation.T.astype(np.complex64)

    def _signature(self, image: NDArray[np.float32], rows: int) -> NDArray[np.complex128]:
        """Return the coefficients (rows, W // 2 + 1) of an image (H, W) averaged down to some rows."""
        # In double precision even a coefficient near zero keeps its magnitude when the robot turns.
        few = image.reshape(rows, -1, image.shape[1]).mean(axis=1, dtype=np.float64)
        few = few if self.circular else np.concatenate([few, few[:, ::-1]], axis=1)
        return np.fft.rfft(few, axis=1, norm="forward")


def _by_frequency(description: Description) -> NDArray[np.complex64]:
    """Return the coefficients (U, B, R)."""
    return np.ascontiguousarray(description.turnable.transpose(1, 0, 2))


def _white(description: Description) -> NDArray[np.complex64]:
    """Return the phases of the coefficients (U, B, R)."""
    return whitened(description.kept("rows", _by_frequency), _NOTHING)


def _power(description: Description) -> Floats:
    """Return the mean squares of rows known only by their kept frequencies, summed over the rows (B,)."""
    squares = np.square(np.abs(description.turnable), dtype=np.float64).sum(axis=2)
    return 2 * squares.sum(axis=1) - squares[:, 0]


def _between_rows(one: NDArray[np.complex64], other: NDArray[np.complex64]) -> float:
    """Return the distance of rows, in the sense of `_power`, from their coefficients (U, R)."""
    values, known = one.view(np.float32), np.ascontiguousarray(other).view(np.float32)
    return sqrt(2 * norm(values, known) ** 2 - norm(values[:1], known[:1]) ** 2)


def _flat_phases(description: Description) -> NDArray[np.float32]:
    """Return the phases (B, U * R) in (-pi, pi]."""
    phases = np.angle(description.turnable.astype(np.complex128))
    return _in_half_turn(phases).reshape(len(description), -1).astype(np.float32)


def _in_half_turn(phases: Floats) -> Floats:
    """Return angles in (-pi, pi]."""
    return pi - np.mod(pi - phases, 2 * pi)
