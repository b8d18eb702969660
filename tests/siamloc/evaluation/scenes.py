"""A small building with known positions, for the tests of the tasks."""

from __future__ import annotations

from typing import Any

import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.evaluation import absolute, room_retrieval
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


def evaluate_absolute(known: VisualMap, descriptors: np.ndarray, queries: FrameTable, *radii_ks: Any, **more: Any):
    """Return the result of localization with these descriptors."""
    return absolute.evaluate_absolute(known, queries, known.search(descriptors, min(20, len(known))), *radii_ks, **more)


def evaluate_rooms(known: VisualMap, descriptors: np.ndarray, queries: FrameTable, excluded: Any = None):
    """Return the result of room retrieval with these descriptors."""
    return room_retrieval.evaluate_rooms(known, queries, known.search(descriptors, min(100, len(known))), excluded)
