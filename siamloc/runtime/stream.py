"""Read images from files, folders, videos and cameras, and locate them one after the other."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from os.path import abspath
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import atomic_path, csv_text, expanded, plain
from foundation.words import as_words
from siamloc.data.checks import wrong_odometry
from siamloc.data.films import Film, quiet
from siamloc.data.frames import BAGS, METADATA, VIDEOS, FrameTable
from siamloc.data.image_files import UnreadableImageError, image_files, no_images, say_not_read
from siamloc.data.manifest import read_rows
from siamloc.data.moves import moves
from siamloc.data.names import NamedPose, parse_name
from siamloc.errors import ConfigError, DataError, Policy
from siamloc.maps.motion import WrongUnitError
from siamloc.runtime.localizer import Localizer
from siamloc.runtime.location import Location

CAMERA = "camera:"
COLUMNS = (
    *("image", "x", "y", "theta", "room", "error_m", "lost", "covariance_xx", "covariance_xy", "covariance_yy"),
    *("agreement", "match", "distance", "ms", "off_by"),
)
"""Columns of a table of locations."""
_UNKNOWN: NDArray[np.float64] = np.full(5, np.nan)
_UNKNOWN.flags.writeable = False


@dataclass(frozen=True)
class Located:
    """The outcome of locating one image: its location, or why the image could not be read.

    Attributes:
        image: name of the file; for a video or a camera, with the number of the frame, such as "drive.mp4#12".
        location: where the image was taken; None if it could not be read.
        fault: why the image could not be read; "" otherwise.
        pose: the pose in its file name, as in COLD's names; None if the name holds none.
    """

    image: str
    location: Location | None
    fault: str = ""
    pose: NamedPose | None = None

    @property
    def off_by(self) -> float:
        """Distance between the location and the pose in the file name, in the map's unit; NaN if either is unknown."""
        if self.location is None or self.pose is None:
            return math.nan
        return math.hypot(self.location.x - self.pose.x, self.location.y - self.pose.y)

    def describe(self, unit: str = "m") -> str:
        """Return the location, or the fault, as one line of text."""
        if self.location is None:
            return f"left out: {self.fault}"
        off = "" if math.isnan(self.off_by) else f"; {self.off_by:.2f} {unit} from the pose in its name"
        return f"{self.image}: {self.location.describe(unit)}{off}"

    def row(self) -> dict[str, object]:
        """Return the location as a row of a table, by the names in `COLUMNS`; unknown values are ""."""
        if self.location is None:
            return {**dict.fromkeys(COLUMNS, ""), "image": self.image}
        told = self.as_dict()
        best, ((xx, xy), (_, yy)) = told["candidates"][0], told["covariance"] or ((None, None), (None, None))
        told |= {"covariance_xx": xx, "covariance_xy": xy, "covariance_yy": yy}
        told |= {"match": best["image"], "distance": best["distance"], "ms": round(told["ms"], 2)}
        return {name: "" if told[name] is None else told[name] for name in COLUMNS}

    def as_dict(self) -> dict[str, Any]:
        """Return the location as plain values for a line of JSON; unknown values are None."""
        told = {} if self.location is None else asdict(self.location)
        pose = None if self.pose is None else self.pose._asdict()
        return plain({"image": self.image, "fault": self.fault or None, **told, "pose": pose, "off_by": self.off_by})


