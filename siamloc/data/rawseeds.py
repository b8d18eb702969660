"""Reader of Rawseeds: a robot with an omnidirectional camera in the University of Milano-Bicocca (Ceriani et al. 2009).

A drive is a folder such as `Bicocca_2009-02-27a` with the folder `OMNI` of images `OMNI_<seconds>.png`, the table
`Bicocca_2009-02-27a-GROUNDTRUTH.csv` of time, x, y and heading, and `Bicocca_2009-02-27a-ODOMETRY_XYT.csv`, whose fifth
to seventh columns are x, y and heading.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foundation.files import expanded
from foundation.settings import Positive, Text
from siamloc.data.frames import ODOMETRY, FrameTable, concatenate, placed
from siamloc.data.recorded import joined, read_recorded
from siamloc.data.trajectory import Array, Trajectory, read_numbers
from siamloc.errors import DataError, Policy

_TRUTH, _WHEELS = (0, 1, 2, 3), (0, 4, 5, 6)  # columns of time, x, y and heading


def read_rawseeds(
    root: str | Path,
    *,
    camera: Text = "OMNI",
    truth: Text = "GROUNDTRUTH",
    gap: Positive = 1.0,
    on_error: Policy = "skip",
) -> FrameTable:
    """Read drives of Rawseeds.

    Sequences are called after their folders, such as `Bicocca_2009-02-27a`, their building after the first word. Images
    outside of the ground truth, which does not cover the whole drive, are left out and reported.

    Args:
        root: the folder of the drives, or of one drive.
        camera: folder of the images.
        truth: the ground truth that is used: the end of its table's name, "GROUNDTRUTH" or "GT-extended".
        gap: longest time between two true poses, in s, over which poses are interpolated.
        on_error: "skip" or "raise", for images without a true pose.

    Raises:
        DataError: no drive in the folder, or a table that is not as expected (with line).
    """
    folder = expanded(root)
    drives = [path for path in (folder, *sorted(folder.glob("*"))) if (path / camera).is_dir()]
    if not drives:
        raise DataError(f"{folder} holds no drive of Rawseeds: expected <drive>/{camera}/{camera}_<seconds>.png")
    return concatenate([_drive(path, camera, truth, gap, on_error) for path in drives])


def _drive(folder: Path, camera: str, truth: str, gap: float, on_error: Policy) -> FrameTable:
    name = folder.absolute().name
    frames = read_recorded(folder / camera, sequence=name, on_error=on_error)
    x, y, theta = joined(frames.time, _table(folder, f"-{truth}.csv", _TRUTH), gap)[:, :3].T
    columns: dict[str, Array] = {"x": x, "y": y, "theta": theta}
    if any(folder.glob("*-ODOMETRY_XYT.csv")):
        wheels = joined(frames.time, _table(folder, "-ODOMETRY_XYT.csv", _WHEELS), gap)
        columns |= dict(zip(ODOMETRY, wheels.T, strict=False))
    frames = frames.with_columns(**columns, building=[name.partition("_")[0]] * len(frames))
    return placed(frames, f"images of {folder} have no true pose", on_error)


def _table(folder: Path, end: str, columns: tuple[int, ...]) -> Trajectory:
    path = next(folder.glob(f"*{end}"), folder / f"{folder.absolute().name}{end}")
    numbers = read_numbers(path)[0]
    if numbers.shape[1] <= max(columns):
        raise DataError(f"{path} has {numbers.shape[1]} columns, expected at least {max(columns) + 1}")
    time, *pose = numbers[:, list(columns)].T
    return Trajectory.planar(time, np.column_stack(pose), str(path))
