"""Search by learned numbers and colours, where colours count only in the light of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.settings import Count
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap

COMPARED = 8
"""Number of the nearest map frames, with and without colours, that are looked at again."""
_SAME_LIGHT = 2.0  # times as far as map frames from each other: colours seen in the light of the map
_FADES = 4.0
_AT_ONCE = 256  # queries


def candidates(
    known: VisualMap,
    queries: Description,
    k: Count,
    *,
    excluded: ArrayLike | None = None,
    within: NDArray[np.int64] | None = None,
) -> Retrieval:
    """Find the nearest map frames of each query, and those that are nearest by the learned part alone.

    In the light of the map, colours find places whose shapes look alike; in another light they mislead, and the learned
    part alone finds the place.

    Args:
        known: a map of m frames, described with colours; see `siamloc.models.colours`.
        queries: n descriptions.
        k: number of map frames to find with colours; as many are found without, at most 8.
        excluded: as for `siamloc.maps.match`.
        within: as for `siamloc.maps.match`.

    Returns:
        (n, k + c): the first c with colours, the c without, then the others, with a distance of infinity where a map
        frame appears again.
    """
    found = known.index.search(queries.position, k, excluded=excluded, within=within)
    learned, c = known.learned_index, min(COMPARED, k)
    near = learned.search(queries.position[:, : learned.width], c, excluded=excluded, within=within).indices
    apart = np.hypot(*_distances(known, queries, near))
    indices = np.concatenate([found.indices[:, :c], near, found.indices[:, c:]], axis=1)
    distances = np.concatenate([found.distances[:, :c], apart, found.distances[:, c:]], axis=1)
    for column in range(2 * c):
        again = indices[:, column + 1 :] == indices[:, column, None]
        distances[:, column + 1 :][again] = np.inf
    return Retrieval(indices, distances)


def in_light_of_map(known: VisualMap, queries: Description, found: Retrieval) -> Retrieval:
    """Put candidates in order with less weight for colours, the less the light of the map a query was taken in.

    The map's frames have a typical distance s between the colours of neighbours: the median over the frames of that to
    the nearest other frame. With the smallest distance h of a query's colours to those of its candidates, the squared
    distance between colours counts exp(-4 (h / s - 2)) times where h > 2 s.

    Args:
        known: a map described with colours.
        queries: n descriptions.
        found: from `candidates`.
    """
    learned, colours = _distances(known, queries, found.indices)
    light = colours.min(axis=1, keepdims=True) / max(known.colour_spacing, 1e-12)
    weight = np.exp(-_FADES * np.maximum(light - _SAME_LIGHT, 0))
    distances = np.where(np.isinf(found.distances), np.inf, np.sqrt(learned**2 + weight * colours**2))
    order = distances.argsort(axis=1, kind="stable")
    return Retrieval(np.take_along_axis(found.indices, order, 1), np.take_along_axis(distances, order, 1))


def _distances(
    known: VisualMap, queries: Description, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances (n, k) of queries to map frames (n, k): of the learned parts, and of the colours."""
    learned, colours = np.empty(rows.shape), np.empty(rows.shape)
    width = known.learned_index.width
    for at in range(0, len(rows), _AT_ONCE):
        part = slice(at, at + _AT_ONCE)
        off = queries.position[part, None].astype(np.float64) - known.descriptors[rows[part]]
        learned[part] = np.linalg.norm(off[..., :width], axis=2)
        colours[part] = np.linalg.norm(off[..., width:], axis=2)
    return learned, colours
