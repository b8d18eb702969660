"""Find described frames in a map: the nearest map frames, headings from them, and the distances to all frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from analytic.distances import distance as distance_named
from foundation.calls import typed
from foundation.settings import Count
from siamloc.data.moves import wrapped
from siamloc.maps.colours import light_distances, nearest_in_light, with_learned
from siamloc.maps.comparing import comparison_of
from siamloc.maps.reranking import COMPARED, reranked
from siamloc.maps.search import Retrieval, check_excluded
from siamloc.maps.visual_map import VisualMap


@typed
def match(
    known: VisualMap,
    queries: Description,
    k: Count = 1,
    *,
    excluded: ArrayLike | None = None,
    within: NDArray[np.int64] | None = None,
) -> Retrieval:
    """Find the min(k, m) nearest map frames of each query, exactly.

    If the map is in metres and its descriptor compares images, such as a network built with relative=True, the first
    eight are put in order again by a comparison with the query, which changes their distances; see
    `siamloc.maps.reranking`. If it also describes colours, so are the eight that are nearest without them; and if it
    describes colours and does not compare, colours count only in the light of the map, with Euclidean distances; see
    `siamloc.maps.colours`.

    Descriptors that are turned into alignment before they are compared ([T] 3.3.4-3.3.6) compute every distance; all
    others are searched as vectors.

    Args:
        known: a map of m frames.
        queries: n descriptions by the map's descriptor.
        k: number of map frames to return, at least 1.
        excluded: (n, m) bool, True where a query must not find a map frame; see `Protocol.excluded`.
        within: the only rows of the map to search, increasing, not together with `excluded`; all if None.

    Raises:
        AnalyticError, ConfigError, DataError: descriptions that cannot be compared, a k below 1, or a query with fewer
            than k map frames left.

    Example:
        >>> from siamloc.data import FrameTable
        >>> known = VisualMap([[0.0], [1.0], [5.0]], FrameTable(path=["a.png", "b.png", "c.png"]))
        >>> query = Description(np.array([[0.9]]))
        >>> match(known, query, 2).indices
        array([[1, 0]])
        >>> match(known, query, 2, excluded=[[False, True, False]]).indices
        array([[0, 2]])
    """
    known.check_descriptor(queries.identity)
    if known.aligned:
        return known.aligned_index.search(queries, k, excluded=excluded, within=within)
    compares = None if queries.orientation is None else comparison_of(known)
    left = len(known) if within is None else len(within)
    k = min(k, left)
    if excluded is not None:
        check_excluded(excluded, (len(queries), len(known)), k)
        left = int((~np.asarray(excluded, dtype=bool)).sum(axis=1).min(initial=left))
    if compares is None:
        in_light = known.has_colours and known.distance == "euclidean"
        search = nearest_in_light if in_light else _by_distance
        return search(known, queries, k, excluded=excluded, within=within)
    compared = min(COMPARED, left)
    found = _by_distance(known, queries, max(k, compared), excluded=excluded, within=within)
    if known.has_colours:
        learned = queries.position[:, : known.learned.shape[1]]
        near = known.learned_index.search(learned, compared, excluded=excluded, within=within).indices
        found, compared = with_learned(known, queries, found, near), 2 * compared
    ordered = reranked(known, queries, found, compares, compared)
    return replace(ordered, indices=ordered.indices[:, :k], distances=ordered.distances[:, :k])


@typed
def headings(known: VisualMap, queries: Description, found: Retrieval, count: int = 1) -> NDArray[np.float64]:
    """Estimate the heading of each query from each of its `count` nearest map frames.

    Args:
        known: a map of m frames, whose headings and orientation parts are used; see `siamloc.maps.build(heading=...)`.
        queries: n descriptions by `known.describe`.
        found: the nearest map frames of each query, at least `count`.
        count: number of map frames to use for each query.

    Returns:
        (n, count) in rad, in (-pi, pi]; NaN if the map frame has no heading, or if there is no orientation part to
        compare.
    """
    turned = np.full((len(queries), count), np.nan)
    if queries.orientation is None or known.orientation is None:
        return turned
    by = known.heading_by
    for place in range(min(count, found.indices.shape[1])):
        rows = found.indices[:, place]
        theta = known.frames.theta[rows]
        if by.tells_heading and np.isfinite(theta).any():
            turned[:, place] = theta + by.relative_heading(queries, known.turning(rows))
    return wrapped(turned)


@typed
def frame_distances(
    known: VisualMap, queries: Description, *, excluded: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return the distances (n, m) of queries to all map frames, with the map's distance; infinite where excluded.

    With Euclidean distances, colours count only in the light of the map; see `siamloc.maps.colours`.

    Raises:
        AnalyticError, ConfigError: descriptions that cannot be compared.
    """
    known.check_descriptor(queries.identity)
    mask = None if excluded is None else np.asarray(excluded, dtype=bool)
    if known.aligned:
        apart = known.aligned_index.distances(queries)
    elif known.has_colours and known.distance == "euclidean":
        return light_distances(known, queries, mask)
    else:
        apart = distance_named(known.distance)(queries.position, known.descriptors)
    return apart if mask is None else np.where(mask, np.inf, apart)


@typed
def learned_distances(known: VisualMap, queries: Description) -> NDArray[np.float64]:
    """Return the distances (n, m) of queries to all map frames, as `frame_distances` does, but without colours."""
    if known.aligned:
        return known.aligned_index.distances(queries)
    return distance_named(known.distance)(queries.position[:, : known.learned.shape[1]], known.learned)


def _by_distance(known: VisualMap, queries: Description, k: int, **which: Any) -> Retrieval:
    return known.index.search(queries.position, k, **which)
