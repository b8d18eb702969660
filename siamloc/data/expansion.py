"""`expand`: write an augmented data set in the layout of its source ([T] 5.3.2, table 5.18).

The pose and the labels of an image are those of its frame; a rotation only adds to the heading. Readers thus read an
expanded data set like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from augment.errors import AugmentError
from augment.expand import expand as write_variants
from augment.expand import headings
from foundation.calls import typed
from foundation.files import csv_text, real_path, storage_errors, write_json, write_text
from foundation.locks import alone
from foundation.settings import Count, Seed, Thousand
from foundation.words import as_words
from siamloc.data.cold import ODOMETRY_FILE
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import ODOMETRY, FrameTable
from siamloc.data.image_files import UnreadableImageError
from siamloc.data.manifest import COLUMNS
from siamloc.data.moves import wrapped
from siamloc.data.names import NamedPose, format_name, name_sequence, parse_name
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.errors import ConfigError, DataError, Policy
from siamloc.progress import track

MANIFEST = "manifest.csv"
_TICK = 1e-6  # s, between the times of two variants in names that carry the time
_KEPT = (".jpeg", ".jpg", ".png")


@dataclass(frozen=True)
class Expanded:
    """An expanded data set on disk.

    Attributes:
        folder: folder of the data set.
        kind: "cold", "folder" or "manifest", the first argument of `siamloc.data.read`.
        frames: number of source frames whose images could be read.
        depth: number of images per frame.
        written: number of images written by this call.
        kept: number of images that were already there.
        failed: why images were left out, one sentence each.
        image_size: rows and columns of the images.
        circular: whether their columns wrap around.
    """

    folder: Path
    kind: str
    frames: int
    depth: int
    written: int
    kept: int
    failed: tuple[str, ...]
    image_size: tuple[int, int]
    circular: bool

    @property
    def source(self) -> dict[str, Any]:
        """Arguments with which `siamloc.data.read` reads the expanded data set: `read(**expanded.source)`."""
        if self.kind == "manifest":
            return {"kind": self.kind, "manifest": str(self.folder / MANIFEST)}
        return {"kind": self.kind, "root": str(self.folder)}

    def summary(self) -> str:
        """Report what was written, what was left out, and how to train with it."""
        lines = []
        if self.failed:
            total = self.frames + len(self.failed)
            lines.append(f"left out: {len(self.failed)} of {total} images, the first: {self.failed[0]}")
        before = f", {self.kept} were there" if self.kept else ""
        count = self.written + self.kept
        lines.append(f"{self.folder}: {count} images of {self.frames} frames, {self.depth} each{before}")
        words = {"data" if key == "kind" else f"data.{key}": value for key, value in self.source.items()}
        words |= {"unwrap": "none"} if self.kind == "cold" else {}
        words |= {"data.image_size": self.image_size, **({} if self.circular else {"data.circular": False})}
        lines.append(f"train with: siamloc train {as_words({**words, 'protocol.train.sequences': ['*']})}")
        return "\n".join(lines)


@typed
def expand(
    frames: FrameTable,
    out: str | Path,
    *,
    depth: Count = 16,
    image_size: Sequence[int] = (128, 512),
    unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None,
    circular: bool = True,
    seed: Seed = 0,
    resume: bool = False,
    workers: Thousand = 2,
    on_error: Policy = "skip",
) -> Expanded:
    """Write several images of every frame: the original, spots, global light, blur, rotations and their combinations.

    Args:
        frames: the frames to expand, as returned by a reader: the expanded data set has the layout of that data set.
        out: folder of the expanded data set, outside the data.
        depth: number of images per frame; 16, 44, 128, 129 and 246 in the thesis.
        image_size: rows and columns of the images, which are panoramas.
        unwrap: camera of omnidirectional images; see `PanoramaLibrary`.
        circular: whether the columns wrap around.
        seed: seed of all random draws.
        resume: continue an interrupted expansion in the same folder; only what is missing is made.
        workers: number of images processed at once.
        on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.

    Raises:
        ConfigError: frames that do not come from a reader, a folder inside the data, or another process that writes
            there.
        DataError: no image can be read.
        AugmentError: a folder in use, or a folder to resume that holds another expansion.
        StorageError: the disk is full or cannot be written to.
    """
    folder, source = Path(out), frames.source
    kind = str(source.get("kind", ""))
    if kind not in ("cold", "folder", "manifest"):
        raise ConfigError("an expanded data set keeps the layout of its source: give frames from siamloc.data.read")
    if not len(frames):
        raise DataError("there are no frames to expand: the table is empty")
    root = Path(source["root"]) if "root" in source else Path(source.get("manifest") or source["places"]).parent
    _check_apart(folder, root, kind, frames)
    decode = Preprocessing.checked(image_size, unwrap).sized_by(frames.path.tolist())
    turns = headings(len(frames), depth, seed, (decode.view.height, decode.view.width), circular)
    theta = turned_headings(frames.theta, turns)
    pictures = outputs(kind, frames, root, folder, theta)
    tilts = dict(zip(frames.path.tolist(), frames.tilt, strict=True))

    def read(path: Path) -> NDArray[np.uint8]:
        try:
            return decode.panorama(path, tilts.get(str(path)))
        except UnreadableImageError as error:
            raise AugmentError(f"{path}: {error}") from error

    with alone(folder), storage_errors(folder):
        done = write_variants(
            frames.path.tolist(),
            pictures,
            folder,
            read,
            seed=seed,
            circular=circular,
            resume=resume,
            threads=workers,
            on_error=on_error,
            progress=track,
            reading=decode.parameters(),
        )
    made = ~np.isin(frames.path, [str(source) for source, _ in done.failed])
    if not made.any():
        raise DataError(f"none of the {len(frames)} images could be read, the first: {done.failed[0][1]}")
    write_lists(kind, frames.take(made), [pictures[row] for row in np.flatnonzero(made)], folder, turns[made])
    reasons = tuple(reason for _, reason in done.failed)
    size = (decode.view.height, decode.view.width)
    return Expanded(folder, kind, int(made.sum()), depth, done.written, done.kept, reasons, size, circular)


def outputs(kind: str, frames: FrameTable, root: Path, folder: Path, theta: NDArray[np.float64]) -> list[list[Path]]:
    """Return the file to write for every image (frames, depth), by the layout:

    - cold: `<sequence folder>/<camera>/t<time>_x<x>_y<y>_a<theta>.jpeg`; the variants of a frame are a microsecond
      apart, so that no two have the same name.
    - folder: `<split>/<room>/`, with a COLD name if the frame has a COLD name, else `<name>_v<variant>`.
    - manifest: the image's own path with `_v<variant>` added.

    Args:
        kind: "cold", "folder" or "manifest".
        frames: n frames.
        root: the folder that the frames were read from; for a manifest, the folder of the table.
        folder: folder of the expanded data set.
        theta: heading of each image (n, depth), rad.

    Raises:
        DataError: two images would have the same name, or the folder's own name would rename a sequence.
    """
    above = _sequence_folders(frames, root, folder) if kind == "cold" else {}
    rows = []
    for frame, turned in zip(frames, theta.tolist(), strict=True):
        path = Path(frame["path"])
        if kind == "cold":
            parent = above[frame["sequence"]] / path.parent.name
        elif kind == "folder":
            parent = Path(frame["sequence"]) / frame["room"]
        elif path.is_relative_to(root) and ".." not in path.relative_to(root).parts:
            parent = path.relative_to(root).parent
        else:
            parent = Path("images") / (frame["sequence"] or "frames")
        suffix = path.suffix if path.suffix.lower() in _KEPT else ".png"
        if kind == "manifest" or parse_name(f"{path.stem}{suffix}") is None:
            names = [f"{path.stem}_v{variant:03d}{suffix}" for variant in range(len(turned))]
        else:
            time, x, y = frame["time"], frame["x"], frame["y"]
            poses = [NamedPose(time + variant * _TICK, x, y, angle) for variant, angle in enumerate(turned)]
            names = [format_name(pose, suffix) for pose in poses]
        rows.append([folder / parent / name for name in names])
    seen: dict[Path, str] = {}
    for original, row in zip(frames.path.tolist(), rows, strict=True):
        for target in row:
            if target in seen:
                raise DataError(
                    f"{original} and {seen[target]} would both be expanded to {target}: give them different names or "
                    "times, or expand fewer sequences at once"
                )
            seen[target] = original
    return rows


def turned_headings(theta: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heading of every image (frames, depth), rad; headings of rotated images lie in (-pi, pi]."""
    turned = theta[:, None] + turns
    return np.where(turns != 0, wrapped(turned), turned)


