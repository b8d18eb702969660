"""Normalized spectral clustering (Ng, Jordan, Weiss; [C] 3.1)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.clustering import checks, eigenvectors, self_organizing, similarity
from analytic.clustering.rows import kmeans
from analytic.errors import AnalyticError

ASSIGNMENTS = ("kmeans", "som")
_CACHED = 256  # rows and columns of a block


def spectral(
    X: ArrayLike,
    n_clusters: int,
    *,
    sigma: float | None = None,
    neighbours: int | None = None,
    seed: int = 0,
    assign: str = "kmeans",
) -> NDArray[np.int64]:
    """Return the clusters of frames by normalized spectral clustering of their descriptors (n,).

    The Gaussian similarity (`affinity`) is normalized, the eigenvectors of the n_clusters smallest eigenvalues of the
    Laplacian I - D^-1/2 S D^-1/2 stand side by side, each row is brought to length 1, and the rows are clustered. Equal
    descriptors count once and share a label. The order of the frames does not matter but for the numbering: labels
    go from 0 to k-1 in the order of first appearance.

    Where the graph of similarities falls into more parts than clusters, each part is linked with its nearest other
    part through their two nearest frames, until there are not more parts than clusters.

    Args:
        X: descriptors (n, D).
        n_clusters: from 1 to the number of different descriptors; with 1, all labels are 0.
        sigma: as in `affinity`.
        neighbours: t, from 1 to the number of different descriptors - 1: keep the similarities of the t nearest
            neighbours only, which is faster and needs less memory. All if None.
        seed: of the k-means starts, and of the self-organizing map.
        assign: how the rows are clustered: "kmeans" (10 starts, see `partition`), or "som" (a map of n_clusters units
            on the squarest grid; units that win no frame make no cluster, so that there can be fewer).

    Raises:
        AnalyticError: descriptors of wrong shape or not finite, more clusters than different descriptors, or a
            parameter out of range.
    """
    x = checks.vectors(X)
    count = checks.clusters(n_clusters, len(x))
    _check_assign(assign)
    seed = checks.whole(seed, "the seed", 0)
    different, inverse, _ = checks.distinct(x)
    if count > len(different):
        raise AnalyticError(
            f"{count} clusters need at least as many different descriptors: the {len(x)} frames have "
            f"{len(different)}; ask for fewer clusters or leave duplicates out"
        )
    scaled, unit = checks.to_unit_range(different)
    width = similarity.scaled_sigma(sigma, unit)
    t = similarity.checked_neighbours(neighbours, len(different)) if len(different) > 1 else None
    if count in (1, len(different)):
        return checks.renumbered(inverse if count > 1 else np.zeros_like(inverse))
    graph, width = similarity.scaled_affinity(scaled, width, t)
    matrix = eigenvectors.normalized(graph)
    part = eigenvectors.parts(matrix)
    while part.max() >= count:
        graph = similarity.linked(graph, part, scaled, width)
        matrix = eigenvectors.normalized(graph)
        part = eigenvectors.parts(matrix)
    return checks.renumbered(_clustered(matrix, part, count, seed, assign)[inverse])


def partition(similarities: Any, n_clusters: int, *, seed: int = 0, assign: str = "kmeans") -> NDArray[np.int64]:
    """Return the clusters of frames whose similarities are given, whatever they were computed from (n,).

    As `spectral` from the normalization on. "kmeans" takes the best of 10 starts: 9 by k-means++ drawn from the seed,
    and one from rows that are as nearly orthogonal as possible, as Ng, Jordan and Weiss propose. Where the clusters of
    the latter are so far apart that there can be no better ones, the others are left out.

    Args:
        similarities: symmetric, finite, not negative (n, n), an array or scipy.sparse; the diagonal does not count.
        n_clusters: from 1 to n.
        seed: as in `spectral`.
        assign: as in `spectral`.

    Raises:
        AnalyticError: similarities that are not as described, a parameter out of range, or a graph of more parts than
            clusters.
    """
    graph = _checked_similarities(similarities)
    count = checks.clusters(n_clusters, graph.shape[0])
    _check_assign(assign)
    seed = checks.whole(seed, "the seed", 0)
    if count == 1:
        return np.zeros(graph.shape[0], dtype=np.int64)
    matrix = eigenvectors.normalized(graph)
    part = eigenvectors.parts(matrix)
    if part.max() >= count:
        raise AnalyticError(
            f"the similarities leave {part.max() + 1} parts without any link, more than the {count} clusters asked "
            "for: make sigma or the number of neighbours larger, or ask for more clusters"
        )
    return checks.renumbered(_clustered(matrix, part, count, seed, assign))


def _clustered(matrix: Any, part: NDArray[np.int64], count: int, seed: int, assign: str) -> NDArray[np.int64]:
    rows = eigenvectors.leading(matrix, part, count)
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    np.divide(rows, length, out=rows, where=length > 0)
    if assign == "som":
        return self_organizing.winners(rows, np.ones(len(rows)), _squarest(count), seed)
    return kmeans(rows, count, seed)


def _squarest(units: int) -> tuple[int, int]:
    height = next(h for h in range(int(units**0.5), 0, -1) if units % h == 0)
    return units // height, height


def _check_assign(assign: str) -> None:
    if assign not in ASSIGNMENTS:
        raise AnalyticError(f"rows are clustered by {' or '.join(map(repr, ASSIGNMENTS))}, got {assign!r}")


def _checked_similarities(similarities: Any) -> Any:
    from scipy import sparse

    graph = (
        sparse.csr_array(similarities, dtype=np.float64)
        if sparse.issparse(similarities)
        else np.asarray(similarities, dtype=np.float64)
    )
    if graph.ndim != 2 or graph.shape[0] != graph.shape[1] or not graph.shape[0]:
        raise AnalyticError(f"similarities must have shape (n, n), got {graph.shape}")
    values = graph if isinstance(graph, np.ndarray) else graph.data
    if not np.isfinite(values).all() or (values < 0).any():
        raise AnalyticError("similarities must be finite and not negative, such as those of `affinity`")
    difference = _asymmetry(graph)
    if difference > 1e-8 * values.max(initial=0):
        raise AnalyticError(f"similarities must be symmetric, but two of a pair differ by {difference:.3g}")
    return graph


def _asymmetry(graph: Any) -> float:
    """Return the largest difference between the two similarities of a pair."""
    if not isinstance(graph, np.ndarray):
        return float(abs(graph - graph.T).max())
    # Block by block: a transposed matrix is read against the grain, and only what fits the cache is read once.
    slices = [slice(start, start + _CACHED) for start in range(0, len(graph), _CACHED)]
    return max(
        float(np.abs(graph[rows, columns] - graph[columns, rows].T).max())
        for place, rows in enumerate(slices)
        for columns in slices[place:]
    )
