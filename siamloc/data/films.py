"""`Film`: the pictures of a video, past those that cannot be decoded."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data.bags import Clock
from siamloc.data.image_files import UnreadableImageError
from siamloc.errors import DataError, Policy, logger

_MOST = 3000  # pictures in a row that cannot be decoded, after which a video has ended: OpenCV does not say which it is
_EARLY = 0.5, 0.01  # s, and share of the length, by which a whole video may end before what it announces
COUNTED = (".avi", ".mp4", ".mov")  # files that hold the number of their pictures: OpenCV estimates that of others
_SILENT = 0  # of OpenCV's levels of messages
_FFMPEG_LEVEL, _FFMPEG_SILENT = "OPENCV_FFMPEG_LOGLEVEL", "-8"


class Film:
    """A video that is open inside a `with` block, with the methods of a `Bag`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._given, self._damaged, self._last = 0, 0, 0.0  # pictures, and the time of the last one in s

    def __enter__(self) -> Film:
        with quiet():
            self._film = cv2.VideoCapture(str(self.path))
        count, self._rate = (self._film.get(key) for key in (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS))
        if not self._film.isOpened() or not self._rate > 0:
            raise DataError(f"{self.path} cannot be read as a video: it is damaged, or in a format that OpenCV lacks")
        self.topics = {"video": ("video", max(int(count), 0))}
        self.seconds = max(count, 0) / self._rate
        return self

    def __exit__(self, *_: object) -> None:
        self._film.release()

    def images(
        self, topic: str = "video", clock: Clock = "stamp"
    ) -> Iterator[tuple[int, NDArray[np.uint8] | UnreadableImageError, str]]:
        """Yield the time in ns, the pixels (rows, columns, 3), RGB, and the ending of the file of each picture.

        A picture that cannot be decoded comes as the error that says so.
        """
        number = lost = 0
        while lost < _MOST:
            there, picture = self._film.read()
            number += 1
            if not there:
                lost += 1
                continue
            for one in range(number - 1 - lost, number - 1):
                damaged = UnreadableImageError(f"{self.path}#{one} cannot be decoded: the video is damaged there")
                self._damaged += 1
                yield round(one / self._rate * 1e9), damaged, ""
            lost = 0
            self._given += 1
            time = self._film.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            seconds = time if time > 0 else (number - 1) / self._rate  # some formats know no times of pictures
            self._last = max(self._last, seconds)
            yield round(seconds * 1e9), np.ascontiguousarray(picture[:, :, ::-1]), ".jpg"

    def check_whole(self, on_error: Policy) -> None:
        """Warn, after the last picture, of pictures that the video announces and has not given.

        Raises:
            DataError: with on_error=raise, the video ends well before the length that it announces.
        """
        announced, given = self.topics["video"][1], self._given
        shown = max(self._last / max(given - 1, 1), 1 / self._rate)  # s
        early, allowed = self.seconds - self._last - shown, _EARLY[0] + _EARLY[1] * self.seconds
        missing = announced - given - self._damaged
        trimmed = "unless it was trimmed without being encoded again"
        if early > allowed:
            short = (
                f"{self.path} ends {early:.1f} s early, after {given} of the {announced} pictures that it announces: "
                f"its end is missing or damaged, {trimmed}"
            )
            if on_error == "raise":
                raise DataError(f"{short} (on_error=skip takes what is there)")
            logger.warning("%s", short)
        elif missing > (0 if self.path.suffix.lower() in COUNTED else allowed * self._rate):
            logger.warning(
                "%s lacks %d of the %d pictures that it announces: they are damaged, %s",
                *(self.path, missing, announced, trimmed),
            )


@contextmanager
def quiet() -> Iterator[None]:
    """Silence OpenCV's and FFmpeg's messages about a missing camera or video: the error raised here reports it."""
    log = getattr(cv2.utils, "logging", cv2)  # where the functions are from OpenCV 4.13 on
    level = log.getLogLevel()
    log.setLogLevel(_SILENT)
    chosen = os.environ.setdefault(_FFMPEG_LEVEL, _FFMPEG_SILENT)  # read when the first video is opened
    try:
        yield
    finally:
        log.setLogLevel(level)
        if chosen is _FFMPEG_SILENT:
            os.environ.pop(_FFMPEG_LEVEL, None)
