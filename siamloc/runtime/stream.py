"""Images one after the other, from files, folders, videos and cameras, and where each was taken."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from siamloc.calls import typed
from siamloc.data.frames import image_files
from siamloc.data.names import NamedPose, parse_name
from siamloc.errors import ConfigError, DataError
from siamloc.files import atomic_path, plain
from siamloc.runtime.localizer import Localizer, Location

VIDEOS = {".mp4", ".avi", ".mkv", ".mov", ".webm", ".mjpeg", ".mpg"}
CAMERA = "camera:"
_FFMPEG_LEVEL, _FFMPEG_SILENT = "OPENCV_FFMPEG_LOGLEVEL", "-8"
COLUMNS = (
    *("image", "x", "y", "theta", "room", "error_m", "lost", "covariance_xx", "covariance_xy", "covariance_yy"),
    *("agreement", "match", "distance", "ms", "off_by"),
)
"""Of a row of a table of locations."""


@dataclass(frozen=True)
class Located:
    """What came of one image.

    Attributes:
        image: its file; of a video or a camera with the number of the picture behind it, such as "drive.mp4#12".
        location: where it was taken; None where the image could not be read.
        fault: why it could not be read; "" otherwise.
        pose: where its name says that it was taken, as COLD's names do; None where the name says nothing.
    """

    image: str
    location: Location | None
    fault: str = ""
    pose: NamedPose | None = None

    @property
    def off_by(self) -> float:
        """Distance between the location and the pose in the name; NaN where either is unknown."""
        if self.location is None or self.pose is None:
            return math.nan
        return math.hypot(self.location.x - self.pose.x, self.location.y - self.pose.y)

    def describe(self, unit: str = "m") -> str:
        """Say it in one line."""
        if self.location is None:
            return f"left out: {self.fault}"
        off = "" if math.isnan(self.off_by) else f"; {self.off_by:.2f} {unit} from the pose in its name"
        return f"{self.image}: {self.location.describe(unit)}{off}"

    def row(self) -> dict[str, object]:
        """Return it as a row with `COLUMNS`; what is unknown is ""."""
        if self.location is None:
            return {**dict.fromkeys(COLUMNS, ""), "image": self.image}
        location, best = self.location, self.location.candidates[0]
        (xx, xy), (_, yy) = location.covariance or ((math.nan, math.nan), (math.nan, math.nan))
        values = (
            *(self.image, location.x, location.y, location.theta, location.room, location.error_m, location.lost),
            *(xx, xy, yy, location.agreement, best.image, best.distance, round(location.ms, 2), self.off_by),
        )
        return dict(zip(COLUMNS, map(_cell, values), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values, as a line of JSON holds them; what is unknown is None."""
        told = {} if self.location is None else asdict(self.location)
        pose = None if self.pose is None else self.pose._asdict()
        return plain({"image": self.image, "fault": self.fault or None, **told, "pose": pose, "off_by": self.off_by})


@typed
def locate_all(
    localizer: Localizer,
    images: str | Path | Sequence[str | Path],
    on_error: Literal["skip", "raise"] = "skip",
    track: bool = False,
    seen: Callable[[NDArray[np.uint8]], None] | None = None,
) -> Generator[Located, None, None]:
    """Locate images one after the other, each as soon as it is there; nothing of them is kept.

    Args:
        localizer: what locates them.
        images: image files, folders of them, video files, and cameras of this machine, such as "camera:0"; or one.
        on_error: "skip" goes on after an image that cannot be read, and says so; "raise" stops there.
        track: follow the robot from image to image, see `Localizer.tracker`; each folder, video and camera is a drive.
        seen: is given each panorama (3, H, W), uint8, RGB, before it is located.

    Yields:
        What came of each image, in order.

    Raises:
        ConfigError: no images named, or a bundle that cannot follow a robot.
        DataError: a file that is not there, a folder without images, a video or a camera that gives no picture, or a
            camera that stops.
    """
    tracker, drive = localizer.tracker() if track else None, ""
    for name, image, pose in pictures(images):
        before, drive = drive, str(image.parent) if isinstance(image, Path) else name.rpartition("#")[0]
        if tracker is not None and drive != before:
            tracker.reset()
        try:
            yield Located(name, localizer.locate(image, tracker, seen), pose=pose)
        except DataError as error:
            if on_error == "raise":
                raise
            yield Located(name, None, str(error), pose)


def pictures(
    images: str | Path | Sequence[str | Path],
) -> Iterator[tuple[str, Path | NDArray[np.uint8], NamedPose | None]]:
    """Yield what images are called, the image (a file, or pixels in RGB), and the pose in its name.

    All names are looked at before the first image is given out.

    Raises:
        ConfigError, DataError: as `locate_all`.
    """
    for name, files in named(images):
        if files is None:
            yield from _filmed(name)
        else:
            yield from ((str(path), path, parse_name(path.name)) for path in files)


