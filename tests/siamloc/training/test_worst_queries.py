"""The picture of the worst queries: which come first, and what each row shows."""

from __future__ import annotations

import cv2
import numpy as np
from torch import nn

from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.training.worst_queries import worst_queries


class Brightness(nn.Module):
    """Describes images (B, 3, H, W) by their mean (B, 1)."""

    def forward(self, images):
        return images.mean(dim=(1, 2, 3))[:, None]


def test_the_worst_query_comes_first_with_the_retrieved_and_the_nearest_map_frame(tmp_path):
    bright = {"dark": 20, "light": 220, "dim": 40, "wrong": 200}
    for name, value in bright.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((32, 128, 3), value, dtype=np.uint8))
    paths = [str(tmp_path / f"{name}.png") for name in bright]
    frames = FrameTable(path=paths, x=[0, 10, 1, 2], y=[0] * 4, room=["hall", "office", "", ""])
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(32, 128))
    picture = worst_queries(Brightness(), images, frames.take([0, 1]), frames.take([2, 3]))
    rows, columns = np.array(picture.shape[:2]) // (2, 3)
    seen = [[int(picture[rows * r + 60, columns * c + 90, 0]) for c in range(3)] for r in range(2)]
    assert seen == [[200, 220, 20], [40, 20, 20]]
    assert picture.dtype == np.uint8
    assert len(worst_queries(Brightness(), images, frames.take([0, 1]), frames.take([2, 3]), rows=1)) == rows
