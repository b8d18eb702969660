"""Reader of the COLD database and of its lists of rooms."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from foundation.files import expanded, first_names, is_picture
from foundation.settings import shortened
from siamloc.data.frames import ODOMETRY, FrameTable, in_capture_order, read_file
from siamloc.data.image_files import image_files
from siamloc.data.manifest import read_rows
from siamloc.data.names import SequenceName, name_sequence, parse_name
from siamloc.errors import ConfigError, DataError, Policy, hint, leave_out, logger

CAMERAS = ("omni_cam", "std_cam")
#: Table of odometry next to `places.lst`: image, odom_x, odom_y, odom_theta.
ODOMETRY_FILE = "odometry.csv"

_LIST_SUFFIX = ".places.lst"
_DEPTH = 6  # <host>/COLD/db/cold-<building>/part_<a|b>/seq..., as a copy of the whole server has it
_ABSENT = 0.01  # share of the listed images: a whole sequence may lack a few, one that was cut lacks many
_LAYOUT = (
    "<building>/part_<a|b>/seq<path>_<lighting><run>/omni_cam/*.jpeg with localization/places.lst, "
    "folders such as cold-freiburg_part_a_seq2_cloudy1, or files *.places.lst"
)


def read_cold(
    root: str | Path | None = None,
    *,
    places: str | Path | None = None,
    camera: str = "omni_cam",
    on_error: Policy = "skip",
) -> FrameTable:
    """Read the sequences of the COLD database below a folder.

    A sequence is a folder that contains a camera's folder, `localization/places.lst` or `places.lst`; or a list named
    after its sequence, such as `freiburg_seq2_cloudy1.places.lst`, whose images are looked for in
    `freiburg_seq2_cloudy1/<camera>` next to it and need not be there. Frames are ordered by time within each sequence;
    sequences are called `freiburg_a_seq2_cloudy3`, their building `freiburg_a`. Without a list, the frames are the
    images in the camera's folder, without rooms. Next to `places.lst`, a table `odometry.csv` with the columns `image`,
    `odom_x`, `odom_y` and `odom_theta` gives the odometry, by file names. Pronobis & Caputo 2009, IJRR 28(5).

    Args:
        root: the database, a building, a part, or one sequence.
        places: one file `places.lst` of poses, instead of the folder `root`.
        camera: "omni_cam" or "std_cam".
        on_error: "skip" or "raise", for images that are listed but missing and for sequences without this camera.

    Raises:
        ConfigError: neither or both of `root` and `places`, or an unknown camera.
        DataError: no sequence below the folder, a malformed line (with file and line number), two sources of one
            sequence, or odometry of other images.
    """
    if camera not in CAMERAS:
        raise ConfigError(f"COLD has no camera {camera!r}; {hint(camera, CAMERAS)}")
    if (root is None) == (places is None):
        raise ConfigError("COLD is read from a folder or from one list: give either root=FOLDER or places=FILE")
    if places is not None:
        sources = [_source_of_list(expanded(places))]
    else:
        sources = _with_camera(_find(expanded(str(root))), camera, on_error)
    named: dict[str, tuple[_Source, list[dict[str, Any]]]] = {}
    for source in sources:
        frames, name = _read_sequence(source, camera, on_error)
        if name in named:
            first = named[name][0]
            raise DataError(
                f"sequence {name} appears twice, as {first.list or first.folder} and as "
                f"{source.list or source.folder}: remove one, or give the folder of one of them as root"
            )
        named[name] = (source, frames)
    return in_capture_order(FrameTable.from_rows([frame for name in sorted(named) for frame in named[name][1]]))


class Stored(NamedTuple):
    """A sequence on disk.

    Attributes:
        folder: its folder.
        list: its list of rooms; None without one.
        name: its name, as far as its folders and rooms say it.
        frames: number of frames in its list.
        lack: what it lacks to be a whole sequence, in words that follow its name; empty if nothing.
    """

    folder: Path
    list: Path | None
    name: SequenceName
    frames: int
    lack: str


def stored(root: Path) -> list[Stored]:
    """Find the sequences below a folder, where `read_cold` finds them, and what each of them lacks."""
    found = []
    for source in _sources(root):
        frames, lack = [], "has no list localization/places.lst"
        if source.list is not None:
            try:
                frames = read_list(source.list)
                lack = _lack(source.folder, [frame["image"] for frame in frames])
            except DataError as error:
                lack = f"has no list that can be used: {error}"
        name = name_sequence(source.folder, source.label, [frame["room"] for frame in frames])
        found.append(Stored(source.folder, source.list, name, len(frames), lack))
    return found


def _lack(folder: Path, listed: list[str]) -> str:
    """Say which listed images a sequence lacks, and which pictures it holds instead; "" if it lacks hardly any."""
    if not folder.is_dir():
        return f"has no folder {folder.name} with its images next to it"
    there = {image.name for camera in CAMERAS for image in (folder / camera).glob("*")}
    absent = [image for image in listed if image not in there]
    if len(absent) <= _ABSENT * len(listed):
        return ""
    pictures = [path.relative_to(folder) for path in sorted(folder.glob("**/*")) if is_picture(path)]
    counts = Counter(picture.parent.as_posix() for picture in pictures)
    held = " and ".join(f"{count} in {name}" for name, count in counts.items())
    return f"lacks {len(absent)} of the {len(listed)} images in its list, the first {absent[0]}, and holds " + (
        f"{shortened(held)}, the first {pictures[0].as_posix()}" if pictures else "none"
    )


@dataclass(frozen=True)
class _Source:
    """A sequence on disk: its folder, its list of rooms, and its name within the root."""

    folder: Path
    list: Path | None
    label: str


def _find(root: Path) -> list[_Source]:
    if not root.is_dir():
        other = "give root=FOLDER, or one list as places=FILE; `siamloc fetch cold` loads the database"
        raise DataError(f"{root} is not a folder: {other}. Expected {_LAYOUT}")
    if not (found := _sources(root)):
        held = first_names(root) or "nothing"
        raise DataError(f"no sequence found under {root}, which holds: {held}. Expected {_LAYOUT}")
    return found


def _sources(root: Path) -> list[_Source]:
    """Return the sequences below a folder, none if it does not exist."""
    found: dict[Path, _Source] = {}
    named_lists: list[Path] = []
    for folder, files in _folders(root):
        # A folder `localization` holds the list of the sequence above it.
        lists = [folder / "localization" / "places.lst", folder / "places.lst"]
        own_list = next((path for path in lists if folder.name != "localization" and path.is_file()), None)
        if own_list is not None or any((folder / name).is_dir() for name in CAMERAS):
            label = folder.absolute().name if folder == root else folder.relative_to(root).as_posix()
            found[folder] = _Source(folder, own_list, label)
        named_lists += [folder / name for name in sorted(files) if name.endswith(_LIST_SUFFIX) and name != _LIST_SUFFIX]
    for path in named_lists:
        source = _source_of_list(path)
        if source.folder not in found or found[source.folder].list is None:
            found[source.folder] = source
    return list(found.values())


def _folders(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield the folders below a root, down to the depth at which sequences occur, and the names of their files."""
    visited: set[str] = set()
    for name, children, files in os.walk(root, followlinks=True):
        folder = Path(name)
        # A link back to a folder above would show the same sequences again.
        if (real := os.path.realpath(folder)) in visited:
            children.clear()
            continue
        visited.add(real)
        inside = len(folder.relative_to(root).parts) < _DEPTH
        children[:] = sorted(
            child for child in children if inside and child not in CAMERAS and not child.startswith(".")
        )
        yield folder, files


