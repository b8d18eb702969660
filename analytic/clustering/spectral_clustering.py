"""Normalized spectral clustering (Ng, Jordan, Weiss; [C] 3.1), from the descriptors to the labels.

The eigenvectors come from scipy, the k-means from scikit-learn.
"""

from __future__ import annotations

import math
import warnings
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from analytic.arrays import Floats, Integers
from analytic.clustering import checks, self_organizing
from analytic.errors import AnalyticError
from analytic.linear_algebra import one_thread
from foundation.settings import Count, Positive, Seed, checked

Assign = Literal["kmeans", "som"]
_STARTS = 10  # of k-means
# Below this a normalized similarity counts as zero. A Lanczos solver finds one copy of an eigenvalue, so the equal
# ones of separate parts are computed part by part; in float64 it can separate parts down to about 1e-13.
_NOTHING = 1e-11
_LEAST_LINK = 1e-3  # of a link between parts; large enough for eigenvectors to distinguish from zero
_SMALL = 1000  # frames up to which the full decomposition is as fast as Lanczos
_SHIFT = 1e-3  # beyond the largest eigenvalue, 1: near enough to spread those close to 1, far enough to solve well


def spectral(
    X: ArrayLike,
    n_clusters: int,
    *,
    sigma: float | None = None,
    neighbours: int | None = None,
    seed: int = 0,
    assign: Assign = "kmeans",
) -> Integers:
    """Cluster descriptors with normalized spectral clustering; return the cluster of each frame (n,).

    The Gaussian similarity (`affinity`) is normalized, the eigenvectors of the n_clusters smallest eigenvalues of the
    Laplacian I - D^-1/2 S D^-1/2 become the columns of a matrix, each row is scaled to length 1, and the rows are
    clustered. Equal descriptors count once and share a label. The order of the frames affects only the numbering:
    labels go from 0 to k-1 in the order of first appearance.

    If the graph of similarities has more parts than clusters, each part is linked with its nearest other part through
    their two nearest frames, until there are no more parts than clusters.

    Args:
        X: descriptors (n, D).
        n_clusters: from 1 to the number of different descriptors; with 1, all labels are 0.
        sigma: as in `affinity`.
        neighbours: t, from 1 to the number of different descriptors - 1: keep only the similarities of the t nearest
            neighbours, which is faster and needs less memory. All if None.
        seed: seed of the k-means starts, and of the self-organizing map.
        assign: how the rows are clustered: "kmeans" (the best of 10 k-means++ starts), or "som" (a map of n_clusters
            units on a grid as square as possible; units that win no frame form no cluster, so there can be fewer).

    Raises:
        AnalyticError: descriptors of wrong shape or not finite, more clusters than different descriptors, or a
            parameter out of range.

    Examples:
        >>> import numpy as np
        >>> descriptors = np.array([[0.0, 0.1], [0.1, 0.0], [5.0, 5.1], [5.1, 5.0], [0.0, 0.0]])
        >>> spectral(descriptors, 2).tolist()
        [0, 0, 1, 1, 0]
    """
    x = checks.vectors(X)
    count = checks.clusters(n_clusters, len(x))
    checked(assign, Assign, "assign", AnalyticError)
    seed = checked(seed, Seed, "the seed", AnalyticError)
    checked(sigma, Positive | None, "sigma", AnalyticError)
    different, inverse, _ = checks.distinct(x)
    if count > len(different):
        raise AnalyticError(f"{count} clusters need as many different descriptors, got {len(different)}: ask for fewer")
    scaled, unit = checks.to_unit_range(different)
    width = None if sigma is None else sigma / unit
    t = _checked_neighbours(neighbours, len(different)) if len(different) > 1 else None
    if count in (1, len(different)):
        return checks.renumbered(inverse if count > 1 else np.zeros_like(inverse))
    graph, width = _similarities(scaled, width, t)
    while (part := _parts(matrix := _normalized(graph))).max() >= count:
        graph = _linked(graph, part, scaled, width)
    return checks.renumbered(_clustered(matrix, part, count, seed, assign)[inverse])


