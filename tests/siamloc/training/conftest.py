"""Two short drives along one line, for trainings that take a moment."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import siamloc
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary

SIZE = (16, 64)
SETTINGS = {"pairs": {"places": 4, "images": 2, "epoch_batches": 6}, "optimizer": {"name": "adamw"}}


def network(seed=0):
    """A small network for batches of places."""
    return siamloc.models.build("simple1", "fourier", SIZE, outputs=16, circular=True, normalize="image", seed=seed)


class Small(torch.nn.Module):
    """A custom network with dropout, for pairs or for places."""

    def __init__(self, outputs=8):
        super().__init__()
        torch.manual_seed(0)
        pool, flat, drop = torch.nn.AdaptiveAvgPool2d((4, 8)), torch.nn.Flatten(), torch.nn.Dropout()
        self.layers = torch.nn.Sequential(pool, flat, drop, torch.nn.Linear(96, outputs))

    def forward(self, panorama):
        return torch.nn.functional.normalize(self.layers(panorama))


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
            pose = {"x": 0.25 * number, "y": 0.0, "theta": 0.05 * (number % 3)}
            rows.append({"path": str(path), **pose, "sequence": drive, "lighting": drive, "room": "ab"[number // 8]})
    return FrameTable.from_rows(rows)


@pytest.fixture(scope="module")
def images(frames, tmp_path_factory):
    return PanoramaLibrary(frames, tmp_path_factory.mktemp("cache"), image_size=SIZE)


@pytest.fixture(scope="module")
def drives(frames):
    return frames.select(sequence="monday"), frames.select(sequence="tuesday")


@pytest.fixture
def train(images, drives, tmp_path):
    """A training on batches of places of the first drive, for one epoch unless a test wants otherwise."""

    def call(net=None, *, images=images, frames=drives[0], run="run", pairs=None, **options):
        options = {"epochs": 1, **SETTINGS, "pairs": {**SETTINGS["pairs"], **(pairs or {})}, **options}
        run = tmp_path / run if isinstance(run, str) else run
        return siamloc.training.fit(network() if net is None else net, images, frames, run=run, **options)

    return call
