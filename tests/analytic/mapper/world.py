"""A world without images: descriptors that change smoothly with the pose, and real or made-up drives through it."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper import IncrementalMapper

COLD = Path(__file__).parents[3] / ".." / "shared" / "data" / "cold_places"


class World(Descriptor):
    """Random Fourier features of the position; an orientation part of waves that turn with the robot.

    Args:
        size: D.
        steps: K of the orientation part; 0 for none.
        features: F of the orientation part.
        reach: metres over which descriptors stay alike.
        seed: of the features.
    """

    name = "world"

    def __init__(self, size=16, steps=12, features=3, reach=2.0, seed=0):
        generator = np.random.default_rng(seed)
        self._identity = {"name": self.name, "size": size, "steps": steps, "reach": reach, "seed": seed}
        self.steps = steps
        self._waves = generator.normal(0, 1 / reach, (2, size))
        self._phases = generator.uniform(0, 2 * np.pi, size)
        self._turns = generator.normal(0, 1 / reach, (2, features, 3))
        self._offsets = generator.uniform(0, 2 * np.pi, (features, 3))

    @property
    def identity(self):
        return self._identity

    def describe(self, batch):
        return self.at(batch)

    def at(self, poses, noise=0.02, seed=0, lighting=0.0):
        """Describe poses (n, 3); `lighting` moves all descriptors, as another time of day does."""
        poses = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
        generator = np.random.default_rng(seed)
        position = np.cos(poses[:, :2] @ self._waves + self._phases + lighting)
        position = position + generator.normal(0, noise, position.shape)
        if not self.steps:
            return Description(position.astype(np.float32), None, self.identity)
        azimuth = poses[:, 2, None] - 2 * np.pi * np.arange(self.steps) / self.steps
        local = np.einsum("nc,cfh->nfh", poses[:, :2], self._turns) + self._offsets + lighting
        harmonic = azimuth[:, :, None, None] * np.arange(1, 4)
        orientation = np.cos(harmonic + local[:, None]).sum(axis=3)
        orientation = orientation + generator.normal(0, noise, orientation.shape)
        return Description(position.astype(np.float32), orientation.astype(np.float32), self.identity)


def corridor_drive(frames, seed=0, rooms=4, length=6.0):
    """Drive back and forth past rooms: poses (frames, 3), with stays, so that nodes fill and are found again."""
    generator = np.random.default_rng(seed)
    places = np.cumsum(generator.uniform(0.5, 1.5, (rooms, 2)) * length, axis=0)
    stops = [0]
    while len(stops) * 30 < frames + 60:
        stops.append(int(generator.choice([room for room in range(rooms) if room != stops[-1]])))
    poses = []
    for here, there in pairwise(stops):
        stay = places[here] + np.cumsum(generator.normal(0, 0.05, (20, 2)), axis=0)
        way = np.linspace(stay[-1], places[there], 10)
        poses.append(np.concatenate([stay, way]))
    xy = np.concatenate(poses)[:frames]
    heading = np.cumsum(generator.normal(0, 0.2, frames))
    return np.column_stack([xy, heading])


def cold_drive(name):
    """Read the poses (n, 3) of a real COLD sequence; the test is skipped where the data are missing."""
    path = COLD / f"{name}.places.lst"
    if not path.exists():
        pytest.skip("needs ../shared/data/cold_places")
    found = re.findall(r"_x(-?[\d.]+)_y(-?[\d.]+)_a(-?[\d.]+)\.jpeg", path.read_text())
    return np.array(found, dtype=np.float64)


def rows(description):
    """Return the frames of a description one by one."""
    return [description.take([row]) for row in range(len(description))]


WORLD = World(size=8, reach=5.0, seed=1)
POSES = corridor_drive(260, seed=1)
FRAMES = rows(WORLD.at(POSES, noise=0.2, seed=1))
WIDE = World(size=96, steps=8, reach=6.0, seed=2)  # more numbers than frames in a node, as images have
WIDE_FRAMES = rows(WIDE.at(corridor_drive(300, seed=5, rooms=6), noise=0.2, seed=3))


def mapped(frames=None, **parameters):
    """Map the first of these frames, or all."""
    mapper = IncrementalMapper(WORLD, **parameters)
    for frame, pose in zip(FRAMES[:frames], POSES, strict=False):
        mapper.add(frame, pose)
    return mapper
