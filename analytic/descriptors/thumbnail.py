"""The raw thumbnail: the baseline that every descriptor has to beat."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from analytic.description import Description
from analytic.descriptors.base import MOST, Descriptor
from analytic.errors import AnalyticError
from analytic.images import as_grey


class Thumbnail(Descriptor):
    """The grey image, averaged down to a few pixels.

    It has no position part in the strict sense: turning the robot shifts it. Tables list it to show the result
    without any method.

    Args:
        rows: height of the thumbnail in pixels.
        columns: width of the thumbnail in pixels.

    Raises:
        AnalyticError: sizes that are not positive, or larger than the image described.

    Example:
        >>> Thumbnail(2, 4).describe(np.full((128, 512), 0.5)).position
        array([[0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]], dtype=float32)
    """

    name = "thumbnail"
    default_distance = "correlation"

    def __init__(self, rows: int = 8, columns: int = 32) -> None:
        whole = all(isinstance(size, int | np.integer) and not isinstance(size, bool) for size in (rows, columns))
        if not whole or not (1 <= rows <= MOST and 1 <= columns <= MOST):
            raise AnalyticError(
                f"rows and columns of a thumbnail must be whole numbers from 1 to {MOST:,}, got {rows} x {columns}"
            )
        self.rows = int(rows)
        self.columns = int(columns)

    @property
    def identity(self) -> dict[str, Any]:
        """Name and parameters."""
        return {"name": self.name, "rows": self.rows, "columns": self.columns}

    def describe(self, batch: ArrayLike) -> Description:
        """Describe images; position (B, rows * columns), values in [0, 1]."""
        grey = as_grey(batch)
        if grey.shape[1] < self.rows or grey.shape[2] < self.columns:
            raise AnalyticError(
                f"the image has {grey.shape[1]} x {grey.shape[2]} pixels, fewer than the thumbnail's "
                f"{self.rows} x {self.columns}: ask for a smaller thumbnail"
            )
        size = (self.columns, self.rows)
        small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA).ravel() for image in grey]
        return Description(position=np.stack(small).astype(np.float32))
