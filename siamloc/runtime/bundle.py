"""The bundle: one folder with everything a robot needs, and its description in `bundle.json`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from siamloc.data.decoding import Preprocessing
from siamloc.data.panorama import camera_from_config
from siamloc.errors import ConfigError, FormatError
from siamloc.files import file_hash, read_json, storage_errors, write_json

if TYPE_CHECKING:
    from siamloc.maps import HeadingPart, VisualMap
    from siamloc.maps.error_model import ErrorModel
    from siamloc.models import SiameseModule

FORMAT = "siamloc-bundle"
VERSION = 2
_DESCRIPTION = "bundle.json"
_MODEL = "model.onnx"
_MAP = "map.npz"
_HEADING = "heading.onnx"
_ERRORS = "error_model.json"
_KEYS = {"sha256": dict, "image_size": list, "unwrap": dict, "identity": dict, "parity": dict}


@dataclass(frozen=True)
class Bundle:
    """An opened bundle.

    Attributes:
        folder: where it lies.
        image_size: rows and columns of a panorama.
        preprocessing: how an image becomes a panorama.
        identity: what the network is; the map carries the same.
        parity: how far the exported network is from the original.
        has_map: whether images can be located, not only described.
        has_heading: whether headings can be told.
        has_errors: whether expected errors can be told.
    """

    folder: Path
    image_size: tuple[int, int]
    preprocessing: Preprocessing
    identity: dict[str, Any]
    parity: dict[str, Any]
    has_map: bool
    has_heading: bool = False
    has_errors: bool = False

    @property
    def model(self) -> Path:
        """The network, as ONNX."""
        return self.folder / _MODEL

    @property
    def map(self) -> Path:
        """The visual map."""
        return self.folder / _MAP

    @property
    def heading(self) -> Path:
        """What tells headings, as ONNX."""
        return self.folder / _HEADING

    @property
    def errors(self) -> Path:
        """The model of the error."""
        return self.folder / _ERRORS

    @classmethod
    def open(cls, folder: str | Path) -> Bundle:
        """Open a bundle and check that its files are the ones it was written with.

        Raises:
            FormatError: no bundle, of a newer version, or with files that are missing or altered.
        """
        folder = Path(folder)
        if not (folder / _DESCRIPTION).is_file():
            raise FormatError(f"{folder} is not a bundle, it holds no {_DESCRIPTION}: write one with `siamloc export`")
        about = read_json(folder / _DESCRIPTION)
        if not isinstance(about, dict) or about.get("format") != FORMAT or not isinstance(about.get("version"), int):
            raise FormatError(f"{folder / _DESCRIPTION} was not written by `siamloc export`: export anew")
        if about["version"] > VERSION:
            raise FormatError(
                f"{folder} has bundle version {about['version']}, this siamloc reads up to {VERSION}: update siamloc"
            )
        for key, kind in _KEYS.items():
            if not isinstance(about.get(key), kind):
                found = "lacks" if key not in about else "is altered in"
                raise FormatError(f"{folder / _DESCRIPTION} {found} {key}: export anew")
        if _MODEL not in about["sha256"]:
            raise FormatError(f"{folder / _DESCRIPTION} lists no {_MODEL}: export anew")
        for name, digest in about["sha256"].items():
            if not (folder / name).is_file() or file_hash(folder / name) != digest:
                raise FormatError(
                    f"{folder / name} is missing or not the file the bundle was written with: export anew"
                )
        try:
            rows, columns = map(int, about["image_size"])
            camera, view = camera_from_config(about["unwrap"], (rows, columns))
        except (TypeError, ValueError) as error:
            raise FormatError(
                f"{folder / _DESCRIPTION} is altered in image_size or unwrap ({error}): export anew"
            ) from error
        return cls(
            folder,
            (rows, columns),
            Preprocessing(view, camera),
            about["identity"],
            about["parity"],
            _MAP in about["sha256"],
            _HEADING in about["sha256"],
            _ERRORS in about["sha256"],
        )


def write_bundle(
    folder: str | Path,
    network: SiameseModule,
    visual_map: VisualMap | None,
    *,
    image_size: tuple[int, int],
    unwrap: Mapping[str, Any],
    circular: bool,
    identity: Mapping[str, Any],
    errors: ErrorModel | None = None,
) -> dict[str, Any]:
    """Write a bundle; an older one in the same folder is replaced only when the new one is whole.

    Args:
        folder: where to.
        network: the trained network.
        visual_map: its map; None for a bundle that only describes images. If it has a heading part, the robot tells
            headings.
        image_size: rows and columns of a panorama.
        unwrap: how omnidirectional images become panoramas, as in the configuration.
        circular: whether the columns wrap around.
        identity: of network and preprocessing, as the map carries it.
        errors: what tells the expected error, learned on this map; None if nothing was learned.

    Returns:
        The comparison of exported and original network, see `siamloc.runtime.export.parity`.

    Raises:
        ConfigError: the folder holds other files than a bundle's, the error model was learned on another map, or what
            tells headings cannot be exported.
        SiamlocError: the exported network differs from the original.
        StorageError: the disk is full or refuses.
    """
    from siamloc.runtime.export import export_onnx

    folder = Path(folder).absolute()
    _check_replaceable(folder)
    if errors is not None and (visual_map is None or not learned_on(errors, visual_map)):
        raise ConfigError("the error model was learned on another map than the bundle's: learn it anew")
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as name:
            fresh = Path(name) / "bundle"
            fresh.mkdir()
            exported = export_onnx(network, fresh / _MODEL, image_size)
            files = list(exported["files"])
            if visual_map is not None:
                visual_map.save(fresh / _MAP)
                files.append(_MAP)
            heading = None
            if visual_map is not None and visual_map.heading is not None:
                heading = _write_heading(visual_map.heading, fresh / _HEADING, image_size)
                files.append(_HEADING)
            if errors is not None:
                errors.save(fresh / _ERRORS)
                files.append(_ERRORS)
            write_json(
                fresh / _DESCRIPTION,
                {
                    "format": FORMAT,
                    "version": VERSION,
                    "image_size": image_size,
                    "unwrap": dict(unwrap),
                    "circular": circular,
                    "identity": dict(identity),
                    "parity": exported["parity"],
                    "heading": heading,
                    "errors": None if errors is None else errors.as_dict(),
                    "sha256": {file: file_hash(fresh / file) for file in files},
                },
            )
            older = Path(name) / "older"
            if folder.exists():
                folder.rename(older)
            try:
                fresh.rename(folder)
            except OSError:
                if older.exists():
                    older.rename(folder)
                raise
    return exported["parity"]


def learned_on(errors: ErrorModel, visual_map: VisualMap) -> bool:
    """Say whether an error model was learned on the frames of a map that have a position."""
    placed = visual_map.frames.has_position
    return errors.map_digest == (visual_map if placed.all() else visual_map.take(placed)).digest


def _write_heading(part: HeadingPart, path: Path, image_size: tuple[int, int]) -> dict[str, Any]:
    """Export what tells headings, and return what `bundle.json` says of it."""
    from siamloc.runtime.heading_export import export_heading

    return {"identity": part.identity, "parity": export_heading(part.descriptor(), path, image_size)}


def _check_replaceable(folder: Path) -> None:
    """Make sure that the folder is not there yet, or empty, or an older bundle and nothing else."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigError(f"{folder} is a file: name another folder for the bundle")
    names = {path.name for path in folder.iterdir()}
    others = sorted(names - {_DESCRIPTION, _MODEL, f"{_MODEL}.data", _MAP, _HEADING, _ERRORS})
    if others or (names and _DESCRIPTION not in names):
        raise ConfigError(
            f"{folder} holds other files, such as {(others or sorted(names))[0]}: name a folder of its own"
        )
