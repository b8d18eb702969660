"""The most likely pose of a query, from the answers of the map frames that it was compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.columns import Rows
from foundation.settings import Positive, Probability
from siamloc.errors import DataError
from siamloc.maps.comparing import Compared
from siamloc.maps.visual_map import VisualMap

FREEDOM = 4.0  # degrees of freedom of the t-distribution described by the information
STRAY = 1.0  # density of answers that are wrong, per square unit of the positions
_CORRELATION = 0.5  # of the errors of two answers for a query, which share its image and its surroundings
_LEAST = 0.01  # scale of x and y in the t-distribution that no number of answers falls below, in m
_ROUNDS = 6
_STILL = 1e-4  # units: a search that moves by less has converged
_NOTHING = 1e-12  # determinants of information below this count as zero


@dataclass(frozen=True, eq=False)
class RefinedPoses(Rows):
    """Poses of n queries, finer than the map's spacing.

    Attributes:
        xy: (n, 2), in the unit of the positions; the map frame's own position if nothing could be compared.
        theta: (n,) in rad, in (-pi, pi]; NaN if nothing could be compared.
        information: (n, 2, 2) inverse of the scale matrix of x and y in a t-distribution with 4 degrees of freedom;
            zeros if nothing could be compared. It says how certain the pose is in the map, not how exact the map is.
        agreement: (n,) share of the answers that agree on the pose, from 0 to 1.
        frame: (n,) the map frame whose answer has the largest weight.
        match: (n,) logarithm of the odds that a map frame was taken near the query, the largest of all compared frames;
            minus infinity if nothing could be compared.
        map_variance: (n,) variance of x, and of y, of the compared map frames, in squared units of the positions: how
            exact a surveyed map is there, which is the same for all queries of a place; 0 where it is not known. None
            for 0 everywhere.

    Poses from `interpolate_poses` have no information, their agreement is the share of map frames used, and their match
    is NaN.
    """

    xy: NDArray[np.float64]
    theta: NDArray[np.float64]
    information: NDArray[np.float64]
    agreement: NDArray[np.float64]
    frame: NDArray[np.int64]
    match: NDArray[np.float64]
    map_variance: NDArray[np.float64] | None = None

    def squared(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return squared distances (n,) from positions (n, 2) in the map, weighted by the information; NaN if zero."""
        return self._weighed(xy, self.information)

    @typed
    def inside(self, xy: ArrayLike, share: Probability = 0.9) -> NDArray[np.float64]:
        """Return which true positions (n, 2) lie in the ellipse with the probability `share` (n,): 1, 0 or NaN.

        The ellipses contain the variance of the map. Positions from the same survey as the map share its errors, so
        that more of them lie inside.

        Args:
            xy: (n, 2).
            share: between 0 and 1; the ellipse with the probability 1 would be the whole plane.
        """
        scale = self.covariance() * (FREEDOM - 2) / FREEDOM
        squared = self._weighed(xy, np.linalg.inv(scale).astype(np.float64))
        return np.where(np.isnan(squared), np.nan, squared <= _limit(share))

    @typed
    def widening(self, xy: ArrayLike, share: Probability = 0.9) -> float:
        """Learn how much wider the information's ellipses must be, from positions of a drive used for nothing else.

        Args:
            xy: (n, 2) positions in the map: true ones, or for a surveyed map those of the same survey.
            share: between 0 and 1, as for `inside`.

        Returns:
            The factor on squared distances, for `widened`, with which `share` of the positions lie in the ellipses
            without the variance of the map.

        Raises:
            DataError: fewer than 10 positions.
        """
        squared = self.squared(xy)
        squared = squared[np.isfinite(squared)]
        if len(squared) < 10:
            raise DataError(f"the ellipses are learned from 10 refined validation frames or more, got {len(squared)}")
        return float(np.quantile(squared, share) / _limit(share))

    @typed
    def widened(self, factor: Positive) -> RefinedPoses:
        """Return the poses with ellipses enlarged by a factor on squared distances; the map's variance stays."""
        return replace(self, information=self.information / factor)

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariances of x and y (n, 2, 2), in squared units of the positions; NaN without information.

        They are the sums of what the information and the variance of the map say.
        """
        told = np.asarray(self.information.any(axis=(1, 2)))[:, None, None]
        held = np.where(told, self.information, np.eye(2))
        of_map = 0.0 if self.map_variance is None else self.map_variance[:, None, None] * np.eye(2)
        return np.where(told, np.linalg.inv(held) * FREEDOM / (FREEDOM - 2) + of_map, np.nan)

    def _weighed(self, xy: ArrayLike, information: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return squared distances (n,) from positions (n, 2), weighted by information (n, 2, 2); NaN if unknown."""
        apart = np.asarray(xy, dtype=np.float64) - self.xy
        told = self.information.any(axis=(1, 2))
        return np.where(told, np.einsum("ni,nij,nj->n", apart, information, apart), np.nan)


