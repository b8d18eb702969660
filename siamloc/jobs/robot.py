"""`siamloc localize` and `siamloc live`, which run without torch and without Hydra."""

from __future__ import annotations

import math
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median
from typing import TYPE_CHECKING, Annotated, Literal

from foundation.files import real_path
from foundation.settings import Count, Pace, Port, Rule, Text
from siamloc.errors import ConfigError, DataError
from siamloc.jobs.job import Job, Say, quiet
from siamloc.runs import Run, suggested_run

if TYPE_CHECKING:
    from siamloc.runtime import Localizer

Threads = Annotated[int, Rule("a whole number from 1 to 1,024", lambda value: 1 <= value <= 1024)]


@dataclass(frozen=True)
class Robot(Job):
    """Base of the two jobs of the robot.

    Attributes:
        images: files, folders, videos, and cameras such as camera:0.
        folder: folder of the run whose bundle is used.
        bundle: folder of a bundle, instead of a run's.
        top: number of map frames to list for each image.
        track: follow the robot from image to image; each folder, video and camera is a drive.
        odometry: table of the robot's odometry, for `track`; see `siamloc.runtime.locate_all`.
        threads: number of onnxruntime threads; onnxruntime chooses if None.
        providers: onnxruntime's execution providers in order of preference; see `siamloc.runtime.Localizer`.
        hierarchical: search the coarse layer first; if None, whenever the bundle has one.
        collect: folder that keeps the images that were located well; see `siamloc.runtime.Localizer`.
    """

    BY_HYDRA = False

    images: tuple[Text, ...] | Text = ()
    folder: Path | None = None
    bundle: Path | None = None
    top: Count = 3
    track: bool = False
    odometry: Path | None = None
    threads: Threads | None = None
    providers: tuple[Text, ...] | None = None
    hierarchical: bool | None = None
    collect: Path | None = None

    @property
    def bundle_folder(self) -> Path:
        """The folder of the bundle.

        Raises:
            ConfigError: neither a bundle nor a run is given.
        """
        bundle = Run(self.folder).bundle if self.bundle is None and self.folder is not None else self.bundle
        if bundle is None:
            raise ConfigError(f"no bundle and no run given: give bundle=FOLDER, or {suggested_run('give run=FOLDER')}")
        return bundle

    def localizer(self) -> Localizer:
        """Open the bundle and return its localizer; refuse a job without images.

        Raises:
            ConfigError: neither a bundle nor a run is given, or no images.
        """
        bundle = self.bundle_folder
        from siamloc.runtime import Localizer
        from siamloc.runtime.stream import named

        named(self.images)  # refused before the bundle is loaded
        keys = ("top", "threads", "providers", "hierarchical", "collect")
        localizer = Localizer(bundle, **{key: getattr(self, key) for key in keys})
        if self.providers or localizer.providers not in ((), ("CPUExecutionProvider",)):
            _note(f"images are described by {' and '.join(localizer.providers) or 'numpy and OpenCV'}")
        return localizer


