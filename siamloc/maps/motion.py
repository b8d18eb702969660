"""`motions`: how a robot moved from query to query, by its odometry, for the filters that track it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from siamloc.data.checks import wrong_odometry
from siamloc.data.frames import FrameTable
from siamloc.data.moves import moves
from siamloc.errors import DataError

_WORDS = "the distance ahead, the distance to the left and the turn to the left in rad, NaN where unknown"


@typed
def motions(frames: FrameTable) -> NDArray[np.float64]:
    """Return how the robot moved to each frame from the one before in its drive, by the odometry of the frames.

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
        DataError: not three numbers, or a turn that is not in rad.
    """
    if motion is None:
        return None
    said = f"a motion is {_WORDS}: three numbers, got {motion!r}"
    try:
        given = np.asarray(motion, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(said) from error
    if given.shape != (3,) or np.isinf(given).any():
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
