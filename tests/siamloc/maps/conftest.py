"""Frames, maps and search results for the tests of maps."""

from __future__ import annotations

from typing import Any

import numpy as np

import analytic
from siamloc.data.frames import FrameTable
from siamloc.maps import Retrieval, VisualMap


def placed(xy: Any, **columns: Any) -> FrameTable:
    """Return frames at some positions (n, 2)."""
    x, y = np.asarray(xy, dtype=float).reshape(-1, 2).T
    return FrameTable(path=[f"{i}.png" for i in range(len(x))], x=x, y=y, **columns)


def plain_map(descriptors: Any, distance: str = "euclidean", **columns: Any) -> VisualMap:
    """Return a map of descriptors (n, D) whose frames lie along a line."""
    return VisualMap(descriptors, placed([(i, 0) for i in range(len(descriptors))], **columns), distance=distance)


def map_of(by: analytic.Descriptor, images: np.ndarray, theta: Any = None) -> VisualMap:
    """Describe images (n, H, W) and return their map."""
    seen = by.describe(images)
    frames = placed([(i, 0) for i in range(len(images))], theta=theta)
    parts = {"orientation": seen.orientation, "describes": by}
    return VisualMap(seen.position, frames, by.identity, by.default_distance, **parts)


def retrieval(rng: np.random.Generator, n: int, m: int = 30, k: int = 10) -> Retrieval:
    """Return k of m map frames for n queries, by chance."""
    return Retrieval(np.argsort(rng.random((n, m)), axis=1)[:, :k], np.sort(rng.random((n, k)), axis=1))
