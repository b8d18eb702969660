"""A filter over refined poses: a robot is expected to keep moving as before, and an outlier must repeat to count.

`SequenceFilter` tracks the frames of a map; this filter tracks positions between them. The robot keeps its velocity up
to a random acceleration (a Kalman filter in x and y), and each pose from `siamloc.maps.refine` is weighted by its
information and by the probability that it is not a stray one. Several hypotheses, called stories, are kept at once
[Reid 1979]: every pose starts a new one, which is dropped if it stays near a better one, and takes over if it explains
the following poses better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Positive, Probability
from siamloc.errors import DataError
from siamloc.maps.refinement import FREEDOM, RefinedPoses

_STORIES = 5
_STRAY = 0.15  # density of poses that are wrong, per square unit of the positions
_TRUSTED = 0.05  # probability below which a pose is considered stray
_NEAR = 0.05  # share of a step: stories this close to each other are merged
_ACCELERATION = 0.5  # standard deviation of the change of the step between two queries, as a share of the usual step
_MOVES = np.block([[np.eye(2), np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
_NOISE = np.kron(np.array([[0.25, 0.5], [0.5, 1.0]]), np.eye(2))


@dataclass(frozen=True)
class _Story:
    """Position and step of the robot, mean (4,) and covariance (4, 4), and how well they explain the poses."""

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    evidence: float
    share: float  # probability that the last pose is not a stray one
    trusted: RefinedPoses  # the last pose not considered stray: it gives the heading and the map frame


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
        self.reset()

    def reset(self) -> None:
        """Forget all queries: the robot may be anywhere."""
        self._stories: list[_Story] = []

    def step(self, pose: RefinedPoses) -> RefinedPoses:
        """Update the filter with the pose of one query and return the filtered pose.

        After a pose that is NaN or has no information (see `RefinedPoses`), the robot is assumed to keep moving as
        before. Heading and map frame are those of the last pose that is not considered stray.

        Raises:
            DataError: not exactly one pose.
        """
        if len(pose) != 1:
            raise DataError(f"a step takes the pose of one query, got {len(pose)}")
        about = pose.information[0]
        stories = [self._moved(story) for story in self._stories]
        if about.any() and np.isfinite(about).all() and np.isfinite(pose.xy).all():
            spread = np.linalg.inv(about)
            best = max((story.evidence for story in stories), default=0.0)
            begun = np.block([[spread, np.zeros((2, 2))], [np.zeros((2, 2)), self.length**2 * np.eye(2)]])
            fresh = best + math.log(self.kidnapping) + math.log(_STRAY)
            stories = [self._told(story, pose, spread) for story in stories]
            stories.append(_Story(np.concatenate([pose.xy[0], np.zeros(2)]), begun, fresh, 1.0, pose))
        if not stories:
            return pose
        self._stories = self._kept(stories)
        story = self._stories[0]
        return replace(
            pose,
            xy=story.mean[None, :2],
            information=np.linalg.inv(story.covariance[:2, :2])[None].astype(np.float64),
            theta=story.trusted.theta,
            agreement=pose.agreement * story.share,
            frame=story.trusted.frame,
        )

    def run(self, poses: RefinedPoses, sequence: ArrayLike) -> RefinedPoses:
        """Track robots through whole sequences, with a reset before each.

        Args:
            poses: poses of n queries, in capture order within each sequence.
            sequence: (n,) name of each query's sequence.

        Raises:
            DataError: not one name for each pose.
        """
        names = np.asarray(sequence)
        if names.shape != (len(poses),):
            raise DataError(f"{len(poses)} poses need as many names of sequences, got shape {names.shape}")
        found: list[RefinedPoses] = [poses.take(np.array([row])) for row in range(len(poses))]
        for name in dict.fromkeys(names.tolist()):
            self.reset()
            for row in np.flatnonzero(names == name).tolist():
                found[row] = self.step(found[row])
        self.reset()
        return RefinedPoses.concatenate(found) if found else poses

    def _moved(self, story: _Story) -> _Story:
        noise = (_ACCELERATION * self.length) ** 2 * _NOISE
        return replace(
            story, mean=_MOVES @ story.mean, covariance=_MOVES @ story.covariance @ _MOVES.T + noise, share=0.0
        )

    def _told(self, story: _Story, pose: RefinedPoses, spread: NDArray[np.float64]) -> _Story:
        """Return a story updated with a pose, which is weighted by the probability that it is not a stray one."""
        agreement = float(pose.agreement[0])
        apart, total = pose.xy[0] - story.mean[:2], story.covariance[:2, :2] + spread
        squared = float(apart @ np.linalg.solve(total, apart))
        height = (1 + squared / FREEDOM) ** (-(FREEDOM + 2) / 2) / (2 * math.pi * math.sqrt(np.linalg.det(total)))
        share = agreement * height / (agreement * height + _STRAY)
        weight = max(share * (FREEDOM + 2) / (FREEDOM + squared), 1e-9)
        gain = story.covariance[:, :2] @ np.linalg.inv(story.covariance[:2, :2] + spread / weight)
        covariance = story.covariance - gain @ story.covariance[:2]
        evidence = story.evidence + math.log(agreement * height + _STRAY)
        trusted = pose if share > _TRUSTED else story.trusted
        return _Story(story.mean + gain @ apart, (covariance + covariance.T) / 2, evidence, share, trusted)

    def _kept(self, stories: list[_Story]) -> list[_Story]:
        """Return the stories that explain the poses best, best first, each place once, the best with evidence 0."""
        kept: list[_Story] = []
        for story in sorted(stories, key=lambda one: -one.evidence):
            near = _NEAR * self.length
            if all(np.hypot(*(story.mean[:2] - other.mean[:2])) > near for other in kept):
                kept.append(story)
        best = kept[0].evidence
        return [replace(story, evidence=story.evidence - best) for story in kept[:_STORIES]]