def affinity(X: ArrayLike, sigma: float | None = None, neighbours: int | None = None) -> Any:
    """Compute the Gaussian similarities S_ij = exp(-|d_i - d_j|^2 / (2 sigma^2)) of all frames ([C] 3.1).

    Args:
        X: descriptors (n, D).
        sigma: how fast the similarity falls with the distance, in the descriptors' unit, positive. If None: a third of
            the mean, over the frames, of the distance to the k-th nearest other frame, k = ceil(ln n) + 1 or n - 1 if
            that is less; 1 if that mean is 0. (The mean itself is von Luxburg's rule; along a drive it joins frames
            of different places, and the clusters break up.)
        neighbours: t, from 1 to n-1: keep S_ij only where j is among the t nearest other frames of i, or i among the t
            nearest of j. All if None.

    Returns:
        A symmetric array (n, n), 1 on the diagonal; with `neighbours` a scipy.sparse.csr_array that stores the
        diagonal too.

    Raises:
        AnalyticError: wrong shape, values that are not finite, a sigma that is not positive, neighbours out of range.

    Examples:
        >>> affinity([[0.0], [1.0], [3.0]], sigma=1.0).round(3).tolist()
        [[1.0, 0.607, 0.011], [0.607, 1.0, 0.135], [0.011, 0.135, 1.0]]
    """
    x = checks.vectors(X)
    t = _checked_neighbours(neighbours, len(x))
    scaled, unit = checks.to_unit_range(x)
    checked(sigma, Positive | None, "sigma", AnalyticError)
    return _similarities(scaled, None if sigma is None else sigma / unit, t)[0]


def _similarities(x: Floats, sigma: float | None, neighbours: int | None) -> tuple[Any, float]:
    """Return the similarities of descriptors from `checks.to_unit_range`, and the sigma used."""
    n = len(x)
    rank = min(n - 1, math.ceil(math.log(n)) + 1)
    if neighbours is None:
        from sklearn.metrics.pairwise import euclidean_distances

        distance = euclidean_distances(x)
        if sigma is None:  # a frame is nearest to itself, at rank 0
            sigma = _chosen_sigma(np.partition(distance, rank, axis=1)[:, rank])
        return _gaussian(distance, sigma), sigma
    from sklearn.neighbors import NearestNeighbors

    distance, index = NearestNeighbors(n_neighbors=max(neighbours, rank)).fit(x).kneighbors()
    if sigma is None:
        sigma = _chosen_sigma(distance[:, rank - 1])
    return _symmetric_graph(index[:, :neighbours], _gaussian(distance[:, :neighbours], sigma)), sigma


def _chosen_sigma(distance: Floats) -> float:
    return float(distance.mean()) / 3 or 1.0


def _gaussian(distance: Floats, sigma: float) -> Floats:
    with np.errstate(over="ignore", under="ignore"):
        return np.exp(-0.5 * np.square(distance / sigma))


def _symmetric_graph(index: Integers, weight: Floats) -> Any:
    """Return the graph with an edge where either end has the other as a neighbour; 1 on the diagonal."""
    from scipy import sparse

    n, t = index.shape
    pointers = np.arange(0, n * t + 1, t, dtype=np.int32)  # the type that scikit-learn accepts
    one_way = sparse.csr_array((weight.ravel(), index.ravel().astype(np.int32), pointers), shape=(n, n))
    return (one_way.maximum(one_way.T) + sparse.eye_array(n, format="csr")).tocsr()


def _normalized(similarity: Any) -> Any:
    """Return D^-1/2 S D^-1/2, D_i = sum_j S_ij over the other frames: the identity minus the Laplacian.

    The diagonal of S does not count (Ng, Jordan, Weiss, step 1). The row of a frame that resembles no other is 0.
    """
    from scipy import sparse

    matrix, dense = similarity.copy(), isinstance(similarity, np.ndarray)
    if dense:
        np.fill_diagonal(matrix, 0)
    else:
        matrix.setdiag(0)
        matrix.eliminate_zeros()
    degree = matrix.sum(axis=1)
    scale = np.divide(1, np.sqrt(degree), out=np.zeros_like(degree), where=degree > 0)
    if dense:
        matrix *= scale[:, None]
        matrix *= scale
        return matrix
    return (sparse.diags_array(scale) @ matrix @ sparse.diags_array(scale)).tocsr()


