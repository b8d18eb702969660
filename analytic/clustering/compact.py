"""Compact maps of clusters: plain sampling, representatives and their positions ([C] 3, 5.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from analytic.arrays import Floats, Integers, real
from analytic.clustering import checks
from analytic.errors import AnalyticError
from foundation.settings import Count, checked


def sample(n: int, n_clusters: int) -> Integers:
    """Cluster frames by plain sampling: runs of consecutive frames, as equal in length as possible (n,).

    Frame i belongs to cluster floor(i * n_clusters / n): the baseline in which every k-th frame represents those
    around it ([C] 5.4).

    Args:
        n: number of frames, at least 1.
        n_clusters: from 1 to n.

    Raises:
        AnalyticError: numbers out of range.

    Examples:
        >>> sample(5, 2).tolist()
        [0, 0, 0, 1, 1]
    """
    frames = int(checked(n, Count, "the number of frames", AnalyticError))
    count = checks.clusters(n_clusters, frames)
    return np.arange(frames, dtype=np.int64) * count // frames


def sample_rows(n: int, n_clusters: int) -> Integers:
    """Pick the frames that plain sampling keeps: the middle frame of each run of `sample` (n_clusters,).

    If two are in the middle, the first is kept. Arguments and errors as for `sample`.

    Examples:
        >>> sample_rows(5, 2).tolist()
        [1, 3]
    """
    first = np.flatnonzero(np.diff(sample(n, n_clusters), prepend=-1))
    last = np.append(first[1:], n) - 1
    return (first + last) // 2


def representatives(X: ArrayLike, labels: ArrayLike) -> Floats:
    """Compute the mean descriptor of each cluster (k, D) ([C] 3).

    Row i belongs to the i-th smallest label, which is label i if labels go from 0 to k-1.

    Args:
        X: descriptors (n, D).
        labels: whole numbers (n,); frames with a negative one are in no cluster.

    Raises:
        AnalyticError: wrong shapes, descriptors that are not finite, labels of the wrong length, or no cluster at all.

    Examples:
        >>> representatives([[0.0, 2.0], [2.0, 2.0], [9.0, 9.0]], [0, 0, 1]).tolist()
        [[1.0, 2.0], [9.0, 9.0]]
    """
    x = checks.vectors(X)
    return _means(x, checks.cluster_labels(labels, len(x)), np.ones(len(x)))


def positions(points: ArrayLike, labels: ArrayLike) -> Floats:
    """Compute the mean position of each cluster (k, 2) ([C] 3).

    A frame whose position is unknown (NaN) does not count; a cluster of only such frames has position NaN. Rows and
    labels as in `representatives`.

    Args:
        points: positions of the frames (n, 2), or with any other number of coordinates.
        labels: whole numbers (n,).

    Raises:
        AnalyticError: wrong shapes, infinite positions, labels of the wrong length, or no cluster at all.

    Examples:
        >>> positions([[0.0, 1.0], [2.0, 1.0], [float("nan"), 1.0]], [0, 0, 1]).tolist()
        [[1.0, 1.0], [nan, nan]]
    """
    array = real(points, "positions")
    unknown = np.isnan(array)
    known = checks.vectors(np.where(unknown, 0.0, array), "positions")
    return _means(known, checks.cluster_labels(labels, len(known)), np.asarray(~unknown.any(axis=1), np.float64))


def _means(x: Floats, labels: Integers, weights: Floats) -> Floats:
    """Return the weighted mean of each cluster (k, D); NaN for a cluster whose frames all have weight 0."""
    members = checks.members(labels)
    sums = np.stack([weights[rows] @ x[rows] for rows in members])
    counts = np.array([[weights[rows].sum()] for rows in members])
    return np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
