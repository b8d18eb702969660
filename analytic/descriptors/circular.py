"""Circular correlation over all turns of the robot at once.

A robot that turns left by s steps sees its surroundings s steps further right: Q[k] = R[k - s], so that
c[s] = sum_k Q[k] R[k - s] has its peak there. By the correlation theorem c is the inverse transform of Q conj(R),
which costs one small product per frequency in place of one comparison per turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

_VALUES = 1 << 23  # of correlations held at once: 32 MiB


def spectrum(columns: NDArray[Any]) -> NDArray[np.complex64]:
    """Return the transform (K // 2 + 1, B, F) along the turn of real values (B, K, F), frequency first."""
    transformed = _fft().rfft(np.asarray(columns, dtype=np.float32), axis=1)
    return np.ascontiguousarray(transformed.transpose(1, 0, 2)).astype(np.complex64, copy=False)


def correlate(queries: NDArray[np.complex64], references: NDArray[np.complex64], steps: int) -> NDArray[np.float32]:
    """Return c (n, m, steps): the correlation of each query with each reference at every turn.

    Args:
        queries: spectra (steps // 2 + 1, n, F).
        references: spectra (steps // 2 + 1, m, F).
        steps: K, steps of a full turn.
    """
    # Conjugating the few queries and the result is Q conj(R) again, and leaves the map's spectra as they lie.
    crossed = (queries.conj() @ references.transpose(0, 2, 1)).conj()
    return _fft().irfft(crossed.transpose(1, 2, 0), n=steps, axis=2)


def heading(step: NDArray[Any], steps: int) -> NDArray[np.float64]:
    """Return the angle of a number of steps to the left, rad in (-pi, pi]."""
    turned = np.asarray(step) % steps
    return np.where(2 * turned > steps, turned - steps, turned) * (2 * np.pi / steps)


def blocks(n: int, m: int, steps: int) -> Iterator[tuple[slice, slice]]:
    """Yield the blocks of a table of pairs (n, m) whose correlations at every turn fit in a bounded memory."""
    most = max(1, _VALUES // steps)
    width = max(1, min(m, most))
    height = max(1, most // width)
    for top in range(0, n, height):
        for left in range(0, m, width):
            yield slice(top, top + height), slice(left, left + width)


def _fft() -> ModuleType:
    """Return scipy's transforms, or numpy's where scipy is not installed, as on a robot."""
    try:
        from scipy import fft
    except ImportError:
        from numpy import fft
    return fft
