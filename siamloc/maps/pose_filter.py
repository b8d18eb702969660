"""A filter over refined poses: a robot moves as its odometry says, or as before; a single outlier does not count.

`SequenceFilter` tracks the frames of a map; this filter tracks positions between them. If the robot's motion is known,
as from its wheels, it has moved by that (an extended Kalman filter in x, y and heading); otherwise, it keeps its
velocity up to a random acceleration (a Kalman filter in x and y). Each pose from `siamloc.maps.refine` is weighted by
its information and by the probability that it is not a stray one. Several hypotheses, called stories, are kept at once
[Reid 1979]: every pose starts a new one, which is dropped if it stays near a better one, and takes over if it explains
the following poses better. Later than the first recognized pose, a new story needs a robot that is carried away.

Motions may be wrong, such as those of a stuck encoder: a robot whose motions are known is also tracked without them, by
other stories, which answer once they explain the poses far better, until the motions explain them as well. Poses of one
place have their errors in common: with known motions, a pose counts by the share of a usual step, or of a radian, that
the robot moved since the last one.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Positive, Probability
from siamloc.data.moves import wrapped
from siamloc.errors import DataError
from siamloc.maps.joining import FREEDOM, RefinedPoses, turns
from siamloc.maps.motion import MotionCheck, motion_or_none, motions_of

_STORIES = 5
_STRAY = 0.15  # density of poses that are wrong, per square unit of the positions
_TRUSTED = 0.05  # probability below which a pose is considered stray
_RECOGNIZED = 0.5  # agreement from which a pose says where the robot is
_NEVER = 1e-9  # probability of what no answer agrees on
_NEAR = 0.05  # share of a step: stories this close to each other are merged
_ACCELERATION = 0.5  # standard deviation of the change of the step between two queries, as a share of the usual step
_MOVES = np.block([[np.eye(2), np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
_NOISE = np.kron(np.array([[0.25, 0.5], [0.5, 1.0]]), np.eye(2))
_HEADING = math.radians(3)  # standard deviation of the heading of a pose
_NO_HEADING = math.pi**2 / 3  # variance of a heading that may be any
_SURE = 1.0  # rad^2: a heading with a larger variance is unknown
_WHEELS = 0.1  # standard deviation of a known motion, as a share of the distance, and of the turn
_SWERVE = math.radians(1)  # standard deviation of the turn of a known motion over the usual step
_JUDGED = 6  # recognized poses by which motions are judged
_STANDING = 0.01  # standard deviation of a motion of zero, as a share of the usual step
# Divisors of the t-distributions of 2 and 3 values: the position, with or without the heading.
_HEIGHT = {2: 2 * math.pi, 3: math.gamma(FREEDOM / 2) * (FREEDOM * math.pi) ** 1.5 / math.gamma((FREEDOM + 3) / 2)}
_ANYWHERE = {2: _STRAY, 3: _STRAY / (2 * math.pi)}


@dataclass(frozen=True)
class _Story:
    """What the robot may be doing, and how well that explains the poses.

    Its mean and covariance are those of position and step (4,), or after a known motion of position and heading (3,).
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    evidence: float
    share: float  # probability that the last pose is not a stray one
    trusted: RefinedPoses  # the last pose not considered stray, or that the position was mostly taken from

    @property
    def theta(self) -> NDArray[np.float64]:
        """Heading in rad (1,), NaN if unknown."""
        if len(self.mean) == 4:
            return self.trusted.theta
        return wrapped(self.mean[2:]) if self.covariance[2, 2] < _SURE else np.full(1, np.nan)


@dataclass(frozen=True)
class _Stories:
    """Stories, best first, and the evidence that the robot is anywhere: that all poses so far were stray ones."""

    best: tuple[_Story, ...] = ()
    anywhere: float = 0.0


