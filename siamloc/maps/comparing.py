"""Compare queries with map frames, image by image, by the network that describes both."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from siamloc.data.moves import wrapped
from siamloc.maps.visual_map import VisualMap

Compares = Callable[
    [NDArray[np.float32], NDArray[np.float32]], tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
]
"""Compares orientation parts of queries (n, K, F) with those of n map frames, pair by pair. Returns pose (n, 3):
the displacement ahead and to the left as seen from the map frame's robot, and how far the query's robot is turned left,
in rad; the inverse of the scale matrix of a t-distribution with 4 degrees of freedom (n, 3, 3), the information; and
the log odds (n,) that the images were taken near each other."""

ODDS = float(np.log(19))
"""Log odds from which on two images count as taken near each other: a probability of 95 %."""
_OFF, _OFF_SHARE, _TURNED = 0.25, 0.15, np.radians(8)  # by how much, in metres, in shares of the displacement, in rad


class Compared(NamedTuple):
    """What a comparison of n queries with k map frames each gives.

    Attributes:
        rows: (n, k) the map frames.
        pose: (n, k, 3) of each query as seen from the map frame; see `Compares`.
        information: (n, k, 3, 3) of the poses.
        match: (n, k) log odds that both images were taken near each other.
    """

    rows: NDArray[np.int64]
    pose: NDArray[np.float64]
    information: NDArray[np.float64]
    match: NDArray[np.float64]

    def take(self, places: NDArray[np.int64]) -> Compared:
        """Return the comparisons at some places of each query's row (n, c)."""
        at = np.arange(len(places))[:, None], places
        return Compared(self.rows[at], self.pose[at], self.information[at], self.match[at])


def comparison_of(known: VisualMap) -> Compares | None:
    """Return the function by which a map's descriptor compares a query with a map frame.

    None if it cannot, or if the map is not in metres, in which networks answer.
    """
    held = known.heading_by_network and known.distance == "euclidean" and known.frames.unit == "m"
    return getattr(known.describes, "compare", None) if held and getattr(known.describes, "compares", False) else None


def compare_with(known: VisualMap, parts: NDArray[np.float32], rows: NDArray[np.int64], compares: Compares) -> Compared:
    """Compare queries with these orientation parts (n, K, F) with map frames (n, k)."""
    seen = known.turning(rows.ravel()).orientation
    assert seen is not None
    pose, information, match = compares(np.repeat(scaled(parts), rows.shape[1], axis=0), scaled(seen))
    return Compared(
        rows, pose.reshape(*rows.shape, 3), information.reshape(*rows.shape, 3, 3), match.reshape(rows.shape)
    )


def scaled(parts: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return orientation parts scaled to a mean square of 1 each, as maps keep them only up to a scale."""
    size = np.sqrt(np.mean(np.square(parts, dtype=np.float64), axis=(1, 2), keepdims=True))
    return (parts / np.maximum(size, 1e-12)).astype(np.float32)


def agree(found: NDArray[np.float64], pose: NDArray[np.float64], tolerance: float = 1.0) -> NDArray[np.bool_]:
    """Return which relative poses by other means (p, 3) agree with the poses (p, 3) that comparisons give."""
    error, length = found - pose, np.hypot(pose[:, 0], pose[:, 1])
    near = np.hypot(error[:, 0], error[:, 1]) < tolerance * (_OFF + _OFF_SHARE * length)
    return np.asarray(near & (np.abs(wrapped(error[:, 2])) < _TURNED))
