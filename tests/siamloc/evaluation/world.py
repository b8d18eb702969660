"""Images whose grey levels show where they were taken, and a custom descriptor that reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from analytic import Description, Descriptor
from siamloc.data import FrameTable, PanoramaLibrary, concatenate

SIZE = (8, 32)


class Reads(Descriptor):
    """Mean grey levels of the picture's halves: position (x, y) up to a scale."""

    name: ClassVar[str] = "reads"

    @property
    def identity(self) -> dict[str, Any]:
        return {"name": self.name}

    def describe(self, batch: Any) -> Description:
        images = np.asarray(batch, dtype=np.float32).mean(axis=1)
        half = images.shape[2] // 2
        return Description(np.stack([images[:, :, :half].mean((1, 2)), images[:, :, half:].mean((1, 2))], axis=1))

    def pairwise(self, queries: Description, references: Description, distance: str | None = None) -> Any:
        return np.linalg.norm(queries.position[:, None] - references.position[None], axis=2)

    def relative_heading(self, query: Description, reference: Description) -> Any:
        raise NotImplementedError


def drive(folder: Path, name: str, n: int, seed: int, **columns: Any) -> FrameTable:
    """Write a drive along a corridor with three rooms; grey levels carry a little noise."""
    rng = np.random.default_rng(seed)
    x, y = np.linspace(1, 30, n) + rng.normal(0, 0.05, n), np.full(n, 3.0) + rng.normal(0, 0.05, n)
    paths = []
    for i in range(n):
        picture = np.zeros((*SIZE, 3), np.uint8)
        picture[:, : SIZE[1] // 2], picture[:, SIZE[1] // 2 :] = round(8 * x[i]), round(8 * y[i] + rng.normal(0, 2))
        paths.append(folder / name / f"{i:03d}.png")
        paths[-1].parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(paths[-1]), picture)
    base: dict[str, Any] = {
        "path": np.array([str(path) for path in paths]),
        "x": x,
        "y": y,
        "theta": np.zeros(n),
        "room": np.array(["office", "hall", "lab"])[np.minimum(x // 10, 2).astype(int)],
        "sequence": np.full(n, name),
        "lighting": np.where(np.arange(n) % 2, "night", "cloudy"),
        "time": np.arange(n) * 1.0,
    }
    return FrameTable(**{**base, **columns})


def library(folder: Path, *tables: FrameTable) -> PanoramaLibrary:
    """Return the panoramas of some tables."""
    return PanoramaLibrary(concatenate(tables), folder / "cache", image_size=SIZE)
