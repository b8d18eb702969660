"""`Mounting`: how a camera is mounted on its robot, and panoramas turned back to look straight ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.settings import Settings


@dataclass(frozen=True)
class Mounting(Settings):
    """How a camera is mounted on the robot, or how its panoramas are stored.

    Attributes:
        yaw: how far the middle column of a panorama looks to the left of the robot's heading, in degrees; of a mirrored
            panorama, after it is flipped.
        mirrored: whether the columns run counter-clockwise, so that the panorama shows the left on its right.
        ahead: where the camera is ahead of the point of the robot whose poses are given, in the unit of the poses.
        left: where it is to the left of that point.

    Example:
        >>> Mounting(yaw=90).straight(np.arange(8)).tolist()  # the robot's front is a quarter turn to the right
        [2, 3, 4, 5, 6, 7, 0, 1]
        >>> Mounting(mirrored=True).straight(np.arange(4)).tolist()
        [3, 2, 1, 0]
    """

    WHERE: ClassVar[str] = "mounting"

    yaw: float = 0.0
    mirrored: bool = False
    ahead: float = 0.0
    left: float = 0.0

    @typed
    def straight(self, panoramas: NDArray) -> NDArray:
        """Return panoramas (..., W) that are flipped and turned, by whole columns, so that their middle looks ahead."""
        columns = round(self.yaw * panoramas.shape[-1] / 360)
        panoramas = np.ascontiguousarray(panoramas[..., ::-1]) if self.mirrored else panoramas
        return np.roll(panoramas, -columns, axis=-1) if columns else panoramas

    def offset(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the camera is from that point (..., 2), along the axes of the map, at headings (...) in rad."""
        cosine, sine = np.cos(theta), np.sin(theta)
        return np.stack([cosine * self.ahead - sine * self.left, sine * self.ahead + cosine * self.left], axis=-1)
