"""A small building with known positions, for the tests of the tasks."""

from __future__ import annotations

import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.maps import VisualMap


def frames(seed: int, n: int, **columns: object) -> FrameTable:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 9, n), rng.uniform(0, 3, n)
    base: dict = {
        "path": np.array([f"run{seed}/{i:04d}, é.jpeg" for i in range(n)]),
        "x": x,
        "y": y,
        "theta": np.where(rng.random(n) < 0.2, np.nan, rng.uniform(-3, 3, n)),
        "room": np.array(["CR-A", "KT-A", "ST-A"])[(x // 3).astype(int)],
        "sequence": np.array([f"run{seed}"] * n),
        "lighting": rng.choice(["cloudy", "night", "sunny"], n),
    }
    return FrameTable(**{**base, **columns})


def describe(table: FrameTable, seed: int = 0, noise: float = 0.3) -> np.ndarray:
    """Return descriptors that are positions and a disturbance."""
    rng = np.random.default_rng(seed)
    return (np.column_stack([table.x, table.y, table.x * 0]) + noise * rng.normal(size=(len(table), 3))).astype("f4")


def visual_map(n: int = 150, **columns: object) -> VisualMap:
    table = frames(1, n, **columns)
    return VisualMap(describe(table, seed=1), table, {"name": "positions"})
