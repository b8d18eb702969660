"""Where a robot was by its odometry: one thread adds what arrives, another asks while it locates an image."""

from __future__ import annotations

from collections import deque
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.moves import composed
from siamloc.errors import DataError

_KEPT = 500  # messages, at 100 Hz those of 5 s
_RESTART = 1.0  # s: time that runs back farther is a clock that began again, as of a recording that is played again


class OdometryHistory:
    """The newest poses of a robot by its odometry, safe to use from several threads.

    Args:
        gap: how far a time may be from the nearest message, in s.
    """

    def __init__(self, gap: float) -> None:
        self.gap = gap
        self._lock = Lock()
        self._kept: deque[NDArray[np.float64]] = deque(maxlen=_KEPT)

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, time: float, pose: ArrayLike, velocity: ArrayLike) -> None:
        """Keep a pose; if the clock began again, forget all others.

        Args:
            time: in s.
            pose: x and y in m, and heading in rad (3,).
            velocity: ahead and to the left in m/s, and to the left in rad/s (3,), seen from the robot.

        Raises:
            DataError: the time is not after that of the pose before.
        """
        with self._lock:
            back = self._kept[-1][0] - time if self._kept else -1.0
            if back > _RESTART:
                self._kept.clear()
            elif back >= 0:
                raise DataError("odometry whose stamp is not after that of the message before is dropped")
            self._kept.append(np.concatenate([[time], pose, velocity]))

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the pose (3,) at a time in s, between two messages or by the velocity of the nearest one.

        Returns:
            x, y and heading in rad; NaN if no message is within `gap`.
        """
        table = self._table()
        times = table[:, 0]
        if not (np.abs(times - time) <= self.gap).any():
            return np.full(3, np.nan)
        if times[0] <= time <= times[-1]:
            table[:, 3] = np.unwrap(table[:, 3])
            return np.array([np.interp(time, times, column) for column in table[:, 1:4].T])
        end = table[0 if time < times[0] else -1]
        ahead, left, turn = end[4:] * (time - end[0])
        half = np.array([0, 0, turn / 2])  # the robot moves along an arc
        return composed((end[1:4] + half)[None], (np.array([ahead, left, 0]) + half)[None])[0]

    def age(self, time: float) -> float:
        """Return how much older than a time in s the newest message is, in s; NaN without messages."""
        times = self._table()[:, 0]
        return float(time - times[-1]) if len(times) else float("nan")

    def fault(self, time: float) -> str:
        """Return why the pose at a time in s is unknown, or "" if it is known."""
        times = self._table()[:, 0]
        if not len(times):
            return "no odometry has arrived"
        apart = np.abs(times - time).min()
        if apart <= self.gap:
            return ""
        return (
            f"the stamps of the image and of the nearest odometry are {apart:.2f} s apart, "
            f"more than odometry_gap ({self.gap:g} s)"
        )

    def _table(self) -> NDArray[np.float64]:
        """Return time, pose and velocity of each message (n, 7)."""
        with self._lock:
            return np.array(self._kept).reshape(-1, 7)
