"""The leading eigenvectors of a normalized similarity with many eigenvalues near 1, by a block Lanczos method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SHIFT = 1e-3  # beyond the largest eigenvalue, 1: near enough to spread those close to 1, far enough to solve well
_BLOCK = 8  # vectors solved for at once: as many as make a solve worth its memory traffic
_MOST, _SPARE = 10, 160  # basis vectors for each eigenvector, and beyond
_TOLERANCE = 1e-12  # of |N v - lambda v|


def inverted(matrix: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the largest eigenvalues, ascending, and their vectors; None if they are not found in time.

    A Krylov space of ((1 + shift) I - N)^-1, which spreads the eigenvalues near 1, grows by a block of vectors at a
    time and is kept orthogonal as a whole.

    Args:
        matrix: N, symmetric, no eigenvalue above 1 (n, n).
        count: number of eigenvalues, much smaller than n.
    """
    from scipy.linalg import cho_factor, cho_solve, eigh, qr

    n = len(matrix)
    definite = -matrix
    definite[np.diag_indices(n)] += 1 + _SHIFT
    factor = cho_factor(definite, lower=True, overwrite_a=True, check_finite=False)
    most = min(n, _MOST * count + _SPARE) // _BLOCK * _BLOCK
    basis, small = np.empty((n, most), order="F"), np.zeros((most, most))
    block = np.random.default_rng(0).normal(size=(n, _BLOCK))
    block = qr(block, mode="economic", check_finite=False, overwrite_a=True)[0]
    for size in range(_BLOCK, most + 1, _BLOCK):
        new, known = slice(size - _BLOCK, size), basis[:, :size]
        basis[:, new] = block
        image = cho_solve(factor, block, overwrite_b=True, check_finite=False)
        image, small[:size, new] = _off(image, known)
        block, rest = qr(image, mode="economic", check_finite=False, overwrite_a=True)
        # Where the space is exhausted, what is left over is rounding, and points anywhere.
        block, again = qr(_off(block, known)[0], mode="economic", check_finite=False, overwrite_a=True)
        rest = again @ rest
        if size < most:
            small[size : size + _BLOCK, new] = rest
        if size >= 2 * count and (size % (2 * _BLOCK) == 0 or size == most):
            upper = np.triu(small[:size, :size])
            bounds = (size - count, size - 1)
            values, inner = eigh(upper + np.triu(upper, 1).T, subset_by_index=bounds, check_finite=False)
            # An error of the inverse counts 1 / values^2 of N.
            if (np.linalg.norm(rest @ inner[new], axis=0) <= _TOLERANCE * values**2).all():
                return 1 + _SHIFT - 1 / values, known @ inner
    return None


def _off(vectors: NDArray[np.float64], basis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return vectors without their parts in a space, and those parts; twice is enough to be orthogonal."""
    # NumPy's products have threads of their own, which would wait on the cores that SciPy's solves run on.
    from scipy.linalg.blas import dgemm

    parts = dgemm(1.0, basis, vectors, trans_a=True)
    vectors = dgemm(-1.0, basis, parts, 1.0, vectors)
    rest = dgemm(1.0, basis, vectors, trans_a=True)
    return dgemm(-1.0, basis, rest, 1.0, vectors), parts + rest