def named(images: str | Path | Sequence[str | Path]) -> list[tuple[str, list[Path] | None]]:
    """Return which image files each name stands for; None for a video or a camera.

    Raises:
        ConfigError: no names.
        DataError: a file that is not there, or a folder without images.
    """
    names = [images] if isinstance(images, (str, Path)) else list(images)
    if not names:
        raise ConfigError("no images given: name files, folders, videos or cameras, images=[a.jpeg,folder,camera:0]")
    return [(str(name), _files(name)) for name in names]


def _files(name: str | Path) -> list[Path] | None:
    path = Path(name)
    if str(name).startswith(CAMERA):
        return None
    if path.is_dir():
        if not (files := image_files(path)):
            raise DataError(f"{path} holds no images")
        return files
    if not path.is_file():
        number = re.fullmatch(r"/dev/video(\d+)", str(name))
        there = f"the camera {path} is called {CAMERA}{number[1]} here" if number else f"there is no image {path}"
        raise DataError(there)
    return None if path.suffix.lower() in VIDEOS else [path]


def _filmed(name: str) -> Iterator[tuple[str, NDArray[np.uint8], None]]:
    """Yield the pictures of a video, or of a camera for as long as it gives any."""
    import cv2

    live = name.startswith(CAMERA)
    number = name.removeprefix(CAMERA)
    if live and not number.isdigit():
        raise ConfigError(f"{name} is no camera: give its number, such as {CAMERA}0")
    with _quiet():
        film = cv2.VideoCapture(int(number) if live else name)
    given = 0
    try:
        while film.isOpened():
            there, picture = film.read()
            if not there:
                break
            yield f"{name}#{given}", np.ascontiguousarray(picture[:, :, ::-1]), None
            given += 1
    finally:
        film.release()
    if not given:
        raise DataError(f"{name} gives no picture: " + ("look at its plug" if live else "it is no video, or empty"))
    if live:
        raise DataError(f"{name} gives no more pictures after {given}: look at its plug")


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence OpenCV's and FFmpeg's lines about a camera or a video that is not there: the sentence here says it."""
    import cv2

    log = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    chosen = os.environ.setdefault(_FFMPEG_LEVEL, _FFMPEG_SILENT)  # read when the first video is opened
    try:
        yield
    finally:
        log.setLogLevel(level)
        if chosen is _FFMPEG_SILENT:
            os.environ.pop(_FFMPEG_LEVEL, None)


@typed
def written(path: str | Path, located: Iterable[Located]) -> Generator[Located, None, None]:
    """Pass locations on, and write each into a file, which is there when the last has been passed on.

    A caller that stops before the end gets the file of what it was given, and so does one who is interrupted, or whose
    images end in an error after the first of them.

    Args:
        path: a table with `COLUMNS`, name.csv, or a line of JSON for each, name.jsonl.
        located: as `locate_all` gives it.

    Raises:
        ConfigError: another ending.
        StorageError: the disk refuses.
    """
    path = Path(path)
    if path.suffix not in LINES:
        raise ConfigError(f"{path} must be a table, .csv, or lines of JSON, .jsonl")
    line = LINES[path.suffix]()
    count, stopped = 0, None
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(line.head)
        try:
            for one in located:
                file.write(line(one))
                count += 1
                yield one
        except (GeneratorExit, KeyboardInterrupt, DataError) as stop:
            if not count and not isinstance(stop, GeneratorExit):
                raise
            stopped = stop
    if stopped is not None and not isinstance(stopped, GeneratorExit):
        raise stopped


class CsvLines:
    """Makes the lines of a table of locations."""

    def __init__(self) -> None:
        self._text = io.StringIO()
        self._writer = csv.DictWriter(self._text, COLUMNS, lineterminator="\n")
        self.head = ",".join(COLUMNS) + "\n"

    def __call__(self, one: Located) -> str:
        """Return the line of a location."""
        self._writer.writerow(one.row())
        line = self._text.getvalue()
        self._text.seek(0)
        self._text.truncate()
        return line


class JsonLines:
    """Makes a line of JSON for each location."""

    head = ""

    def __call__(self, one: Located) -> str:
        """Return the line of a location."""
        return json.dumps(one.as_dict(), ensure_ascii=False, allow_nan=False) + "\n"


LINES: dict[str, type[CsvLines] | type[JsonLines]] = {".csv": CsvLines, ".jsonl": JsonLines}
"""What makes the lines of a file with this ending, the first of them in `head`."""


def _cell(value: object) -> object:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