@dataclass(frozen=True)
class Localize(Robot):
    """Locate image files with an exported bundle.

    Needs only numpy, OpenCV and onnxruntime. Prints a line for each image as soon as it is located: position and
    room; heading, expected error and verdict if the bundle supports them; covariance and agreement of refined
    poses; and the error if file names carry poses as COLD's do. Ctrl-C and SIGTERM keep the results so far.

        images=[a.jpeg,folder]   files, folders as they are at the start, videos, or cameras such as camera:0
        run=FOLDER               the run whose bundle is used
        bundle=FOLDER            another bundle
        top=3                    number of map frames to list
        track=true               follow the robot from image to image; each folder, video and camera is a drive
        odometry=robot.csv       by its wheels: a table with the columns image, odom_x, odom_y, odom_theta
        format=table|jsonl|csv   readable lines, or output for other programs
        out=FILE                 write a .csv or .jsonl file, too; locations.csv by default with format=table
        on_error=skip|raise      skip images that cannot be read, or stop at the first one
        threads=2                number of onnxruntime threads
        providers=[CUDAExecutionProvider,CPUExecutionProvider]   by default a GPU or OpenVINO where onnxruntime has it
        hierarchical=false       search the whole map even if the bundle has a coarse layer
        collect=FOLDER           keep the images that were located well
        update=true              then update the map of the bundle by all images in that folder; also without images=

    Example:
        $ siamloc localize run=runs/vgg16 images=[photo.jpeg]
    """

    format: Literal["table", "jsonl", "csv"] = "table"
    out: Path | None = None
    on_error: Literal["skip", "raise"] = "skip"
    update: bool = False

    @property
    def target(self) -> Path | None:
        """The file that the locations are written to."""
        if self.out is not None or self.format != "table":
            return self.out
        inside = self.folder if self.bundle is None else None
        return (inside or Path()) / "locations.csv"

    def run(self, say: Say = quiet) -> int:
        """Locate the images, say each location as soon as it is known, and return the number of located images.

        Raises:
            DataError: no image can be located.
            KeyboardInterrupt: after the last line, if the user stopped it.
        """
        if self.update and self.collect is None:
            raise ConfigError("an update needs the images that the robot collected: give collect=FOLDER")
        target = self.target if self.images and self.update else None
        if target is not None and real_path(target).is_relative_to(real_path(self.bundle_folder)):
            raise ConfigError(f"{target} is in the bundle, which the update replaces: give out= a place outside of it")
        count = self._located(say) if self.images or not self.update else 0
        if self.update:
            assert self.collect is not None
            from siamloc.runtime import update

            updates = update(self.bundle_folder, self.collect)
            for found in updates:
                say(f"{found.drive.sequence[0]}: {found.summary()}")
            if not updates:
                say(f"update: all readable pictures in {self.collect} were counted before")
        return count

    def _located(self, say: Say) -> int:
        """Locate the images, and return the number of located images."""
        localizer = self.localizer()
        from siamloc.maps.motion import WrongUnitError
        from siamloc.runtime import locate_all, written
        from siamloc.runtime.stream import LINES

        located = locate_all(localizer, self.images, on_error=self.on_error, track=self.track, odometry=self.odometry)
        target = self.target
        off, faults, lost, first, count, stopped = list[float](), 0, 0, "", 0, False
        head, line = ("", None) if self.format == "table" else LINES[f".{self.format}"]
        if head:
            say(head.rstrip("\n"))
        with closing(located if target is None else written(target, located)) as passing:
            try:
                for one in passing:
                    say(line(one).rstrip("\n") if line else one.describe(localizer.unit))
                    count += 1
                    faults += one.location is None
                    first = first or one.fault
                    unsure = one.location is not None and bool(one.location.lost)
                    lost += unsure
                    if not math.isnan(one.off_by) and (self.track or not unsure):  # else nothing is claimed
                        off.append(one.off_by)
            except KeyboardInterrupt:
                stopped = True
            except DataError as error:
                if count and target is not None and not isinstance(error, WrongUnitError):
                    _note(f"{count - faults} of {count} images located before this: {target}")
                raise
        if count == faults and not stopped:
            raise DataError(f"none of the {count} images could be located: {first}")
        if target is not None and self.folder is not None and target.parent == Run(self.folder).folder:
            Run(self.folder).record_written([target])
        conclude = _note if line else say
        where = "" if target is None else f": {target}"
        but = f", {lost} lost" if lost else ""
        conclude(
            f"{count - faults - lost} of {count} images located{but}{', then interrupted' if stopped else ''}{where}"
        )
        if off:
            of = ", without the lost ones" if lost and not self.track else ""
            conclude(
                f"from the poses in their names{of}: mean {mean(off):.2f} {localizer.unit}, median {median(off):.2f} "
                f"{localizer.unit}, largest {max(off):.2f} {localizer.unit}"
            )
        if stopped:
            raise KeyboardInterrupt("stopped by the user")
        return count - faults


@dataclass(frozen=True)
class Watch(Robot):
    """Show on a web page where the robot is while it drives.

    Locates images as localize does, and serves a web page: the floor plan with the pose, its uncertainty and the
    path so far, the camera image next to the map image, the room, expected error and time. The page is read-only,
    and visible only from this machine unless host= says otherwise. Needs the extras `robot` and `live`:
    `pip install '.[robot,live]'`.

        images=[drive.mp4]   files, folders as they are at the start, videos, or cameras such as camera:0
        bundle=FOLDER        the bundle; export it with thumbnails=true to see the map images
        run=FOLDER           or the run whose bundle is used
        track=true           follow the robot from image to image
        odometry=robot.csv   by its wheels, as for localize
        collect=FOLDER       keep the images that were located well, as for localize
        plan=map.yaml        the building, from a map server, to draw behind the floor plan
        fps=5                images per second at most, 0 for full speed; cameras keep their own rate
        port=8000            0 picks a free port
        host=127.0.0.1       0.0.0.0 lets everybody on the network watch

    Example:
        $ siamloc live run=runs/vgg16 images=[drive.mp4]
    """

    host: Text = "127.0.0.1"
    port: Port = 8000
    fps: Pace = 5.0
    plan: Path | None = None

    def run(self, say: Say = quiet) -> None:
        """Locate the images, and serve the page until the user stops it.

        Raises:
            KeyboardInterrupt: the user stopped it.
        """
        localizer = self.localizer()
        from siamloc.runtime import Live

        keys = ("track", "host", "port", "fps", "odometry", "plan")
        page = Live(localizer, self.images, **{key: getattr(self, key) for key in keys})
        if self.host not in ("127.0.0.1", "localhost", "::1"):
            say(f"everybody who can reach {self.host} can watch: leave host out to keep it on this machine")
        with page:
            say(f"{page.url} shows where the robot is; Ctrl-C stops it")
            try:
                page.join()
                say(f"{page.summary}; the page stays until Ctrl-C")
                while True:
                    time.sleep(60)
            except KeyboardInterrupt:
                raise KeyboardInterrupt("stopped by the user") from None
            except DataError:
                time.sleep(1)  # so that the page can show the reason as well
                raise


def _note(line: str) -> None:
    """Print a line for people on standard error, since standard output may be for other programs."""
    print(line, file=sys.stderr)
