"""Distances between all pairs of frames, a block of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_BLOCK_BYTES = 32 << 20
_FEW_DIMENSIONS = 16  # up to here subtracting is as fast as a matrix product, and exact


def row_slices(rows: int, columns: int) -> Iterator[slice]:
    """Yield slices of rows such that a block of float64 stays within 32 MiB, or is one row."""
    step = max(1, _BLOCK_BYTES // (8 * max(1, columns)))
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))


def squared_blocks(x: NDArray[np.float64]) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Yield the rows of a block and their squared Euclidean distances to all rows (r, n); 0 from a row to itself."""
    squares = np.einsum("nd,nd->n", x, x)
    for rows in row_slices(len(x), len(x)):
        block = _squared(x[rows], x, squares[rows], squares)
        block[np.arange(rows.stop - rows.start), np.arange(rows.start, rows.stop)] = 0
        yield rows, block


def squared_matrix(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return all squared Euclidean distances (n, n), exactly symmetric, 0 on the diagonal."""
    squares = np.einsum("nd,nd->n", x, x)
    matrix = _squared(x, x, squares, squares)
    np.fill_diagonal(matrix, 0)
    return matrix


def nearest(
    x: NDArray[np.float64], count: int, squared: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the nearest other rows (n, count), nearest first, and the Euclidean distances to them.

    Which rows are nearest is decided to the rounding of a matrix product; the distances themselves are exact.

    Args:
        x: (n, D).
        count: from 1 to n-1.
        squared: all squared distances (n, n) where they are at hand.
    """
    index = np.empty((len(x), count), dtype=np.int64)
    distance = np.empty((len(x), count))
    if squared is None:
        blocks = squared_blocks(x)
    else:
        blocks = ((rows, squared[rows].copy()) for rows in row_slices(len(x), len(x)))
    for rows, block in blocks:
        block[np.arange(len(block)), np.arange(rows.start, rows.stop)] = np.inf
        found = np.argpartition(block, count - 1, axis=1)[:, :count]
        found.sort(axis=1)
        exact = np.stack([np.linalg.norm(x[rows] - x[found[:, j]], axis=1) for j in range(count)], axis=1)
        order = np.argsort(exact, axis=1, kind="stable")
        index[rows] = np.take_along_axis(found, order, axis=1)
        distance[rows] = np.take_along_axis(exact, order, axis=1)
    return index, distance


def _squared(
    a: NDArray[np.float64], b: NDArray[np.float64], a_squares: NDArray[np.float64], b_squares: NDArray[np.float64]
) -> NDArray[np.float64]:
    if a.shape[1] <= _FEW_DIMENSIONS:
        from scipy.spatial.distance import cdist

        return cdist(a, b, "sqeuclidean")
    block = a @ b.T
    block *= -2
    block += np.add.outer(a_squares, b_squares)  # added up first, so that the matrix is symmetric to the last digit
    return np.maximum(block, 0, out=block)
