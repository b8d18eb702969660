"""`contents` and `extract`: look into a recording (a ROS bag, a video, a folder of pictures), and write its images."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from foundation.calls import OF_FIELDS, takes, typed
from foundation.files import expanded, read_json, real_path, write_bytes, write_json, write_picture, write_text
from foundation.settings import Count, Positive, Settings, Text
from siamloc.data.bags import KINDS, Bag, Clock, is_part, proposed
from siamloc.data.films import COUNTED, Film
from siamloc.data.frames import BAGS, METADATA, VIDEOS, FrameTable, advice, placed
from siamloc.data.image_files import UnreadableImageError, decode_image
from siamloc.data.manifest import manifest_of
from siamloc.data.names import lighting_in
from siamloc.data.reading import read
from siamloc.data.recorded import COLUMNS_OF, check_clocks, check_taken, images_of, joined
from siamloc.data.trajectory import Array, Axes, Form, Order, Trajectory, read_trajectory
from siamloc.data.trajectory_checks import doubts
from siamloc.errors import ConfigError, DataError, Policy, leave_out, logger, say_once
from siamloc.progress import track

SOURCES = ("images", "poses", "odometry")
MANIFEST = "frames.csv"
"""The manifest in the folder of an extracted recording."""
CALIBRATION = "camera_info.json"
"""The calibrations of the cameras in a bag, by topic."""
_KEPT = "recording.json"
_ABOVE = ("map:", "world:")  # frames that poses are given in
_QUALITY = 95  # of the JPEG files of images that were not compressed


@dataclass(frozen=True)
class Extraction(Settings):
    """What to take from a recording.

    Attributes:
        images: topic of the images; that of `contents(file).proposal` if None.
        poses: topic of poses, a frame in another one such as "map:base_link", or a file with a trajectory; that of the
            proposal if None, and no poses if "none".
        odometry: likewise, for the poses by the robot's wheels.
        times: list of the times of a folder of pictures; see `siamloc.data.recorded.read_recorded`.
        form: form of the files with trajectories; found out if None. See `siamloc.data.trajectory.read_trajectory`.
        order: order of their quaternions, if it is another than that of the form.
        axes: whose poses and odometry they are; see `siamloc.data.trajectory.Trajectory.flat`. With "camera", one of
            the two may be a robot's: poses or odometry that stay upright only as a robot's are, and odometry next to
            poses has those axes with which it stays upright best.
        clock: "stamp" for the times that the messages carry, "bag" for those at which they were recorded.
        offset: seconds to add to the times of the images for those of the poses; the frames' times have it, the names
            of the files do not. The time in a video begins with 0.
        gap: longest time between two poses, in s, over which poses are interpolated.
        every: take every k-th image.
        rate: images per second on average, at most; all if None.
        sequence: name of the drive; the recording's name if empty.
        on_error: "skip" or "raise", for images that are damaged or have no pose, or out of order where a rate is
            asked for.
    """

    WHERE: ClassVar[str] = "recording"

    images: Text | None = None
    poses: Text | None = None
    odometry: Text | None = None
    times: Text | None = None
    form: Form | None = None
    order: Order | None = None
    axes: Axes = "robot"
    clock: Clock = "stamp"
    offset: float = 0.0
    gap: Positive = 2.0
    every: Count = 1
    rate: Positive | None = None
    sequence: str = ""
    on_error: Policy = "skip"


@dataclass(frozen=True)
class Contents:
    """What is inside a recording.

    Attributes:
        file: the recording.
        seconds: its length.
        topics: type and number of the messages of each topic; a video has the one topic "video", a folder of pictures
            "pictures".
        frames: frames in others, such as "odom:base_link", that the recording gives poses of.
        proposal: which of them most likely give the images, poses and odometry.
        height: height in m of the proposed camera above the robot's base, by the base's name, if the frames say it.
    """

    file: Path
    seconds: float
    topics: dict[str, tuple[str, int]]
    frames: tuple[str, ...] = ()
    proposal: dict[str, str] = field(default_factory=dict)
    height: dict[str, float] = field(default_factory=dict)

    def describe(self) -> str:
        """Return a line for the recording, one for each topic, and one for what is proposed."""
        width = max(map(len, self.topics), default=0)
        lines = [f"{self.file}: {self.seconds:.1f} s, {len(self.topics)} topic{'s' * (len(self.topics) != 1)}"]
        for name, (kind, count) in sorted(self.topics.items()):
            rate = f", {count / self.seconds:.1f}/s" if self.seconds > 0 and count > 1 else ""
            used = KINDS.get(kind)
            lines.append(f"  {name:<{width}}  {count} x {kind}{rate}{f' ({used})' if used else ''}")
        if self.frames:
            lines.append(f"  frames: {', '.join(self.frames)}")
        for base, height in self.height.items():
            floor = "" if base == "base_footprint" else f"{base} is on the floor, and "
            usable = f"if {floor}the camera is not a ring of two radii"
            lines.append(f"  the camera is {height:.2f} m above {base}: survey.height={height:.2f}, {usable}")
        lacking = [what for what in SOURCES if what not in self.proposal]
        if "poses" in lacking and (seen := next((name for name in self.frames if name.startswith(_ABOVE)), None)):
            lines.append(f"  poses may be recording.poses={seen}, with recording.axes=camera if its z is ahead")
        said = [f"{what}={source}" for what, source in self.proposal.items()] + [f"no {what}" for what in lacking]
        return "\n".join([*lines, f"proposed: {', '.join(said)}"])


class Pictures:
    """A folder of pictures, with the methods of a `Bag`.

    The times are those of a list, or those of the pictures (`siamloc.data.picture_times.taken_at`). Pictures without
    them count as taken a second apart, in the order of their names.

    Attributes:
        taken: times in s (n,), NaN if unknown.
        second: how the names of second pictures differ, which go with the first; see `DualFisheyeCamera`.
    """

    def __init__(self, path: Path, times: Path | None = None, second: tuple[str, str] | None = None) -> None:
        self.path, self.second = path, second
        files, self.taken = images_of(path, times, second=second)
        kind, taken = "pictures", self.taken
        if not np.isfinite(taken).all():
            kind = "pictures without times (give recording.times=FILE, or they count as a second apart)"
            taken = np.arange(len(files), dtype=np.float64)
        self._files = sorted(zip(taken.tolist(), files, strict=True))
        self.topics = {"pictures": (kind, len(files))}
        self.seconds = float(np.ptp(taken))

    def images(self, topic: str, clock: Clock) -> Iterator[tuple[int, Path, str]]:
        """Yield the time in ns, the file, and its name as an ending, of each picture."""
        for time, file in self._files:
            plain = re.sub(r"[^\w.+-]", "_", file.name)
            yield round(time * 1e9), file, "_" + (plain if self.second is None else file.name)


@typed
def contents(file: str | Path, times: str | Path | None = None, second: tuple[str, str] | None = None) -> Contents:
    """Look into a recording: a ROS bag (.bag, .db3, .mcap or the folder of a ROS 2 bag), a video, a folder of pictures.

    Args:
        file: the recording.
        times: list of the times of a folder of pictures; see `siamloc.data.recorded.read_recorded`.
        second: as for `extract`.

    Raises:
        ConfigError: times of a recording that has times of its own, or `second` of one that is no folder of pictures.
        DataError: the file does not exist, cannot be read, or is no recording.
    """
    with _opened(expanded(file), times, second) as source:
        about = source.path, source.seconds, dict(source.topics)
        if not isinstance(source, Bag):
            return Contents(*about, proposal={"images": next(iter(source.topics))})
        frames = tuple(source.first_transforms)
        proposal = proposed(source.topics, frames)
        height = source.height(proposal["images"]) if frames and "images" in proposal else {}
        return Contents(*about, tuple(":".join(edge) for edge in frames), proposal, height)


@takes(Extraction)
def extract(
    file: str | Path,
    out: str | Path,
    *,
    second: tuple[str, str] | None = None,
    settings: Extraction = OF_FIELDS,
    **fields: Any,
) -> FrameTable:
    """Write the images of a recording into a folder, named by their times in ns, and their manifest, `frames.csv`.

    The pictures of a folder keep their names after the times. Images that are there already are not written
    again, so that an interrupted call goes on.

    Args:
        file: the recording; see `contents`.
        out: the folder.
        second: how the names of second pictures in a folder differ, as in `DualFisheyeCamera`: they are written next to
            the first ones, and are no frames of their own.
        settings: an `Extraction`.

    Returns:
        The frames of the manifest.

    Raises:
        ConfigError: `poses` or `odometry` that is neither in the recording nor a file, or as for `contents`.
        DataError: a recording that cannot be read, without images, or whose poses are of another clock.
        StorageError: the disk is full or refuses.
    """
    path, folder = expanded(file), expanded(out)
    if path.is_dir() and path.resolve() == folder.resolve():
        raise ConfigError(f"{folder} is the recording itself: give another folder for its images")
    found = contents(path, settings.times, second)
    sources = {what: getattr(settings, what) or found.proposal.get(what, "none") for what in SOURCES}
    if sources["images"] == "none":
        raise DataError(f"{path} holds no images; its topics: {', '.join(found.topics) or 'none'}")
    settings = replace(settings, poses=sources["poses"])
    with _opened(path, settings.times, second) as recording:
        given = {what: _trajectory(recording, what, sources[what], settings) for what in SOURCES[1:]}
        about = _identity(path, sources["images"])
        if (folder / _KEPT).is_file() and read_json(folder / _KEPT) != about:
            raise DataError(f"{folder} holds the images of another recording, as {_KEPT} says: give another folder")
        counted = isinstance(recording, Pictures) or path.suffix.lower() in COUNTED  # whose length is known
        if counted and recording.seconds > 0:  # before all pictures are decoded
            taken = recording.taken if isinstance(recording, Pictures) else np.array([0.0, recording.seconds])
            for one in filter(None, given.values()):
                check_clocks(taken + settings.offset, one, settings.offset)
        files, times = _write_images(recording, folder, sources["images"], settings, given["poses"])
        write_json(folder / _KEPT, about)
        times = times + settings.offset
        columns = {"time": times}
        for what, names in COLUMNS_OF.items():
            if (trajectory := given[what]) is not None:
                columns |= dict(zip(names, _joined(recording, times, trajectory, what, settings).T, strict=False))
        if isinstance(recording, Bag) and (cameras := recording.calibrations()):
            write_json(folder / CALIBRATION, cameras)
    name = settings.sequence or drive_name(path)
    labels = {"sequence": [name] * len(files), "lighting": [lighting_in(name)] * len(files)}
    frames = FrameTable(path=files).with_columns(**labels, **columns)
    if "x" in columns:
        frames = placed(frames, f"images of {path} have no pose", settings.on_error)
    write_text(folder / MANIFEST, manifest_of(frames, folder))
    return read("manifest", manifest=folder / MANIFEST)


def drive_name(recording: Path) -> str:
    """Return the name of a recording's drive: the file without its ending, or the folder, which may have a dot."""
    path = recording if recording.name.strip(".") else recording.resolve()
    return path.name if path.is_dir() and path.suffix.lower() not in BAGS else path.stem


