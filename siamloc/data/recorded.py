"""Reader of recordings: a folder of images, and a trajectory in another file, joined by time."""

from __future__ import annotations

from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np

from foundation.files import expanded
from foundation.settings import Positive, shortened
from foundation.words import as_words
from siamloc.data.frames import BAGS, ODOMETRY, TILT, FrameTable, in_capture_order, placed
from siamloc.data.image_files import image_files, no_images, say_not_read
from siamloc.data.names import lighting_in
from siamloc.data.picture_times import taken_at
from siamloc.data.text_rows import headed, is_number
from siamloc.data.trajectory import Array, Axes, Form, Order, Trajectory, read_trajectory, seconds
from siamloc.data.trajectory_checks import doubts
from siamloc.errors import DataError, Policy, logger

COLUMNS_OF = {"poses": ("x", "y", "theta", *TILT), "odometry": ODOMETRY}
"""The columns of a `FrameTable` that the poses in the plane of a trajectory fill."""
_OTHER_UNIT = 300  # times as long a drive counts other units than seconds
_ANY_DRIVE = {"rgb", "data", "images", "image", "frames", "mav0", "cam0", "cam1", "image_0", "image_2"}
_ANY_DRIVE |= {f"image_0{number}" for number in range(4)}
_TIMES = "timestamps.txt"  # of the raw data of KITTI, beside the folder of the images


def read_recorded(
    images: str | Path,
    poses: str | Path | None = None,
    *,
    times: str | Path | None = None,
    odometry: str | Path | None = None,
    form: Form | None = None,
    order: Order | None = None,
    axes: Axes | None = None,
    offset: float = 0.0,
    gap: Positive = 2.0,
    sequence: str = "",
    lighting: str = "",
    on_error: Policy = "skip",
) -> FrameTable:
    """Read a folder of images with a trajectory in TUM, KITTI, EuRoC or planar form, joined by time.

    Poses are interpolated between the two entries of the trajectory around the time of an image. Images without such
    entries are left out and reported. A trajectory in KITTI form has a pose for each image.

    Args:
        images: folder of the images.
        poses: the trajectory; see `siamloc.data.trajectory.read_trajectory`. Without it frames have no poses.
        times: list of the images' times: a time on each line, in the order of the names, or a time and a file name, in
            either order, as `rgb.txt` of TUM and `data.csv` of EuRoC; a time may be a date with a time of day, in UTC
            where it has no time zone. Without the list, the time is the number at the end of an image's name, what its
            camera wrote into the file, or the date and time in its name (`siamloc.data.picture_times.taken_at`), else
            that in `timestamps.txt` in or beside the folder, as in the raw data of KITTI.
        odometry: the trajectory by the robot's wheels.
        form: form of the trajectories; found out if None.
        order: order of their quaternions, if it is another than that of the form.
        axes: whose poses they are: "robot", with x ahead and z up, or "camera", with z ahead and y down; "camera" in
            KITTI form and otherwise "robot" if None. With "camera", the poses or the odometry may be a robot's, see
            `siamloc.data.trajectory.Trajectory.own_axes`.
        offset: seconds to add to the images' times for those of the trajectories, which the frames' times then are.
        gap: longest time between two entries, in s, over which poses are interpolated.
        sequence: name of the drive; the folder's name if empty.
        lighting: lighting of the drive; the one in its name if empty.
        on_error: "skip" or "raise", for images without a pose.

    Raises:
        DataError: a file that cannot be used as it is (with line), names without times, or clocks that differ.
    """
    folder = expanded(images)
    given = {
        what: read_trajectory(expanded(file), form, order)
        for what, file in (("poses", poses), ("odometry", odometry))
        if file is not None
    }
    span = next((length for one in given.values() if (length := float(np.ptp(one.time))) > 0), None)
    files, taken = images_of(folder, None if times is None else expanded(times), span)
    taken = taken + offset
    columns: dict[str, Array] = {"time": taken}
    for what, trajectory in given.items():
        timed = bool(np.isfinite(trajectory.time).all())
        usual: Axes = "robot" if timed else "camera"
        own = trajectory.own_axes(axes or usual, beside=what == "odometry" and len(given) > 1)
        for doubt in doubts(trajectory, own):
            logger.warning("%s", doubt)
        found = joined(taken, trajectory, gap, own, offset) if timed else _in_order(len(files), trajectory, own)
        columns |= dict(zip(COLUMNS_OF[what], found.T, strict=False))
    name = sequence or next((part for part in reversed(folder.absolute().parts) if part not in _ANY_DRIVE), "")
    labels = {"sequence": [name] * len(files), "lighting": [lighting or lighting_in(name)] * len(files)}
    frames = FrameTable(path=[str(file) for file in files], **columns, **labels)  # type: ignore[arg-type]
    if poses is not None:
        what = f"images of {folder} were taken outside of {poses}, or in a gap of more than {gap:g} s"
        frames = placed(frames, what, on_error)
    return in_capture_order(frames)


def joined(taken: Array, trajectory: Trajectory, gap: float, axes: Axes = "robot", offset: float = 0.0) -> Array:
    """Return the poses in the plane, roll and pitch (n, 5) at the times of images (n,), NaN where there is no pose.

    The times contain the `offset`, which messages name.

    Raises:
        DataError: the images have no times, none was taken during the trajectory, or its frame does not stay upright.
    """
    check_taken(taken)
    check_clocks(taken, trajectory, offset)
    return trajectory.at(taken, gap).tilted(axes, trajectory)


