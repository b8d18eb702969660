"""Drawn drives for the tests of bundles, and bundles with other parts."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytic import DESCRIPTORS, Descriptor
from foundation.files import file_hash, read_json, write_json
from siamloc.data.frames import FrameTable
from siamloc.maps import VisualMap
from siamloc.maps.heading import NetworkHeading, described, halved
from siamloc.models import as_descriptor, build
from siamloc.runtime import export
from tests.drawn import draw_panorama, draw_sequence

SIZE = (32, 128)
IMAGES = {"height": 32, "width": 128, "camera": None}


def drive(seed: int, frames_per_room: int = 8) -> tuple[np.ndarray, FrameTable]:
    """Return the pictures (N, H, W, 3), RGB, and the frames of a drive through the drawn flat."""
    poses = draw_sequence(seed, frames_per_room)
    pictures = [draw_panorama(p["local_x"], p["y"], p["theta"], p["room"])[..., ::-1] for p in poses]
    columns = {key: np.array([pose[key] for pose in poses]) for key in ("x", "y", "theta", "room")}
    return np.stack(pictures), FrameTable(np.array([f"{seed}/{i}.png" for i in range(len(poses))]), **columns)


def batch(pictures: np.ndarray) -> np.ndarray:
    """Return pictures as a batch of panoramas (N, 3, H, W)."""
    return pictures.transpose(0, 3, 1, 2)


def mapped(by: Descriptor, heading: Descriptor | None = None) -> VisualMap:
    """Return the map of the first drive, with headings by a second descriptor or, if it finds them, by its own."""
    pictures, frames = drive(0)
    seen, parts = described(by, heading, batch(pictures)), {}
    if seen.orientation is not None:
        parts = {"orientation": halved(heading or by, seen.orientation)}
        if heading is not None or by.name not in DESCRIPTORS:
            parts["heading"] = (heading or NetworkHeading(by.tells_heading)).identity
    return VisualMap(seen.position, frames, {**by.identity, "images": IMAGES}, **parts, describes=by)


@pytest.fixture(scope="session")
def small() -> tuple[Descriptor, VisualMap]:
    """A small network, and its map without headings."""
    network = as_descriptor(build("simple1", "fc500_500_5", SIZE))
    return network, mapped(network)


@pytest.fixture(scope="session")
def bare(small, tmp_path_factory) -> Path:
    """The bundle of the small network and its map, to be left as it is."""
    return export(*small, tmp_path_factory.mktemp("robot") / "bare").path


def rewritten(bundle: Path, folder: Path, **parts: Any) -> Path:
    """A copy of a bundle with other parts, as if it had been exported with them."""
    shutil.copytree(bundle, folder)
    names = {"map": "map.npz", "errors": "error_model.json"}
    for name, part in parts.items():
        part.save(folder / names[name])
    return altered(folder, *map(names.get, parts))


def altered(bundle: Path, *files: str, **changed: Any) -> Path:
    """Change values in bundle.json, and the hashes of files that were replaced."""
    about = {**read_json(bundle / "bundle.json"), **changed}
    for file in files:
        about["sha256"][file] = file_hash(bundle / file)
    write_json(bundle / "bundle.json", about)
    return bundle
