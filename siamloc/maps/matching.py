"""Find described frames in a map: the nearest map frames, headings from them, and the distances to all frames.

Colours count only in the light of the map. If images are compared, the nearest map frames are put in order again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from analytic.distances import distance as distance_named
from foundation.calls import typed
from foundation.settings import Count
from siamloc.data.moves import wrapped
from siamloc.maps.comparing import Compared, Compares, compare_with, comparison_of
from siamloc.maps.joining import joined
from siamloc.maps.search import Retrieval, check_excluded, checked, slices
from siamloc.maps.visual_map import VisualMap

_SAME_LIGHT = 2.0  # times the spacing of the map's colours
_FADES = 4.0
_COMPARED = 8  # nearest map frames that are compared with a query
_ODDS = -2.0, 4.0  # log odds beyond these count no more
_ODDS_PER_DISTANCE = 30.0  # log odds that weigh as much as a distance of 1 between descriptors
_NEARNESS = 2.0  # distance between descriptors that weighs as much as 1 between positions
_AWAY = 2.0  # largest distance between positions that counts, in their unit
_JOINED = 3  # map frames whose answers are joined to a pose
_STRANGE_PER_ODDS = 0.1  # strangeness that one log odds takes away
_PAIRS_AT_ONCE = 1 << 22
_AT_ONCE = 256  # queries


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
    eight are put in order again by a comparison with the query, which changes their distances. If it also describes
    colours, so are the eight that are nearest without them; and if it describes colours and does not compare, colours
    count only in the light of the map, with Euclidean distances.

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
    mask = None if excluded is None else check_excluded(excluded, (len(queries), len(known)), k)
    if mask is not None:
        left = int((~mask).sum(axis=1).min(initial=left))
    if compares is None and known.has_colours and known.distance == "euclidean":
        return _nearest_in_light(known, queries, k, excluded=mask, within=within)
    if compares is None:
        return known.index.search(queries.position, k, excluded=mask, within=within)
    compared = min(_COMPARED, left)
    found = known.index.search(queries.position, max(k, compared), excluded=mask, within=within)
    if known.has_colours:
        learned = queries.position[:, : known.learned.shape[1]]
        near = known.learned_index.search(learned, compared, excluded=mask, within=within).indices
        found, compared = _with_learned(known, queries, found, near), 2 * compared
    ordered = _reranked(known, queries, found, compares, compared)
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

    With Euclidean distances, colours count only in the light of the map.

    Raises:
        AnalyticError, ConfigError: descriptions that cannot be compared.
    """
    known.check_descriptor(queries.identity)
    mask = None if excluded is None else np.asarray(excluded, dtype=bool)
    if known.aligned:
        apart = known.aligned_index.distances(queries)
    elif known.has_colours and known.distance == "euclidean":
        return _light_distances(known, queries, mask)
    else:
        apart = distance_named(known.distance)(queries.position, known.descriptors)
    return apart if mask is None else np.where(mask, np.inf, apart)


@typed
def learned_distances(known: VisualMap, queries: Description) -> NDArray[np.float64]:
    """Return the distances (n, m) of queries to all map frames, as `frame_distances` does, but without colours."""
    if known.aligned:
        return known.aligned_index.distances(queries)
    return distance_named(known.distance)(queries.position[:, : known.learned.shape[1]], known.learned)


def _light_distances(known: VisualMap, queries: Description, excluded: NDArray[np.bool_] | None) -> NDArray[np.float64]:
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


