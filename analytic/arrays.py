"""The arrays of this package, and a check of those that callers pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def real(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return values as float64; raise an error unless they are real numbers.

    Args:
        values: an array or regular nested lists; integers, booleans or floating point.
        what: name of the values in the error message.

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
