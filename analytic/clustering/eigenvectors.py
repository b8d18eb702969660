"""The leading eigenvectors of the normalized similarity, part by part of its graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.clustering import krylov

# Below this a normalized similarity counts as none. A Lanczos solver finds one copy of an eigenvalue, so that the
# equal ones of separate parts are sought separately; in float64 it tells parts apart down to about 1e-13.
_NOTHING = 1e-11
_SMALL = 500  # frames up to which the full decomposition is as fast as Lanczos
_FLAT = 1200  # the same where no eigenvalue but the first stands out


def normalized(similarity: Any) -> Any:
    """Return D^-1/2 S D^-1/2, D_i = sum_j S_ij over the other frames: the identity minus the Laplacian.

    The diagonal of S does not count (Ng, Jordan, Weiss, step 1). The row of a frame that resembles no other is 0.

    Args:
        similarity: symmetric, not negative (n, n), an array or scipy.sparse.
    """
    if isinstance(similarity, np.ndarray):
        matrix = similarity.copy()
        np.fill_diagonal(matrix, 0)
        scale = _inverse_root(matrix.sum(axis=1))
        matrix *= scale[:, None]
        matrix *= scale
        return matrix
    from scipy import sparse

    matrix = sparse.csr_array(similarity, copy=True)
    matrix.setdiag(0)
    matrix.eliminate_zeros()
    scale = sparse.diags_array(_inverse_root(matrix.sum(axis=1)))
    return (scale @ matrix @ scale).tocsr()


def parts(matrix: Any) -> NDArray[np.int64]:
    """Return the number of the part of the graph that each frame belongs to (n,), given the normalized similarity.

    Normalized similarities below 1e-11 join nothing.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    strong = matrix > _NOTHING
    if isinstance(matrix, np.ndarray):
        hub = int(strong.sum(axis=1).argmax())
        if strong[hub].sum() == len(matrix) - 1:
            return np.zeros(len(matrix), dtype=np.int64)
        strong = sparse.csr_array(strong)
    return connected_components(strong, directed=False)[1].astype(np.int64)


def leading(matrix: Any, part: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Return the eigenvectors of the `count` largest eigenvalues, as columns, the largest first (n, count).

    They belong to the smallest eigenvalues of the Laplacian. A frame that resembles no other is a part of its own
    with eigenvalue 1.

    Args:
        matrix: from `normalized`.
        part: from `parts`.
        count: from 1 to n.
    """
    values: list[NDArray[np.float64]] = []
    columns: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []
    for number in range(int(part.max()) + 1):
        rows = np.flatnonzero(part == number)
        inside = matrix if len(rows) == len(part) else matrix[rows][:, rows]
        value, vector = _largest(inside, min(count, len(rows)))
        values.append(value)
        columns.extend((rows, column) for column in vector.T)
    order = np.argsort(-np.concatenate(values), kind="stable")[:count]
    vectors = np.zeros((len(part), len(order)))
    for place, chosen in enumerate(order):
        rows, column = columns[chosen]
        vectors[rows, place] = column
    return vectors


def _largest(matrix: Any, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    n = matrix.shape[0]
    if n == 1:
        return np.ones(1), np.ones((1, 1))
    if n <= _SMALL or 8 * count > n:
        return _full(matrix, count)
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    if isinstance(matrix, np.ndarray):
        # The squares of all eigenvalues add up to that of the entries: a large sum means that many are near 1, one of
        # hardly more than the first eigenvalue's own that none stands out, which takes Lanczos long.
        squares = float(np.vdot(matrix, matrix))
        if squares > count:
            found = krylov.inverted(matrix, count)
            return _full(matrix, count) if found is None else found
        if squares < 2 and n <= _FLAT:
            return _full(matrix, count)
    start = np.random.default_rng(0).uniform(0.5, 1, n)
    try:
        return eigsh(matrix, k=count, which="LA", v0=start)
    except ArpackNoConvergence:
        return _full(matrix, count)


def _full(matrix: Any, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from scipy.linalg import eigh

    n = matrix.shape[0]
    dense = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
    try:
        return eigh(dense, subset_by_index=(n - count, n - 1), check_finite=False)
    except np.linalg.LinAlgError:
        # Where hosts of eigenvalues are equal but for rounding, LAPACK's search for some of them may fail.
        values, vectors = np.linalg.eigh(dense)
        return values[-count:], vectors[:, -count:]


def _inverse_root(degree: NDArray[np.float64]) -> NDArray[np.float64]:
    degree = np.asarray(degree, dtype=np.float64).reshape(-1)
    return np.divide(1, np.sqrt(degree), out=np.zeros_like(degree), where=degree > 0)