def writes_camera(folder: Path, unwrap: Mapping[str, Any]) -> bool:
    """Whether a camera (`PanoramaLibrary`'s `unwrap`) names the calibration that `extract` has yet to write there."""
    file = Path(unwrap.get("file") or "")
    return file.name == CALIBRATION and not file.exists() and real_path(file) == real_path(folder / CALIBRATION)


def _opened(
    path: Path, times: str | Path | None = None, second: tuple[str, str] | None = None
) -> AbstractContextManager[Bag | Film | Pictures]:
    if not path.exists():
        raise DataError(f"there is no recording {path}")
    if times is not None and path.is_dir() and not (path / METADATA).is_file():
        return nullcontext(Pictures(path, expanded(times), second))
    if times is not None:
        raise ConfigError(f"{path} has times of its own: recording.times is for a folder of pictures")
    if second is not None and (path.suffix.lower() in (*BAGS, *VIDEOS) or (path / METADATA).is_file()):
        raise ConfigError(
            f"{path} is no folder of pictures, for which unwrap.second is: extract the pictures of each lens (of a bag "
            "by recording.images=TOPIC), put those of equal times into one folder as front_TIME and back_TIME, and "
            "take that instead, with its poses and odometry in files"
        )
    if path.suffix.lower() in VIDEOS:
        return Film(path)
    if path.suffix.lower() in BAGS or (path / METADATA).is_file():
        if is_part(path) and (parts := len([*path.parent.glob(f"*{path.suffix}")])) > 1:
            say_once(f"{path} is a part of the bag {path.parent}: name the folder to read all {parts} parts")
        return Bag(path)
    if path.is_dir():
        return nullcontext(Pictures(path, second=second))
    known = ", ".join((*BAGS, *VIDEOS))
    raise DataError(
        f"{path} is no recording: expected a file {known}, a folder of pictures, or the folder of a ROS 2 bag"
        f"{advice([path.name])}"
    )


