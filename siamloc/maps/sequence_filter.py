"""A discrete Bayes filter over the frames of a map, so that a moving robot's estimate uses its recent frames.

There is only a forward pass: an estimate depends on the queries up to its own. The likelihood of a map frame given a
query is the softmax of the descriptor distances, exp(-d / temperature) ([T] 5.3.5 uses only the smallest distance). The
robot's motion is learned from the map's own spacing (`MotionModel`), unless its wheels tell how far it moved; the
temperature is learned from the map itself (`temperature_of_map`) or, together with the probability of kidnapping, on a
validation sequence (`tune_filter`).

Queries from one place make the same mistakes. If the motion is known, a query therefore counts by the share of a usual
step, or of a radian, that the robot moved since the query before, unless it contradicts the motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.columns import Rows
from foundation.settings import Positive, Probability
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps.checked_arrays import check_placed
from siamloc.maps.matching import frame_distances
from siamloc.maps.motion import MotionCheck, motion_or_none, motions_of
from siamloc.maps.search import VectorIndex
from siamloc.maps.thinning import near
from siamloc.maps.visual_map import VisualMap

_REACH = 4.0  # standard deviations; the weight beyond is below 4e-4 and covered by kidnapping
_FAST = 95  # percentile of the map's speeds, taken as the robot's largest speed
_STANDING = 0.01  # weight of a query of a robot that did not move
_AGREES = 0.5  # mean likelihood of a query where the robot has moved to, as a share of that where the query shows it
_SAMPLE = 500  # map frames from which a temperature is learned


@dataclass(frozen=True, eq=False)
class Track(Rows):
    """Output of the filter after each query.

    Attributes:
        frame: (n,) the most probable map frame, the smallest row of equally probable ones.
        probability: (n,) probability of the most probable frame.
        spread: (n,) root mean square distance of the belief from that frame, in units of x and y.
        xy: (n, 2) position between map frames: the mean of the belief within a radius of the most probable frame; None
            if no radius was given.
    """

    frame: NDArray[np.int64]
    probability: NDArray[np.float64]
    spread: NDArray[np.float64]
    xy: NDArray[np.float64] | None = None


class SequenceFilter:
    """Track where a robot is in a map, query by query.

    A share of the belief, `kidnapping`, is spread over the whole map at each step. A robot that was carried away is
    found again within 1 + log(m / kidnapping) / log(r w) queries if each of them makes its new place r times as likely
    as any other and the motion model gives its steps the probability w: with w = 0.1 and r = 100, that is 7 queries in
    a map of 1000 frames with the default kidnapping.

    Args:
        motion: motion model of a robot in this map (m frames).
        temperature: temperature of the softmax, in units of the descriptor distance; see `temperature_of_map`.
        kidnapping: probability that the robot could be anywhere, in (0, 1).

    Attributes:
        belief: (m,) probability of each map frame after the last query; uniform at first.

    Raises:
        ConfigError: a temperature or probability out of range.
    """

    @typed
    def __init__(self, motion: MotionModel, temperature: Positive, kidnapping: Probability = 1e-3) -> None:
        self.motion, self.temperature, self.kidnapping = motion, float(temperature), float(kidnapping)
        self._check = MotionCheck(motion.step)
        self.reset()

    def reset(self) -> None:
        """Forget all queries: the robot may be anywhere."""
        self.belief = np.full(len(self.motion), 1 / len(self.motion))
        self._begun = False
        self._check.reset()

    def step(self, distances: ArrayLike, motion: ArrayLike | None = None) -> NDArray[np.float64]:
        """Update the belief with one query and return it (m,).

        Args:
            distances: (m,) from the query's descriptor to the map's; infinite for map frames that are excluded.
            motion: how the robot moved since the last query (3,), as for `PoseFilter.step`, of which only the distance
                counts here; if None or NaN, the robot is assumed to move as the motion model says.

        Raises:
            DataError: not one distance for each map frame, or none that is finite; or a motion of another form.
            WrongUnitError: motions in another unit than the map, as soon as enough queries show it.
        """
        apart = np.asarray(distances, dtype=np.float64)
        # NaN and -infinity show in the smallest value.
        if apart.shape != (len(self.motion),) or not np.isfinite(apart.min()):
            raise DataError(
                f"a query needs {len(self.motion)} distances to the map, finite ones or infinity where it is "
                f"not compared, got shape {apart.shape}"
            )
        move = motion_or_none(motion)
        self._check.step(move, self.motion.xy[apart.argmin()])
        length, new = None, 1.0
        if move is not None:
            length = float(np.hypot(*move[:2]))
            new = min(length / (self.motion.step or 1.0) + abs(float(move[2])) + _STANDING, 1.0)
        moved = self.motion.predict(self.belief, length)
        # The most likely frame has likelihood 1, so the sums cannot vanish.
        log_likelihood = (apart.min() - apart) / self.temperature
        likelihood = np.exp(log_likelihood)
        agrees = moved @ likelihood > _AGREES * (likelihood @ likelihood) / likelihood.sum()
        new = new if self._begun and agrees else 1.0
        self._begun = True
        kidnapping = new * self.kidnapping
        belief = ((1 - kidnapping) * moved + kidnapping / len(apart)) * np.exp(new * log_likelihood)
        self.belief = belief / belief.sum()
        return self.belief

    def run(
        self,
        distances: ArrayLike,
        sequence: ArrayLike,
        radius: float | None = None,
        motion: ArrayLike | None = None,
    ) -> Track:
        """Track robots through whole sequences, with a reset before each.

        Args:
            distances: (n, m) from each query to the map, in capture order within each sequence.
            sequence: (n,) name of each query's sequence.
            radius: radius of the mean between map frames, in units of x and y; no mean is computed if None.
            motion: how the robot moved to each query from the one before (n, 3), as `siamloc.maps.motions` returns it;
                NaN where unknown, as for all if None.

        Raises:
            DataError: arrays that do not match each other or the map.
        """
        apart, names = np.asarray(distances), np.asarray(sequence)
        if apart.shape != (len(names), len(self.motion)):
            raise DataError(
                f"{len(names)} queries need distances of shape ({len(names)}, {len(self.motion)}), got {apart.shape}"
            )
        moved = motions_of(motion, len(names))
        frame = np.zeros(len(names), dtype=np.int64)
        probability, spread = np.zeros(len(names)), np.zeros(len(names))
        xy = None if radius is None else np.zeros((len(names), 2))
        for name in dict.fromkeys(names.tolist()):
            self.reset()
            for row in np.flatnonzero(names == name).tolist():
                belief = self.step(apart[row], moved[row])
                frame[row] = best = int(belief.argmax())
                probability[row], spread[row] = belief[best], self.spread(best)
                if xy is not None and radius is not None:
                    xy[row] = self._between(best, radius)
        self.reset()
        return Track(frame, probability, spread, xy)

    def _between(self, frame: int, radius: float) -> NDArray[np.float64]:
        offset = self.motion.xy - self.motion.xy[frame]
        near = np.where(np.square(offset).sum(axis=1) <= radius**2, self.belief, 0.0)
        return np.asarray(self.motion.xy[frame] + near @ offset / near.sum(), dtype=np.float64)

    def spread(self, frame: int) -> float:
        """Return the root mean square distance of the belief from a map frame, in units of x and y."""
        squared = np.square(self.motion.xy - self.motion.xy[frame]).sum(axis=1)
        return float(np.sqrt(self.belief @ squared))


@dataclass(frozen=True, eq=False)
class MotionModel:
    """Probabilities of moving from one map frame to another between two queries, as a list of pairs.

    The probability falls with the distance d between two frames as exp(-d^2 / (2 sigma^2)), in any direction, with
    sigma^2 = step^2 + spacing^2 / 6. The second term is there because a frame stands for all places up to half a
    spacing from it: the difference of two such places has that variance. If the length of a move is known, it takes the
    place of a step that is shorter. If the move is shorter than the step, so is the probability of leaving a frame, by
    their ratio: many short moves count as much as a long one.

    Attributes:
        xy: (m, 2) positions of the map's frames.
        source: (e,) start frame; the pairs include every frame with itself.
        target: (e,) end frame.
        weight: (e,) probability of the move; the moves from one source add up to 1.
        step: distance the robot moves between two queries.
        spacing: median distance between consecutive frames of the map.
    """

    xy: NDArray[np.float64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    weight: NDArray[np.float64]
    step: float
    spacing: float

    def __len__(self) -> int:
        return len(self.xy)

    @classmethod
    @typed
    def learn(cls, frames: FrameTable, step: Positive | None = None, interval: Positive | None = None) -> MotionModel:
        """Learn the motion from the frames of a map.

        Args:
            frames: m frames in capture order within each sequence, all with positions.
            step: distance a robot moves between two queries, in units of x and y. If None, `interval` times
                the speed that 95 % of the steps of the map's robot stay below, or the map's spacing if there is no
                interval or the map has no times.
            interval: seconds between two queries.

        Raises:
            ConfigError: a step or an interval that is not positive.
            DataError: no frames, or a frame without a position.
        """
        check_placed(frames, "a model of motion")
        spacing = spacing_of(frames)
        if step is None:
            length, seconds = steps_of(frames)
            timed = (seconds > 0) & np.isfinite(seconds)
            step = spacing
            if interval is not None and (length[timed] > 0).any():
                step = interval * float(np.percentile(length[timed] / seconds[timed], _FAST))
        return cls(frames.xy, *_transitions(frames, np.sqrt(step**2 + spacing**2 / 6)), float(step), spacing)

    def predict(self, belief: NDArray[np.float64], length: float | None = None) -> NDArray[np.float64]:
        """Return the belief (m,) after another step of the robot.

        Args:
            belief: (m,) before it.
            length: the distance between the ends of the step, if it is known.
        """
        if length is None or length == self.step:
            moved = np.bincount(self.target, self.weight * belief[self.source], minlength=len(self))
            return np.asarray(moved, dtype=np.float64)
        if length < self.step:
            share = length / self.step
            return (1 - share) * belief + share * self.predict(belief)
        length = max(self.step, min(length, self._extent))  # beyond, any place is as likely
        usual, variance = (step**2 + self.spacing**2 / 6 for step in (self.step, length))
        if usual == 0:  # all frames are in one place
            return self.predict(belief)
        # The pairs of the model reach four of its standard deviations.
        parts = math.ceil(variance / (2 * usual))
        weight = np.exp(-self._squared * parts / (2 * variance))
        weight /= np.bincount(self.source, weight, minlength=len(self))[self.source]
        for _ in range(parts):
            belief = np.bincount(self.target, weight * belief[self.source], minlength=len(self)).astype(np.float64)
        return belief

    @cached_property
    def _extent(self) -> float:
        return float(np.hypot(*np.ptp(self.xy, axis=0)))

    @cached_property
    def _squared(self) -> NDArray[np.float64]:
        return np.asarray(np.square(self.xy[self.source] - self.xy[self.target]).sum(axis=1), dtype=np.float64)


def spacing_of(frames: FrameTable) -> float:
    """Return the median distance between consecutive frames of a sequence, without standstill; 0 if nothing moved."""
    length, _ = steps_of(frames)
    return float(np.median(length[length > 0])) if (length > 0).any() else 0.0


def steps_of(frames: FrameTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances and the times between consecutive frames of each sequence."""
    length, seconds = [np.empty(0)], [np.empty(0)]
    for rows in frames.rows_by("sequence").values():
        length.append(np.hypot(np.diff(frames.x[rows]), np.diff(frames.y[rows])))
        seconds.append(np.diff(frames.time[rows]))
    return np.concatenate(length), np.concatenate(seconds)


