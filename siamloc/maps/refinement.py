"""Poses finer than the map's spacing: where a query was taken relative to the map frames that it resembles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import typed
from foundation.columns import Rows
from foundation.settings import Count, NotNegative, Positive
from siamloc.data.frames import FrameTable
from siamloc.data.moves import wrapped
from siamloc.errors import ConfigError, DataError
from siamloc.maps.learned import Learned
from siamloc.maps.matching import headings
from siamloc.maps.reranking import Compares, scaled
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap

OUTPUTS = ("pose", "information", "match")
"""What `Compares` returns, in order."""

FREEDOM = 4.0  # degrees of freedom of the t-distribution described by the information
STRAY = 1.0  # density of answers that are wrong, per square unit of the positions
_ROUNDS = 6
_STILL = 1e-4  # units: a search that moves by less has converged
_NOTHING = 1e-12  # determinants of information below this count as zero
_AT_ONCE = 256  # queries


@dataclass(frozen=True, eq=False)
class RefinedPoses(Rows):
    """Poses of n queries, finer than the map's spacing.

    Attributes:
        xy: (n, 2), in the unit of the positions; the map frame's own position if nothing could be compared.
        theta: (n,) in rad, in (-pi, pi]; NaN if nothing could be compared.
        information: (n, 2, 2) inverse of the scale matrix of x and y in a t-distribution with 4 degrees of freedom;
            zeros if nothing could be compared. Errors of the answers for a query are correlated: see `widening`.
        agreement: (n,) share of the answers that agree on the pose, from 0 to 1.
        frame: (n,) the map frame whose answer has the largest weight.
        match: (n,) logarithm of the odds that a map frame was taken near the query, the largest of all compared frames;
            minus infinity if nothing could be compared.

    Poses from `interpolate_poses` have no information, their agreement is the share of map frames used, and their match
    is NaN.
    """

    xy: NDArray[np.float64]
    theta: NDArray[np.float64]
    information: NDArray[np.float64]
    agreement: NDArray[np.float64]
    frame: NDArray[np.int64]
    match: NDArray[np.float64]

    def squared(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return squared distances (n,) from true positions (n, 2), weighted by the information; NaN if it is zero."""
        apart = np.asarray(xy, dtype=np.float64) - self.xy
        told = self.information.any(axis=(1, 2))
        return np.where(told, np.einsum("ni,nij,nj->n", apart, self.information, apart), np.nan)

    def inside(self, xy: ArrayLike, share: float = 0.9) -> NDArray[np.float64]:
        """Return which true positions (n, 2) lie in the ellipse with the probability `share` (n,): 1, 0 or NaN."""
        squared = self.squared(xy)
        return np.where(np.isnan(squared), np.nan, squared <= _limit(share))

    def widening(self, xy: ArrayLike, share: float = 0.9) -> float:
        """Learn how much wider the ellipses must be, from true positions (n, 2) of a drive used for nothing else.

        Returns:
            The factor on squared distances, for `widened`, with which `share` of the true positions lie in the
            ellipses.

        Raises:
            DataError: fewer than 10 positions.
        """
        squared = self.squared(xy)
        squared = squared[np.isfinite(squared)]
        if len(squared) < 10:
            raise DataError(f"the ellipses are learned from 10 refined validation frames or more, got {len(squared)}")
        return float(np.quantile(squared, share) / _limit(share))

    def widened(self, factor: float) -> RefinedPoses:
        """Return the poses with ellipses enlarged by a factor on squared distances."""
        return replace(self, information=self.information / factor)

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariances of x and y (n, 2, 2), in squared units of the positions; NaN without information."""
        told = np.asarray(self.information.any(axis=(1, 2)))[:, None, None]
        held = np.where(told, self.information, np.eye(2))
        return np.where(told, np.linalg.inv(held) * FREEDOM / (FREEDOM - 2), np.nan)


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
    VERSION = 2
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
        ConfigError: k below 1, or a map whose descriptor does not compare.
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
    starts = range(0, len(rows), _AT_ONCE)
    return RefinedPoses.concatenate(
        [_refined(known, parts[at : at + _AT_ONCE], rows[at : at + _AT_ONCE], compares) for at in starts]
    )


def _refined(known: VisualMap, parts: NDArray[np.float32], rows: NDArray[np.int64], compares: Compares) -> RefinedPoses:
    """Return the poses of queries with these parts (n, K, F), from map frames (n, k)."""
    n, count = rows.shape
    held = known.turning(rows.ravel()).orientation
    assert held is not None
    pose, information, match = compares(np.repeat(scaled(parts), count, axis=0), scaled(held))
    theta, xy = known.frames.theta[rows], known.frames.xy[rows]
    building = known.frames.building[rows]
    usable = np.asarray(np.isfinite(theta) & np.isfinite(xy).all(axis=2) & (building == building[:, :1]))
    theta, xy = np.where(usable, theta, 0.0), np.where(usable[..., None], xy, 0.0)
    pose, information = pose.reshape(n, count, 3), information.reshape(n, count, 3, 3)
    axes = _turns(theta)
    spread = np.linalg.inv(information)
    about = np.linalg.inv(axes @ spread[..., :2, :2] @ axes.swapaxes(-1, -2))
    odds = np.where(usable, match.reshape(n, count), -np.inf)
    probability = 1 / (1 + np.exp(-odds))
    at = xy + known.mounting.offset(theta) + (axes @ pose[..., :2, None])[..., 0]
    most_likely, weight, share = _most_likely(at, about, probability)
    turned = theta + pose[..., 2]
    weight_of_turn = weight / spread[..., 2, 2]
    heading = np.arctan2((weight_of_turn * np.sin(turned)).sum(axis=1), (weight_of_turn * np.cos(turned)).sum(axis=1))
    nothing = np.logical_not(usable.any(axis=1))
    robot = most_likely - known.mounting.offset(heading)
    return RefinedPoses(
        np.where(nothing[:, None], known.frames.xy[rows[:, 0]], robot),
        np.where(nothing, np.nan, heading),
        (weight[..., None, None] * about).sum(axis=1),
        share.mean(axis=1),
        rows[np.arange(n), share.argmax(axis=1)],
        odds.max(axis=1),
    )


class _Answers(NamedTuple):
    """Answers of k map frames for n queries, (n, k) each: position, entries of information, height of density."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    xx: NDArray[np.float64]
    xy: NDArray[np.float64]
    yy: NDArray[np.float64]
    height: NDArray[np.float64]