def _identity(path: Path, topic: str) -> dict[str, Any]:
    """Return what tells a recording from others, whose images may have the same times."""
    about: dict[str, Any] = {"recording": str(path.resolve()), "images": topic}
    if path.is_file():
        about |= {"bytes": path.stat().st_size, "modified": path.stat().st_mtime_ns}
    return about


def _write_second(folder: Path, first: Path, stamp: str, second: tuple[str, str]) -> None:
    """Write the second picture of two next to the first; without it, `PanoramaLibrary` leaves the first one out."""
    name = first.name.removeprefix(stamp).replace(*second)
    copy = first.parent / f"{stamp}{name}"
    if copy.exists():
        return
    try:
        decode_image(data := (folder / name).read_bytes())
    except (OSError, UnreadableImageError):
        return
    write_bytes(copy, data)


def _write_images(
    recording: Bag | Film | Pictures, folder: Path, topic: str, settings: Extraction, poses: Trajectory | None
) -> tuple[list[str], NDArray[np.float64]]:
    """Write every k-th image, at most as many as the rate says; return the files and their times in s.

    Images with the time of another one, and with a rate those that were recorded after later ones, are left out, which
    is reported. With on_error=raise, nothing is written from the first of them on, or from the first without a pose.
    """
    strict = settings.on_error == "raise"
    found: dict[int, str] = {}
    late, same, damaged = list[str](), list[str](), list[str]()
    apart = None if settings.rate is None else round(1e9 / settings.rate)
    due, last = 0.0, 0
    count = recording.topics.get(topic, ("", 0))[1]
    messages = track(recording.images(topic, settings.clock), count, f"extracting {recording.path.name}")
    for number, (time, image, ending) in enumerate(messages):
        if strict and (late or same or damaged):
            break
        if number % settings.every:
            continue
        if isinstance(image, UnreadableImageError):
            damaged.append(str(image))
            continue
        if time in found:
            same.append(f"{time / 1e9:.3f} s")
            continue
        if apart is not None and found and time < due - apart / 4:  # pictures come a little early or late
            if time < last:
                late.append(f"{time / 1e9:.3f} s")
            continue
        file = folder / f"{time:019d}{ending}"
        there = file.is_file()
        if isinstance(image, (Path, bytes)) and not there:
            name = image if isinstance(image, Path) else f"the image at {time / 1e9:.3f} s"
            try:
                image = image.read_bytes() if isinstance(image, Path) else image
                decode_image(image)
            except (OSError, UnreadableImageError) as error:
                damaged.append(f"{name}: {getattr(error, 'strerror', None) or error}")
                continue
        if apart is not None:
            last = time
            due = (max(due, time - apart / 2) if found else time) + apart
        if strict and poses is not None:
            _check_pose(recording.path, time / 1e9, poses, settings)
        found[time] = str(file)
        if isinstance(image, bytes) and not there:
            write_bytes(file, image)
        elif isinstance(image, np.ndarray) and not there:
            write_picture(file, image, _QUALITY)
        if isinstance(recording, Pictures) and recording.second is not None:
            _write_second(recording.path, file, f"{time:019d}_", recording.second)
    leave_out(damaged, count, f"images of {topic} in {recording.path} cannot be used", settings.on_error)
    if not found:
        raise DataError(f"{recording.path}: {topic} holds no images")
    if isinstance(recording, Film):
        recording.check_whole(settings.on_error)
    what = f"images of {recording.path} were recorded after later ones, which a rate leaves out"
    leave_out(late, number + 1, what, settings.on_error)
    stamped = isinstance(recording, Bag) and settings.clock == "stamp"
    remedy = " (clock=bag takes the times at which they were recorded)" if stamped else ""
    leave_out(same, number + 1, f"images of {recording.path} have the time of another one{remedy}", settings.on_error)
    order = sorted(found)
    return [found[time] for time in order], np.array(order, dtype=np.int64) / 1e9


