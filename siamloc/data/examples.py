"""`example`: a tiny data set for trying things out, drawn and decoded in a moment."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary

ROOMS = ("office", "hall", "lab")


def example(frames: int = 12, image_size: tuple[int, int] = (16, 64), seed: int = 0) -> PanoramaLibrary:
    """Draw two drives, "monday" and "tuesday", along a painted corridor with three rooms.

    The images are in a temporary folder, which is removed when Python exits. They show noise that slides past as the
    robot moves: enough to try out every call, but not to measure anything.

    Args:
        frames: number of frames per drive, 0.5 m apart.
        image_size: rows and columns of a panorama.
        seed: seed of the paint and of the light.

    Example:
        >>> images = example()
        >>> len(images), sorted(set(images.frames.room.tolist()))
        (24, ['hall', 'lab', 'office'])
    """
    rng = np.random.default_rng(seed)
    rows, columns = image_size
    step = max(columns // 16, 1)
    paint = cv2.GaussianBlur(rng.uniform(40, 215, (rows, columns + frames * step, 3)).astype(np.float32), (0, 0), 2)
    folder = Path(tempfile.mkdtemp(prefix="siamloc-example-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    table = []
    for sequence, lighting, gain in (("monday", "cloudy", 1.0), ("tuesday", "night", 0.7)):
        for i in range(frames):
            picture = gain * paint[:, i * step : i * step + columns] + rng.normal(0, 4, (rows, columns, 3))
            path = folder / f"{sequence}-{i:03d}.png"
            cv2.imwrite(str(path), picture.clip(0, 255).astype(np.uint8))
            pose = {"x": 0.5 * i, "y": 0.0, "theta": 0.0, "time": float(i)}
            labels = {"room": ROOMS[len(ROOMS) * i // frames], "sequence": sequence, "lighting": lighting}
            table.append({"path": str(path), **pose, **labels})
    return PanoramaLibrary(FrameTable.from_rows(table), folder / "panoramas", image_size=image_size)
