"""Helpers for clusterings and their measures: argument checks, the numbering of clusters, blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.arrays import Floats, Integers, real
from analytic.errors import AnalyticError
from foundation.settings import Count, checked

_BLOCK_BYTES = 32 << 20


def vectors(values: ArrayLike, what: str = "descriptors") -> Floats:
    """Check vectors and return them as float64 (n, D), n and D at least 1.

    Args:
        values: vectors of shape (n, D).
        what: noun for the vectors in the error message.

    Raises:
        AnalyticError: a wrong shape, no rows, or values that are not finite.
    """
    array = real(values, what)
    if array.ndim != 2 or not array.size:
        raise AnalyticError(f"{what} must have shape (n, D) with n and D at least 1, got {array.shape}")
    wrong = int((~np.isfinite(array)).any(axis=1).sum())
    if wrong:
        raise AnalyticError(f"{wrong} of {len(array)} {what} are not finite: leave those frames out")
    return array


def clusters(n_clusters: Any, frames: int) -> int:
    """Check the requested number of clusters and return it.

    Raises:
        AnalyticError: not a whole number, below 1, or more than there are frames.
    """
    count = int(checked(n_clusters, Count, "the number of clusters", AnalyticError))
    if count > frames:
        raise AnalyticError(f"{count} clusters need at least as many frames, got {frames}: ask for fewer clusters")
    return count


def cluster_labels(labels: ArrayLike, frames: int) -> Integers:
    """Check labels, one whole number per frame (n,); negative ones mark frames that are in no cluster.

    Raises:
        AnalyticError: a wrong shape or length, or labels that are not whole numbers.
    """
    array = np.asarray(labels)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise AnalyticError(f"labels must be whole numbers of shape (n,), got {array.dtype} of shape {array.shape}")
    if len(array) != frames:
        raise AnalyticError(f"every frame needs one label: got {len(array)} labels for {frames} frames")
    return array.astype(np.int64)


def members(labels: Integers) -> list[Integers]:
    """Return the frames of each cluster, for ascending labels; frames with a negative label are in none.

    Raises:
        AnalyticError: no frame is in a cluster.
    """
    rows = np.flatnonzero(labels >= 0)
    if not len(rows):
        raise AnalyticError("no frame is in a cluster: labels from 0 on are needed")
    rows = rows[np.argsort(labels[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(labels[rows])) + 1)


def renumbered(labels: NDArray[Any]) -> Integers:
    """Renumber labels (n,) from 0 to k-1 in the order of their first appearance."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.reshape(-1)]


def distinct(rows: Floats) -> tuple[Floats, Integers, Integers]:
    """Return the distinct rows in a fixed order, the index of each input row among them, and their counts.

    A method that works on these gives equal frames the same label, and does not depend on the order of the input.
    """
    different, inverse, counts = np.unique(rows + 0.0, axis=0, return_inverse=True, return_counts=True)
    return different, inverse.reshape(-1), counts


def to_unit_range(rows: Floats) -> tuple[Floats, float]:
    """Centre rows on their mean and divide them by their largest magnitude; return the rows and that divisor.

    Distances keep their ratios; squares neither overflow nor vanish, and a common offset costs no precision.
    """
    unit = float(np.abs(rows).max()) or 1.0
    scaled = rows / unit
    return scaled - scaled.mean(axis=0), unit


def row_slices(rows: int, columns: int) -> Iterator[slice]:
    """Yield slices of `rows` rows such that a block of float64 with `columns` columns takes at most 32 MiB.

    A slice has one row at least, however large the row is.
    """
    step = max(1, _BLOCK_BYTES // (8 * max(1, columns)))
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))
