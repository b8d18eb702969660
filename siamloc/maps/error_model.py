"""Expected error of an estimate: learned on a validation sequence, predicted from the retrieval only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Count, Natural, NotNegative, Positive
from siamloc.errors import ConfigError, DataError
from siamloc.maps.joining import RefinedPoses
from siamloc.maps.learned import Learned
from siamloc.maps.search import Retrieval

_GROUP = 25  # validation queries behind each value of the model, at least
_FEWEST = 10
# Chosen on drives through two buildings; benchmarks/foreign.py measures them on others.
_KEPT = 0.99  # share of the correct answers that are not foreign
STRANGE = 0.78  # `Retrieval.strangeness` of images that show nothing of the map, at least
_BETWEEN = 0.55  # position of the threshold between the strangest of these, 0, and the median of elsewhere, 1
_AGREEMENT, _UNTOLD = 0.02, 1e6  # smallest agreement used, and the deviation of a pose about which nothing is known


def ratio_score(found: Retrieval, map_xy: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return the distance to the best match over the distance to the best match elsewhere (n,), in [0, 1].

    A match is elsewhere if it lies beyond the radius from the best match. Near 1, another place looks just as much like
    the query. If all neighbours lie within the radius, the largest descriptor distance among them replaces the missing
    one: the score is then too high rather than too low.
    """
    apart = np.hypot(*(map_xy[found.indices] - map_xy[found.indices[:, :1]]).transpose(2, 0, 1))
    known = np.isfinite(found.distances)
    other = np.where((apart > radius) & known, found.distances, np.inf).min(axis=1)
    last = np.where(known, found.distances, -np.inf).max(axis=1)
    other = np.where(np.isinf(other), last, other)
    return np.divide(found.distances[:, 0], other, out=np.ones(len(other)), where=other > 0)


def pose_score(poses: RefinedPoses) -> NDArray[np.float64]:
    """Return the logarithm of the uncertainty of refined poses (n,): the standard deviation over the agreement.

    How exact the map is does not count: errors are learned, and expected, in the map.

    If nothing could be compared, the score is larger than any other. Because of the logarithm, a few such poses do not
    dominate the mean of a group.
    """
    in_map = replace(poses, map_variance=None).covariance()
    spread = np.sqrt(np.trace(in_map, axis1=1, axis2=2)) / np.maximum(poses.agreement, _AGREEMENT)
    return np.log(np.where(np.isnan(spread), _UNTOLD, np.clip(spread, 1 / _UNTOLD, _UNTOLD)))


