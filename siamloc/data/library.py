"""Decoded panoramas of many sequences behind one index: one store per sequence, shared by all roles."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.store import PanoramaStore


class PanoramaLibrary:
    """The panoramas of a table of frames.

    Each sequence has a store of its own, so that changing which sequences train, form the map or are queried never
    decodes an image twice.

    Args:
        frames: the frames wanted; whole sequences, so that their stores serve every selection of them.
        cache: folder of the stores.
        **preprocessing: passed to `PanoramaStore.open_or_build`.

    Attributes:
        frames: the frames whose image could be read, in the order given; its `index` counts from 0 and addresses
            `batch`.
        rejected: images that were left out, as dictionaries of path and reason.
    """

    def __init__(self, frames: FrameTable, cache: str | Path, **preprocessing: Any) -> None:
        self._stores: list[PanoramaStore] = []
        self.rejected: list[dict[str, str]] = []
        tables, owner, row = [], [], []
        for number, rows in enumerate(frames.rows_by("sequence").values()):
            store = PanoramaStore.open_or_build(frames.take(rows), Path(cache), **preprocessing)
            self._stores.append(store)
            self.rejected.extend(store.rejected)
            tables.append(store.frames)
            owner.append(np.full(len(store.frames), number))
            row.append(np.arange(len(store.frames)))
        self.frames = concatenate(tables)
        origin = np.concatenate([table.index for table in tables]) if tables else np.zeros(0, dtype=np.int64)
        self._row_of_origin = {int(index): row for row, index in enumerate(origin)}
        self._owner = np.concatenate(owner) if owner else np.zeros(0, dtype=np.int64)
        self._row = np.concatenate(row) if row else np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def image_shape(self) -> tuple[int, ...]:
        """Shape (3, H, W) of a panorama."""
        return tuple(self._stores[0].panoramas.shape[1:])

    def select(self, frames: FrameTable) -> FrameTable:
        """Return the readable ones among frames of the table that the library was made of, in their order."""
        rows = [self._row_of_origin.get(index) for index in frames.index.tolist()]
        return self.frames.take([row for row in rows if row is not None])

    def batch(self, index: ArrayLike) -> NDArray[np.uint8]:
        """Return panoramas (B, 3, H, W) uint8 by the `index` column of `frames`."""
        index = np.asarray(index, dtype=np.int64)
        owners = self._owner[index]
        first = owners[0] if len(owners) else 0
        if (owners == first).all():
            return self._stores[first].batch(self._row[index])
        images = np.empty((len(index), *self.image_shape), dtype=np.uint8)
        for owner in np.unique(owners):
            mine = np.flatnonzero(owners == owner)
            images[mine] = self._stores[owner].batch(self._row[index[mine]])
        return images

    def batches(self, frames: FrameTable, size: int = 64) -> Iterator[NDArray[np.uint8]]:
        """Yield the panoramas of some of the frames in batches of at most `size`, in order."""
        for start in range(0, len(frames), size):
            yield self.batch(frames.index[start : start + size])
