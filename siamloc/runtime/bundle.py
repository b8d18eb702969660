"""The bundle: one folder with everything a robot needs, and its description in `bundle.json`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from foundation.calls import typed
from foundation.files import check_version, file_hash, older_folder, read_json
from foundation.settings import Count, Size, misfit
from siamloc.data.decoding import Preprocessing, is_known
from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.maps import CoarseLayer, ErrorModel, Refinement, VisualMap
from siamloc.maps.heading import is_analytic
from siamloc.maps.packing import Precision
from siamloc.runtime.own_camera import SampledCamera
from siamloc.runtime.thumbnails import read_thumbnails

FORMAT = "siamloc-bundle"
VERSION = 4
DESCRIPTION = "bundle.json"
MODEL = "model.onnx"
MAP = "map.npz"
ERRORS = "error_model.json"
REFINEMENT = "refinement.json"
RELATIVE = "relative.onnx"
LAYER, COARSE = "layer.npz", "coarse_map.npz"
THUMBNAILS = "thumbnails.npz"
CAMERA = "camera.npz"
PARTS = (MODEL, MAP, ERRORS, REFINEMENT, RELATIVE, LAYER, COARSE, THUMBNAILS, CAMERA)
_READERS: dict[str, Callable[[Path], Any]] = {
    MAP: VisualMap.load,
    ERRORS: ErrorModel.load,
    REFINEMENT: Refinement.load,
    LAYER: CoarseLayer.load,
    COARSE: VisualMap.load,
    THUMBNAILS: read_thumbnails,
    CAMERA: SampledCamera.load,
}
_FINER = {"interpolate": "between", "relative": "by comparison with"}
_KEYS: dict[str, Any] = {
    "sha256": dict,
    "preprocessing": dict,
    "identity": dict,
    "parity": {"max_abs_difference": float, "max_relative_difference": float},
    "precision": Precision,
    "unit": str | None,
    "heading": {"identity": {"name": str}},
    "refinement": {"method": Literal["interpolate", "relative"], "neighbours": Count},
    "search": {"by": str},
    "errors": {"lost_above": float | None},
    "precisions": list,
    "pictures": {"size": Size | None, "bits": Literal[10, 12, 14, 16] | None},
}
"""The kind of value of each key of a description."""
_LONGEST = 64_000_000  # bytes of a description
_TRIES, _PAUSE = 5, 0.02  # to read a bundle that is replaced meanwhile, and s between them
_OPTIONAL = ("heading", "refinement", "search", "errors", "precisions", "unit", "pictures")


@dataclass(frozen=True, repr=False)
class Bundle:
    """An opened bundle; `siamloc.runtime.export` writes one.

    Attributes:
        path: folder of the bundle.
        about: the content of `bundle.json`: `preprocessing`, `identity` (of the network or analytic descriptor),
            `parity` (how far the exported descriptors are from the originals), `precision`, `heading` and `errors`
            (where they come from, None without), `refinement` (how poses are made finer than the map, None if they are
            not), `search` (how a coarse layer is searched first, None without one), `precisions` (size, speed and
            accuracy in each precision, if one was chosen), `figures` (of its evaluation, None without), `pictures` (of
            the map: `size` if the camera's parameters count in their pixels or there is none, and how many `bits` of 16
            are in use; None otherwise), `sha256` by file.
        preprocessing: reads an image and makes a panorama of it, with image size and camera.
    """

    path: Path
    about: dict[str, Any]
    preprocessing: Preprocessing

    def __repr__(self) -> str:
        return f"Bundle({str(self.path)!r}: {', '.join(self.files)})"

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files in the bundle, without `bundle.json`."""
        return tuple(self.about["sha256"])

    @property
    def image_size(self) -> tuple[int, int]:
        """Rows and columns of a panorama."""
        return self.preprocessing.view.height, self.preprocessing.view.width

    @property
    def identity(self) -> dict[str, Any]:
        """Names, parameters and hashes of all that makes a descriptor, preprocessing included; as in the map."""
        return {**self.about["identity"], "images": self.about["preprocessing"]}

    @property
    def parity(self) -> dict[str, Any]:
        """How far the exported descriptors are from the original's; see `siamloc.runtime.parity`."""
        return dict(self.about["parity"])

    def load(self, name: str) -> Any:
        """Read a part by the name of its file, such as "map.npz"; None if the bundle has no such part.

        Raises:
            FormatError: the part is damaged.
        """
        return _READERS[name](self.path / name) if name in self.files else None

    def thumbnail(self, row: int) -> bytes | None:
        """Return a thumbnail of a map frame as JPEG; None if the bundle has none.

        Args:
            row: row in the map, as in `Candidate.row`.

        Raises:
            FormatError: the thumbnails are damaged.
            IndexError: there is no such row.
        """
        return None if self._thumbnails is None else self._thumbnails[row]

    def summary(self) -> str:
        """Return two lines with the accuracy of the exported descriptor and what the robot gets."""
        first = (
            f"bundle: {self.path}, {self.bytes / 1e6:.1f} MB, {self.about['precision']}; largest difference from the "
            f"original {self.parity['max_abs_difference']:.1e}, {self.parity['max_relative_difference']:.1e} of the "
            "largest value"
        )
        if MAP not in self.files:
            return f"{first}\nthe robot gets descriptors only: there is no map to locate images in"
        finer = self.about.get("refinement")
        how = "" if finer is None else f" ({_FINER[finer['method']]} {finer['neighbours']} map frames)"
        frames = self.load(MAP).frames
        alike = "room" if (frames.room != "").any() else "the map frames that look most alike"
        gets = [f"position{how}" if frames.has_position.any() else alike]
        if self.about.get("heading") is not None and np.isfinite(frames.theta).any():
            gets.append(f"heading (by {self.about['heading']['identity']['name']})")
        if ERRORS in self.files:
            lost = self.about["errors"].get("lost_above")
            gets.append(
                "expected error"
                if lost is None
                else f"expected error (lost above {lost:g} {self.about.get('unit', 'm')})"
            )
        if LAYER in self.files:
            gets.append(f"a coarse layer by {self.about['search']['by']}")
        if THUMBNAILS in self.files:
            gets.append("pictures of the map")
        return f"{first}\nthe robot gets: {', '.join(gets)}"

    @classmethod
    @typed
    def open(cls, path: str | Path) -> Bundle:
        """Open a bundle and check that its files are unchanged since it was written.

        Nothing in it is executed, and nothing is written to disk.

        Args:
            path: folder of the bundle.

        Raises:
            FormatError: not a bundle, or one of another version, with missing or altered files, or with links.
        """
        path = Path(path)
        described = path / DESCRIPTION
        if not path.is_dir():
            older = older_folder(path)
            advice = "give that of a bundle, which `siamloc export` writes"
            if older is not None:
                advice = f"rename {older}, the bundle that was to be replaced, to that name"
            raise FormatError(f"there is no folder {path}: {advice}")
        if not _holds(described):
            raise FormatError(f"{path} is not a bundle, it holds no {DESCRIPTION}: write one with `siamloc export`")
        if described.stat().st_size > _LONGEST:
            raise FormatError(f"{described} is far too long for the description of a bundle: export again")
        about = read_json(described)
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise FormatError(f"{described} was not written by `siamloc export`: export again")
        check_version(about.get("version"), VERSION, f"the bundle {path}", "export again")
        kinds = {key: kind for key, kind in _KEYS.items() if about.get(key) is not None or key not in _OPTIONAL}
        if (wrong := misfit(about, kinds)) is not None:
            raise FormatError(f"{described} is not whole, or was altered in {wrong}: export again")
        for part, key in ((LAYER, "search"), (ERRORS, "errors"), (REFINEMENT, "refinement")):
            if part in about["sha256"] and about.get(key) is None:
                raise FormatError(f"{described} is altered in {key}, but the bundle holds {part}: export again")
        if MODEL not in about["sha256"] and not is_analytic(about["identity"]):
            raise FormatError(f"{described} lists no {MODEL}: export again")
        for name, digest in about["sha256"].items():
            if name not in PARTS:
                raise FormatError(f"{described} lists {name!r}, which no bundle has: export again")
            if not _holds(path / name) or file_hash(path / name) != digest:
                raise FormatError(f"{path}/{name} is missing or not the file the bundle was written with: export again")
        try:
            if CAMERA in about["sha256"] and not is_known(about["preprocessing"]["camera"]["kind"]):
                level = Preprocessing.of({**about["preprocessing"], "camera": None})
                preprocessing = replace(level, camera=SampledCamera.load(path / CAMERA))
            else:
                preprocessing = Preprocessing.of(about["preprocessing"])
        except (ConfigError, TypeError, KeyError) as error:
            raise FormatError(f"{described} is altered in preprocessing ({error}): export again") from error
        pictures = about.get("pictures") or {"size": None, "bits": None}
        size = None if pictures["size"] is None else tuple(pictures["size"])
        return cls(path, about, replace(preprocessing, size=size, bits=pictures["bits"]))

    @property
    def bytes(self) -> int:
        """Total size of the files in bytes."""
        return sum((self.path / name).stat().st_size for name in (DESCRIPTION, *self.files))

    @cached_property
    def _thumbnails(self) -> Any:
        return self.load(THUMBNAILS)