@dataclass(frozen=True)
class ErrorModel(Learned):
    """The expected error as an increasing function of a score of the retrieval or the pose, as plain numbers.

    The ratio score has no unit, so a model learned under one lighting also holds under another, where all distances are
    larger. Isotonic regression assumes only that the function does not decrease.

    Attributes:
        score: "ratio", see `ratio_score`, or "pose", which uses only the refined pose, see `pose_score`.
        radius: distance beyond which a match is another place, in units of x and y.
        neighbours: number of matches of each query that the score uses.
        knots: scores, increasing.
        errors: the expected error at each knot, non-decreasing; linear between knots and constant beyond. But beyond
            the last of several knots of "pose", the mean of the least certain 25 or more of the validation, it grows as
            the deviation does, up to 50 times.
        queries: number of queries it was learned from.
        lost_above: the expected error above which the robot counts as lost; None if no threshold was chosen.
        foreign_above: the strangeness above which a query shows nothing that is on the map, so that the robot is lost
            whatever the expected error, see `with_foreign`; None if it was not learned.
        foreign_weight: weight of the best match's distance in the strangeness, beside the score; None where images are
            compared, which tells the strangeness (`Retrieval.strangeness`).
        map_digest: digest of the map it was learned on; "" if unknown.
        refine: the poses whose errors are predicted: "none" for those of the nearest map frames, or a method of
            `siamloc.maps.Refinement`.
    """

    FORMAT = "siamloc-error-model"
    VERSION = 8
    NOUN = "error model"

    score: Literal["ratio", "pose"]
    radius: NotNegative
    neighbours: Count
    knots: tuple[float, ...]
    errors: tuple[float, ...]
    queries: Natural
    lost_above: Positive | None = None
    map_digest: str = ""
    refine: Literal["none", "interpolate", "relative"] = "none"
    foreign_above: float | None = None
    foreign_weight: NotNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        knots, errors = np.asarray(self.knots, dtype=float), np.asarray(self.errors, dtype=float)
        fits = knots.shape == errors.shape and len(knots) > 0
        if not fits or not (np.diff(knots) > 0).all() or not (np.diff(errors) >= 0).all() or not errors[0] >= 0:
            raise DataError("an error model needs increasing scores with errors >= 0 that do not decrease")

    @classmethod
    @typed
    def fit(
        cls, found: Retrieval, map_xy: ArrayLike, errors: ArrayLike, radius: NotNegative = 1.0, neighbours: Count = 20
    ) -> ErrorModel:
        """Learn from a validation sequence.

        The errors of at least 25 queries with similar scores are averaged before the regression: a single query
        means little, the most extreme one least of all.

        Args:
            found: search results of n validation queries.
            map_xy: (m, 2) positions of the map's frames.
            errors: (n,) errors of the estimates for these queries, not negative; the model predicts errors of such
                estimates.
            radius: distance beyond which a match is another place.
            neighbours: number of matches that the score uses; fewer if the map, or the search result, has fewer.

        Raises:
            ConfigError: a parameter out of range.
            DataError: fewer than 10 queries, or arrays that do not fit each other.
        """
        neighbours = min(neighbours, found.indices.shape[1])
        blank = cls("ratio", float(radius), neighbours, (0.0,), (0.0,), len(found))
        return blank._learned(blank.scores(found, map_xy), errors)

    @classmethod
    def fit_poses(cls, poses: RefinedPoses, errors: ArrayLike) -> ErrorModel:
        """Learn from the refined poses of a validation sequence, as `fit` does.

        Args:
            poses: poses of n validation queries.
            errors: (n,) errors of the poses' positions, not negative.

        Raises:
            DataError: fewer than 10 queries, or not one error for each.
        """
        blank = cls("pose", 0.0, 1, (0.0,), (0.0,), len(poses), refine="relative")
        return blank._learned(pose_score(poses), errors)

    def _learned(self, scores: NDArray[np.float64], errors: ArrayLike) -> ErrorModel:
        count, values = len(scores), np.asarray(errors, dtype=np.float64)
        if values.shape != (count,) or not (values >= 0).all() or not np.isfinite(values).all():
            raise DataError(f"{count} validation queries need as many errors, finite and >= 0, got {values.shape}")
        if count < _FEWEST:
            raise DataError(
                f"an error model needs at least {_FEWEST} validation queries, got {count}: "
                "give protocol.validation more frames"
            )
        order = np.argsort(scores, kind="stable")
        groups = np.array_split(order, max(1, len(order) // _GROUP))
        knots, inverse = np.unique([scores[rows].mean() for rows in groups], return_inverse=True)
        size = np.bincount(inverse, [len(rows) for rows in groups])
        mean = np.bincount(inverse, [values[rows].sum() for rows in groups]) / size
        from sklearn.isotonic import IsotonicRegression

        fitted = IsotonicRegression().fit_transform(knots, mean, sample_weight=size)
        return replace(self, knots=tuple(knots), errors=tuple(np.maximum.accumulate(fitted)), queries=count)

    @property
    def of_poses(self) -> bool:
        """Whether the model was learned from refined poses and predicts their errors."""
        return self.score == "pose"

    def scores(self, found: Retrieval, map_xy: ArrayLike, poses: RefinedPoses | None = None) -> NDArray[np.float64]:
        """Return the score of each query (n,). Arguments and errors as for `judged`."""
        if self.of_poses:
            if poses is None:
                raise ConfigError("the error model was learned from refined poses: give it those")
            return pose_score(poses)
        xy = np.asarray(map_xy, dtype=np.float64)
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise DataError(f"the error of an estimate needs map positions (m, 2), all known, got shape {xy.shape}")
        k = min(self.neighbours, len(xy))
        if found.indices.ndim != 2 or found.indices.shape[1] < k:
            raise DataError(f"the error of an estimate needs {k} neighbours a query, got shape {found.indices.shape}")
        return ratio_score(Retrieval(found.indices[:, :k], found.distances[:, :k]), xy, self.radius)

    def predict(self, found: Retrieval, map_xy: ArrayLike, poses: RefinedPoses | None = None) -> NDArray[np.float64]:
        """Return the expected error of each query (n,), in units of x and y. Arguments and errors as for `judged`."""
        scores = self.scores(found, map_xy, poses)
        expected = np.interp(scores, self.knots, self.errors)
        # Scores of poses are logarithms of deviations. A single knot says nothing of the tail.
        if self.of_poses and len(self.knots) > 1:
            expected *= np.exp(np.clip(scores - self.knots[-1], 0, -np.log(_AGREEMENT)))
        return expected

    def judged(
        self, found: Retrieval, map_xy: ArrayLike, poses: RefinedPoses | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_] | None]:
        """Return the expected error of each query (n,), and which queries are lost (None if no threshold was chosen).

        A query is lost if its expected error is above `lost_above`, or if it shows nothing that is on the map, see
        `with_foreign`.

        Args:
            found: search results of n queries, with at least `neighbours` matches each, or the whole map.
            map_xy: (m, 2) positions of the map's frames.
            poses: the refined poses of the queries, for a model that was learned from refined poses.

        Raises:
            ConfigError: a model of refined poses was given none.
            DataError: too few neighbours, or a map frame without a position.
        """
        expected = self.predict(found, map_xy, poses)
        if self.lost_above is None:
            return expected, None
        return expected, (expected > self.lost_above) | self.foreign(found, map_xy)

    def foreign(self, found: Retrieval, map_xy: ArrayLike) -> NDArray[np.bool_]:
        """Return which queries (n,) show nothing that is on the map; none if no threshold was learned.

        Arguments and errors as for `judged`.
        """
        if self.foreign_above is None:
            return np.zeros(len(found), dtype=bool)
        return np.logical_not(self._strangeness(found, map_xy) <= self.foreign_above)  # NaN counts as foreign

    def with_foreign(self, right: Retrieval, map_xy: ArrayLike, elsewhere: Retrieval | None = None) -> ErrorModel:
        """Return a model that also recognizes images from another building, or from another camera, as foreign.

        No such images are needed. If the queries were compared with the map frames by `siamloc.maps.match`, that tells
        how little of the map each shows (`Retrieval.strangeness`), and from 0.78 on it is nothing. For other queries,
        places outside the map are imitated by removing the map's own places from it: strangeness is the model's score
        plus the best match's distance, in units of its usual value elsewhere, and the threshold lies about halfway
        between the strangeness of correct answers and of answers elsewhere. Either threshold lies above all correct
        answers except the strangest 1 %.

        Args:
            right: search results of validation queries that were located well.
            map_xy: (m, 2) positions of the map's frames.
            elsewhere: search results of validation queries among the map frames far from where they were taken; not
                needed for queries that were compared.

        Raises:
            ConfigError: as for `judged`.
            DataError: fewer than 10 queries located well; where they were not compared, a model of refined poses, or
                fewer than 10 queries elsewhere.
        """
        compared, others = right.strangeness is not None, 0 if elsewhere is None else len(elsewhere)
        if self.of_poses and not compared:
            raise DataError("foreign queries are learned from refined poses only if the map's distance is euclidean")
        if len(right) < _FEWEST or not (compared or others >= _FEWEST):
            raise DataError(
                f"foreign queries are learned from at least {_FEWEST} validation queries that are located well, and, "
                f"unless images are compared, from as many with map frames far from them, got {len(right)} and {others}"
            )
        if compared or elsewhere is None:
            model = replace(self, foreign_weight=None)
            return replace(model, foreign_above=max(STRANGE, model._strangest(right, map_xy)))
        model = replace(self, foreign_weight=1 / (float(np.median(elsewhere.distances[:, 0])) or 1.0))
        strangest = model._strangest(right, map_xy)
        usual = float(np.median(model._strangeness(elsewhere, map_xy)))
        return replace(model, foreign_above=strangest + _BETWEEN * max(0.0, usual - strangest))

    def _strangest(self, right: Retrieval, map_xy: ArrayLike) -> float:
        """Return the strangeness that only the strangest of the correct answers exceed."""
        return float(np.quantile(self._strangeness(right, map_xy), _KEPT, method="lower"))

    def _strangeness(self, found: Retrieval, map_xy: ArrayLike) -> NDArray[np.float64]:
        """Return how little of the map each query shows (n,)."""
        if self.foreign_weight is not None:
            return self.scores(found, map_xy) + self.foreign_weight * found.distances[:, 0]
        if found.strangeness is None:
            raise ConfigError("the error model was learned from compared images: search with siamloc.maps.match")
        return found.strangeness
