"""The frames of a node that an image is compared with, in blocks that grow without being copied.

A gallery is a value: adding a frame gives another gallery, and the first stays as it was. Both may share a block, whose
further rows the shorter one does not see.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors import circular
from analytic.descriptors.base import Description

BLOCK = 128  # frames: the unused rows of a last block must weigh little beside the descriptors


class _Buffers:
    """Room for the frames of one block; the spectra are computed when a descriptor asks for them."""

    def __init__(self, like: Description) -> None:
        self.position = np.empty((BLOCK, *like.position.shape[1:]), dtype=like.position.dtype)
        turned = like.orientation
        self.orientation = None if turned is None else np.empty((BLOCK, *turned.shape[1:]), dtype=turned.dtype)
        self.spectra: NDArray[np.complex64] | None = None
        self.transformed = 0

    def write(self, row: int, description: Description) -> None:
        self.position[row] = description.position[0]
        if self.orientation is not None and description.orientation is not None:
            self.orientation[row] = description.orientation[0]
        self.transformed = min(self.transformed, row)

    def spectrum(self, rows: int) -> NDArray[np.complex64]:
        assert self.orientation is not None
        # Row by row, so that the values do not depend on when a map was stored.
        for row in range(self.transformed, rows):
            column = circular.spectrum(self.orientation[row : row + 1])
            if self.spectra is None:
                self.spectra = np.empty((column.shape[0], BLOCK, column.shape[2]), dtype=column.dtype)
            self.spectra[:, row] = column[:, 0]
        self.transformed = max(self.transformed, rows)
        assert self.spectra is not None
        return self.spectra[:, :rows]


class _Block(Description):
    """The first rows of the buffers as a description whose spectrum is not computed anew for each added frame."""

    @classmethod
    def of(cls, buffers: _Buffers, rows: int) -> _Block:
        orientation = None if buffers.orientation is None else buffers.orientation[:rows]
        block = cls(buffers.position[:rows], orientation)
        object.__setattr__(block, "buffers", buffers)
        return block

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        if self.orientation is None:
            return super().spectrum
        buffers: _Buffers = self.__dict__["buffers"]
        return buffers.spectrum(len(self))


@dataclass(frozen=True)
class Gallery:
    """Frames by their number in the map, with their descriptions.

    Attributes:
        frames: (n,) in the order in which they came in.
        blocks: their descriptions, all but the last full.
    """

    frames: NDArray[np.int64]
    blocks: tuple[Description, ...]

    @staticmethod
    def of(frames: Iterable[int], descriptions: Iterable[Description]) -> Gallery:
        """Return the gallery of frames and as many descriptions of one frame each."""
        gallery = Gallery(np.empty(0, dtype=np.int64), ())
        for frame, description in zip(frames, descriptions, strict=True):
            gallery = gallery.add(frame, description)
        return gallery

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: int, description: Description) -> Gallery:
        """Return the gallery with one frame more; of two galleries made from this one, only the later may be used."""
        rows = len(self.frames) % BLOCK
        last = self.blocks[-1] if rows else None
        buffers = last.__dict__["buffers"] if last is not None else _Buffers(description)
        buffers.write(rows, description)
        full = self.blocks[:-1] if rows else self.blocks
        return Gallery(np.append(self.frames, frame), (*full, _Block.of(buffers, rows + 1)))

    def keep(self, rows: NDArray[Any] | Sequence[int]) -> Gallery:
        """Return the gallery of some rows, in that order, in blocks of its own."""
        return Gallery.of(self.frames[rows].tolist(), (self.row(int(row)) for row in np.arange(len(self))[rows]))

    def without(self, frames: Iterable[int]) -> Gallery:
        """Return the gallery without some frames, which need not be in it."""
        kept = ~np.isin(self.frames, list(frames))
        return self if kept.all() else self.keep(kept)

    def row(self, row: int) -> Description:
        """Return the description of one row."""
        return self.blocks[row // BLOCK].take(slice(row % BLOCK, row % BLOCK + 1))

    def descriptions(self) -> list[Description]:
        """Return the description of each row."""
        return [self.row(row) for row in range(len(self))]

    @property
    def positions(self) -> NDArray[np.float64]:
        """Return the position descriptors (n, D)."""
        return np.concatenate([block.position for block in self.blocks]).astype(np.float64)

    @cached_property
    def closest(self) -> tuple[float, int]:
        """Return the least distance between two frames, and the row of the later one of them."""
        from scipy.spatial.distance import cdist

        apart = cdist(self.positions, self.positions)
        apart[np.tril_indices(len(self))] = np.inf
        first, second = np.unravel_index(np.argmin(apart), apart.shape)
        return float(apart[first, second]), int(second)


def spread(gallery: Gallery, frame: int, description: Description, limit: int) -> Gallery:
    """Return a gallery of at most `limit` frames after another frame has come.

    A full gallery takes the frame only if it is further from all others than the closest two are from each other; then
    the later of those two goes. What stays covers the node as evenly as one look at each frame allows.
    """
    if len(gallery) < limit:
        return gallery.add(frame, description)
    least, later = gallery.closest
    position = description.position.astype(np.float64)
    if np.sqrt(np.square(gallery.positions - position).sum(axis=1).min()) <= least:
        return gallery
    return gallery.keep(np.delete(np.arange(len(gallery)), later)).add(frame, description)


def thin(gallery: Gallery, limit: int | None) -> Gallery:
    """Return the gallery after the later frame of its closest pair has gone until it has at most `limit` frames."""
    while limit is not None and len(gallery) > limit:
        gallery = gallery.keep(np.delete(np.arange(len(gallery)), gallery.closest[1]))
    return gallery