def joined(known: VisualMap, compared: Compared) -> RefinedPoses:
    """Join the answers of k map frames for each of n queries to the most likely poses; see `refine`."""
    rows, pose, information, match = compared
    n = len(rows)
    theta, xy = known.frames.theta[rows], known.frames.xy[rows]
    building = known.frames.building[rows]
    usable = np.asarray(np.isfinite(theta) & np.isfinite(xy).all(axis=2) & (building == building[:, :1]))
    theta, xy = np.where(usable, theta, 0.0), np.where(usable[..., None], xy, 0.0)
    axes = turns(theta)
    spread = np.linalg.inv(information)
    about = np.linalg.inv(axes @ spread[..., :2, :2] @ axes.swapaxes(-1, -2))
    odds = np.where(usable, match, -np.inf)
    probability = np.exp(-np.logaddexp(0, -odds))
    at = xy + known.mounting.offset(theta) + (axes @ pose[..., :2, None])[..., 0]
    at = np.where(usable[..., None], at, at[np.arange(n), usable.argmax(axis=1)][:, None])  # no start of its own
    most_likely, weight, share = _most_likely(at, about, probability)
    turned = theta + pose[..., 2]
    weight_of_turn = weight / spread[..., 2, 2]
    heading = np.arctan2((weight_of_turn * np.sin(turned)).sum(axis=1), (weight_of_turn * np.cos(turned)).sum(axis=1))
    nothing = np.logical_not(usable.any(axis=1) & weight.any(axis=1))
    robot = most_likely - known.mounting.offset(heading)
    variance = np.nan_to_num(known.frames.deviation[rows]) ** 2
    return RefinedPoses(
        np.where(nothing[:, None], known.frames.xy[rows[:, 0]], robot),
        np.where(nothing, np.nan, heading),
        _together((weight[..., None, None] * about).sum(axis=1), share),
        share.mean(axis=1),
        rows[np.arange(n), share.argmax(axis=1)],
        odds.max(axis=1),
        (share * variance).sum(axis=1) / np.maximum(share.sum(axis=1), _NOTHING),
    )


def _most_likely(
    at: NDArray[np.float64], about: NDArray[np.float64], probability: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the most likely points (n, 2) given k answers (n, k, 2), and the answers' weights and shares (n, k).

    The search starts from each answer and reweights iteratively: each round takes the mean of the answers, weighted by
    their information and by how likely each is, at the point of the round before, not to be a stray one. The best of
    the points found is returned.

    Args:
        at: where each answer says that the query was taken.
        about: information (n, k, 2, 2) of the answers.
        probability: that each answer is not a stray one (n, k).
    """
    middle = at[:, :1]
    at = at - middle
    height = probability * np.sqrt(np.linalg.det(about)) / (2 * np.pi)

    def weighed(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return the weights, the shares and the densities (n, s, k) of the answers at points (n, s, 2).

        A share is the probability that an answer is not a stray one. The weight is the share, reduced with the
        answer's distance from the point.
        """
        away = points[:, :, None] - at[:, None]
        near = 1 / (1 + np.einsum("nski,nkij,nskj->nsk", away, about, away) / FREEDOM)
        density = height[:, None] * near ** ((FREEDOM + 2) / 2)
        share = density / (density + STRAY)
        return share * near, share, density

    pulls = (about @ at[..., None])[..., 0]
    points = at  # (n, k, 2): current point of the search from each answer
    arrived = np.zeros((*probability.shape, 1), dtype=bool)
    for _ in range(_ROUNDS):
        weight, _, _ = weighed(points)
        total = np.einsum("nsk,nkij->nsij", weight, about)
        known = (np.linalg.det(total) > _NOTHING)[..., None]
        total = np.where(known[..., None], total, np.eye(2))
        moved = np.where(known, np.linalg.solve(total, (weight @ pulls)[..., None])[..., 0], points)
        moving = np.abs(moved - points).max(axis=2, keepdims=True) >= _STILL
        points = np.where(arrived, points, moved)  # so that a query alone has the same result as in a batch
        arrived |= ~moving
        if arrived.all():
            break
    weight, share, density = weighed(points)
    likely = np.log(density + STRAY).sum(axis=2)
    best = np.arange(len(at)), likely.argmax(axis=1)
    return points[best] + middle[:, 0], weight[best], share[best]


def _together(information: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the information of poses (n, 2, 2) whose answers have correlated errors.

    Args:
        information: sum of that of the answers (n, 2, 2).
        share: of the answers (n, k), see `_most_likely`.
    """
    told = (np.linalg.det(information) > _NOTHING)[:, None, None]
    answers = np.maximum(share.sum(axis=1), 1)
    spread = np.linalg.inv(np.where(told, information, np.eye(2))) * (1 + _CORRELATION * (answers - 1))[:, None, None]
    return np.where(told, np.linalg.inv(spread + _LEAST**2 * np.eye(2)), 0.0)


def _limit(share: float) -> float:
    """Return the squared distance that contains this share of a t-distribution in the plane."""
    return FREEDOM * float((1 - share) ** (-2 / FREEDOM) - 1)


def turns(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices (..., 2, 2) that turn the axes of robots with these headings into those of the building."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)