def read_whole(path: str | Path, read: Callable[[], object]) -> None:
    """Read the parts of a bundle, again if an update replaced it meanwhile, so that they are all of one bundle.

    Args:
        path: folder of the bundle.
        read: reads them.

    Raises:
        FormatError: the bundle was replaced each time.
        SiamlocError: as `read`, if the bundle stayed.
    """
    for left in reversed(range(_TRIES)):
        before = _written(path)
        try:
            read()
        except (SiamlocError, OSError):
            if _written(path) == before and (before or not left):
                raise
            time.sleep(_PAUSE)  # between the two renames of an update nothing is there
        else:
            if _written(path) == before:
                return
    raise FormatError(f"{path} was replaced {_TRIES} times while it was opened: open it when no update runs")


def _written(path: str | Path) -> tuple[int, int] | None:
    """Return which file describes a bundle, and when it was written; None without one."""
    try:
        about = (Path(path) / DESCRIPTION).stat()
    except OSError:
        return None
    return about.st_ino, about.st_mtime_ns


def _holds(file: Path) -> bool:
    """Whether a regular file is there.

    Raises:
        FormatError: it is a link.
    """
    if file.is_symlink():
        raise FormatError(f"{file} is a link, which could lead anywhere: copy the file itself into the bundle")
    return file.is_file()
