"""Put the nearest map frames of a query in order again, by comparing each of them with the query."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from siamloc.maps.comparing import Compared, Compares, compare_with
from siamloc.maps.joining import joined
from siamloc.maps.search import Retrieval, slices
from siamloc.maps.visual_map import VisualMap

COMPARED = 8
"""Number of nearest map frames that are compared with a query."""
_ODDS = -2.0, 4.0  # log odds beyond these count no more
_ODDS_PER_DISTANCE = 30.0  # log odds that weigh as much as a distance of 1 between descriptors
_NEARNESS = 2.0  # distance between descriptors that weighs as much as 1 between positions
_AWAY = 2.0  # largest distance between positions that counts, in their unit
_JOINED = 3  # map frames whose answers are joined to a pose
_AT_ONCE = 256  # queries
_STRANGE_PER_ODDS = 0.1  # strangeness that one log odds takes away


def reranked(known: VisualMap, queries: Description, found: Retrieval, compares: Compares, compared: int) -> Retrieval:
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