def _check_pose(path: Path, time: float, poses: Trajectory, settings: Extraction) -> None:
    if np.isnan(poses.at(np.array([time + settings.offset]), settings.gap).position).any():
        raise DataError(
            f"the image of {path} at {time:.3f} s has no pose in {poses.source}, from {poses.time[0]:.3f} to "
            f"{poses.time[-1]:.3f} s, with offset={settings.offset:g} and gap={settings.gap:g} "
            "(on_error=skip leaves it out)"
        )


def _trajectory(recording: Bag | Film | Pictures, what: str, source: str, settings: Extraction) -> Trajectory | None:
    """Return the poses of a topic, a frame or a file; None if there are none.

    Raises:
        DataError: poses that cannot be used, before any image is written.
    """
    if source == "none":
        return None
    file = expanded(source)
    if isinstance(recording, Bag) and (source in recording.topics or (":" in source and not file.exists())):
        found = recording.poses(source, settings.clock)
    elif file.is_file():
        found = read_trajectory(file, settings.form, settings.order)
        if not np.isfinite(found.time).all():
            raise DataError(
                f"recording.{what}={file} holds poses without times, one for each image: prepare data=trajectory "
                f"data.images=FOLDER data.{what}={file} takes them in order"
            )
    else:
        raise ConfigError(
            f"recording.{what}={source} is no topic of {recording.path}, no frame such as map:base_link, and no file"
        )
    axes = _axes(found, what, settings)
    found.flat(axes)
    for doubt in doubts(found, axes):
        logger.warning("%s", doubt)
    if isinstance(recording, Pictures):
        check_taken(recording.taken)
    return found


def _joined(
    recording: Bag | Film | Pictures, times: Array, trajectory: Trajectory, what: str, settings: Extraction
) -> Array:
    """Return the poses in the plane, roll and pitch (n, 5) at the times of the images (n,), in the poses' clock."""
    try:
        return joined(times, trajectory, settings.gap, _axes(trajectory, what, settings), settings.offset)
    except DataError as error:
        if settings.clock == "bag" or not isinstance(recording, Bag):
            raise
        raise DataError(f"{error}; if the camera has a clock of its own, clock=bag takes the recorder's") from error


def _axes(trajectory: Trajectory, what: str, settings: Extraction) -> Axes:
    return trajectory.own_axes(settings.axes, beside=what == "odometry" and settings.poses != "none")