class PoseFilter:
    """Track a robot from the refined poses of its queries.

    Args:
        step: distance the robot moves between two queries, in units of x and y, such as that of a `MotionModel`.
        kidnapping: probability that the robot is carried somewhere else between two queries.

    Raises:
        ConfigError: a step or a probability out of range.

    Example:
        >>> information, sure = 100 * np.eye(2)[None], np.ones(1)
        >>> one = RefinedPoses(np.zeros((1, 2)), np.zeros(1), information, sure, np.zeros(1, int), 9 * sure)
        >>> robot = PoseFilter(step=0.2)
        >>> for x in (0.0, 0.2, 0.4, 9.0, 0.8):
        ...     found = robot.step(replace(one, xy=np.array([[x, 0.0]])))
        ...     print(found.xy.round(1).tolist())
        [[0.0, 0.0]]
        [[0.2, 0.0]]
        [[0.4, 0.0]]
        [[0.6, 0.0]]
        [[0.8, 0.0]]
    """

    @typed
    def __init__(self, step: Positive, kidnapping: Probability = 1e-3) -> None:
        self.length, self.kidnapping = float(step), float(kidnapping)
        self._check = MotionCheck(self.length)
        self.reset()

    def reset(self) -> None:
        """Forget all queries: the robot may be anywhere."""
        self._stories = _Stories()  # that follow the motions, where these are known
        self._alone = _Stories()  # that do without, from the first known motion
        self._explained: deque[tuple[float, float]] = deque(maxlen=_JUDGED)  # share of both in the last poses
        self._contradicted = False
        self._moved_on = math.inf  # steps and rad since the last recognized pose
        self._check.reset()

    def step(
        self, pose: RefinedPoses, motion: ArrayLike | None = None, covariance: ArrayLike | None = None
    ) -> RefinedPoses:
        """Update the filter with the pose of one query and return the filtered pose.

        A pose that is NaN or has no information (see `RefinedPoses`) only lets the robot move on. The map frame and the
        variance of the map, which no number of poses lessens, are those of the last pose that is not considered stray,
        or that the position was mostly taken from; so is the heading, unless the motion is known. Motions are not used
        once most of the last recognized poses agree with each other, but not with the motions, until they do.

        Args:
            pose: the pose of the query.
            motion: how the robot moved since the last query, seen from itself at the last query (3,): distances ahead
                and to the left in units of x and y, and turn to the left in rad. If None or NaN, the robot is assumed
                to keep moving as before.
            covariance: covariance of the motion (3, 3); if None, distances and turns are off by 10 %, and turns by
                another degree over the usual step.

        Raises:
            DataError: not exactly one pose, or a motion or a covariance of another form.
            WrongUnitError: motions in another unit than the poses, or that turn the other way, as soon as enough poses
                show it.
        """
        if len(pose) != 1:
            raise DataError(f"a step takes the pose of one query, got {len(pose)}")
        about, move = pose.information[0], motion_or_none(motion)
        told = bool(about.any() and np.isfinite(about).all() and np.isfinite(pose.xy).all())
        recognized = bool(told and pose.agreement[0] >= _RECOGNIZED)
        self._check.step(move, pose.xy[0] if recognized else None, float(pose.theta[0]))
        self._moved_on += math.inf if move is None else math.hypot(*move[:2]) / self.length + abs(move[2]) + _STANDING
        noise = None if move is None else self._noise(move) if covariance is None else _checked(covariance)
        if move is not None or self._alone.best:
            self._alone = self._followed(self._alone, pose if told else None)
        self._stories = self._followed(self._stories, pose if told else None, move, noise, min(self._moved_on, 1.0))
        if told:  # the next pose tells little more if the robot stays here
            self._moved_on = 0.0 if recognized else (1 - float(pose.agreement[0])) * min(self._moved_on, 1.0)
        if not self._stories.best:
            return pose
        if recognized and move is not None:
            self._explained.append((self._stories.best[0].share, self._alone.best[0].share))
            self._contradicted = self._contradicts()
        story = (self._alone if self._contradicted else self._stories).best[0]
        return replace(
            pose,
            xy=story.mean[None, :2],
            information=np.linalg.inv(story.covariance[:2, :2])[None].astype(np.float64),
            theta=story.theta,
            agreement=pose.agreement * story.share,
            frame=story.trusted.frame,
            map_variance=story.trusted.map_variance,
        )

    def run(self, poses: RefinedPoses, sequence: ArrayLike, motion: ArrayLike | None = None) -> RefinedPoses:
        """Track robots through whole sequences, with a reset before each.

        Args:
            poses: poses of n queries, in capture order within each sequence.
            sequence: (n,) name of each query's sequence.
            motion: how the robot moved to each query from the one before (n, 3), as for `step` and as
                `siamloc.maps.motions` returns it; NaN where unknown, as for all if None.

        Raises:
            DataError: not one name and one motion for each pose.
        """
        names = np.asarray(sequence)
        if names.shape != (len(poses),):
            raise DataError(f"{len(poses)} poses need as many names of sequences, got shape {names.shape}")
        moved = motions_of(motion, len(poses))
        found: list[RefinedPoses] = [poses.take(np.array([row])) for row in range(len(poses))]
        for name in dict.fromkeys(names.tolist()):
            self.reset()
            for row in np.flatnonzero(names == name).tolist():
                found[row] = self.step(found[row], moved[row])
        self.reset()
        return RefinedPoses.concatenate(found) if found else poses

    def _followed(
        self,
        before: _Stories,
        pose: RefinedPoses | None,
        move: NDArray[np.float64] | None = None,
        noise: NDArray[np.float64] | None = None,
        new: float = 1.0,
    ) -> _Stories:
        """Return the stories after a motion with a covariance, and a pose; None where unknown.

        `new` is the weight of the pose, 0 to 1: how far the robot moved since the last recognized pose, in usual steps.
        """
        if move is None or noise is None:
            stories = [self._moved(story) for story in before.best]
        else:
            stories = [_driven(_with_heading(story), move, noise) for story in before.best]
            self._last = move
        if pose is None:
            return self._kept(stories, None, before.anywhere) if stories else before
        spread, seen = np.linalg.inv(pose.information[0]), pose.xy[0]
        begun = _Story(np.concatenate([seen, np.zeros(2)]), _blocks(spread, self.length**2 * np.eye(2)), 0, 1, pose)
        if move is not None:
            begun = _with_heading(begun)
            if np.isfinite(pose.theta[0]):
                spread, seen = begun.covariance, begun.mean
        agreement, stray = float(pose.agreement[0]), math.log(_ANYWHERE[len(seen)])
        carried = max((story.evidence + math.log(self.kidnapping) for story in stories), default=-math.inf)
        fresh = max(carried, before.anywhere) + math.log(max(agreement, _NEVER)) + stray
        begun = replace(begun, evidence=fresh)
        stories = [*(_told(story, pose, seen, spread, new) for story in stories), begun]
        recognized = agreement >= _RECOGNIZED
        anywhere = before.anywhere + stray + (math.log(max(1 - agreement, _NEVER)) if recognized else 0.0)
        return self._kept(stories, begun if recognized else None, anywhere)

    def _contradicts(self) -> bool:
        """Return whether the last recognized poses contradict the motions.

        They do once most of them agree with each other but not with the motions, until the motions explain them as
        well: wrong wheels come near the truth again and again, while poses pull the robot along.
        """
        if len(self._explained) < _JUDGED:
            return False
        driven, alone = np.mean(self._explained, axis=0)
        return bool(driven < alone if self._contradicted else driven < alone / 2 and alone > 0.5)

    def _moved(self, story: _Story) -> _Story:
        if len(story.mean) == 3:
            step = turns(story.mean[2]) @ self._last[:2]
            unsure = (_ACCELERATION * self.length) ** 2 * np.eye(2)
            story = replace(
                story,
                mean=np.concatenate([story.mean[:2], step]),
                covariance=_blocks(story.covariance[:2, :2], unsure),
                trusted=replace(story.trusted, theta=story.theta),
            )
        noise = (_ACCELERATION * self.length) ** 2 * _NOISE
        return replace(
            story, mean=_MOVES @ story.mean, covariance=_MOVES @ story.covariance @ _MOVES.T + noise, share=0.0
        )

    def _noise(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the usual covariance (3, 3) of a known motion."""
        steps = math.hypot(*motion[:2]) / self.length
        place = (_WHEELS**2 * steps**2 + _STANDING**2) * self.length**2
        turn = (_WHEELS * motion[2]) ** 2 + _SWERVE**2 * (steps + _STANDING)
        return np.diag([place, place, turn])

    def _kept(self, stories: list[_Story], begun: _Story | None, anywhere: float) -> _Stories:
        """Return the stories that explain the poses best, best first, each place once, the best with evidence 0.

        A story that has just begun at a recognized pose is among them: a later pose must be able to confirm it, even if
        old stories that no pose confirms are as likely.
        """
        kept: list[_Story] = []
        for story in sorted(stories, key=lambda one: -one.evidence):
            near = _NEAR * self.length
            if all(np.hypot(*(story.mean[:2] - other.mean[:2])) > near for other in kept):
                kept.append(story)
        best, last = kept[0].evidence, kept[_STORIES - 1 :]
        kept[_STORIES - 1 :] = [story for story in last if story is begun] or last[:1]
        return _Stories(tuple(replace(story, evidence=story.evidence - best) for story in kept), anywhere - best)


def _told(
    story: _Story, pose: RefinedPoses, seen: NDArray[np.float64], spread: NDArray[np.float64], new: float
) -> _Story:
    """Return a story updated with a pose, which counts the less, the more probable it is that the pose is stray.

    Args:
        story: the story; the first values of its mean are those that the pose shows.
        pose: the pose.
        seen: position (2,), or position and heading (3,), of the pose.
        spread: covariance of `seen`.
        new: weight of the pose, 0 to 1: how far the robot moved since the last recognized pose, in usual steps.
    """
    n, agreement = len(seen), float(pose.agreement[0])
    apart, total = seen - story.mean[:n], story.covariance[:n, :n] + spread
    apart[2:] = wrapped(apart[2:])
    squared = float(apart @ np.linalg.solve(total, apart))
    height = (1 + squared / FREEDOM) ** (-(FREEDOM + n) / 2) / (_HEIGHT[n] * math.sqrt(np.linalg.det(total)))
    share = agreement * height / (agreement * height + _ANYWHERE[n])
    weight = max(new * share * (FREEDOM + n) / (FREEDOM + squared), 1e-9)
    gain = story.covariance[:, :n] @ np.linalg.inv(story.covariance[:n, :n] + spread / weight)
    covariance = story.covariance - gain @ story.covariance[:n]
    evidence = story.evidence + math.log(agreement * height + _ANYWHERE[n])
    taken = share > _TRUSTED or np.trace(gain[:2]) > 1  # the position is more the pose's than the story's
    trusted = pose if taken else story.trusted
    return _Story(story.mean + gain @ apart, (covariance + covariance.T) / 2, evidence, share, trusted)


def _driven(story: _Story, motion: NDArray[np.float64], noise: NDArray[np.float64]) -> _Story:
    """Return a story of position and heading after a known motion (3,) with a covariance (3, 3)."""
    axes = _blocks(turns(story.mean[2]), np.eye(1))
    shift = axes @ motion
    moves = np.eye(3)
    moves[:2, 2] = -shift[1], shift[0]
    covariance = moves @ story.covariance @ moves.T + axes @ noise @ axes.T
    return replace(story, mean=story.mean + shift, covariance=covariance, share=0.0)


def _with_heading(story: _Story) -> _Story:
    """Return a story of position and heading; the heading is that of the last pose not considered stray."""
    if len(story.mean) == 3:
        return story
    theta = float(story.trusted.theta[0])
    turn, variance = (theta, _HEADING**2) if math.isfinite(theta) else (0.0, _NO_HEADING)
    return replace(
        story,
        mean=np.array([*story.mean[:2], turn]),
        covariance=_blocks(story.covariance[:2, :2], np.full((1, 1), variance)),
    )


def _blocks(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix with two matrices on its diagonal."""
    apart = np.zeros((len(first), len(second)))
    return np.block([[first, apart], [apart.T, second]])


def _checked(covariance: ArrayLike) -> NDArray[np.float64]:
    """Return the covariance of a motion.

    Raises:
        DataError: not a symmetric matrix (3, 3) of finite numbers without negative eigenvalues.
    """
    given = np.asarray(covariance, dtype=np.float64)
    fits = given.shape == (3, 3) and np.isfinite(given).all() and np.allclose(given, given.T)
    if not fits or np.linalg.eigvalsh(given)[0] < -1e-9 * np.abs(given).max():
        raise DataError(f"the covariance of a motion is a symmetric matrix (3, 3) of variances, got {covariance!r}")
    return given