def write_lists(
    kind: str, frames: FrameTable, pictures: list[list[Path]], folder: Path, turns: NDArray[np.float64]
) -> None:
    """Write the files that a reader needs next to the images: COLD's lists of rooms and odometry, or the manifest.

    Args:
        kind: "cold", "folder" (which needs nothing) or "manifest".
        frames: the n frames whose images were made.
        pictures: image files of each frame (n, depth).
        folder: folder of the expanded data set.
        turns: what each image adds to the heading of its frame (n, depth), rad.

    Raises:
        StorageError: the disk cannot be written to.
    """
    theta, wheels = (turned_headings(angles, turns).tolist() for angles in (frames.theta, frames.odom_theta))
    places = frames.odometry[:, :2]
    if kind == "cold":
        for rows in frames.rows_by("sequence").values():
            sequence = pictures[rows[0]][0].parents[1]
            # Without this note, the COLD reader would take the panoramas for images of the mirror and unwrap them.
            write_json(sequence / "camera.json", {"images": "panorama"})
            lines = [f"{picture.name} {frames.room[row]}\n" for row in rows for picture in pictures[row]]
            if any(frames.room[rows].tolist()):
                write_text(sequence / "localization" / "places.lst", "".join(lines))
            if np.isfinite(places[rows]).any():
                own = [
                    (picture.name, *places[row], angle)
                    for row in rows
                    for picture, angle in zip(pictures[row], wheels[row], strict=True)
                ]
                write_text(sequence / "localization" / ODOMETRY_FILE, csv_text([("image", *ODOMETRY), *own]))
    elif kind == "manifest":
        table: list[Sequence[Any]] = [COLUMNS]
        for frame, row, *angles in zip(frames, pictures, theta, wheels, strict=True):
            for picture, angle, wheel in zip(row, *angles, strict=True):
                values = {**frame, "theta": angle, "odom_theta": wheel, "image": picture.relative_to(folder).as_posix()}
                table.append([values[column] for column in COLUMNS])
        write_text(folder / MANIFEST, csv_text(table))


