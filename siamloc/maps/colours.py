"""Search by what is learned and by colours, where colours count only in the light of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from analytic.distances import distance as distance_named
from foundation.settings import Count
from siamloc.maps.search import Retrieval, checked, slices
from siamloc.maps.visual_map import VisualMap

_SAME_LIGHT = 2.0  # times the spacing of the map's colours
_FADES = 4.0
_PAIRS_AT_ONCE = 1 << 22
_AT_ONCE = 256  # queries


def light_distances(
    known: VisualMap, queries: Description, excluded: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Compute distances to all map frames, in which colours count the less, the less the light is that of the map.

    Where the colours of a query are at least h from those of all map frames, and the map's have the spacing s (see
    `VisualMap.colour_spacing`), the squared distance between colours counts exp(-4 (h / s - 2)) times if h > 2 s, and
    once otherwise.

    Args:
        known: a map of m frames, described with colours and compared by Euclidean distance.
        queries: n descriptions.
        excluded: (n, m) True where a query must not find a map frame, whose colours then do not count as the map's.

    Returns:
        (n, m), infinite where excluded.

    Raises:
        DataError: descriptions that are not finite.
    """
    checked(queries.position, "query")
    euclidean, width = distance_named("euclidean"), known.learned.shape[1]
    learned = euclidean(queries.position[:, :width], known.learned)
    colours = euclidean(queries.position[:, width:], known.descriptors[:, width:])
    counts = np.ones(colours.shape, dtype=bool) if excluded is None else ~excluded
    light = colours.min(axis=1, keepdims=True, initial=np.inf, where=counts) / known.colour_spacing
    apart = np.sqrt(learned**2 + np.exp(-_FADES * np.maximum(light - _SAME_LIGHT, 0)) * colours**2)
    return np.where(counts, apart, np.inf)


def nearest_in_light(
    known: VisualMap,
    queries: Description,
    k: Count,
    *,
    excluded: ArrayLike | None = None,
    within: NDArray[np.int64] | None = None,
) -> Retrieval:
    """Find the k nearest map frames by `light_distances`; arguments as for `siamloc.maps.match`."""
    rows = np.arange(len(known)) if within is None else within
    mask = None if excluded is None else np.asarray(excluded, dtype=bool)
    indices, distances = np.zeros((len(queries), k), dtype=np.int64), np.zeros((len(queries), k))
    for part in slices(len(queries), _PAIRS_AT_ONCE // len(known)):
        apart = light_distances(known, queries.take(part), None if mask is None else mask[part])
        order = apart[:, rows].argsort(axis=1, kind="stable")[:, :k]
        indices[part] = rows[order]
        distances[part] = np.take_along_axis(apart, indices[part], 1)
    return Retrieval(indices, distances)


def with_learned(known: VisualMap, queries: Description, found: Retrieval, near: NDArray[np.int64]) -> Retrieval:
    """Put the map frames that are nearest by the learned part alone before those that are nearest with colours.

    In the light of the map, colours find places whose shapes look alike; in another light they mislead, and the learned
    part alone finds the place. So do the means of the distances with colours and without, which the first 2 c map
    frames get.

    Args:
        known: a map described with colours.
        queries: n descriptions.
        found: the nearest map frames with colours (n, k), c or more.
        near: rows of the nearest map frames by the learned part (n, c).

    Returns:
        (n, c + k), with a distance of infinity where a map frame appears again.
    """
    indices = np.concatenate([near, found.indices], axis=1)
    distances = np.concatenate([np.empty(near.shape), found.distances], axis=1)
    count, width = near.shape[1], known.learned.shape[1]
    for part in slices(len(near), _AT_ONCE):
        off = queries.position[part, None].astype(np.float64) - known.descriptors[indices[part, : 2 * count]]
        learned = np.linalg.norm(off[..., :width], axis=2)
        distances[part, : 2 * count] = (learned + np.linalg.norm(off, axis=2)) / 2
    for column in range(count):
        again = indices[:, column + 1 :] == indices[:, column, None]
        distances[:, column + 1 :][again] = np.inf
    return Retrieval(indices, distances)