def _nearest_in_light(
    known: VisualMap,
    queries: Description,
    k: int,
    *,
    excluded: NDArray[np.bool_] | None,
    within: NDArray[np.int64] | None,
) -> Retrieval:
    """Find the k nearest map frames by `_light_distances`; arguments as for `match`."""
    rows = np.arange(len(known)) if within is None else within
    indices, distances = np.zeros((len(queries), k), dtype=np.int64), np.zeros((len(queries), k))
    for part in slices(len(queries), _PAIRS_AT_ONCE // len(known)):
        apart = _light_distances(known, queries.take(part), None if excluded is None else excluded[part])
        order = apart[:, rows].argsort(axis=1, kind="stable")[:, :k]
        indices[part] = rows[order]
        distances[part] = np.take_along_axis(apart, indices[part], 1)
    return Retrieval(indices, distances)


def _with_learned(known: VisualMap, queries: Description, found: Retrieval, near: NDArray[np.int64]) -> Retrieval:
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


def _reranked(known: VisualMap, queries: Description, found: Retrieval, compares: Compares, compared: int) -> Retrieval:
    """Put the nearest map frames of each query in order again.

    Distances between descriptors tell which places look alike; comparing two images tells whether both were taken near
    each other, and then where. If a comparison is certain, with log odds of 4 or more, the answers of the three best
    map frames are joined to a pose, and map frames near it are preferred. With the log odds o, limited to -2 ... 4, and
    the distance p from that pose, limited to 2, a map frame at distance d gets the distance d + (4 - o) / 30 + 2 p.
    Without that pose, as in a map without headings, p is the distance that a map frame's own certain answer tells, and
    2 for all others. Map frames after those compared get the distance d + 4.2, as other places. The map frame that
    looks most like the query is that of the smallest distance d + (4 - o) / 30.

    The strangeness of a query is the smallest d - o / 10, with o as it is: in another light, descriptors still resemble
    each other where comparisons are less certain. To a network that learned with the loss `soft_contrastive`, places
    that share nothing are 1 apart.

    Args:
        known: a map of m frames, with the orientation parts that are compared.
        queries: n descriptions with orientation parts, by `known.describe`.
        found: the nearest map frames of each query.
        compares: compares orientation parts.
        compared: number of map frames to compare, from the first.
    """
    parts, distances = queries.orientation, found.distances + _doubt(np.array(_ODDS[0])) + _NEARNESS * _AWAY
    assert parts is not None
    alike, strangeness = found.indices[:, 0].copy(), np.empty(len(found.indices))
    for part in slices(len(found.indices), _AT_ONCE):
        answers = compare_with(known, parts[part], found.indices[part, :compared], compares)
        strangeness[part] = (found.distances[part, :compared] - _STRANGE_PER_ODDS * answers.match).min(axis=1)
        judged = found.distances[part, :compared] + _doubt(answers.match)
        alike[part] = np.take_along_axis(found.indices[part], judged.argmin(axis=1)[:, None], 1)[:, 0]
        distances[part, :compared] = judged + _NEARNESS * _away(known, judged, answers)
    order = distances.argsort(axis=1, kind="stable")
    indices = np.take_along_axis(found.indices, order, 1)
    return Retrieval(indices, np.take_along_axis(distances, order, 1), alike, strangeness)


def _away(known: VisualMap, judged: NDArray[np.float64], answers: Compared) -> NDArray[np.float64]:
    """Return how far map frames (n, k) are from where the best answers place the query, at most `_AWAY`."""
    pose = joined(known, answers.take(judged.argsort(axis=1, kind="stable")[:, :_JOINED]))
    away = np.linalg.norm(known.frames.xy[answers.rows] - pose.xy[:, None], axis=2)
    here = known.frames.building[answers.rows] == known.frames.building[pose.frame, None]
    certain = answers.match >= _ODDS[1]
    placed = here & np.isfinite(away) & (certain.any(axis=1) & np.isfinite(pose.theta))[:, None]
    alone = np.where(certain, np.hypot(answers.pose[..., 0], answers.pose[..., 1]), _AWAY)
    return np.minimum(np.where(placed, away, alone), _AWAY)


def _doubt(odds: NDArray[np.float64]) -> NDArray[np.float64]:
    return (_ODDS[1] - odds.clip(*_ODDS)) / _ODDS_PER_DISTANCE
