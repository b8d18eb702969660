"""`Collector`: keeps the pictures of a robot that were located well, for an update of its map."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.files import scratch_folder, storage_errors, write_picture
from siamloc.data.frames import FrameTable
from siamloc.data.names import NamedPose, format_name, parse_name
from siamloc.data.panorama import shows_nothing
from siamloc.errors import DataError, StorageError, say_once
from siamloc.runtime.location import Location

MOST = 2000
"""Number of pictures that a collector leaves in a folder, by default."""
SINCE = "@"
"""What parts the name of a drive from the time of its newest picture, where a map counts a collected drive."""
_CERTAIN = 0.25  # largest standard deviation of a position, in the unit of the map
_AGREEMENT = 0.5  # least agreement on a pose about which nothing else is known
_APART, _TURNED = 0.1, math.radians(20)  # by how much pictures differ, in the unit of the map and in rad
_ELSEWHERE = 1.0  # farther than that apart are two places, in the unit of the map
_SLIP = 0.2  # share of their way by which wheels may be wrong
_PROVEN = 3.0  # how far from where it moved otherwise than the wheels a tracker counts as right again, in that unit
_FOLLOWED = 9.0  # and after which way along the wheels
_WAITING = 200  # largest number of pictures in memory


class Collector:
    """Keeps panoramas with their poses in a folder: `<folder>/<start of the drive>/<time and pose>.png`.

    A picture is kept if its position in the map is certain: its standard deviation, or else its expected error, is at
    most 0.25, however exact the map is, and it is recognized there. It is taken at least 0.1 or 20 degrees away from
    the one before. A picture that only the tracker of a robot locates waits in memory until a later picture is
    recognized where the tracker has the robot; it is dropped if the tracker was wrong, or if the drive ends before.
    Where the tracker moves otherwise than the wheels, by more than 1 and a fifth of their way, all pictures wait until
    it is 3 away from there, or has followed the wheels for 9.

    Args:
        folder: the folder, with a folder for each drive.
        most: number of pictures in the folder, of those there at the start and its own; the oldest are removed for
            others.
        headings: whether the map gives headings; without, they are 0 in the names of the files.

    Raises:
        StorageError: the folder cannot be written to.
    """

    def __init__(self, folder: str | Path, most: int = MOST, headings: bool = True) -> None:
        self.folder, self.most, self.headings = Path(folder), most, headings
        with scratch_folder(self.folder / "drive"):  # refuses a folder that cannot be written to
            self._kept = [path for path, _ in _pictures(self.folder)]
        self._waiting = deque[tuple[NamedPose, NDArray[np.uint8]]](maxlen=_WAITING)
        self._lock = threading.Lock()
        self.begin()

    def begin(self) -> None:
        """Begin another drive."""
        with self._lock:
            self.drive = self.folder / f"{time.strftime('drive-%Y%m%d-%H%M%S')}-{secrets.token_hex(4)}"
            self._since = time.time() - time.monotonic()  # so that times rise within a drive, whatever sets the clock
            self._before: NamedPose | None = None
            self._last: NamedPose | None = None
            self._leapt: NamedPose | None = (
                None  # to where the tracker leapt against the wheels, until it counts as right
            )
            self._way = 0.0  # along the wheels since then
            self._gap = True  # whether the wheels' last motion does not lead here from the picture before
            self._waiting.clear()

    def take(
        self,
        panorama: NDArray[np.uint8],
        location: Location,
        tracked: bool,
        map_variance: float = 0.0,
        motion: ArrayLike | None = None,
    ) -> Path | None:
        """Keep a panorama (3, H, W), uint8, RGB, if it was located well; return its file, None if it has none yet.

        A disk that is full or cannot be written to is a warning: the robot drives on.

        Args:
            panorama: the panorama.
            location: where it was taken.
            tracked: whether the location is that of a tracked robot.
            map_variance: the part of the location's variances that is the map's, as in `RefinedPoses`.
            motion: how the robot moved since the picture before, as for `Localizer.locate`; None or NaN if unknown.
        """
        place = location.x, location.y, location.theta if self.headings else 0.0
        with self._lock:
            if not all(map(math.isfinite, place)):
                self._gap = True
                return None
            pose = NamedPose(self._since + time.monotonic(), *place)
            before, self._before = self._before, pose
            step = 0.0 if before is None else _apart(before, pose)
            told = math.nan if self._gap or motion is None else math.hypot(*np.asarray(motion, dtype=float)[:2])
            wheels, told, self._gap = not math.isnan(told), np.nan_to_num(told), False
            leap = abs(step - told)
            if leap > _ELSEWHERE + _SLIP * told:
                self._waiting.clear()  # the tracker was wrong
                if wheels and (self._leapt is None or leap > _PROVEN):
                    self._leapt, self._way = pose, 0.0
            else:
                self._way += min(step, told)
            if self._leapt is not None and (_apart(self._leapt, pose) >= _PROVEN or self._way >= _FOLLOWED):
                self._leapt = None
            recognized = _recognized(location, tracked) and self._leapt is None
            if not _certain(location, map_variance) or not (
                recognized or (tracked and not shows_nothing(panorama[None])[0])
            ):
                return None
            if self._last is not None:
                turned = abs(math.remainder(pose.theta - self._last.theta, 2 * math.pi))
                if _apart(self._last, pose) < _APART and turned < _TURNED:
                    return None
            self._last = pose
            self._waiting.append((pose, panorama.copy()))
            try:
                return self._written() if recognized else None
            except StorageError:
                say_once(f"{self.folder} takes no more images, which are not collected: free some space on its disk")
                return None

    def _written(self) -> Path:
        """Write the waiting pictures, and return the file of the last one."""
        while self._waiting:
            pose, panorama = self._waiting.popleft()
            path = self.drive / format_name(pose, ".png")
            write_picture(path, np.ascontiguousarray(panorama.transpose(1, 2, 0)))
            self._kept.append(path)
        while len(self._kept) > self.most:
            oldest = self._kept.pop(0)
            with storage_errors(oldest):
                oldest.unlink(missing_ok=True)
        return path


def _apart(one: NamedPose, other: NamedPose) -> float:
    return math.hypot(one.x - other.x, one.y - other.y)


def _certain(location: Location, map_variance: float) -> bool:
    """Whether the position of a picture in the map is certain."""
    if location.covariance is None:
        return location.error_m <= _CERTAIN  # NaN is not
    (xx, _), (_, yy) = location.covariance
    return (xx + yy) / 2 - map_variance <= _CERTAIN**2


def _recognized(location: Location, tracked: bool) -> bool:
    """Whether a picture alone shows that the robot is where it was located."""
    if location.lost:
        return False
    if tracked and math.isnan(location.agreement):
        nearest = location.candidates[0]
        return math.hypot(nearest.x - location.x, nearest.y - location.y) <= _ELSEWHERE
    return (location.lost is False and not tracked) or location.agreement >= _AGREEMENT


def collected(folder: str | Path) -> list[FrameTable]:
    """Return the pictures that collectors kept in a folder, a table of frames with poses and times for each drive.

    Raises:
        DataError: there is no such folder, or it holds no picture.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder: give the one in which a Localizer(..., collect=folder) collected")
    drives: dict[str, list[dict[str, Any]]] = {}
    for path, pose in _pictures(folder):
        row = {"path": str(path), "sequence": path.parent.name, **pose._asdict()}
        drives.setdefault(path.parent.name, []).append(row)
    if not drives:
        raise DataError(f"{folder} holds no picture that was located well: let the robot drive longer")
    return [FrameTable.from_rows(rows) for _, rows in sorted(drives.items())]


def _pictures(folder: Path) -> list[tuple[Path, NamedPose]]:
    """Return the pictures that collectors kept in a folder, oldest first, with the times and poses in their names."""
    named = ((path, parse_name(path.name)) for path in folder.glob("*/*.png"))
    return sorted(((path, pose) for path, pose in named if pose is not None), key=lambda picture: picture[1].time)
