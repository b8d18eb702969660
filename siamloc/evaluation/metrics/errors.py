"""Errors of estimated poses, their lower bound, and their summary."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import DataError
from siamloc.evaluation.metrics.arrays import column_of, map_positions, positions_of


def localization_error(estimated_xy: ArrayLike, true_xy: ArrayLike) -> NDArray[np.float64]:
    """Return the Euclidean distance between estimated and true positions (n,).

    Args:
        estimated_xy: (n, 2).
        true_xy: (n, 2).

    Raises:
        DataError: other shapes, or a position that is not finite.
    """
    estimated, true = positions_of(estimated_xy, "estimated"), positions_of(true_xy, "true")
    if len(estimated) != len(true):
        raise DataError(f"as many estimated as true positions are needed, got {len(estimated)} and {len(true)}")
    difference = estimated - true
    return np.hypot(difference[:, 0], difference[:, 1])


def error_floor(
    map_xy: ArrayLike, query_xy: ArrayLike, excluded: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the distance of each query to the nearest map frame (n,): no retrieval can do better.

    Args:
        map_xy: (m, 2), m at least 1.
        query_xy: (n, 2).
        excluded: (n, m) map frames that do not count for a query; at least one must count. None excludes nothing.

    Raises:
        DataError: an empty map, other shapes, a position that is not finite, or no map frame that counts for a query.
    """
    known, queries = map_positions(map_xy), positions_of(query_xy, "query")
    if excluded is not None:
        if np.shape(excluded) != (len(queries), len(known)) or np.all(excluded, axis=1).any():
            raise DataError(
                f"`excluded` must have shape (n, m) = {(len(queries), len(known))} and leave each query a map frame, "
                f"got {np.count_nonzero(excluded)} excluded of shape {np.shape(excluded)}"
            )
        apart = np.hypot(*(queries[:, None] - known[None]).transpose(2, 0, 1))
        return np.where(excluded, np.inf, apart).min(axis=1)
    from scipy.spatial import cKDTree

    # The tree compares squares; the length itself comes from the function that measures errors.
    _, closest = cKDTree(known).query(queries)
    return localization_error(known[closest], queries)


def heading_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Return the angle between estimated and true headings in rad (n,), in [0, pi], regardless of full turns.

    Raises:
        DataError: different shapes, or a heading that is not finite.
    """
    a, b = column_of(estimated, "estimated headings"), column_of(true, "true headings")
    if a.shape != b.shape:
        raise DataError(f"as many estimated as true headings are needed, got {len(a)} and {len(b)}")
    return np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi)


def summarize(errors: ArrayLike) -> dict[str, Any]:
    """Return count, mean, median, p95 (linear interpolation), max and rmse of errors (n,); NaN where n is 0.

    Raises:
        DataError: another shape, or an error that is not finite.
    """
    values = column_of(errors, "errors")
    if not len(values):
        return {"count": 0, **dict.fromkeys(("mean", "median", "p95", "max", "rmse"), math.nan)}
    median, p95 = np.percentile(values, (50, 95))
    return {
        "count": len(values),
        "mean": float(values.mean()),
        "median": float(median),
        "p95": float(p95),
        "max": float(values.max()),
        "rmse": float(np.sqrt(np.mean(values**2))),
    }
