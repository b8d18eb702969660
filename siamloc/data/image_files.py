"""Image files: those of a folder, their sizes, and their pixels."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.columns import spread_rows
from foundation.ordering import by_numbers
from foundation.settings import shortened
from siamloc.data.frames import advice
from siamloc.errors import say_once

_LARGEST = 16_384  # pixels per side of an image
_LOOKED_AT = 16  # images of a folder whose bits are counted
_SPOT = 4  # images of a folder by which it has images of 16 bits
_HEAD = 26  # bytes in which a PNG says how many bits it has
_ONE_BY_ONE = Lock()  # a folder is looked at once, by one of the threads
_MAY_BE_DEEP = b"II*\0", b"MM\0*", b"P5", b"P6"  # a TIFF, or a PPM or PGM, begins with these


class UnreadableImageError(Exception):
    """An image that cannot be used, among others that can; the text says why."""


def image_files(folder: Path, second: tuple[str, str] | None = None) -> list[Path]:
    """Return the image files directly inside a folder, in the order of their names, where 2 comes before 10.

    Hidden files, whose names begin with a dot, are left out.

    Args:
        folder: the folder.
        second: how the names of second pictures differ, which are left out; see `DualFisheyeCamera`.
    """
    suffixes = {".jpeg", ".jpg", ".png", ".bmp", ".ppm", ".tif", ".tiff", ".webp"}
    shown = (path for path in folder.iterdir() if not path.name.startswith("."))
    files = sorted((path for path in shown if path.suffix.lower() in suffixes and path.is_file()), key=by_numbers)
    if second is None:
        return files
    others = {other for file in files if (other := file.name.replace(*second)) != file.name}
    return [file for file in files if file.name not in others]


def pictures_not_read(folder: Path) -> list[str]:
    """Return the names of files directly inside a folder whose formats are not read, such as HEIC.

    Hidden files are left out, and those that have the name of an image file but for the suffix, which shows the same.
    """
    read = {path.stem for path in image_files(folder)}
    shown = (path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return sorted(path.name for path in shown if advice([path.name]) and path.stem not in read)


def say_not_read(folder: Path) -> None:
    """Warn once of `pictures_not_read`."""
    if names := pictures_not_read(folder):
        what = f"files in formats that are not read are left out: {len(names)}, the first {names[0]}"
        say_once(f"{folder}: {what}{advice(names)}")


def no_images(folder: Path) -> str:
    """Say that a folder holds no images, what it holds instead, and which folder below it holds some."""
    inside = sorted(path.name for path in folder.iterdir())
    said = f"{folder} holds no images; it holds: {shortened(', '.join(inside)) or 'nothing'}{advice(inside)}"
    for path in (path for pattern in ("*/", "*/*/", "*/*/*/") for path in sorted(folder.glob(pattern))):
        with suppress(OSError):
            if image_files(path):
                return f"{said}; there are some in {path}"
    return said


def read_image(path: str | Path, bits: int | None = None) -> NDArray[np.uint8]:
    """Read an image file as (rows, columns, 3), uint8, BGR; grey images get three equal channels.

    Args:
        path: the file.
        bits: how many of 16 bits are in use; if None, as many as in the images of the folder.

    Raises:
        UnreadableImageError: the file is missing, empty, cut short, or not an image.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError as error:
        raise UnreadableImageError("the file does not exist") from error
    except (OSError, ValueError) as error:  # a name that no file can have
        raise UnreadableImageError(getattr(error, "strerror", None) or str(error)) from error
    return decode_image(data, Path(path).absolute().parent, bits)


def decode_image(data: bytes, folder: Path | None = None, bits: int | None = None) -> NDArray[np.uint8]:
    """Decode the content of an image file as (rows, columns, 3), uint8, BGR; see `read_image`.

    Args:
        data: the content.
        folder: the folder whose images of 16 bits say how many of them are in use; this image does if None.
        bits: how many of 16 bits are in use; None if unknown.

    Raises:
        UnreadableImageError: the content is empty, cut short, too large, or not an image.
    """
    if not data:
        raise UnreadableImageError("the file is empty")
    if cut_short(data):
        raise UnreadableImageError("the file is cut short")
    if (size := _declared_size(data)) is not None and max(size) > _LARGEST:
        raise UnreadableImageError(f"it has {size[0]:,} x {size[1]:,} pixels, and {_LARGEST:,} a side are the most")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
        if (deep := _deep(data)) is not None:
            if bits is None and folder is not None and (bits := _bits_in(folder)) < 16:
                say_once(f"{folder}: its images use {bits} of 16 bits, and are brightened alike")
            bits = bits or bits_used(deep)
            image = np.minimum(deep >> (bits - 8), 255)
    except cv2.error as error:
        raise UnreadableImageError(f"the image cannot be decoded ({error.err})") from error
    if image is None and data[4:8] == b"ftyp":
        raise UnreadableImageError("it is a HEIC or AVIF picture or a video: convert it to JPEG")
    if image is None:
        raise UnreadableImageError(
            "the file is not an image, is damaged, or is of a kind that OpenCV does not read, such as a TIFF of 32-bit "
            "floats: save it with 8 or 16 bits"
        )
    return np.asarray(image, dtype=np.uint8)


