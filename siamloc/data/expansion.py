"""File names of the images of an expanded data set, and the lists next to them, in the layout of the original.

The pose and the labels of an image are those of its frame; a rotation only adds to the heading. Readers thus read an
expanded data set like any other.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.files import write_json, write_text
from siamloc.data.frames import FrameTable
from siamloc.data.manifest import COLUMNS
from siamloc.data.names import NamedPose, format_name, name_sequence, parse_name
from siamloc.errors import DataError

MANIFEST = "manifest.csv"
_TICK = 1e-6  # s, between the times of two variants in names that carry the time
_KEPT = (".jpeg", ".jpg", ".png")


def outputs(
    kind: str, frames: FrameTable, root: str | Path, folder: str | Path, headings: NDArray[np.float64]
) -> list[list[Path]]:
    """Return the file of every image (frames, depth).

    - cold: `<sequence folder>/<camera>/t<time>_x<x>_y<y>_a<theta>.jpeg`; the variants of a frame are a microsecond
      apart, so that no two have the same name.
    - folder: `<split>/<room>/`, with COLD names if the frame has one, else `<name>_v<variant>`.
    - manifest: the image's own path with `_v<variant>` added.

    Args:
        kind: "cold", "folder" or "manifest".
        frames: n frames.
        root: the folder that the frames were read from; for a manifest, the folder of the table.
        folder: folder of the expanded data set.
        headings: amount that each image's rotation adds to the heading (n, depth), rad.

    Raises:
        DataError: two images would have the same name, or the folder's own name would rename a sequence.
    """
    places = _cold(frames, Path(root), Path(folder)) if kind == "cold" else _PLACES[kind](frames, Path(root))
    turned = turned_headings(frames, headings)
    rows = []
    for row, frame in enumerate(frames):
        parent, stem, suffix = places[row]
        pose = parse_name(f"{stem}{suffix}") if kind != "manifest" else None
        names = [
            f"{stem}_v{variant:03d}{suffix}"
            if pose is None
            else format_name(NamedPose(frame["time"] + variant * _TICK, frame["x"], frame["y"], theta), suffix)
            for variant, theta in enumerate(turned[row].tolist())
        ]
        rows.append([Path(folder) / parent / name for name in names])
    _check_distinct(rows, frames)
    return rows


def turned_headings(frames: FrameTable, headings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heading of every image (frames, depth), rad; those of rotated images lie in (-pi, pi]."""
    theta = frames.theta[:, None] + headings
    return np.where(headings != 0, math.pi - (math.pi - theta) % (2 * math.pi), theta)


def write_lists(
    kind: str, frames: FrameTable, pictures: list[list[Path]], folder: str | Path, headings: NDArray[np.float64]
) -> list[Path]:
    """Write the files that a reader needs next to the images and return them: COLD's lists of rooms, or the manifest.

    Args:
        kind: "cold", "folder" (which needs nothing) or "manifest".
        frames: the frames whose images were made.
        pictures: image files of each frame (n, depth).
        folder: folder of the expanded data set.
        headings: as for `outputs` (n, depth), rad.

    Raises:
        StorageError: the disk cannot be written to.
    """
    if kind == "cold":
        return _write_places(frames, pictures)
    if kind == "manifest":
        return [_write_manifest(frames, pictures, Path(folder), turned_headings(frames, headings))]
    return []


def _cold(frames: FrameTable, root: Path, folder: Path) -> list[tuple[Path, str, str]]:
    """Keep each sequence's folder below the root, with as many of the folders above as its name needs."""
    above: dict[str, Path] = {}
    for sequence, rows in frames.rows_by("sequence").items():
        camera = Path(frames.path[rows[0]]).parent
        rooms = frames.room[rows].tolist()
        for relative in _candidates(camera.parent, root, sequence):
            if name_sequence(folder / relative, relative.as_posix(), rooms).sequence == sequence:
                above[sequence] = relative
                break
        else:
            raise DataError(
                f"below {folder} the sequence {sequence} would be read as one of another building: choose a folder "
                "whose name contains no building and no part"
            )
    return [
        (above[frame["sequence"]] / Path(frame["path"]).parent.name, *_stem(Path(frame["path"]))) for frame in frames
    ]


def _candidates(sequence_folder: Path, root: Path, sequence: str) -> list[Path]:
    parts = sequence_folder.absolute().parts
    below = [sequence_folder.relative_to(root)] if sequence_folder.is_relative_to(root) else []
    tails = [Path(*parts[-count:]) for count in (1, 2, 3) if len(parts) > count]
    return [path for path in [*below, *tails] if path.parts] + [Path(sequence)]


def _folder(frames: FrameTable, root: Path) -> list[tuple[Path, str, str]]:
    return [(Path(frame["sequence"]) / frame["room"], *_stem(Path(frame["path"]))) for frame in frames]


def _manifest(frames: FrameTable, root: Path) -> list[tuple[Path, str, str]]:
    """Keep the images' own folders if they lie below the table's folder, else gather them by sequence."""
    places = []
    for frame in frames:
        path = Path(frame["path"])
        inside = path.is_relative_to(root) and ".." not in path.relative_to(root).parts
        parent = path.relative_to(root).parent if inside else Path("images") / (frame["sequence"] or "frames")
        places.append((parent, *_stem(path)))
    return places


_PLACES: dict[str, Callable[[FrameTable, Path], list[tuple[Path, str, str]]]] = {
    "folder": _folder,
    "manifest": _manifest,
}


def _stem(path: Path) -> tuple[str, str]:
    return path.stem, path.suffix if path.suffix.lower() in _KEPT else ".png"


def _check_distinct(rows: list[list[Path]], frames: FrameTable) -> None:
    seen: dict[Path, str] = {}
    for frame, row in zip(frames, rows, strict=True):
        for path in row:
            if path in seen:
                raise DataError(
                    f"{frame['path']} and {seen[path]} would both be expanded to {path}: give them different names or "
                    "times, or expand fewer sequences at once"
                )
            seen[path] = frame["path"]


def _write_places(frames: FrameTable, pictures: list[list[Path]]) -> list[Path]:
    written = []
    for rows in frames.rows_by("sequence").values():
        sequence = pictures[rows[0]][0].parents[1]
        # Without this note, the COLD reader would take the panoramas for images of the mirror and unwrap them.
        write_json(sequence / "camera.json", {"images": "panorama"})
        if not any(frames.room[rows].tolist()):
            continue
        lines = [f"{picture.name} {frames.room[row]}\n" for row in rows for picture in pictures[row]]
        target = sequence / "localization" / "places.lst"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_text(target, "".join(lines))
        written.append(target)
    return written


def _write_manifest(
    frames: FrameTable, pictures: list[list[Path]], folder: Path, headings: NDArray[np.float64]
) -> Path:
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row, frame in enumerate(frames):
        for picture, theta in zip(pictures[row], headings[row].tolist(), strict=True):
            values = {**frame, "theta": theta, "image": picture.relative_to(folder).as_posix()}
            writer.writerow("" if values[column] != values[column] else values[column] for column in COLUMNS)
    write_text(folder / MANIFEST, text.getvalue())
    return folder / MANIFEST
