"""Choose the right building among several maps ([C] 5.3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.clustering import checks
from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError


@dataclass(frozen=True)
class BuildingChoice:
    """The building chosen for each query.

    Attributes:
        building: number of the map with the nearest representative (n,).
        representative: row of that representative in its map (n,).
        apart: distance to the nearest representative of each building (n, B).
    """

    building: NDArray[np.int64]
    representative: NDArray[np.int64]
    apart: NDArray[np.float64]


def choose_building(queries: ArrayLike, maps: Sequence[ArrayLike], distance: str = "cosine") -> BuildingChoice:
    """Return the building of each query: the one whose map holds the nearest representative ([C] 5.3.3).

    Ties go to the first building. [C] uses the cosine distance.

    Args:
        queries: descriptors (n, D).
        maps: the representatives of each building (k, D), such as those of `analytic.clustering.representatives`; k
            may differ between buildings.
        distance: a name in `analytic.DISTANCES`.

    Raises:
        AnalyticError: no maps, wrong shapes, descriptors whose length differs from the queries', values that are not
            finite, or an unknown distance.

    Example:
        >>> office, school = np.array([[1.0, 0.0], [0.8, 0.2]]), np.array([[0.0, 1.0]])
        >>> found = choose_building([[0.9, 0.2], [0.1, 0.7]], [office, school])
        >>> found.building, found.representative
        (array([0, 1]), array([1, 0]))
    """
    between = distance_named(distance)
    asked = checks.vectors(queries, "queries")
    if isinstance(maps, np.ndarray) and maps.ndim == 2:
        raise AnalyticError("maps must be a list with the representatives of each building, got a single array")
    known = [checks.vectors(one, f"representatives of building {i}") for i, one in enumerate(maps)]
    if not known:
        raise AnalyticError("there is no map to choose from: give the representatives of at least one building")
    for i, one in enumerate(known):
        if one.shape[1] != asked.shape[1]:
            raise AnalyticError(
                f"building {i} has descriptors of {one.shape[1]} numbers and the queries of {asked.shape[1]}: describe "
                "both with the same descriptor"
            )
    apart = np.empty((len(asked), len(known)))
    rows = np.empty(apart.shape, dtype=np.int64)
    for block in checks.row_slices(len(asked), max(map(len, known))):
        for i, one in enumerate(known):
            distances = between(asked[block], one)
            rows[block, i] = distances.argmin(axis=1)
            apart[block, i] = distances.min(axis=1)
    building = apart.argmin(axis=1)
    return BuildingChoice(building, rows[np.arange(len(asked)), building], apart)
