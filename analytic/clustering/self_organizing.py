"""Clustering with a self-organizing map ([C] 3.2), trained in batches."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from analytic.arrays import Floats, Integers
from analytic.clustering import checks
from analytic.errors import AnalyticError
from foundation.settings import Rule, Seed, checked

Grid = Annotated[tuple[int, int], Rule("two whole numbers (W, H), each at least 1", lambda grid: min(grid) >= 1)]
_EPOCHS = 60
_LAST_RADIUS = 0.3  # in units of the grid: a neighbour then has 0.4 % of the winner's weight
_SETTLING = 40


def som(X: ArrayLike, grid: tuple[int, int], *, seed: int = 0) -> Integers:
    """Cluster descriptors with a self-organizing map of W x H units on a rectangular grid (n,).

    A cluster is a unit that won frames, so there can be fewer than W x H. Equal descriptors share a label. The order
    of the frames affects only the numbering: labels go from 0 to k-1 in the order of first appearance.

    1. Units start evenly spread over the plane of the two principal components, within sqrt(3) standard deviations,
       the longer side of the grid along the first. They are numbered column by column, (0, 0), (0, 1) ... (W-1, H-1).
    2. In each of 60 epochs every frame chooses its nearest unit (Euclidean; ties go to the first), and every
       unit becomes the mean of the frames, weighted by exp(-g^2 / (2 r^2)), where g is the distance on the grid to the
       frame's unit; r falls geometrically from half the longer side (at least 0.3) to 0.3.
    3. Up to 40 epochs with the last radius follow, until no frame changes. Before each, the units that won no frame
       are moved one by one: of the units that hold at least two different frames, the one with the largest sum of
       squared distances gives up its farthest frame, the empty unit is set to it, and the frames choose again.

    Args:
        X: descriptors (n, D).
        grid: (W, H), both at least 1, W x H at most n.
        seed: seed of the randomized search for the principal components.

    Raises:
        AnalyticError: descriptors of wrong shape or not finite, an invalid grid, or a seed out of range.

    Examples:
        >>> som([[0.0, 0.1], [0.1, 0.0], [5.0, 5.1], [5.1, 5.0]], (2, 1)).tolist()
        [0, 0, 1, 1]
    """
    x = checks.vectors(X)
    width, height = checked(grid, Grid, "the grid", AnalyticError)
    if width * height > len(x):
        raise AnalyticError(f"{width} x {height} units need {width * height} frames, got {len(x)}: use a smaller grid")
    seed = checked(seed, Seed, "the seed", AnalyticError)
    different, inverse, counts = checks.distinct(x)
    scaled, _ = checks.to_unit_range(different)
    return checks.renumbered(winners(scaled, counts.astype(np.float64), (width, height), seed)[inverse])


def winners(x: Floats, weights: Floats, grid: tuple[int, int], seed: int) -> Integers:
    """Return the number of the unit that wins each row after training (n,), 0 to W x H - 1.

    Args:
        x: rows (n, D).
        weights: weight of each row, positive (n,).
        grid: (W, H).
        seed: as in `som`.
    """
    places = np.stack(np.meshgrid(np.arange(grid[0]), np.arange(grid[1]), indexing="ij"), axis=-1).reshape(-1, 2)
    apart = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    units = _first_units(x, weights, places, seed)
    first = max(max(grid) / 2, _LAST_RADIUS)
    won = _nearest_unit(x, units)
    for radius in np.geomspace(first, _LAST_RADIUS, _EPOCHS):
        units = _moved(x, weights, won, units, apart, float(radius))
        won = _nearest_unit(x, units)
    for _ in range(_SETTLING):
        units, won = _revived(x, weights, won, units)
        units = _moved(x, weights, won, units, apart, _LAST_RADIUS)
        before, won = won, _nearest_unit(x, units)
        if np.array_equal(before, won):
            break
    return won


def _first_units(x: Floats, weights: Floats, places: Integers, seed: int) -> Floats:
    """Return where the units start, evenly spread over the plane of the first two principal components, or fewer."""
    from sklearn.utils.extmath import randomized_svd

    mean = weights @ x / weights.sum()
    seen = np.sqrt(weights / weights.sum())[:, None] * (x - mean)
    _, deviations, axes = randomized_svd(seen, min(2, *seen.shape), random_state=seed)
    size = places.max(axis=0)
    spread = np.sqrt(3) * (2 * places / np.maximum(size, 1) - (size > 0))
    longer_first = np.argsort(-size, kind="stable")[: len(axes)]
    return mean + spread[:, longer_first] @ (axes * deviations[:, None])


def _nearest_unit(x: Floats, units: Floats) -> Integers:
    return (np.einsum("ud,ud->u", units, units) - 2 * (x @ units.T)).argmin(axis=1)


def _moved(x: Floats, weights: Floats, won: Integers, units: Floats, apart: Integers, radius: float) -> Floats:
    """Return the units after one epoch; a unit too far from every winner to be affected stays where it is."""
    from scipy import sparse

    n = len(x)
    member = sparse.csr_array((weights, (won, np.arange(n))), shape=(len(units), n))
    influence = np.exp(-apart / (2 * radius**2))
    total = influence @ np.bincount(won, weights=weights, minlength=len(units))
    moved = influence @ (member @ x)
    felt = total > np.finfo(np.float64).tiny
    return np.where(felt[:, None], moved / np.where(felt, total, 1)[:, None], units)


def _revived(x: Floats, weights: Floats, won: Integers, units: Floats) -> tuple[Floats, Integers]:
    """Return the units and the winners after moving every unit without frames to where one is missing."""
    units = units.copy()
    for unit in np.flatnonzero(np.bincount(won, minlength=len(units)) == 0):
        squared = ((x - units[won]) ** 2).sum(axis=1)
        error = np.bincount(won, weights=weights * squared, minlength=len(units))
        error[np.bincount(won, minlength=len(units)) < 2] = 0
        worst = int(error.argmax())
        if not error[worst] > 0:
            break
        units[unit] = x[np.where(won == worst, squared, -1).argmax()]
        won = _nearest_unit(x, units)
    return units, won