def _transitions(frames: FrameTable, sigma: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    source, target, apart = map(np.concatenate, zip(*near(frames, frames, _REACH * sigma), strict=True))
    weight = np.exp(-np.square(apart) / (2 * sigma**2)) if sigma > 0 else np.ones(len(source))
    return source, target, weight / np.bincount(source, weight, minlength=len(frames))[source]


@dataclass(frozen=True)
class TunedFilter:
    """Settings of a sequence filter, with their validation error.

    Attributes:
        temperature: temperature of the softmax, in units of the descriptor distance.
        kidnapping: probability that the robot could be anywhere.
        error: mean error on the validation sequence.
    """

    temperature: float
    kidnapping: float
    error: float


def learn_temperature(distances: ArrayLike, true: ArrayLike) -> float:
    """Return the temperature that makes the true frames most likely under softmax(-d / temperature).

    At this temperature, the expected distance under the softmax equals, on average, that of the true frame.

    Args:
        distances: (n, m) from queries to the map; infinite where a frame is left out.
        true: (n,) the geometrically nearest map frame of each query, at a finite distance.
    """
    apart, rows = np.asarray(distances, dtype=np.float64), np.asarray(true)
    apart = apart - apart.min(axis=1, keepdims=True)
    wanted = apart[np.arange(len(apart)), rows]
    finite = apart[np.isfinite(apart)]
    scale = float(np.median(finite[finite > 0])) if (finite > 0).any() else 1.0
    values = np.where(np.isfinite(apart), apart, 0.0)
    low, high = -12.0, 5.0  # logarithm of temperature / scale
    for _ in range(50):
        middle = (low + high) / 2
        weight = np.exp(-apart / (scale * np.exp(middle)))
        expected = (weight * values).sum(axis=1) / weight.sum(axis=1)
        # The expected distance grows with the temperature.
        if expected.mean() < wanted.mean():
            low = middle
        else:
            high = middle
    return scale * float(np.exp((low + high) / 2))


@typed
def temperature_of_map(known: VisualMap) -> float:
    """Return the temperature learned from the map itself, by searching for each frame among the others.

    A large map is sampled. A map of one frame, or of frames that all look alike, gives a temperature as well; there,
    any value works.

    Raises:
        DataError: a map frame without a position.
    """
    check_placed(known.frames, "a temperature")
    if len(known) == 1:
        return 1.0
    chosen = np.unique(np.linspace(0, len(known) - 1, min(len(known), _SAMPLE)).astype(np.int64))
    own = chosen[:, None] == np.arange(len(known))
    apart = frame_distances(known, known.description.take(chosen), excluded=own)
    nearest = VectorIndex(known.frames.xy).search(known.frames.xy[chosen], excluded=own)
    return learn_temperature(apart, nearest.indices[:, 0])


@typed
def tune_filter(
    motion: MotionModel,
    distances: ArrayLike,
    true_xy: ArrayLike,
    sequence: ArrayLike,
    temperature: float,
    softer: Sequence[float] = (1, 2, 3, 4),
    kidnapping: Sequence[float] = (1e-3, 1e-5, 1e-7),
    moves: ArrayLike | None = None,
) -> list[TunedFilter]:
    """Try settings of the filter on a validation sequence; return the tried settings, smallest mean error first.

    The temperature that suits single queries treats each of them as independent. But consecutive queries see nearly the
    same, so mistakes persist, and a higher (softer) temperature keeps the filter from trusting a mistake more the
    longer it lasts. How much softer depends on how densely the map is sampled, and is therefore found by trial.

    Args:
        motion: motion model of a robot in the map (m frames).
        distances: (n, m) from the validation queries to the map.
        true_xy: (n, 2) true positions of the queries; NaN where unknown, which does not count.
        sequence: (n,) sequences of the queries.
        temperature: the temperature that suits single queries.
        softer: factors of the temperature to try, positive.
        kidnapping: probabilities to try, in (0, 1).
        moves: how the robot moved to each query from the one before (n, 3), as `siamloc.maps.motions` returns it; NaN
            where unknown, as for all if None.

    Raises:
        ConfigError: nothing to try, or values out of range.
        DataError: arrays that do not match each other, or no true position.
    """
    if not len(softer) or not len(kidnapping):
        raise ConfigError("tuning a sequence filter needs at least one factor and one probability to try")
    true = np.asarray(true_xy, dtype=np.float64)
    known = np.isfinite(true).all(axis=-1)
    if true.shape != (len(np.asarray(sequence)), 2) or not known.any():
        raise DataError(f"validation queries need true positions of shape (n, 2), some of them known, got {true.shape}")
    tried = []
    for factor, probability in product(softer, kidnapping):
        track = SequenceFilter(motion, temperature * factor, probability).run(distances, sequence, motion=moves)
        error = np.hypot(*(motion.xy[track.frame] - true)[known].T)
        tried.append(TunedFilter(float(temperature * factor), float(probability), float(error.mean())))
    return sorted(tried, key=lambda settings: settings.error)
