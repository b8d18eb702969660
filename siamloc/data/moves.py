"""Poses in the plane: moves of a robot from one pose to the next, and poses as seen from others."""

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
    rows = np.arange(len(given))
    found[1:] = relative(given, rows[:-1], rows[1:])
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
    turned = np.column_stack([np.zeros((len(given), 2)), heading[:-1]])
    moved = composed(turned, given)[:, :2]
    return np.column_stack([np.concatenate([[[0.0, 0.0]], np.cumsum(moved, axis=0)]), wrapped(heading)])


def euler(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Return roll, pitch and heading in rad (..., 3) of unit quaternions (..., 4), w x y z, from robot to map.

    Roll is positive where the left side is up, pitch where the front is down: of a robot that looks along x with z up.

    Example:
        >>> euler([0.5**0.5, 0, 0, 0.5**0.5]).round(3).tolist()
        [0.0, 0.0, 1.571]
    """
    w, x, y, z = np.moveaxis(np.asarray(quaternions, dtype=np.float64), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x**2 + y**2))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    return np.stack([roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))], axis=-1)


def relative(poses: NDArray[np.float64], first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return some of the poses (n, 3) as seen from others (e, 3): the move from the `first` row to the `second` one."""
    apart = poses[second] - poses[first]
    cosine, sine = np.cos(poses[first, 2]), np.sin(poses[first, 2])
    ahead, left = cosine * apart[:, 0] + sine * apart[:, 1], cosine * apart[:, 1] - sine * apart[:, 0]
    return np.column_stack([ahead, left, wrapped(apart[:, 2])])


def composed(pose: NDArray[np.float64], move: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the poses (n, 3) after a move (n, 3) from each pose (n, 3), or all from the same pose (1, 3)."""
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = cosine * move[:, 0] - sine * move[:, 1], sine * move[:, 0] + cosine * move[:, 1]
    return np.column_stack([pose[:, 0] + x, pose[:, 1] + y, pose[:, 2] + move[:, 2]])


def way_along(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the way from the first of n poses, or positions, to each of them (n,)."""
    return np.asarray(np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T)))


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the poses (n, 3) of the origin as seen from poses (n, 3)."""
    turned = np.column_stack([np.zeros((len(pose), 2)), -pose[:, 2]])
    return composed(turned, np.column_stack([-pose[:, :2], np.zeros(len(pose))]))


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wrap angles to (-pi, pi]."""
    return np.asarray(np.pi - np.remainder(np.pi - angle, TURN))
