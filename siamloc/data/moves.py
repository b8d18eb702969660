"""Moves of a robot in the plane: how it gets from one pose to the next, seen from itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

TURN = 2 * np.pi


def moves(poses: ArrayLike) -> NDArray[np.float64]:
    """Return how the robot moves to each pose from the pose before, seen from there.

    Args:
        poses: x, y and heading in rad (n, 3), NaN where unknown.

    Returns:
        The distance ahead, the distance to the left and the turn to the left in rad, in (-pi, pi], of each move (n, 3);
        NaN for the first pose, and where either pose is unknown.

    Example:
        >>> moves([[0, 0, 0], [1, 0, np.pi / 2], [1, 2, np.pi / 2]]).round(2)[1:].tolist()
        [[1.0, 0.0, 1.57], [2.0, 0.0, 0.0]]
    """
    given = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    found = np.full(given.shape, np.nan)
    east, north, turn = np.diff(given, axis=0).T
    cos, sin = np.cos(given[:-1, 2]), np.sin(given[:-1, 2])
    found[1:] = np.column_stack([cos * east + sin * north, cos * north - sin * east, np.pi - (np.pi - turn) % TURN])
    found[np.isnan(found).any(axis=1)] = np.nan
    return found


def chained(steps: ArrayLike) -> NDArray[np.float64]:
    """Return the poses of a robot that makes some moves, from (0, 0, 0): the reverse of `moves`.

    Args:
        steps: moves (n, 3) as `moves` returns them; the first one is not used.

    Returns:
        x, y and heading in rad, in (-pi, pi], after each move (n, 3).

    Example:
        >>> chained([[np.nan] * 3, [1, 0, np.pi / 2], [2, 0, 0]]).round(2).tolist()
        [[0.0, 0.0, 0.0], [1.0, 0.0, 1.57], [1.0, 2.0, 1.57]]
    """
    given = np.asarray(steps, dtype=np.float64).reshape(-1, 3)[1:]
    heading = np.concatenate([[0.0], np.cumsum(given[:, 2])])
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    ahead, left, _ = given.T
    steps = np.column_stack([cos * ahead - sin * left, sin * ahead + cos * left])
    return np.column_stack([np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)]), np.pi - (np.pi - heading) % TURN])
