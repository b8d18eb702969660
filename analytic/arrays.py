"""Arrays of numbers, as callers give them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError


def real(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return values as float64; what has no real numbers in it is refused.

    Args:
        values: an array or nested lists of one shape; whole numbers, true and false, or floating point.
        what: it is, for the error message.

    Raises:
        AnalyticError: text, complex numbers, dates, other objects, or lists of different lengths.

    Example:
        >>> real([[1, 2], [3, 4]], "descriptors").sum()
        np.float64(10.0)
    """
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise AnalyticError(f"{what} must be an array of numbers: {error}") from error
    if array.dtype.kind not in "biuf":
        raise AnalyticError(f"{what} must be an array of real numbers, got one of {array.dtype}")
    return array.astype(np.float64, copy=False)
