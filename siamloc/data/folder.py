"""Reader of image folders: `<split>/<room>/<image>`, the layout that the field's published code uses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from foundation.files import expanded, first_names
from siamloc.data.frames import FrameTable, advice, in_capture_order
from siamloc.data.image_files import image_files, pictures_not_read
from siamloc.data.names import lighting_in, parse_name
from siamloc.errors import DataError, Policy, leave_out

_LAYOUT = "<split>/<room>/<image>, such as test_cloudy/KT-A/t1152889564.947_x0.2_y0.1_a0.0.jpeg"


def read_folder(root: str | Path, *, on_error: Policy = "skip") -> FrameTable:
    """Read an image folder, <split>/<room>/<image>.jpeg; a split is a sequence.

    The split becomes the sequence and the room's folder the room; the split's name may contain the lighting. If all
    images of a split have COLD names, the frames are in order of time, otherwise of room and name; an image without a
    COLD name has no pose (NaN).

    Args:
        root: the folder that contains the splits.
        on_error: "skip" or "raise", for images next to the rooms' folders, which have no room, or deeper inside, and
            for pictures in formats that are not read, such as HEIC.

    Raises:
        DataError: the folder is missing, or holds no image in this layout.
    """
    root = expanded(root)
    if not root.is_dir():
        raise DataError(f"{root} is not a folder: expected one with {_LAYOUT}")
    frames: list[dict[str, Any]] = []
    stray: list[str] = []
    foreign: list[str] = []
    for split in _subfolders(root):
        stray += [str(image) for image in image_files(split)]
        for room in _subfolders(split):
            frames += [_frame(image, split.name) for image in image_files(room)]
            stray += [str(image) for inside in _subfolders(room) for image in image_files(inside)]
            foreign += [str(room / name) for name in pictures_not_read(room)]
    if not frames:
        raise DataError(
            f"{root} holds no images laid out as {_LAYOUT}; it holds: {first_names(root) or 'nothing'}"
            + (f"; images not directly in a room's folder: {len(stray)}, the first {stray[0]}" if stray else "")
            + advice(foreign)
        )
    leave_out(stray, len(stray) + len(frames), "images lie next to the rooms' folders, or in folders inside", on_error)
    what = f"files are in formats that are not read{advice(foreign)}"
    leave_out(foreign, len(foreign) + len(frames), what, on_error)
    return in_capture_order(FrameTable.from_rows(frames))


def _subfolders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))


def _frame(image: Path, split: str) -> dict[str, Any]:
    pose = parse_name(image.name)
    labels = {"room": image.parent.name, "sequence": split, "lighting": lighting_in(split)}
    return {"path": str(image), **labels, **(pose._asdict() if pose is not None else {})}