def check_clocks(taken: Array, trajectory: Trajectory, offset: float) -> None:
    """Refuse a trajectory during which no image was taken, by the times of the first and the last one, with offset."""
    if taken.max() < trajectory.time[0] or taken.min() > trajectory.time[-1]:
        spans = float(np.ptp(taken)), float(np.ptp(trajectory.time))
        remedy = (
            "these are two clocks; give offset=SECONDS, which is added to the images' times "
            f"({trajectory.time[0] - taken.min() + offset:.3f} lets both begin together)"
        )
        if 0 < _OTHER_UNIT * min(spans) < max(spans):
            which = "images' times" if spans[0] > spans[1] else "times of the poses"
            remedy = f"the {which} seem to count ms, us or ns from a start of their own; write them in seconds"
        shifted = f" with offset={offset:.3f}" if offset else ""
        raise DataError(
            f"the images were taken between {taken.min():.3f} and {taken.max():.3f} s{shifted}, and "
            f"{trajectory.source} has poses between {trajectory.time[0]:.3f} and {trajectory.time[-1]:.3f} s: {remedy}"
        )


def check_taken(taken: Array) -> None:
    """Refuse images without times."""
    if not np.isfinite(taken).all():
        raise DataError(
            "the images have no times: neither do their names end in a number of seconds or ns, or hold a date and "
            "time, nor did their camera write a time into each file (small whole numbers are taken for counters), so "
            "give times=FILE, with a time on each line"
        )


def _in_order(count: int, trajectory: Trajectory, axes: Axes) -> Array:
    if count != len(trajectory):
        raise DataError(
            f"{trajectory.source} holds {len(trajectory)} poses without times, and there are {count} images: "
            "expected a pose for each"
        )
    return trajectory.tilted(axes)


def images_of(
    folder: Path, times: Path | None = None, span: float | None = None, second: tuple[str, str] | None = None
) -> tuple[list[Path], Array]:
    """Return the images of a folder and the times at which they were taken, in s; NaN if unknown.

    Args:
        folder: the folder.
        times: list of the times; see `read_recorded`.
        span: as for `siamloc.data.trajectory.seconds`.
        second: as for `siamloc.data.image_files.image_files`.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of images")
    files = image_files(folder, second)
    if not files:
        inside = sorted(path.name for path in folder.iterdir())
        if bag := next((name for name in inside if name.lower().endswith(BAGS)), None):
            command = f"siamloc prepare {as_words({'recording.file': folder / bag})}"
            raise DataError(
                f"{folder} holds no images, and no metadata.yaml as the folder of a ROS 2 bag does: "
                f"`{command}` reads the file of the bag; `rosbags-convert --src FILES --dst FOLDER` joins parts"
            )
        raise DataError(no_images(folder))
    say_not_read(folder)
    there, own = {file.name: file for file in files}, times is None
    if times is None:
        taken = taken_at(files, span)
        times = next((path for place in (folder, folder.parent) if (path := place / _TIMES).is_file()), None)
        if np.isfinite(taken).all() or times is None:
            return files, taken
    _, rows = headed(times)
    bare = len(rows[0][1]) == 1
    if own:
        named = {name for _, words in rows if (name := _named(words, there)[0])}
        if len(rows) != len(files) if bare else len(named) < len(files):
            logger.warning("%s is not used: it has no time for each of the %d images of %s", times, len(files), folder)
            return files, taken
    if bare:
        if len(rows) != len(files):
            raise DataError(f"{times} holds {len(rows)} times for {len(files)} images in {folder}: expected one each")
        return files, _times(times, [words[0] for _, words in rows], span)
    listed = dict[str, tuple[int, str]]()
    for number, words in rows:
        name, time = _named(words, there)
        if name and not is_number(time):
            line = shortened(" ".join(words))
            raise DataError(f"{times}, line {number}: expected a time and the name of an image, got {line!r}")
        if name in listed:
            raise DataError(
                f"{times}, line {number}: image {name!r} is already in line {listed[name][0]}: remove one of the lines"
            )
        if name:
            listed[name] = number, time
    if not listed:
        line = shortened(" ".join(rows[0][1]))
        raise DataError(
            f"{times} names no image of {folder}: expected a time and the name of an image on each line, got {line!r}"
        )
    return [there[name] for name in listed], _times(times, [time for _, time in listed.values()], span)


def _named(words: list[str], there: Container[str]) -> tuple[str, str]:
    """Return the image in a row and the time before it, or after it at the end; else two empty texts.

    A name may hold spaces.
    """
    last = len(words) - 1
    for start, end in (*((1, end) for end in range(2, last + 2)), (0, last)):
        name = Path(" ".join(words[start:end])).name
        if name in there:
            return name, words[0 if start else last]
    return "", ""


def _times(path: Path, words: Sequence[str], span: float | None) -> Array:
    try:
        return seconds(np.array(words, dtype=np.float64), str(path), span)
    except ValueError as error:
        raise DataError(f"{path} is not a list of times: {error}") from error
