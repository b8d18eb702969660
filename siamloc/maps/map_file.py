"""The file format of maps: an npz archive of descriptors, frames, heading parts and a JSON header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import read_headed, write_arrays
from siamloc.data.frames import FrameTable
from siamloc.errors import FormatError
from siamloc.maps.heading import HeadingPart
from siamloc.maps.packing import Precision, packed, shares_values, unpacked

_FORMAT = "siamloc map"
_VERSION = 2


def write_map(
    path: str | Path,
    descriptors: NDArray[np.float32],
    frames: FrameTable,
    about: Mapping[str, Any],
    orientation: NDArray[Any] | None,
    heading: HeadingPart | None,
    precision: Precision,
) -> None:
    """Write a map, atomically; equal contents give equal files.

    Args:
        path: the file to write.
        descriptors: (n, D).
        frames: the n frames.
        about: `identity`, `distance`, `unit` and `made`, as plain values.
        orientation: (n, K, F); not written again if it shares its memory with the descriptors.
        heading: the separate heading part, if any.
        precision: of descriptors; orientation parts have at least float16.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    header = {
        "format": _FORMAT,
        "version": _VERSION,
        "frames": len(descriptors),
        "width": descriptors.shape[1],
        **about,
    }
    arrays: dict[str, NDArray] = {"descriptors": descriptors}
    if orientation is not None:
        header["orientation"] = list(orientation.shape)
        if not shares_values(orientation, descriptors):
            arrays["orientation"] = orientation
    if heading is not None:
        header["heading"] = heading.identity
        arrays["heading"] = heading.values
    arrays.update({f"frame_{name}": column for name, column in frames.columns().items()})
    if precision != "float32":
        arrays = {**arrays, **packed("descriptors", descriptors, precision)}
        if "orientation" in arrays:
            arrays.update(packed("orientation", arrays["orientation"], "float16"))
    write_arrays(path, header, arrays)


def read_map(content: Path | bytes, path: str | Path) -> tuple[dict[str, Any], tuple[Any, Any]]:
    """Read a map file: return the fields of a `VisualMap` by name, and the number of frames and width in the header.

    Args:
        content: the path, or the content of the file.
        path: name of the file in error messages.

    Raises:
        FormatError: a file that is truncated, altered, not a map, or of another version.
    """
    header, arrays = read_headed(content, path, _FORMAT, _VERSION, "build it again")
    try:
        _unpack(arrays)
    except ValueError as error:
        raise not_whole(path, error) from error
    columns: dict[str, Any] = {
        name.removeprefix("frame_"): array for name, array in arrays.items() if name.startswith("frame_")
    }
    try:
        fields = {
            "descriptors": arrays["descriptors"],
            "frames": FrameTable(**columns, unit=header["unit"]),
            "identity": header["identity"],
            "distance": header["distance"],
            "unit": header["unit"],
            "made": header.get("made", {}),
            "orientation": _stored_orientation(header, arrays),
            "heading": HeadingPart(header["heading"], arrays["heading"]) if "heading" in header else None,
        }
    except (KeyError, TypeError, ValueError) as error:
        raise not_whole(path, error) from error
    return fields, (header.get("frames"), header.get("width"))


def not_whole(path: str | Path, error: Exception) -> FormatError:
    """Return the error for a file whose parts do not form a map."""
    return FormatError(f"{path} is not a whole siamloc map ({error}): build it again")


def _unpack(arrays: dict[str, Any]) -> None:
    """Convert arrays of lower precision to float32, and make the large ones read-only."""
    for name in ("descriptors", "orientation"):
        if f"{name}_scale" in arrays:
            arrays[name] = unpacked(arrays[name], arrays.pop(f"{name}_scale"))
    for name in {"descriptors", "orientation", "heading"} & set(arrays):
        arrays[name].flags.writeable = False  # nothing else refers to it


def _stored_orientation(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> NDArray | None:
    if "orientation" in arrays or header.get("orientation") is None:
        return arrays.get("orientation")
    return arrays["descriptors"].reshape(header["orientation"])
