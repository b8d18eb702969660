"""k-means on the rows of spectral clustering: from several starts, unless one is shown to be the best of all."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.linear_algebra import one_thread

_DRAWN = 9
_SHORT = 10_000_000  # products in a step, about 2 ms


def kmeans(rows: NDArray[np.float64], count: int, seed: int) -> NDArray[np.int64]:
    """Return the clusters of rows by the best of 10 starts (n,).

    One start is from rows as nearly orthogonal as possible, as Ng, Jordan and Weiss propose; 9 are by k-means++ drawn
    from the seed, and left out where the first one gives clusters so far apart that no others can be better.

    Args:
        rows: of length 1 or 0 (n, k).
        count: from 1 to n.
        seed: of the draws.
    """
    # Products and steps have threads of their own each, which would wait for one another.
    with one_thread(openmp=True) if rows.size * count < _SHORT else nullcontext():
        first = _settled(rows, rows[_orthogonal(rows, count)])
        if is_best(rows, first.labels_, first.cluster_centers_):
            return first.labels_.astype(np.int64)
        runs = [*(_settled(rows, rows[start]) for start in drawn_starts(rows, count, _DRAWN, seed)), first]
    return min(runs, key=lambda run: run.inertia_).labels_.astype(np.int64)


def is_best(rows: NDArray[np.float64], labels: NDArray[Any], centres: NDArray[np.float64]) -> bool:
    """Say whether clusters are so far apart that no others have a smaller sum W of squared distances to their centres.

    Let r_i be the largest distance of a frame of cluster i, of m_i frames, to its centre c_i. Clusters that are as
    good have a centre within t_i = r_i + sqrt(W / m_i) of c_i: otherwise the frames of i alone would add up to more
    than W. Where |c_i - c_j| > 2 r_i + t_i + t_j for all i and j, each of these centres is the nearest one for all
    frames of its cluster, so that the clusters are the same. False says nothing.

    Args:
        rows: (n, D).
        labels: 0 to k-1 (n,).
        centres: (k, D).
    """
    distance = np.linalg.norm(rows - centres[labels], axis=1)
    size = np.bincount(labels, minlength=len(centres))
    if not size.all():
        return False
    radius = np.zeros(len(centres))
    np.maximum.at(radius, labels, distance)
    reach = radius + np.sqrt(distance @ distance / size)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return bool((apart > (2 * radius + reach)[:, None] + reach).all())


def drawn_starts(rows: NDArray[np.float64], count: int, starts: int, seed: int) -> NDArray[np.int64]:
    """Return the rows that k-means++ begins with, for several starts side by side (starts, count).

    Each further row is the best of 2 + ln(count) candidates, drawn in proportion to the squared distance to the
    nearest row chosen before (Arthur and Vassilvitskii 2007, 5). All starts share one matrix product a step.
    """
    rng, trials = np.random.default_rng(seed), 2 + int(np.log(count))
    squares = np.einsum("nd,nd->n", rows, rows)
    every = np.arange(starts)

    def to_all(chosen: NDArray[np.int64]) -> NDArray[np.float64]:
        squared = rows[chosen] @ rows.T
        squared *= -2
        squared += squares
        squared += squares[chosen][:, None]
        return np.maximum(squared, 0, out=squared)

    picked = np.empty((starts, count), dtype=np.int64)
    picked[:, 0] = rng.integers(len(rows), size=starts)
    nearest = to_all(picked[:, 0])
    for place in range(1, count):
        summed = np.cumsum(nearest, axis=1)
        draws = rng.random((starts, trials)) * summed[:, -1:]
        found = [np.searchsorted(one, draw) for one, draw in zip(summed, draws, strict=True)]
        candidates = np.minimum(np.stack(found), len(rows) - 1)
        squared = to_all(candidates.ravel()).reshape(starts, trials, -1)
        np.minimum(squared, nearest[:, None], out=squared)
        best = squared.sum(axis=2).argmin(axis=1)
        picked[:, place], nearest = candidates[every, best], squared[every, best]
    return picked


def _settled(rows: NDArray[np.float64], start: NDArray[np.float64]) -> Any:
    from sklearn.cluster import KMeans
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        # Rows that coincide give fewer clusters; the labels show it.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return KMeans(len(start), n_init=1, init=start, random_state=0).fit(rows)


def _orthogonal(rows: NDArray[np.float64], count: int) -> list[int]:
    """Return rows each as nearly at right angles as can be to those before; the first is the one most like the mean."""
    chosen = [int((rows @ rows.mean(axis=0)).argmax())]
    closeness = np.abs(rows @ rows[chosen[0]])
    while len(chosen) < count:
        chosen.append(int(closeness.argmin()))
        closeness = np.maximum(closeness, np.abs(rows @ rows[chosen[-1]]))
    return chosen
