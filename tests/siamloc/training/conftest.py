"""Two short drives along one line, for trainings that take a moment."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary

SIZE = (16, 64)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Two drives along one line; the stripes of an image show where it was taken."""
    folder, rows = tmp_path_factory.mktemp("images"), []
    columns = np.arange(SIZE[1])
    for drive, light in (("monday", 1.0), ("tuesday", 0.6)):
        for number in range(16):
            path = folder / f"{drive}{number}.png"
            stripes = 128 + 100 * np.sin(2 * np.pi * columns * (1 + number) / SIZE[1])
            cv2.imwrite(str(path), np.tile(light * stripes[None, :, None], (SIZE[0], 1, 3)).astype(np.uint8))
            rows.append(
                {
                    "path": str(path),
                    "x": 0.25 * number,
                    "y": 0.0,
                    "sequence": drive,
                    "lighting": drive,
                    "room": "ab"[number // 8],
                }
            )
    return FrameTable.from_rows(rows)


@pytest.fixture(scope="module")
def images(frames, tmp_path_factory):
    return PanoramaLibrary(frames, tmp_path_factory.mktemp("cache"), image_size=SIZE)


@pytest.fixture(scope="module")
def drives(frames):
    return frames.select(sequence="monday"), frames.select(sequence="tuesday")