def _source_of_list(path: Path) -> _Source:
    if path.parent.name == "localization":
        folder = path.parent.parent
    elif path.name == "places.lst":
        folder = path.parent
    else:
        named = path.name.endswith(_LIST_SUFFIX)
        folder = path.with_name(path.name.removesuffix(_LIST_SUFFIX)) if named else path.with_suffix("")
    return _Source(folder, path, folder.absolute().name)


def _with_camera(sources: list[_Source], camera: str, on_error: str) -> list[_Source]:
    """Leave out the sequences that have images of another camera only."""
    lacking = [
        source
        for source in sources
        if not (source.folder / camera).is_dir() and any((source.folder / other).is_dir() for other in CAMERAS)
    ]
    what = f"sequences have no folder {camera}, only another camera's"
    leave_out([str(source.folder) for source in lacking], len(sources), what, on_error)
    return [source for source in sources if source not in lacking]


def _read_sequence(source: _Source, camera: str, on_error: str) -> tuple[list[dict[str, Any]], str]:
    """Return the frames of a sequence, and its name."""
    images = source.folder / camera
    if source.list is not None:
        frames = read_list(source.list)
        if source.list.name == "places.lst" and (table := source.list.with_name(ODOMETRY_FILE)).is_file():
            _add_odometry(frames, table)
        if images.is_dir():
            there = set(os.listdir(images))  # noqa: PTH208 (names, not paths)
            missing = [str(images / frame["image"]) for frame in frames if frame["image"] not in there]
            leave_out(missing, len(frames), f"images listed in {source.list} do not exist", on_error)
            frames = [frame for frame in frames if frame["image"] in there]
    else:
        frames = _unlisted(images, on_error)
    name = name_sequence(source.folder, source.label, [frame["room"] for frame in frames])
    for frame in frames:
        frame |= {"path": str(images / frame.pop("image")), **name._asdict()}
    return frames, name.sequence