def _check_apart(folder: Path, root: Path, kind: str, frames: FrameTable) -> None:
    """Raise ConfigError if a reader of the data set would read the expanded images as frames."""
    inside = real_path(folder)
    if kind != "manifest" and inside.is_relative_to(real_path(root)):
        raise ConfigError(f"out={folder} lies in the data set {root} itself: choose a folder outside it")
    if any(parent.is_relative_to(inside) for parent in {real_path(path).parent for path in frames.path.tolist()}):
        raise ConfigError(f"out={folder} holds images that are to be expanded: choose a folder outside the data")


def _sequence_folders(frames: FrameTable, root: Path, folder: Path) -> dict[str, Path]:
    """Return where each sequence goes: its folder below the root, or enough of the folders above for its name.

    Raises:
        DataError: the name of the expanded data set's own folder would rename a sequence.
    """
    above: dict[str, Path] = {}
    for sequence, rows in frames.rows_by("sequence").items():
        old = Path(frames.path[rows[0]]).parent.parent
        below = [old.relative_to(root)] if old.is_relative_to(root) else []
        tails = [Path(*old.absolute().parts[-count:]) for count in (1, 2, 3) if len(old.absolute().parts) > count]
        for relative in [*(path for path in [*below, *tails] if path.parts), Path(sequence)]:
            named = name_sequence(folder / relative, relative.as_posix(), frames.room[rows].tolist())
            if named.sequence == sequence:
                above[sequence] = relative
                break
        else:
            raise DataError(
                f"below {folder} the sequence {sequence} would be read as one of another building: choose a folder "
                "whose name contains no building and no part"
            )
    return above
