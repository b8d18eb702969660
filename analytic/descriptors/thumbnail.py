"""The raw thumbnail: the baseline that every descriptor has to beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Cells, ImageDescriptor
from analytic.errors import AnalyticError


@dataclass(frozen=True, kw_only=True)
class Thumbnail(ImageDescriptor):
    """The grey image, averaged down to a few pixels.

    Position (rows * columns,): value r * columns + c is the mean of the pixels that thumbnail pixel (r, c) covers. It
    moves when the robot turns, so it is no position part in the strict sense: tables list the thumbnail to show the
    result without any method. There is no orientation part, and no heading.

    Args:
        rows: height of the thumbnail in pixels, at most that of an image.
        columns: width of the thumbnail in pixels, at most that of an image.

    Example:
        >>> Thumbnail(rows=2, columns=4).describe(np.full((128, 512), 0.5)).position
        array([[0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]], dtype=float32)
    """

    name = "thumbnail"
    default_distance = "correlation"
    oriented = False

    rows: Cells = 8
    columns: Cells = 32

    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return (rows, columns) for the position part, and (0,), as there is no orientation part."""
        return (self.rows, self.columns), (0,)

    def _check_size(self, height: int, width: int) -> None:
        if height < self.rows or width < self.columns:
            raise AnalyticError(
                f"{height} x {width} pixels are fewer than the thumbnail's {self.rows} x {self.columns}: ask for a "
                "smaller thumbnail"
            )

    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], None]:
        return cv2.resize(image, (self.columns, self.rows), interpolation=cv2.INTER_AREA).ravel(), None