def _deep(data: bytes) -> NDArray[np.uint16] | None:
    """Return the pixels (rows, columns, 3), BGR, of a PNG, TIFF or PPM of 16 bits; None for all other images."""
    if not _may_be_deep(data):
        return None
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    return np.asarray(image, np.uint16) if image is not None and image.dtype == np.uint16 else None


def _may_be_deep(data: bytes) -> bool:
    return data.startswith(_MAY_BE_DEEP) or (data.startswith(b"\x89PNG") and data[24:25] == b"\x10")


def bits_used(image: NDArray[Any]) -> int:
    """Return how many bits the sensor of an image has: 10, 12, 14 or 16, since a dark image leaves upper ones empty."""
    bits = max(int(image.max()).bit_length(), 10)
    return bits + bits % 2


def bits_of(path: str | Path) -> int | None:
    """Return how many bits the images of 16 bits next to an image, itself among them, use; None if it has 8."""
    with Path(path).open("rb") as file:
        head = file.read(_HEAD)
        deep = _may_be_deep(head) and _deep(head + file.read()) is not None
    return _bits_in(Path(path).absolute().parent) if deep else None


def bits_by_folder(paths: Iterable[str | Path]) -> dict[str, int]:
    """Return what `bits_of` returns for each folder in which one of a few images has 16 bits."""
    folders: dict[str, list[str | Path]] = {}
    for path in paths:
        folders.setdefault(os.path.dirname(path), []).append(path)  # noqa: PTH120 (tens of thousands of paths)
    found = dict[str, int]()
    for folder, inside in folders.items():
        for path in spread(inside, _SPOT):
            with suppress(OSError, ValueError, cv2.error):
                if (bits := bits_of(path)) is not None:
                    found[os.path.abspath(folder)] = bits  # noqa: PTH100
                    break
    return found


def _bits_in(folder: Path) -> int:
    with _ONE_BY_ONE:
        return _bits_found(folder)


@cache
def _bits_found(folder: Path) -> int:
    """Return how many bits the images of 16 bits in a folder use, so that all of them are brightened alike."""
    most = 0
    for file in spread(image_files(folder), _LOOKED_AT):
        with suppress(OSError, cv2.error):
            if (image := _deep(file.read_bytes())) is not None:
                most = max(most, bits_used(image))
    return most or 16


def spread(items: Sequence[Any] | NDArray[Any], most: int) -> list[Any]:
    """Return up to `most` of some items, evenly spread from the first to the last."""
    return [items[row] for row in spread_rows(len(items), most).tolist()]


def size_of(path: str | Path) -> tuple[int, int] | None:
    """Return the rows and columns of an image as it is read, turned as its metadata say; None if it cannot be read."""
    with suppress(UnreadableImageError):
        rows, columns = read_image(path, bits=16).shape[:2]
        return rows, columns
    return None


def _declared_size(data: bytes) -> tuple[int, int] | None:
    """Return the rows and columns in the header of a PNG or JPEG; None for other formats, or without a header."""
    if data.startswith(b"\x89PNG") and len(data) > 24:
        columns, rows = struct.unpack(">II", data[16:24])
        return rows, columns
    at = 2
    while data.startswith(b"\xff\xd8") and at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            rows, columns = struct.unpack(">HH", data[at + 5 : at + 9])
            return rows, columns
        at += 2 + length
    return None


def cut_short(data: bytes) -> bool:
    """Whether a JPEG or PNG ends before its end marker: some releases of OpenCV fill the rest with grey."""
    if data.startswith(b"\xff\xd8"):
        # The last scan has to be closed; an earlier end marker may belong to an embedded thumbnail.
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda") or b"\xff\xd9" not in data
    return data.startswith(b"\x89PNG") and b"IEND" not in data
