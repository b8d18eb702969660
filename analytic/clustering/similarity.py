"""The similarity of descriptors: Gaussian, full or between nearest neighbours ([C] 3.1)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.clustering import checks, pairs
from analytic.errors import AnalyticError

_LEAST_LINK = 1e-3  # of a link between parts of a graph; large enough for eigenvectors to tell from nothing


def affinity(X: ArrayLike, sigma: float | None = None, neighbours: int | None = None) -> Any:
    """Return the similarities S_ij = exp(-|d_i - d_j|^2 / (2 sigma^2)) of all frames, 1 on the diagonal ([C] 3.1).

    Args:
        X: descriptors (n, D).
        sigma: how fast the similarity falls with the distance, in the descriptors' unit, positive. If None: a third of
            the mean, over the frames, of the distance to the k-th nearest other frame, k = ceil(ln n) + 1 or n - 1 if
            that is less; 1 if that mean is 0. (The mean itself is von Luxburg's rule; along a drive it joins frames
            that are places apart, and the clusters fall to pieces.)
        neighbours: t, from 1 to n-1: keep S_ij only where j is among the t nearest other frames of i, or i among those
            of j. All if None.

    Returns:
        A symmetric array (n, n); with `neighbours` a scipy.sparse.csr_array that stores the diagonal too.

    Raises:
        AnalyticError: wrong shape, values that are not finite, a sigma that is not positive, neighbours out of range.
    """
    x = checks.vectors(X)
    t = checked_neighbours(neighbours, len(x))
    scaled, unit = checks.to_unit_range(x)
    return scaled_affinity(scaled, scaled_sigma(sigma, unit), t)[0]


def scaled_sigma(sigma: float | None, unit: float) -> float | None:
    """Return a checked sigma in the unit of scaled descriptors."""
    if sigma is None:
        return None
    if isinstance(sigma, bool) or not isinstance(sigma, int | float | np.number) or not 0 < sigma < math.inf:
        raise AnalyticError(f"sigma must be a positive number, or None to have one chosen, got {sigma!r}")
    with np.errstate(over="ignore"):
        return float(np.float64(sigma) / unit)


def checked_neighbours(neighbours: int | None, frames: int) -> int | None:
    """Return a checked number of neighbours."""
    if neighbours is None:
        return None
    if frames == 1:
        raise AnalyticError("a single frame has no neighbours: leave neighbours out")
    return checks.whole(neighbours, f"the number of neighbours among {frames} frames", 1, frames - 1)


def scaled_affinity(x: NDArray[np.float64], sigma: float | None, neighbours: int | None) -> tuple[Any, float]:
    """Return the similarities, and the sigma used, of descriptors from `checks.to_unit_range`."""
    n = len(x)
    if n == 1:
        return np.ones((1, 1)), sigma or 1.0
    rank = min(n - 1, math.ceil(math.log(n)) + 1)
    if neighbours is None:
        squared = pairs.squared_matrix(x)
        if sigma is None:
            sigma = _chosen(pairs.nearest(x, rank, squared)[1][:, -1])
        return _gaussian(np.sqrt(squared, out=squared), sigma), sigma
    index, distance = pairs.nearest(x, max(neighbours, rank) if sigma is None else neighbours)
    if sigma is None:
        sigma = _chosen(distance[:, rank - 1])
    return _sparse(index[:, :neighbours], _gaussian(distance[:, :neighbours], sigma)), sigma


def linked(similarity: Any, part: NDArray[Any], x: NDArray[np.float64], sigma: float) -> Any:
    """Return the similarities with every part of the graph joined to its nearest other part.

    The link goes between the two nearest frames and has their similarity, 0.001 at least. Links tell a clustering
    that is asked for fewer clusters than the graph has parts which of the parts belong together.

    Args:
        similarity: (n, n), an array or sparse.
        part: the number of the part of each frame, 0 to p-1, p at least 2 (n,).
        x: scaled descriptors (n, D).
        sigma: in their unit.
    """
    parts = int(part.max()) + 1
    best = np.full(parts, np.inf)
    ends = np.zeros((parts, 2), dtype=np.int64)
    for rows, block in pairs.squared_blocks(x):
        block[part[rows, None] == part] = np.inf
        closest = block.argmin(axis=1)
        distance = block[np.arange(len(block)), closest]
        for row in np.argsort(distance, kind="stable"):
            own = part[rows.start + row]
            if distance[row] < best[own]:
                best[own] = distance[row]
                ends[own] = rows.start + row, closest[row]
    weight = np.maximum(_gaussian(np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1), sigma), _LEAST_LINK)
    if isinstance(similarity, np.ndarray):
        joined = similarity.copy()
        for (i, j), value in zip(ends, weight, strict=True):
            joined[i, j] = joined[j, i] = max(value, joined[i, j])
        return joined
    from scipy import sparse

    links = sparse.coo_array((weight, (ends[:, 0], ends[:, 1])), shape=similarity.shape).tolil()
    return similarity.maximum(links.tocsr()).maximum(links.T.tocsr()).tocsr()


def _chosen(distance: NDArray[np.float64]) -> float:
    return float(distance.mean()) / 3 or 1.0


def _gaussian(distance: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    with np.errstate(over="ignore", under="ignore"):
        scaled = np.divide(distance, sigma, out=distance) if sigma > 0 else np.where(distance > 0, np.inf, 0.0)
        np.multiply(scaled, scaled, out=scaled)
        scaled *= -0.5
        return np.exp(scaled, out=scaled)


def _sparse(index: NDArray[np.int64], weight: NDArray[np.float64]) -> Any:
    """Return the symmetric graph in which an edge stands if either end names it; 1 on the diagonal."""
    from scipy import sparse

    n, t = index.shape
    kind = np.int32 if n * t <= np.iinfo(np.int32).max else np.int64  # which is what scikit-learn accepts
    pointers = np.arange(0, n * t + 1, t, dtype=kind)
    one_way = sparse.csr_array((weight.ravel(), index.ravel().astype(kind), pointers), shape=(n, n))
    return (one_way.maximum(one_way.T) + sparse.eye_array(n, format="csr")).tocsr()