@typed
def locate_all(
    localizer: Localizer,
    images: str | Path | Sequence[str | Path],
    on_error: Policy = "skip",
    track: bool = False,
    seen: Callable[[NDArray[np.uint8]], None] | None = None,
    odometry: str | Path | None = None,
) -> Generator[Located, None, None]:
    """Locate images one after the other, each as soon as it arrives; the images are not kept.

    Args:
        localizer: locates them.
        images: image files, folders of them, video files, and cameras of this machine, such as "camera:0"; or one.
            Folders are listed once: images that come later are not located. Of two pictures of a `DualFisheyeCamera`
            the second goes with the first.
        on_error: "skip" reports an image that cannot be read and continues; "raise" stops there, and at the end of a
            video whose end is missing.
        track: follow the robot from image to image, see `Localizer.tracker`; each folder, video and camera is a drive.
        seen: called with each panorama (3, H, W), uint8, RGB, before it is located.
        odometry: how the robot moved from image to image, for `track`: a manifest, or any CSV table with the columns
            `image`, `odom_x`, `odom_y` (in the map's unit) and `odom_theta` (rad); paths are relative to its folder,
            and the first image of a video is called "drive.mp4#0". With the columns `roll` and `pitch` (rad), the tilt
            of the robot is taken out of the images.

    Yields:
        The outcome for each image, in order.

    Raises:
        ConfigError: no images given, a bundle that cannot follow a robot, or odometry without `track`.
        DataError: a file that does not exist, a folder without images, a video that cannot be read, holds no
            images, or, with on_error="raise", lacks its end, a camera that gives no image or stops, or odometry that
            cannot be used, is of other images, or is in another unit than the map, which the first images that are
            recognized along a way show.
    """
    if odometry is not None and not track:
        raise ConfigError(f"odometry={odometry} says how the robot is followed: set track=true (in Python track=True)")
    wheels = {} if odometry is None else read_odometry(odometry)
    second = localizer.bundle.preprocessing.second
    names = [str(path) for name, files in named(images, second) for path in files or [Path(name)]]
    in_table = {*wheels, *(path.rpartition("#")[0] for path in wheels)}
    if wheels and not any(abspath(name) in in_table for name in names):  # noqa: PTH100
        raise DataError(
            f"{odometry} names none of the images, such as {names[0]}: paths are relative to its folder, and the first "
            "image of drive.mp4 is drive.mp4#0"
        )
    tracker, drive, last = None, "", _UNKNOWN
    for name, image, pose in pictures(images, on_error, second):
        before, drive = drive, str(image.parent) if isinstance(image, Path) else name.rpartition("#")[0]
        if track and drive != before:
            tracker, last = localizer.tracker(), _UNKNOWN
        here = wheels.get(abspath(name), _UNKNOWN)  # noqa: PTH100
        motion = moves([last[:3], here[:3]])[1] if wheels else None
        try:
            if isinstance(image, UnreadableImageError):
                raise DataError(str(image))
            location = localizer.locate(image, tracker, seen, motion, here[3:] if np.isfinite(here[3:]).all() else None)
            last = here
            yield Located(name, location, pose=pose)
        except DataError as error:
            if on_error == "raise" or isinstance(error, WrongUnitError):
                raise
            yield Located(name, None, str(error), pose)


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


def pictures(
    images: str | Path | Sequence[str | Path], on_error: Policy = "skip", second: tuple[str, str] | None = None
) -> Iterator[tuple[str, Path | NDArray[np.uint8] | UnreadableImageError, NamedPose | None]]:
    """Yield for each image its name, the image (a file, or pixels in RGB), and the pose in its name.

    A picture of a video that cannot be decoded comes as the error that says so.

    All names are checked before the first image is yielded.

    Raises:
        ConfigError, DataError: as `locate_all`.
    """
    for name, files in named(images, second):
        if files is None:
            yield from _live(name) if name.startswith(CAMERA) else _filmed(name, on_error)
        else:
            yield from ((str(path), path, parse_name(path.name)) for path in files)


def named(
    images: str | Path | Sequence[str | Path], second: tuple[str, str] | None = None
) -> list[tuple[str, list[Path] | None]]:
    """Return the image files in each named file or folder; None in place of a video or a camera.

    Args:
        images: as for `locate_all`.
        second: as for `siamloc.data.image_files.image_files`.

    Raises:
        ConfigError: no names.
        DataError: a file that does not exist, or a folder without images.
    """
    names = [expanded(one) for one in ([images] if isinstance(images, (str, Path)) else images)]
    if not names:
        raise ConfigError("no images given: name files, folders, videos or cameras, images=[a.jpeg,folder,camera:0]")
    return [(str(name), _files(name, second)) for name in names]


