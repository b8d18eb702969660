"""`VisualMap`: the frames a robot knows, with their descriptors, in memory and in one file."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.descriptors.base import Description
from analytic.distances import DISTANCES
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError, hint
from siamloc.files import atomic_path, plain
from siamloc.maps.heading import HeadingPart
from siamloc.maps.search import Retrieval, nearest

_FORMAT = "siamloc-map"
_VERSION = 1


@dataclass(frozen=True, eq=False)
class VisualMap:
    """Descriptors (n, D) with the frames they describe; immutable.

    Attributes:
        descriptors: (n, D) float32, read-only.
        frames: n frames; poses and rooms may be missing, and then the tasks that need them say so.
        identity: what made the descriptors (name, parameters, hash of the weights), as plain values.
        distance: how descriptors are compared: a name in `analytic.DISTANCES`.
        unit: what x and y count, "m" if nothing else is known.
        made: how its frames were chosen, as plain values; for the record only.
        orientation: (n, K, F) what tells headings, read-only; None for a descriptor that has no such part.
        heading: what another descriptor tells headings by, where this one cannot; None if that is not wanted.

    Raises:
        DataError: no frames, not as many descriptors or heading parts as frames, or values that are not finite.
        ConfigError: an unknown distance.
    """

    descriptors: NDArray[np.float32]
    frames: FrameTable
    identity: dict[str, Any] = field(default_factory=dict)
    distance: str = "euclidean"
    unit: str = "m"
    made: dict[str, Any] = field(default_factory=dict)
    orientation: NDArray[Any] | None = None
    heading: HeadingPart | None = None

    def __post_init__(self) -> None:
        descriptors = np.array(self.descriptors, dtype=np.float32)
        if descriptors.ndim != 2 or 0 in descriptors.shape:
            raise DataError(f"a map needs descriptors of shape (n, D), n and D at least 1, got {descriptors.shape}")
        if len(descriptors) != len(self.frames):
            raise DataError(
                f"a map needs one descriptor per frame, got {len(descriptors)} for {len(self.frames)} frames"
            )
        if not np.isfinite(descriptors).all():
            bad = np.flatnonzero(~np.isfinite(descriptors).all(axis=1))
            raise DataError(
                f"{len(bad)} of {len(descriptors)} map descriptors hold values that are not finite, the first that of "
                f"{self.frames.path[bad[0]]}: look at the model and at this image"
            )
        if self.distance not in DISTANCES:
            raise ConfigError(f"unknown distance {self.distance!r}: {hint(self.distance, DISTANCES)}")
        descriptors.flags.writeable = False
        object.__setattr__(self, "descriptors", descriptors)
        if self.orientation is not None:
            orientation = _checked_orientation(self.orientation, len(self.frames))
            if _in_one_line(orientation, descriptors):
                orientation = descriptors.reshape(orientation.shape)
            object.__setattr__(self, "orientation", orientation)
        if self.heading is not None and len(self.heading) != len(self.frames):
            raise DataError(
                f"a map needs one heading part per frame, got {len(self.heading)} for {len(self.frames)} frames"
            )
        object.__setattr__(self, "identity", plain(dict(self.identity)))

    def __len__(self) -> int:
        return len(self.descriptors)

    @property
    def width(self) -> int:
        """Values in a descriptor, D."""
        return self.descriptors.shape[1]

    @cached_property
    def description(self) -> Description:
        """The map as what its descriptor compares; its spectrum is computed once for all queries."""
        return Description(self.descriptors, self.orientation)

    @cached_property
    def digest(self) -> str:
        """What changes with the map's descriptors, frames or descriptor; what tells headings does not count."""
        digest = hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode())
        digest.update("\0".join([*self.frames.path.tolist(), *self.frames.place.tolist()]).encode())
        for array in (self.descriptors, self.frames.xy):
            digest.update(array.tobytes())
        return digest.hexdigest()

    def take(self, rows: NDArray) -> VisualMap:
        """Return the map of the rows given by positions or by a mask."""
        return replace(
            self,
            descriptors=self.descriptors[rows],
            frames=self.frames.take(rows),
            orientation=None if self.orientation is None else self.orientation[rows],
            heading=None if self.heading is None else self.heading.take(rows),
        )

    def oriented(self) -> VisualMap:
        """Return the map with its heading part as the orientation part, to compare with what told the headings.

        Raises:
            DataError: it has no heading part.
        """
        if self.heading is None:
            raise DataError("the map holds nothing to tell headings by: build it anew with `siamloc map heading=hog`")
        return replace(self, orientation=self.heading.orientation)

    def search(self, descriptors: ArrayLike, k: int = 1) -> Retrieval:
        """Return the k nearest map frames of each descriptor (n, D), exactly; min(k, len(map)) of them.

        Raises:
            DataError, ConfigError: as `siamloc.maps.nearest`.
        """
        return nearest(descriptors, self.descriptors, k, self.distance)

    def check_describer(self, identity: Mapping[str, Any]) -> None:
        """Make sure that queries were described by what described the map.

        Raises:
            ConfigError: they were not; the keys that differ are named with both values.
        """
        ours, theirs = _flat(self.identity), _flat(plain(dict(identity)))
        keys = [key for key in {**ours, **theirs} if ours.get(key, _ABSENT) != theirs.get(key, _ABSENT)]
        if keys:
            listed = "; ".join(f"{key} is {_shown(ours, key)} in the map, {_shown(theirs, key)} here" for key in keys)
            raise ConfigError(
                f"the map was described by something else than the queries: {listed}. "
                "Describe the queries with the map's model, or build the map anew"
            )

    def save(self, path: str | Path) -> None:
        """Write the map into one npz file, atomically; equal maps give equal files.

        Raises:
            StorageError: the disk refuses.
        """
        header = {
            "format": _FORMAT,
            "version": _VERSION,
            "frames": len(self),
            "width": self.width,
            "identity": self.identity,
            "distance": self.distance,
            "unit": self.unit,
            "made": plain(self.made),
        }
        arrays: dict[str, NDArray] = {"descriptors": self.descriptors}
        if self.orientation is not None:
            header["orientation"] = list(self.orientation.shape)
            if not np.shares_memory(self.orientation, self.descriptors):
                arrays["orientation"] = self.orientation
        if self.heading is not None:
            header["heading"] = self.heading.identity
            arrays["heading"] = self.heading.values
        arrays["header"] = np.array(json.dumps(header, ensure_ascii=False))
        arrays.update({f"frame_{name}": column for name, column in self.frames.columns().items()})
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for name, array in arrays.items():
                # A fixed date keeps the file a function of its contents; text shrinks to little, descriptors do not.
                entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED if array.dtype.kind == "U" else zipfile.ZIP_STORED
                with archive.open(entry, "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)

    @classmethod
    def load(cls, path: str | Path) -> VisualMap:
        """Read a map that `save` wrote.

        Raises:
            FormatError: the file is missing, cut short, altered, not a map, or of a newer version.
        """
        path = Path(path)
        if not path.is_file():
            raise FormatError(f"{path} does not exist: build the map first")
        try:
            with path.open("rb") as file:
                archive = np.load(file, allow_pickle=False)
                arrays = {name: archive[name] for name in archive.files} if hasattr(archive, "files") else {}
        except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
            raise FormatError(f"{path} is not a siamloc map, or not a whole one: build it anew") from error
        header = _read_header(path, arrays)
        columns = {name.removeprefix("frame_"): array for name, array in arrays.items() if name.startswith("frame_")}
        try:
            loaded = cls(
                descriptors=arrays["descriptors"],
                frames=FrameTable(**columns),
                identity=header["identity"],
                distance=header["distance"],
                unit=header["unit"],
                made=header.get("made", {}),
                orientation=_stored_orientation(header, arrays),
                heading=HeadingPart(header["heading"], arrays["heading"]) if "heading" in header else None,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{path} is not a whole siamloc map ({error}): build it anew") from error
        if (len(loaded), loaded.width) != (header.get("frames"), header.get("width")):
            raise FormatError(
                f"{path} announces {header.get('frames')} descriptors of {header.get('width')} values and holds "
                f"{len(loaded)} of {loaded.width}: build it anew"
            )
        return loaded


_ABSENT = object()


def _in_one_line(orientation: NDArray, descriptors: NDArray) -> bool:
    """Say whether the orientation parts are the descriptors in another shape, so that one copy will do."""
    same = orientation.dtype == descriptors.dtype and orientation.size == descriptors.size
    return same and np.array_equal(orientation.reshape(descriptors.shape), descriptors)


def _stored_orientation(header: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> NDArray | None:
    if "orientation" in arrays or header.get("orientation") is None:
        return arrays.get("orientation")
    return arrays["descriptors"].reshape(header["orientation"])


def _checked_orientation(orientation: NDArray, frames: int) -> NDArray:
    array = np.array(orientation)
    if array.ndim != 3 or len(array) != frames or 0 in array.shape or array.dtype.kind not in "fcu":
        raise DataError(
            f"a map's orientation parts must be numbers of shape ({frames}, K, F), got {array.dtype} {array.shape}"
        )
    if not np.isfinite(array).all():
        raise DataError("a map's orientation parts hold values that are not finite: look at the images")
    array.flags.writeable = False
    return array


def _read_header(path: Path, arrays: Mapping[str, NDArray]) -> dict[str, Any]:
    try:
        header = json.loads(str(arrays["header"][()]))
        known = header["format"] == _FORMAT and isinstance(header["version"], int)
    except (KeyError, TypeError, ValueError):
        known = False
    if not known:
        raise FormatError(f"{path} is not a siamloc map: give the file that `siamloc map` wrote")
    if header["version"] > _VERSION:
        raise FormatError(
            f"{path} is a map of format version {header['version']}, this siamloc reads up to {_VERSION}: "
            "update siamloc"
        )
    return header


def _flat(value: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested dictionaries as one with dotted keys."""
    flat: dict[str, Any] = {}
    for key, item in value.items():
        if isinstance(item, Mapping):
            flat.update(_flat(item, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = item
    return flat


def _shown(identity: Mapping[str, Any], key: str) -> str:
    return repr(identity[key]) if key in identity else "absent"