def _most_likely(
    at: NDArray[np.float64], about: NDArray[np.float64], probability: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the most likely points (n, 2) given k answers (n, k, 2), and the answers' weights and shares (n, k).

    The search starts from each answer and reweights iteratively: each round takes the mean of the answers, weighted by
    their information and by how likely each is, at the point of the round before, not to be a stray one. The best of
    the points found is returned.

    A robot processes one query at a time, where numpy's call overhead exceeds the computation, so 2 x 2 matrices are
    written out by their entries.
    """
    n, k = probability.shape
    middle = at[:, :1]
    x, y = (at - middle)[..., 0], (at - middle)[..., 1]
    xx, xy, yy = about[..., 0, 0], about[..., 0, 1], about[..., 1, 1]
    answers = _Answers(x, y, xx, xy, yy, probability * np.sqrt(xx * yy - xy * xy) / (2 * np.pi))
    summed = np.stack([xx, xy, yy, xx * x + xy * y, xy * x + yy * y], axis=2)
    points = at - middle  # (n, k, 2): current point of the search from each answer
    arrived = np.zeros((n, k, 1), dtype=bool)
    for _ in range(_ROUNDS):
        weight, _, _ = _weighed(points, answers)
        sums = weight @ summed
        a, b, c, right, up = (sums[..., one] for one in range(5))
        size = a * c - b * b
        moved = np.stack([c * right - b * up, a * up - b * right], axis=2) / np.maximum(size, _NOTHING)[..., None]
        moved = np.where((size > _NOTHING)[..., None], moved, points)
        moving = np.abs(moved - points).max(axis=2, keepdims=True) >= _STILL
        points = np.where(arrived, points, moved)  # so that a query alone has the same result as in a batch
        arrived |= ~moving
        if arrived.all():
            break
    weight, share, density = _weighed(points, answers)
    likely = np.log(density + STRAY).sum(axis=2)
    best = np.arange(len(at)), likely.argmax(axis=1)
    return points[best] + middle[:, 0], weight[best], share[best]


def _weighed(points: NDArray[np.float64], answers: _Answers) -> tuple[NDArray[np.float64], ...]:
    """Return the weights, the shares and the densities (n, s, k) of the answers at points (n, s, 2).

    A share is the probability that an answer is not a stray one. The weight is the share, reduced with the
    answer's distance from the point.
    """
    dx, dy = points[..., :1] - answers.x[:, None], points[..., 1:] - answers.y[:, None]
    squared = (answers.xx[:, None] * dx + 2 * answers.xy[:, None] * dy) * dx + answers.yy[:, None] * dy * dy
    near = 1 / (1 + squared / FREEDOM)
    density = answers.height[:, None] * near ** ((FREEDOM + 2) / 2)
    share = density / (density + STRAY)
    return share * near, share, density


def _limit(share: float) -> float:
    """Return the squared distance that contains this share of a t-distribution in the plane."""
    return FREEDOM * float((1 - share) ** (-2 / FREEDOM) - 1)


def check_compares(known: VisualMap) -> None:
    """Check that a map and its network can estimate where queries were taken relative to its frames.

    Raises:
        ConfigError: the network does not compare, or the map lacks the parts that it compares.
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


def _turns(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices (..., 2, 2) that turn a robot's axes into those of the building."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)


def path_positions(frames: FrameTable) -> NDArray[np.float64]:
    """Return how far along the path of its sequence each frame lies (m,), 0 for the first of each sequence.

    Raises:
        DataError: a frame without a position.
    """
    if not frames.has_position.all():
        raise DataError(
            f"{int((~frames.has_position).sum())} of {len(frames)} map frames have no position: there is no path "
            "along which to interpolate"
        )
    along = np.zeros(len(frames))
    for rows in frames.rows_by("sequence").values():
        along[rows[1:]] = np.cumsum(np.hypot(np.diff(frames.x[rows]), np.diff(frames.y[rows])))
    return along


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
    near, apart = rows[:, :k], found.distances[:, :k]
    along, best = path_positions(frames), near[:, :1]
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
    weight, angle = np.where(known, weight, 0.0), np.where(known, angle, 0.0)
    # Relative to the first known heading, so that a single one is reproduced to the last bit.
    first = np.take_along_axis(angle, known.argmax(axis=1)[:, None], axis=1)
    turned = angle - first
    mean = np.arctan2((weight * np.sin(turned)).sum(axis=1), (weight * np.cos(turned)).sum(axis=1))
    return np.where(known.any(axis=1), _wrapped(first[:, 0] + mean), np.nan)


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles in (-pi, pi]; those already in this range are unchanged."""
    inside = (angle > -np.pi) & (angle <= np.pi)
    return np.where(inside, angle, wrapped(angle))