def _add_odometry(frames: list[dict[str, Any]], table: Path) -> None:
    rows = {Path(row["path"]).name: row for row in read_rows(table)}
    if not rows.keys() & {frame["image"] for frame in frames}:
        raise DataError(f"{table} names no image of places.lst next to it, but {next(iter(rows))}: use the same names")
    for frame in frames:
        frame |= {name: value for name, value in rows.get(frame["image"], {}).items() if name in ODOMETRY}


def read_list(path: Path) -> list[dict[str, Any]]:
    """Read a list with `<image name> <room code>` on each line.

    Returns:
        `image`, `room`, `time` in seconds, `x` and `y` in metres, and `theta` in rad of each frame.

    Raises:
        DataError: the list cannot be read or is empty, or a line is malformed or repeats an image.
    """
    frames: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(read_file(path, "the list").split("\n"), start=1):
        words = line.split()
        if not words:
            continue
        pose = parse_name(words[0])
        if len(words) != 2 or pose is None or "\0" in words[1]:
            raise DataError(
                f"{path}, line {number}: expected t<seconds>_x<metres>_y<metres>_a<radians>.jpeg, or t<seconds>.jpeg, "
                f"and a room code, got {line.strip()[:120]!r}"
            )
        if words[0] in frames:
            raise DataError(f"{path}, line {number}: image {words[0]} is in the list already")
        frames[words[0]] = {"image": words[0], "room": words[1], **pose._asdict()}
    if not frames:
        raise DataError(f"{path} lists no images")
    return list(frames.values())


def _unlisted(folder: Path, on_error: str) -> list[dict[str, Any]]:
    """Take the frames from the names of a camera's images."""
    poses = {image.name: parse_name(image.name) for image in image_files(folder)}
    if not poses:
        raise DataError(f"{folder} holds no images, and there is no list of rooms next to it")
    nameless = [name for name, pose in poses.items() if pose is None]
    leave_out(nameless, len(poses), f"images of {folder} carry no time in their names", on_error)
    logger.info("%s has no list of rooms: its %d frames carry none", folder.parent, len(poses) - len(nameless))
    return [{"image": name, "room": "", **pose._asdict()} for name, pose in poses.items() if pose is not None]
