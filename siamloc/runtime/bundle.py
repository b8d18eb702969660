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
    from siamloc.maps import VisualMap
    from siamloc.models import SiameseModule

FORMAT = "siamloc-bundle"
VERSION = 1
_DESCRIPTION = "bundle.json"
_MODEL = "model.onnx"
_MAP = "map.npz"


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
    """

    folder: Path
    image_size: tuple[int, int]
    preprocessing: Preprocessing
    identity: dict[str, Any]
    parity: dict[str, Any]
    has_map: bool

    @property
    def model(self) -> Path:
        """The network, as ONNX."""
        return self.folder / _MODEL

    @property
    def map(self) -> Path:
        """The visual map."""
        return self.folder / _MAP

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
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise FormatError(f"{folder / _DESCRIPTION} was not written by siamloc")
        if about["version"] > VERSION:
            raise FormatError(
                f"{folder} has bundle version {about['version']}, this siamloc reads up to {VERSION}: update siamloc"
            )
        missing = [key for key in ("sha256", "image_size", "unwrap", "identity", "parity") if key not in about]
        if missing:
            raise FormatError(f"{folder / _DESCRIPTION} lacks {missing[0]}: export anew")
        for name, digest in about["sha256"].items():
            if not (folder / name).is_file() or file_hash(folder / name) != digest:
                raise FormatError(
                    f"{folder / name} is missing or not the file the bundle was written with: export anew"
                )
        rows, columns = about["image_size"]
        camera, view = camera_from_config(about["unwrap"], (rows, columns))
        return cls(
            folder,
            (rows, columns),
            Preprocessing(view, camera),
            about["identity"],
            about["parity"],
            _MAP in about["sha256"],
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
) -> dict[str, Any]:
    """Write a bundle; an older one in the same folder is replaced only when the new one is whole.

    Args:
        folder: where to.
        network: the trained network.
        visual_map: its map; None for a bundle that only describes images.
        image_size: rows and columns of a panorama.
        unwrap: how omnidirectional images become panoramas, as in the configuration.
        circular: whether the columns wrap around.
        identity: of network and preprocessing, as the map carries it.

    Returns:
        The comparison of exported and original network, see `siamloc.runtime.export.parity`.

    Raises:
        ConfigError: the folder holds other files than a bundle's.
        SiamlocError: the exported network differs from the original.
        StorageError: the disk is full or refuses.
    """
    from siamloc.runtime.export import export_onnx

    folder = Path(folder).absolute()
    _check_replaceable(folder)
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


def _check_replaceable(folder: Path) -> None:
    """Make sure that the folder is not there yet, or empty, or an older bundle and nothing else."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigError(f"{folder} is a file: name another folder for the bundle")
    names = {path.name for path in folder.iterdir()}
    others = sorted(names - {_DESCRIPTION, _MODEL, f"{_MODEL}.data", _MAP})
    if others or (names and _DESCRIPTION not in names):
        raise ConfigError(
            f"{folder} holds other files, such as {(others or sorted(names))[0]}: name a folder of its own"
        )
