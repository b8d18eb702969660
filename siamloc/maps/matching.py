"""Finding queries in a map by the descriptor that made it: nearest frames, and the heading relative to the best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analytic import Description, Descriptor
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap

_PAIRS = 1 << 17  # distances held at once


def match(known: VisualMap, queries: Description, descriptor: Descriptor, k: int) -> Retrieval:
    """Return the k nearest map frames of each query, exactly; min(k, len(known)) of them.

    Descriptors that are compared after turning them alike ([T] 3.3.4-3.3.6) are asked for every distance, the others
    are searched as vectors.

    Args:
        known: m frames, described by `descriptor`.
        queries: n descriptions.
        descriptor: what made both.
        k: how many to return, at least 1.

    Raises:
        AnalyticError, ConfigError, DataError: descriptions that cannot be compared, or a k below 1.
    """
    if not descriptor.aligned:
        return known.search(queries.position, k)
    k = min(k, len(known))
    rows = max(1, _PAIRS // len(known))
    indices, distances = np.zeros((len(queries), k), dtype=np.int64), np.zeros((len(queries), k))
    for start in range(0, len(queries), rows):
        part = slice(start, start + rows)
        apart = descriptor.pairwise(queries.take(part), known.description, known.distance)
        order = np.argsort(apart, axis=1, kind="stable")[:, :k]  # of equally near ones the smaller index comes first
        indices[part], distances[part] = order, np.take_along_axis(apart, order, axis=1)
    return Retrieval(indices, distances)


def estimated_headings(
    known: VisualMap, queries: Description, descriptor: Descriptor, found: Retrieval
) -> NDArray[np.float64] | None:
    """Return the heading of each query from its nearest map frame's (n,), rad in (-pi, pi]; NaN where that is unknown.

    None if the descriptor tells no headings, or no map frame has one.
    """
    if queries.orientation is None or known.orientation is None or not descriptor.tells_heading:
        return None
    best = found.indices[:, 0]
    theta = known.frames.theta[best]
    if not np.isfinite(theta).any():
        return None
    turned = theta + descriptor.relative_heading(queries, known.description.take(best))
    return np.pi - np.remainder(np.pi - turned, 2 * np.pi)