def _files(path: Path, second: tuple[str, str] | None) -> list[Path] | None:
    if str(path).startswith(CAMERA):
        return None
    folder = path.is_dir()
    if folder and (files := image_files(path, second)):
        say_not_read(path)
        return files
    if not folder and not path.is_file():
        number = re.fullmatch(r"/dev/video(\d+)", str(path))
        there = f"the camera {path} is called {CAMERA}{number[1]} here" if number else f"there is no image {path}"
        raise DataError(there)
    if (path / METADATA).is_file() or (not folder and path.suffix.lower() in BAGS):
        command = f"siamloc prepare {as_words({'recording.file': path})}"
        raise DataError(f"{path} is a ROS bag: `{command}` writes its images into a folder")
    if folder:
        raise DataError(no_images(path))
    return None if path.suffix.lower() in VIDEOS else [path]


def _filmed(name: str, on_error: Policy) -> Iterator[tuple[str, NDArray[np.uint8] | UnreadableImageError, None]]:
    """Yield the pictures of a video, and an error in place of each that cannot be decoded."""
    number = -1
    with Film(Path(name)) as film:
        for number, (_, picture, _) in enumerate(film.images()):
            yield f"{name}#{number}", picture, None
    if number < 0:
        raise DataError(f"{name} holds no images")
    film.check_whole(on_error)


def _live(name: str) -> Iterator[tuple[str, NDArray[np.uint8], None]]:
    """Yield the pictures of a camera for as long as it delivers any."""
    number = name.removeprefix(CAMERA)
    if not number.isdigit():
        raise ConfigError(f"{name} is not a camera: give its number, such as {CAMERA}0")
    with quiet():
        camera = cv2.VideoCapture(int(number))
    given = 0
    try:
        while camera.isOpened():
            there, picture = camera.read()
            if not there:
                break
            yield f"{name}#{given}", np.ascontiguousarray(picture[:, :, ::-1]), None
            given += 1
    finally:
        camera.release()
    what = f"no more images after {given}" if given else "no image"
    raise DataError(f"{name} gives {what}: check that it is plugged in")


@typed
def written(path: str | Path, located: Iterable[Located]) -> Generator[Located, None, None]:
    """Write locations to a file while passing them on; the file appears after the last location.

    The file is also written, with all locations up to there, if the caller stops early, is interrupted, or an image
    after the first raises an error; but not if the odometry is in another unit, which makes all locations wrong.

    Args:
        path: a table with `COLUMNS`, name.csv, or one line of JSON per location, name.jsonl.
        located: the locations, as yielded by `locate_all`.

    Raises:
        ConfigError: another file extension.
        StorageError: the disk is full or cannot be written to.
    """
    path = Path(path)
    if path.suffix not in LINES:
        raise ConfigError(f"{path} must be a table (.csv) or lines of JSON (.jsonl)")
    head, line = LINES[path.suffix]
    count, stopped = 0, None
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file,
    ):
        file.write(head)
        try:
            for one in located:
                file.write(line(one))
                count += 1
                yield one
        except (GeneratorExit, KeyboardInterrupt, DataError) as stop:
            if isinstance(stop, WrongUnitError) or not (count or isinstance(stop, GeneratorExit)):
                raise
            stopped = stop
    if stopped is not None and not isinstance(stopped, GeneratorExit):
        raise stopped


LINES: dict[str, tuple[str, Callable[[Located], str]]] = {
    ".csv": (csv_text([COLUMNS]), lambda located: csv_text([located.row().values()])),
    ".jsonl": ("", lambda located: json.dumps(located.as_dict(), ensure_ascii=False, allow_nan=False) + "\n"),
}
"""The first line of a file of locations, and the function that formats each further line, by file extension."""