def _parts(matrix: Any) -> Integers:
    """Return the connected part of the graph that each frame belongs to (n,), from 0."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    linked = matrix > _NOTHING
    if isinstance(matrix, np.ndarray) and linked.sum(axis=1).max() == len(matrix) - 1:
        return np.zeros(len(matrix), dtype=np.int64)  # a frame resembles all others: no need to walk a full graph
    return connected_components(sparse.csr_array(linked), directed=False)[1].astype(np.int64)


def _linked(similarity: Any, part: Integers, x: Floats, sigma: float) -> Any:
    """Return the similarities with every part of the graph joined to its nearest other part.

    The link goes between the two nearest frames and has their similarity, 0.001 at least. If fewer clusters are
    requested than the graph has parts, the links show which of the parts belong together.
    """
    from scipy import sparse
    from sklearn.metrics import pairwise_distances_chunked

    def nearest_outside(block: Floats, start: int) -> tuple[Integers, Floats]:
        block[part[start : start + len(block), None] == part] = np.inf
        return block.argmin(axis=1), block.min(axis=1)

    blocks = pairwise_distances_chunked(x, reduce_func=nearest_outside, working_memory=32)
    nearest, distance = map(np.concatenate, zip(*blocks, strict=True))
    order = np.lexsort((distance, part))
    ends = order[np.unique(part[order], return_index=True)[1]]  # of each part the frame nearest to another one
    weight = np.maximum(_gaussian(distance[ends], sigma), _LEAST_LINK)
    links = sparse.coo_array((weight, (ends, nearest[ends])), shape=similarity.shape).tocsr()
    links = links.maximum(links.T)
    if isinstance(similarity, np.ndarray):
        return np.maximum(similarity, links.toarray())
    return similarity.maximum(links).tocsr()


def _clustered(matrix: Any, part: Integers, count: int, seed: int, assign: str) -> Integers:
    """Return the clusters of frames from their normalized similarity and the parts of its graph."""
    rows = _leading_eigenvectors(matrix, part, count)
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    np.divide(rows, length, out=rows, where=length > 0)
    if assign == "som":
        return self_organizing.winners(rows, np.ones(len(rows)), _squarest(count), seed)
    from sklearn.cluster import KMeans
    from sklearn.exceptions import ConvergenceWarning

    # The steps of k-means are short: on a busy processor, threads that wait for each other take ten times as long.
    with one_thread(openmp=True), warnings.catch_warnings():
        # Rows that coincide give fewer clusters; the labels show it.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return KMeans(count, n_init=_STARTS, random_state=seed).fit(rows).labels_.astype(np.int64)


def _leading_eigenvectors(matrix: Any, part: Integers, count: int) -> Floats:
    """Return the eigenvectors of the `count` largest eigenvalues of the normalized similarity, as columns (n, count).

    They belong to the smallest eigenvalues of the Laplacian. A frame that resembles no other is a separate part
    with eigenvalue 1.
    """
    found: list[tuple[float, Integers, Floats]] = []
    for number in range(int(part.max()) + 1):
        rows = np.flatnonzero(part == number)
        inside = matrix if len(rows) == len(part) else matrix[rows][:, rows]
        values, vectors = _largest(inside, min(count, len(rows)))
        found += [(value, rows, vector) for value, vector in zip(values.tolist(), vectors.T, strict=True)]
    found.sort(key=lambda one: -one[0])
    columns = np.zeros((len(part), count))
    for column, (_, rows, vector) in zip(columns.T, found, strict=False):
        column[rows] = vector
    return columns


def _largest(matrix: Any, count: int) -> tuple[Floats, Floats]:
    """Return the largest eigenvalues of one part and their vectors, with Lanczos if the part is large."""
    from scipy.linalg import eigh
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    n = matrix.shape[0]
    if n == 1:
        return np.ones(1), np.ones((1, 1))
    dense = isinstance(matrix, np.ndarray)
    if n > _SMALL and 8 * count <= n:
        start = np.random.default_rng(0).uniform(0.5, 1, n)
        # Inversion spreads the eigenvalues near 1 well, but the inverse of a sparse matrix is dense.
        how = {"sigma": 1 + _SHIFT} if dense else {"which": "LA"}
        try:
            return eigsh(matrix, k=count, v0=start, **how)
        except ArpackNoConvergence:
            pass
    full = matrix if dense else matrix.toarray()
    return eigh(full, subset_by_index=(n - count, n - 1), driver="evx", check_finite=False)


def _squarest(units: int) -> tuple[int, int]:
    height = next(h for h in range(int(units**0.5), 0, -1) if units % h == 0)
    return units // height, height


def _checked_neighbours(neighbours: int | None, frames: int) -> int | None:
    if neighbours is None:
        return None
    count = int(checked(neighbours, Count, "the number of neighbours", AnalyticError))
    if count >= frames:
        raise AnalyticError(f"each of {frames} frames has at most {frames - 1} neighbours, got neighbours={count}")
    return count
