"""Two short drives, and the pretended GPU."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary

SIZE = (16, 64)


@pytest.fixture
def gpu():
    from tests.gpu.pretend import Pretend

    with Pretend() as gpu:
        yield gpu


@pytest.fixture(scope="session")
def frames(tmp_path_factory):
    """Two drives along one line, with headings; the images are noise."""
    folder, rows, rng = tmp_path_factory.mktemp("images"), [], np.random.default_rng(0)
    for drive in ("monday", "tuesday"):
        for number in range(16):
            path = folder / f"{drive}{number}.png"
            cv2.imwrite(str(path), rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8))
            pose = {"x": 0.25 * number, "y": 0.0, "theta": 0.05 * (number % 3)}
            rows.append({"path": str(path), **pose, "sequence": drive, "lighting": drive, "room": "ab"[number // 8]})
    return FrameTable.from_rows(rows)


@pytest.fixture(scope="session")
def images(frames, tmp_path_factory):
    return PanoramaLibrary(frames, tmp_path_factory.mktemp("cache"), image_size=SIZE)


@pytest.fixture(scope="session")
def drives(frames):
    return frames.select(sequence="monday"), frames.select(sequence="tuesday")
