"""Checked arrays for the measures: of the right shape, and finite."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import DataError


def numbers_of(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return values as float64; masked ones are NaN.

    Args:
        values: the values, of any shape.
        what: noun for the values in the error message, such as "errors".

    Raises:
        DataError: texts, or rows of different lengths.
    """
    try:
        return np.asarray(np.ma.asarray(values, dtype=np.float64).filled(np.nan))
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} must be an array of numbers ({error})") from error


def column_of(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Check the values of a measure, one for each query, and return them as float64 (n,).

    Args:
        values: the values (n,).
        what: noun for the values in the error message, such as "errors".

    Raises:
        DataError: another shape, or a value that is not finite.
    """
    column = numbers_of(values, what)
    if column.ndim != 1:
        raise DataError(f"{what} must have shape (n,), got {column.shape}")
    if not np.isfinite(column).all():
        raise DataError(f"{int((~np.isfinite(column)).sum())} of {len(column)} {what} are not finite")
    return column


def positions_of(xy: ArrayLike, what: str) -> NDArray[np.float64]:
    """Check positions and return them as float64 (n, 2).

    Args:
        xy: the positions (n, 2).
        what: whose positions they are, for the error message, such as "query".

    Raises:
        DataError: another shape, or a position that is not finite.
    """
    positions = numbers_of(xy, f"{what} positions")
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise DataError(f"{what} positions must have shape (n, 2), got {positions.shape}")
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        raise DataError(
            f"{int((~finite).sum())} of {len(positions)} {what} positions are unknown or not finite: "
            "leave those frames out"
        )
    return positions


def map_positions(xy: ArrayLike) -> NDArray[np.float64]:
    """Check the positions of a map's frames and return them as float64 (m, 2), m at least 1.

    Raises:
        DataError: another shape, a position that is not finite, or no positions.
    """
    positions = positions_of(xy, "map")
    if not len(positions):
        raise DataError("the map is empty: there is nothing to retrieve")
    return positions
