"""How compact clusters are, in positions or in descriptors ([C] 5.2, [I] 6.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from analytic.arrays import Floats, Integers
from analytic.clustering import checks
from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError
from foundation.settings import checked

Mode = Literal["nearest", "pooled"]
Unassigned = Literal["left_out", "cluster"]
_FEW_DIMENSIONS = 16  # up to this, subtracting is as fast as a matrix product, and exact


@dataclass(frozen=True)
class Silhouettes:
    """Silhouettes of one clustering, each in [-1, 1].

    Attributes:
        frames: silhouette of each frame; NaN for a frame in no cluster (n,).
        labels: labels of the clusters, ascending (k,).
        clusters: mean over the frames of each cluster (k,).
        sizes: number of frames in each cluster (k,).
        mode: "nearest" or "pooled".
    """

    frames: Floats
    labels: Integers
    clusters: Floats
    sizes: Integers
    mode: str

    @property
    def mean(self) -> float:
        """The average for the mode: over frames for "nearest", over clusters for "pooled"."""
        if self.mode == "pooled":
            return float(self.clusters.mean())
        return float(np.nanmean(self.frames))


def silhouette(
    X: ArrayLike,
    labels: ArrayLike,
    mode: Mode = "nearest",
    distance: str = "euclidean",
    unassigned: Unassigned = "left_out",
) -> float:
    """Measure how compact clusters are by the average silhouette of positions or of descriptors, in [-1, 1].

    Higher is more compact. See `silhouettes` for the arguments, their values and the errors. With mode="nearest" every
    frame weighs the same ([C] eq. 8, 10); with "pooled" every cluster does ([I] eq. 12).

    Examples:
        >>> points = [[0.0, 0.0], [0.0, 1.0], [9.0, 0.0], [9.0, 1.0]]
        >>> round(silhouette(points, [0, 0, 1, 1]), 3)
        0.889
    """
    return silhouettes(X, labels, mode, distance, unassigned).mean


def silhouettes(
    X: ArrayLike,
    labels: ArrayLike,
    mode: Mode = "nearest",
    distance: str = "euclidean",
    unassigned: Unassigned = "left_out",
) -> Silhouettes:
    """Compute the silhouettes (b - a) / max(a, b) of frames and clusters.

    a is the mean distance of a frame to the *other* frames of its cluster. b is, with "nearest", the smallest of its
    mean distances to the frames of each other cluster ([C] eq. 9, 11); with "pooled", its mean distance to all frames
    of other clusters taken together, with equal weights ([I] eq. 13, [T] eq. 4.11). The only frame of a cluster has
    silhouette 0, and so has a frame with a = b = 0. Memory is bounded: distances are computed in blocks.

    Args:
        X: positions (n, 2), or descriptors (n, D).
        labels: whole numbers (n,); frames with a negative one are in no cluster.
        mode: "nearest" or "pooled".
        distance: a name in `analytic.DISTANCES`; the papers do not say which they use; Euclidean is customary.
        unassigned: "left_out" measures the clusters alone; "cluster" counts the frames in no cluster as one more
            cluster, because [I] 7 averages over the capture points of *every* image.

    Raises:
        AnalyticError: wrong shapes, values that are not finite, labels of the wrong length, fewer than two clusters, or
            an unknown mode, distance or way with unassigned frames.

    Examples:
        >>> found = silhouettes([[0.0], [1.0], [9.0]], [0, 0, 1], mode="pooled")
        >>> found.frames.round(3).tolist(), found.sizes.tolist()
        ([0.889, 0.875, 0.0], [2, 1])
    """
    checked(mode, Mode, "mode", AnalyticError)
    checked(unassigned, Unassigned, "unassigned", AnalyticError)
    distance_named(distance)
    x = checks.vectors(X, "positions or descriptors")
    names = checks.cluster_labels(labels, len(x))
    if unassigned == "cluster":
        names = np.where(names < 0, names.max(initial=-1) + 1, names)
    rows = np.flatnonzero(names >= 0)
    rows = rows[np.argsort(names[rows], kind="stable")]
    present, start, number, sizes = np.unique(names[rows], return_index=True, return_inverse=True, return_counts=True)
    if len(present) < 2:
        raise AnalyticError(f"a silhouette compares clusters, so it needs at least two, got {len(present)}")
    found = np.zeros(len(rows))
    for block, apart in _blocks(x[rows], distance):
        sums = np.add.reduceat(apart, start, axis=1)
        found[block] = _of_frames(sums, number[block], sizes, mode)
    frames = np.full(len(x), np.nan)
    frames[rows] = found
    return Silhouettes(frames, present, np.add.reduceat(found, start) / sizes, sizes, mode)


def moment_of_inertia(points: ArrayLike, labels: ArrayLike) -> float:
    """Measure how compact a map is by its moment of inertia, in square metres ([C] eq. 7); lower is more compact.

    It is the *sum* over clusters of the mean squared distance of the frames to their cluster's mean position.
    Arguments and errors as for `moments_of_inertia`.

    Examples:
        >>> moment_of_inertia([[0.0, 0.0], [2.0, 0.0], [9.0, 9.0]], [0, 0, 1])
        1.0
    """
    return float(moments_of_inertia(points, labels).sum())


def moments_of_inertia(points: ArrayLike, labels: ArrayLike) -> Floats:
    """Compute the mean squared distance to the mean position for each cluster, in the order of labels (k,).

    Args:
        points: positions (n, 2), or with any other number of coordinates.
        labels: whole numbers (n,); frames with a negative one are in no cluster and are left out.

    Raises:
        AnalyticError: wrong shapes, positions that are not finite, labels of the wrong length, or no cluster at all.

    Examples:
        >>> moments_of_inertia([[0.0, 0.0], [2.0, 0.0], [9.0, 9.0]], [0, 0, 1]).tolist()
        [1.0, 0.0]
    """
    positions = checks.vectors(points, "positions")
    groups = [positions[rows] for rows in checks.members(checks.cluster_labels(labels, len(positions)))]
    return np.array([((group - group.mean(axis=0)) ** 2).sum(axis=1).mean() for group in groups])


def _of_frames(sums: Floats, number: Integers, sizes: Integers, mode: str) -> Floats:
    """Return silhouettes (r,) from the summed distances to each cluster (r, k) and the frames' own clusters (r,)."""
    each = np.arange(len(sums))
    own = sums[each, number]
    within = own / np.maximum(sizes[number] - 1, 1)
    if mode == "nearest":
        means = sums / sizes
        means[each, number] = np.inf
        between = means.min(axis=1)
    else:
        sums[each, number] = 0
        between = sums.sum(axis=1) / (sizes.sum() - sizes[number])
    larger = np.maximum(within, between)
    found = np.divide(between - within, larger, out=np.zeros_like(larger), where=larger > 0)
    return np.where(sizes[number] == 1, 0.0, found)


def _blocks(x: Floats, distance: str) -> Iterator[tuple[slice, Floats]]:
    between = distance_named(distance)
    if distance == "euclidean":
        x, _ = checks.to_unit_range(x)  # a silhouette is a ratio
        if x.shape[1] > _FEW_DIMENSIONS:
            from sklearn.metrics.pairwise import euclidean_distances

            between = euclidean_distances
    for rows in checks.row_slices(len(x), len(x)):
        block = between(x[rows], x)
        block[np.arange(len(block)), np.arange(rows.start, rows.stop)] = 0
        yield rows, block
