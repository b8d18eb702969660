"""Poses finer than the map's spacing: where a query was taken relative to the map frames that it resembles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import typed
from foundation.settings import Count, NotNegative, Positive
from siamloc.data.frames import FrameTable
from siamloc.data.moves import way_along, wrapped
from siamloc.errors import ConfigError, DataError
from siamloc.maps.checked_arrays import check_placed
from siamloc.maps.comparing import Compares, compare_with
from siamloc.maps.joining import RefinedPoses, joined
from siamloc.maps.learned import Learned
from siamloc.maps.matching import headings
from siamloc.maps.search import Retrieval, slices
from siamloc.maps.visual_map import VisualMap

OUTPUTS = ("pose", "information", "match")
"""What `Compares` returns, in order."""

_AT_ONCE = 256  # queries


@dataclass(frozen=True)
class Refinement(Learned):
    """How poses are made finer than the map, as plain values that an evaluation passes on to the robot.

    Attributes:
        method: "interpolate", see `siamloc.maps.interpolate_poses`, or "relative", see `refine`.
        neighbours: number of nearest map frames used, at least 1.
        radius: map frames farther apart are different places, for "interpolate"; in units of x and y.
        widening: how much wider the ellipses of "relative" must be, see `RefinedPoses.widening`.
        map_digest: digest of the map this was learned on; "" if unknown.

    Raises:
        ConfigError: an unknown method, or a value out of range.
    """

    FORMAT = "siamloc-refinement"
    VERSION = 4
    NOUN = "refinement of poses"

    method: Literal["interpolate", "relative"]
    neighbours: Count = 3
    radius: NotNegative = 1.0
    widening: Positive = 1.0
    map_digest: str = ""

    def poses(
        self, known: VisualMap, queries: Description, found: Retrieval, compares: Compares | None = None
    ) -> RefinedPoses:
        """Return the refined poses of queries; arguments and errors as for `refine` and `interpolate_poses`.

        For "interpolate", all map frames need positions.
        """
        if self.method == "relative":
            return refine(known, queries, found, compares, self.neighbours).widened(self.widening)
        turned = headings(known, queries, found, min(self.neighbours, len(known)))
        return interpolate_poses(found, known.frames, self.neighbours, self.radius, turned)


@typed
def refine(
    known: VisualMap, queries: Description, found: Retrieval, compares: Compares | None = None, k: Count = 3
) -> RefinedPoses:
    """Estimate poses by comparing each query with its k most similar map frames.

    Each map frame answers where the query was taken, with what certainty, and whether it was taken nearby at all. An
    answer is correct with the probability of the match, and then follows its t-distribution; otherwise it may lie
    anywhere. The result is the most likely pose: answers that agree refine the pose, and answers that disagree are left
    out. Map frames in another building than the nearest one are left out, too.

    Args:
        known: a map of m frames with positions, headings and orientation parts.
        queries: n descriptions with orientation parts, by `known.describe`.
        found: the nearest map frames of each query.
        compares: a comparison function; the `compare` method of the map's descriptor if None.
        k: number of map frames to compare, at least 1.

    Raises:
        ConfigError: k below 1, a map whose descriptor does not compare, or one that is not in metres.
        DataError: a map without headings, or without orientation parts.
    """
    if compares is None:
        check_compares(known)
        compares = known.descriptor.compare  # type: ignore[attr-defined]
    parts = queries.orientation
    if parts is None or known.orientation is None:
        raise DataError("the map or the queries have no orientation parts to compare: use a network that computes them")
    if not (np.isfinite(known.frames.theta) & known.frames.has_position).any():
        raise DataError("no map frame has a heading: refining needs the column theta, in rad")
    rows = found.indices[:, : min(k, found.indices.shape[1])]
    answers = (compare_with(known, parts[at], rows[at], compares) for at in slices(max(len(rows), 1), _AT_ONCE))
    return RefinedPoses.concatenate([joined(known, one) for one in answers])


def check_compares(known: VisualMap) -> None:
    """Check that a map and its network can estimate where queries were taken relative to its frames.

    Raises:
        ConfigError: the network does not compare, or the map lacks the parts that it compares or is not in metres.
    """
    if not getattr(known.descriptor, "compares", False):
        raise ConfigError(
            f"{known.descriptor.name} does not tell where images were taken relative to others: train a network with "
            "model.relative=true (from Python build(..., relative=True)) and map by it, take descriptor=pretrained for "
            "panoramas, or use task.refine=interpolate"
        )
    if not known.heading_by_network:
        raise ConfigError(
            "the map does not hold what its network compares by: make it again without heading= of another descriptor"
        )
    if known.frames.unit != "m":
        raise ConfigError(
            f"networks that compare answer in metres, and the map is in {known.frames.unit!r}: give x and y in metres, "
            "or use task.refine=interpolate"
        )


@typed
def interpolate_poses(
    found: Retrieval,
    frames: FrameTable,
    k: Count = 3,
    radius: NotNegative = 1.0,
    headings: ArrayLike | None = None,
    epsilon: Positive = 1e-6,
) -> RefinedPoses:
    """Return poses between the k nearest map frames of each query.

    A frame at descriptor distance d has the weight 1 / (d + epsilon). Only frames within a radius of the nearest one,
    measured along the map's own path, count: a frame behind a wall, or one elsewhere that looks alike, would pull the
    mean to a place where the robot cannot be. Headings are averaged as directions.

    Args:
        found: result of the search, at least min(k, m) neighbours of n queries.
        frames: the map's frames (m), in capture order within each sequence, all with positions.
        k: largest number of neighbours used; 1 gives the nearest frame's position exactly.
        radius: along the path, in units of x and y, not negative; 0 leaves only frames at the nearest one's position.
        headings: (n, k or more) heading of the query according to each neighbour, rad; NaN where there is none. Without
            them, the poses have no heading.
        epsilon: keeps the weight of an identical descriptor finite, positive.

    Raises:
        ConfigError: k, radius or epsilon out of range.
        DataError: too few neighbours, rows outside the map, headings of another shape, or a frame without a position.
    """
    k = min(k, len(frames))
    rows = found.indices
    if rows.shape[1] < k or (rows.size and not 0 <= rows.min() <= rows.max() < len(frames)):
        raise DataError(
            f"interpolation needs {k} neighbours a query, rows 0 to {len(frames) - 1} of the map, got shape "
            f"{rows.shape}"
        )
    check_placed(frames, "a path along which to interpolate")
    along = np.zeros(len(frames))  # the path of each drive, from its first frame
    for drive in frames.rows_by("sequence").values():
        along[drive] = way_along(frames.xy[drive])
    near, apart = rows[:, :k], found.distances[:, :k]
    best = near[:, :1]
    inside = (np.abs(along[near] - along[best]) <= radius) & (frames.sequence[near] == frames.sequence[best])
    weight = np.where(inside, 1 / (apart + epsilon), 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    # Offsets from the nearest frame: for a single frame they are zero, so its position is reproduced to the last bit.
    xy = frames.xy[best[:, 0]] + np.einsum("nk,nkc->nc", weight, frames.xy[near] - frames.xy[best])
    nothing = np.full(len(xy), np.nan)
    theta = nothing if headings is None else _mean_heading(weight, headings, k)
    return RefinedPoses(xy, theta, np.zeros((len(xy), 2, 2)), (weight > 0).sum(axis=1) / k, near[:, 0], nothing)


def _mean_heading(weight: NDArray[np.float64], headings: ArrayLike, k: int) -> NDArray[np.float64]:
    angle = np.asarray(headings, dtype=np.float64)
    if angle.ndim != 2 or len(angle) != len(weight) or angle.shape[1] < k:
        raise DataError(f"{len(weight)} queries need headings by {k} neighbours, got shape {angle.shape}")
    angle = angle[:, :k]
    known = np.isfinite(angle) & (weight > 0)
    directions = np.where(known, weight * np.exp(1j * np.where(known, angle, 0.0)), 0.0)
    return np.where(known.any(axis=1), wrapped(np.angle(directions.sum(axis=1))), np.nan)
