"""BRIEF-gist: whether each window of the image is brighter than the one before it ([T] 3.2.5, 3.3.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.alignment import Turns, best_turns
from analytic.description import Description
from analytic.descriptors.base import AlignedDescriptor, Cells, Several


@dataclass(frozen=True, kw_only=True)
class BriefGist(AlignedDescriptor):
    """One bit per window of a grid: whether its mean is above that of the window before it in its row.

    An image (H, W) is cut into `rows` x `columns` windows of H / rows x W / columns pixels that neither overlap nor
    leave pixels out: window (r, c) holds the pixel rows [r H / rows, (r + 1) H / rows) and the columns
    [c W / columns, (c + 1) W / columns). With mean grey value m,

        bit(r, c) = 1 if m(r, c) - m(r, c - 1) > 0, else 0,

    where c - 1 of the first window is the last window of the row. With `circular=False` the first window has no
    window before it, and its bit is 0. Equal means give 0. Sums are computed in float64, which is exact for 8-bit
    images: neither the order of the pixels nor a turn by whole windows can flip a bit.

    Position: (rows * columns,) float32 of 0 and 1, row after row: value r * columns + c is bit(r, c). It turns with the
    robot; `pairwise`, `align` and `localize` first turn each pair to its largest correlation, which is the turn with
    the fewest different bits, or the smallest such turn. With `circular=False` bits are compared without any turn.
    Orientation: (columns, rows), value [c, r] is bit(r, c).

    The default distance, "manhattan", is the number of different bits at that turn (Hamming), from 0 to
    rows * columns. `pairwise` accepts every other distance as well; of those that
    [T] 3.5.1 tried, "correlation" found the nearest frame most often.

    Args:
        rows: windows one above the other; divides the height ([T] table 3.1, k10).
        columns: windows side by side, at least 2; divides the width ([T] table 3.1, w2).

    Example:
        >>> import analytic
        >>> import numpy as np
        >>> briefgist = analytic.descriptor("briefgist", rows=32)
        >>> panoramas = np.random.default_rng(0).random((2, 64, 256))
        >>> known, turned = briefgist.describe(panoramas), briefgist.describe(np.roll(panoramas, -64, axis=2))
        >>> np.degrees(briefgist.relative_heading(turned, known))
        array([-90., -90.])
    """

    name = "briefgist"
    default_distance = "manhattan"
    divides = (("rows", "height"), ("columns", "width"))

    rows: Cells = 64
    columns: Several = 16

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the shapes (rows * columns,) of the position part and (columns, rows) of the orientation part."""
        return (self.rows * self.columns,), (self.columns, self.rows)

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        height, width = image.shape
        windows = image.reshape(self.rows, height // self.rows, self.columns, width // self.columns)
        sums = windows.sum(axis=(1, 3), dtype=np.float64)
        bits = (sums > np.roll(sums, 1, axis=1)).astype(np.float32)
        if not self.circular:
            bits[:, 0] = 0
        return bits.reshape(-1), bits.T

    def _best_turns(self, queries: Description, references: Description, steps: int) -> Turns:
        # Correlations of bits are whole numbers: once rounded, ties are exact.
        return best_turns(queries.spectrum, references.spectrum, steps, whole=True)

    def _compared(self, queries: Description, references: Description, turns: Turns, name: str) -> NDArray[np.float64]:
        if name != "manhattan":
            return super()._compared(queries, references, turns, name)
        # |a - b| = (a - b)^2 for bits, and all of these are whole numbers.
        return queries.squares[:, None] + references.squares - 2 * turns.peak
