"""What a survey refuses: networks that do not compare, and drives that are too short, unordered, unlike or still."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps.describing import descriptor_from
from siamloc.maps.pose_graph import Array

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor

_FEWEST = 10  # frames of a drive
_LEAST_WAY = 1.0  # metres of a drive
_KNOWN = 0.3  # share of the steps of a drive that images or odometry show, at least: fewer where images are shuffled


def comparing_descriptor(network: Descriptor | nn.Module | str, circular: bool) -> Any:
    """Return a network as a descriptor that compares panoramas and gives headings.

    Raises:
        ConfigError: a network without a comparison or without headings.
    """
    described = descriptor_from(network, circular=circular)
    if not (getattr(described, "compares", False) and getattr(described, "tells_heading", False)):
        raise ConfigError(
            "a survey needs a network that compares panoramas: take pretrained, or a network with the head fourier or "
            "magnitudes that was built and trained with relative=True"
        )
    return described


def check_lengths(frames: FrameTable) -> None:
    """Check that each drive has enough frames, in the order in which they were taken.

    Raises:
        DataError: a drive that is too short, or whose times go back.
    """
    for name, rows in frames.rows_by("sequence").items():
        said, times = f"drive {name or '(unnamed)'}", frames.time[rows]
        if len(rows) < _FEWEST:
            raise DataError(f"{said} has {len(rows)} frames: a survey needs {_FEWEST} or more of each")
        if (np.diff(times[np.isfinite(times)]) < 0).any():
            raise DataError(f"the times of {said} go back: give its frames in the order in which they were taken")


def check_drives(known: NDArray[np.bool_], start: Array, drive: NDArray[np.int64], names: list[str]) -> None:
    """Check that most steps of each drive are known, and that the robot moved.

    Args:
        known: whether images or odometry show each step from frame to frame (n - 1,).
        start: poses of the frames (n, 3).
        drive: number of the drive of each frame (n,), -1 for frames with a given pose.
        names: names of the drives.

    Raises:
        DataError: a drive whose images are unlike, or one that stands still.
    """
    for number, name in enumerate(names):
        mine = known[(drive[1:] == number) & (drive[:-1] == number)]
        if len(mine) and mine.mean() < _KNOWN:
            raise DataError(
                f"only {mine.sum()} of {len(mine)} images of drive {name} are like the one before: give "
                "its frames in the order in which they were taken, sorted by time, at most two metres apart, or give "
                "odometry"
            )
        xy = start[drive == number, :2]
        if len(xy) and np.hypot(*(xy - xy[0]).T).max() < _LEAST_WAY:
            raise DataError(
                f"drive {name} stays within {_LEAST_WAY:g} m of where it begins: a survey needs a drive that moves"
            )
