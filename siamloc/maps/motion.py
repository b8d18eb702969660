"""`motions`: how a robot moved from query to query, by its odometry, for the filters that track it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from siamloc.data.checks import wrong_odometry
from siamloc.data.frames import FrameTable
from siamloc.data.moves import composed, moves, wrapped
from siamloc.errors import DataError

_WORDS = "the distance ahead, the distance to the left and the turn to the left in rad, NaN where unknown"
_FEWEST, _KEPT, _FAR = 15, 30, 3.0  # places from which a unit is judged, at least and at most, and steps between two
_ALIKE, _RIGHT = 0.9, 3.0  # share of the pairs of places that agree; factor that no drift explains
_FARTHEST = 1e7  # distance that a motion cannot exceed
_APART, _TURNS, _MOST = 5, 10, 0.7  # places between which turns are judged, the fewest such turns, their share
_TURNED = np.radians([10, 120])  # turns that noise does not reverse, and that are not half a turn

MIRRORED = (
    "turns left where its images turn right: headings grow counter-clockwise and the columns of a panorama run "
    "clockwise; give"
)
"""What is wrong with odometry that turns the other way, up to what to give."""


class WrongUnitError(DataError):
    """Motions in another unit than that of the positions of the map, or that turn the other way."""


class MotionCheck:
    """Check once a drive that its motions have the unit and the turns of the map, by the places that are recognized.

    The way between two places as seen by the images, and as told by the motions, differ by one factor and one turn for
    most pairs of places if the unit is wrong. They do not if wheels slip, nor if the robot stands, is carried or lost.
    If motions turn the other way, most turns are as large as the images show, but opposite.

    Args:
        length: distance the robot moves between two queries, in units of x and y.
    """

    def __init__(self, length: float) -> None:
        self.length = length
        self.reset()

    def reset(self) -> None:
        """Forget the drive."""
        self._driven, self._unit_judged, self._turns_judged = np.zeros((1, 3)), False, False
        self._places = np.empty((0, 2, 3))  # poses by images and by motions
        self._turns = np.empty((0, 2))

    def step(self, motion: NDArray[np.float64] | None, xy: NDArray[np.float64] | None, theta: float = np.nan) -> None:
        """Take a motion (3,), None if unknown, and the position (2,) by the image after it, None if not recognized.

        Args:
            motion: the motion.
            xy: the position.
            theta: heading by the image, in rad; NaN if unknown.

        Raises:
            WrongUnitError: the motions of the drive are in another unit, or turn the other way.
        """
        if self._unit_judged and self._turns_judged:
            return
        if motion is None:
            self.reset()
        else:
            self._driven = composed(self._driven, motion[None])
        if xy is None:
            return
        place = np.array([[[*xy, theta], self._driven[0]]])
        if len(self._places) and np.hypot(*(place - self._places[-1])[0, 0, :2]) < self.length:
            return
        self._places = np.concatenate([self._places[1 - _KEPT :], place])
        if not self._unit_judged:
            self._judge_unit()
        if not self._turns_judged and len(self._places) > _APART:
            self._judge_turns()

    def _judge_unit(self) -> None:
        first, second = np.triu_indices(len(self._places), 1)
        apart = self._places[second] - self._places[first]
        seen, driven = (apart[..., 0] + 1j * apart[..., 1]).T
        far = np.abs(seen) > _FAR * self.length
        if len(self._places) < _FEWEST or far.sum() < _FEWEST:
            return
        ratio = driven[far] / seen[far]
        usual = complex(np.median(ratio.real), np.median(ratio.imag))
        if (np.abs(ratio - usual) < abs(usual) / 2).mean() < _ALIKE:
            return
        if not 1 / _RIGHT <= abs(usual) <= _RIGHT:
            self.reset()
            raise WrongUnitError(
                f"the odometry of the robot moves {abs(usual):.3g} times as far as its images show: give it in the "
                "unit of the map's positions, such as metres"
            )
        self._unit_judged = True

    def _judge_turns(self) -> None:
        turn = wrapped(self._places[-1, :, 2] - self._places[-1 - _APART, :, 2])
        if not _TURNED[0] < abs(turn[0]) < _TURNED[1]:
            return
        self._turns = np.concatenate([self._turns[1 - _KEPT :], turn[None]])
        if len(self._turns) < _TURNS:
            return
        seen, driven = self._turns.T
        same, opposite = (np.mean(np.abs(wrapped(driven - turns)) < np.abs(seen) / 2) for turns in (seen, -seen))
        if opposite > _MOST:
            self.reset()
            raise WrongUnitError(
                f"the odometry of the robot {MIRRORED} headings with the other sign, and y if it points to the right"
            )
        self._turns_judged = bool(same > _MOST)


@typed
def motions(frames: FrameTable) -> NDArray[np.float64]:
    """Return how the robot moved to each frame from the frame before in its drive, by the odometry of the frames.

    Args:
        frames: n frames, in capture order within each sequence.

    Returns:
        The distances ahead and to the left, in the unit of the positions, and the turn to the left in rad, in
        (-pi, pi], seen from the frame before (n, 3); NaN for the first frame of a drive, and where the odometry of
        either frame is unknown.

    Raises:
        DataError: odometry in degrees.

    Example:
        >>> frames = FrameTable(path=["1.jpg", "2.jpg"], odom_x=[0, 0], odom_y=[0, 2], odom_theta=[np.pi / 2, 3])
        >>> motions(frames).round(2).tolist()
        [[nan, nan, nan], [2.0, 0.0, 1.43]]
    """
    for finding in wrong_odometry(frames):
        raise DataError(f"a robot is tracked by its odometry: {finding}")
    found = np.full((len(frames), 3), np.nan)
    poses = frames.odometry
    for rows in frames.rows_by("sequence").values():
        found[rows] = moves(poses[rows])
    return found


def motion_or_none(motion: ArrayLike | None) -> NDArray[np.float64] | None:
    """Return a motion (3,) that a filter is given, as numbers; None if any of them is unknown.

    Raises:
        DataError: not three numbers, larger ones than tables of odometry may hold, or a turn that is not in rad.
    """
    if motion is None:
        return None
    said = f"a motion is {_WORDS}: three numbers up to 10 million, got {motion!r}"
    try:
        given = np.asarray(motion, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(said) from error
    if given.shape != (3,) or (np.abs(given) > _FARTHEST).any():
        raise DataError(said)
    if abs(given[2]) > 2 * np.pi:
        raise DataError(f"the turn of a motion is in rad, at most one full turn, got {given[2]:g}")
    return None if np.isnan(given).any() else given


def motions_of(motion: ArrayLike | None, count: int) -> NDArray[np.float64]:
    """Return the motions (n, 3) of n queries that a filter is given; NaN if there are none.

    Raises:
        DataError: another shape.
    """
    given = np.full((count, 3), np.nan) if motion is None else np.asarray(motion, dtype=np.float64)
    if given.shape != (count, 3):
        raise DataError(f"{count} queries need as many motions ({_WORDS}), of shape ({count}, 3), got {given.shape}")
    return given
