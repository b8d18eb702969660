"""The file format of maps: an npz archive of descriptors, frames, heading parts and a JSON header."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import read_headed, write_arrays
from siamloc.data.frames import FrameTable
from siamloc.errors import FormatError
from siamloc.maps.history import UPKEEP, History
from siamloc.maps.packing import Precision, packed, shares_values, unpacked

Map = TypeVar("Map")

_FORMAT = "siamloc map"
_VERSION = 2
_PLAIN = ("identity", "distance", "made")


def write_map(path: str | Path, known: Any, precision: Precision) -> None:
    """Write a map, atomically; equal maps give equal files.

    Args:
        path: the file to write.
        known: the map; its orientation parts are not written again if they share their memory with the descriptors.
        precision: precision of descriptors; orientation parts have at least float16.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    header: dict[str, Any] = {
        "format": _FORMAT,
        "version": _VERSION,
        "frames": len(known),
        "width": known.width,
        "unit": known.unit,
        **{name: getattr(known, name) for name in _PLAIN},
    }
    arrays: dict[str, NDArray[Any]] = {"descriptors": known.descriptors}
    if known.heading is not None and known.orientation is not None:
        header["heading"] = known.heading
        arrays["heading"] = known.orientation
    elif known.orientation is not None:
        header["orientation"] = list(known.orientation.shape)
        if not shares_values(known.orientation, known.descriptors):
            arrays["orientation"] = known.orientation
    if any(column.any() for column in (known.history.confirmed, known.history.contradicted, known.history.joined)):
        arrays |= {f"history_{name}": column for name, column in vars(known.history).items()}
    # Columns without any value are left out: `FrameTable` fills them in.
    columns = known.frames.columns().items()
    arrays.update({f"frame_{name}": column for name, column in columns if (column == column).any()})
    if precision != "float32":
        arrays = {**arrays, **packed("descriptors", known.learned, precision)}
        if known.has_colours:  # with a scale of their own, since their largest numbers are larger
            arrays |= packed("colours", known.descriptors[:, known.learned.shape[1] :], precision)
        if "orientation" in arrays:
            arrays.update(packed("orientation", arrays["orientation"], "float16"))
    write_arrays(path, header, arrays)


def read_map(path: str | Path, kind: Callable[..., Map]) -> Map:
    """Read a map that `write_map` wrote.

    Args:
        path: the file.
        kind: the class of the map.

    Raises:
        OldFormatError: a map of an older siamloc.
        FormatError: a file that is missing, truncated, altered, not a map, or of another version.
    """
    header, arrays = read_headed(path, _FORMAT, _VERSION, "build the map again with `siamloc map`", "siamloc-map")
    try:
        for name in ("descriptors", "orientation", "colours"):
            if f"{name}_scale" in arrays:
                arrays[name] = unpacked(arrays[name], arrays.pop(f"{name}_scale"))
        if "colours" in arrays:
            arrays["descriptors"] = np.concatenate([arrays["descriptors"], arrays.pop("colours")], axis=1)
        for name in {"descriptors", "orientation", "heading"} & set(arrays):
            arrays[name].flags.writeable = False  # nothing else refers to it
        columns: dict[str, Any] = {
            name.removeprefix("frame_"): array for name, array in arrays.items() if name.startswith("frame_")
        }
        descriptors = arrays["descriptors"]
        orientation = arrays["heading"] if "heading" in header else arrays.get("orientation")
        if orientation is None and header.get("orientation") is not None:
            orientation = descriptors.reshape(header["orientation"])
        frames, heading = FrameTable(**columns, unit=header["unit"]), header.get("heading")
        told = {name.removeprefix("history_"): array for name, array in arrays.items() if name.startswith("history_")}
        if told and "joined" not in told:
            told["joined"] = np.isin(frames.sequence, header["made"].get(UPKEEP, {}).get("drives", []))
        history = History(**told) if told else None
        values = {name: header[name] for name in _PLAIN}
        known = kind(descriptors, frames, **values, orientation=orientation, heading=heading, history=history)
        announced = (header.get("frames"), header.get("width"))
        if descriptors.shape != announced:
            raise ValueError(f"it announces descriptors {announced} and holds {descriptors.shape}")
        return known
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path} is not a whole siamloc map ({error}): build it again") from error
