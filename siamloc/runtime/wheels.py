"""Read the wheel odometry and the tilt of the images that a robot locates."""

from __future__ import annotations

from os.path import abspath
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.files import expanded
from siamloc.data.checks import wrong_odometry
from siamloc.data.frames import FrameTable
from siamloc.data.manifest import read_rows
from siamloc.errors import DataError

UNKNOWN: NDArray[np.float64] = np.full(5, np.nan)
UNKNOWN.flags.writeable = False


def read_odometry(table: str | Path) -> dict[str, NDArray[np.float64]]:
    """Read the poses that a robot computed from its wheels, and its tilt (5,), by the path of the image.

    They are x, y and heading in rad, and roll and pitch in rad; NaN if unknown.

    Args:
        table: a manifest, or any CSV table with the columns `image`, `odom_x`, `odom_y` and `odom_theta`, and perhaps
            `roll` and `pitch`; paths are relative to its folder. Without a column `sequence`, each folder of images is
            a drive.

    Raises:
        DataError: the table cannot be read, has no odometry, or has it in degrees.
    """
    file = expanded(table)
    rows = [{"sequence": str(Path(row["path"]).parent), **row} for row in read_rows(file)]
    frames = FrameTable.from_rows(rows)
    if not np.isfinite(frames.odometry).all(axis=1).any():
        raise DataError(f"{file} has no row with all of odom_x, odom_y and odom_theta: a robot is tracked by them")
    for finding in wrong_odometry(frames):
        raise DataError(f"{file}: {finding}")
    held = np.column_stack([frames.odometry, frames.tilt])
    return {abspath(path): row for path, row in zip(frames.path.tolist(), held, strict=True)}  # noqa: PTH100
