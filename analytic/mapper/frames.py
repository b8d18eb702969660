"""The frames of a node: their position descriptors, those furthest from the centre, and those compared with images.

All three are immutable: adding a frame returns a new object and leaves the old one unchanged. Both may share a buffer,
whose additional rows the shorter one does not see.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.description import spectrum
from analytic.descriptors.base import Description

BLOCK = 128  # frames
_GROWTH = 1.25  # of the capacity; memory matters more than copying
_RIM = 32  # frames of a new rim
_MOST_RIM = 128  # frames of a rim, which every new frame joins, before a new one is formed
_ROUNDING = 1e-9
_FIRST = 16  # initial capacity of a block in frames: unused capacity must cost little


@dataclass(frozen=True)
class Rows:
    """An array that grows by rows: the first `count` rows of a buffer (capacity, D)."""

    buffer: NDArray[np.float64]
    count: int

    @staticmethod
    def of(array: NDArray[np.float64]) -> Rows:
        """Return the rows of an array (n, D)."""
        return Rows(np.ascontiguousarray(array, dtype=np.float64), len(array))

    @property
    def array(self) -> NDArray[np.float64]:
        """The rows as an array (n, D)."""
        return self.buffer[: self.count]

    def add(self, row: NDArray[np.float64]) -> Rows:
        """Return the rows with one more (D,); of two results made from these rows, only the later may be used."""
        buffer = self.buffer
        if self.count == len(buffer):
            buffer = np.empty((max(16, int(self.count * _GROWTH)), buffer.shape[1]))
            buffer[: self.count] = self.array
        buffer[self.count] = row
        return Rows(buffer, self.count + 1)


@dataclass(frozen=True)
class Rim:
    """The frames of a node that may be the furthest from its centre, so that not every image is compared with all.

    Once all distances to the centre have been computed, the furthest frames form the rim, and the rest lie within a
    radius of that centre. If the centre has moved by s since then, none of the rest is further from it than the
    radius plus s. As long as a frame of the rim is, the furthest of the rim is the furthest of all; otherwise a new rim
    is formed.

    Attributes:
        anchor: (D,) the centre when the rim was formed.
        members: (k,) rows of the frames of the rim.
        radius: radius around the anchor within which all other frames lie.
    """

    anchor: NDArray[np.float64]
    members: NDArray[np.int64]
    radius: float

    @staticmethod
    def of(rows: NDArray[np.float64], squares: NDArray[np.float64], centre: NDArray[np.float64]) -> Rim:
        """Return the rim of frames (n, D) whose squared lengths (n,) are known."""
        if len(rows) <= _RIM:
            return Rim(centre, np.arange(len(rows)), -np.inf)
        apart = squares - 2 * (rows @ centre) + centre @ centre
        order = np.argpartition(apart, -_RIM)
        return Rim(centre, np.sort(order[-_RIM:]), float(np.sqrt(max(apart[order[:-_RIM]].max(), 0.0))))

    def add(self, row: int) -> Rim:
        """Return the rim with another frame."""
        return replace(self, members=np.append(self.members, row))

    def furthest(self, rows: NDArray[np.float64], centre: NDArray[np.float64]) -> float:
        """Return the largest distance of the frames of the rim, among (n, D), to a centre (D,)."""
        # Row by row, so that the value does not depend on which others are in the rim.
        return float(np.sqrt(np.square(rows[self.members] - centre).sum(axis=1).max()))

    def holds(self, furthest: float, centre: NDArray[np.float64]) -> bool:
        """Whether no frame outside the rim can be further from a centre (D,) than the furthest inside."""
        reach = (self.radius + float(np.linalg.norm(centre - self.anchor))) * (1 + _ROUNDING)
        return furthest >= reach and len(self.members) <= _MOST_RIM


class _Buffers:
    """Storage for the frames of one block; the spectra are computed when a descriptor asks for them."""

    def __init__(self, like: Description, room: int) -> None:
        self.room = room
        self.position = np.empty((room, *like.position.shape[1:]), dtype=like.position.dtype)
        turned = like.orientation
        self.orientation = None if turned is None else np.empty((room, *turned.shape[1:]), dtype=turned.dtype)
        self.spectra: NDArray[np.complex64] | None = None
        self.transformed = 0

    def write(self, row: int, description: Description) -> None:
        self.position[row] = description.position[0]
        if self.orientation is not None and description.orientation is not None:
            self.orientation[row] = description.orientation[0]
        self.transformed = min(self.transformed, row)

    def copy_row(self, row: int, other: _Buffers, source: int) -> None:
        """Copy a row of other buffers, with its spectrum if that and those before it have been computed."""
        self.position[row] = other.position[source]
        if self.orientation is not None and other.orientation is not None:
            self.orientation[row] = other.orientation[source]
        self.transformed = min(self.transformed, row)
        if other.spectra is not None and source < other.transformed and self.transformed == row:
            self._spectra(other.spectra)[:, row] = other.spectra[:, source]
            self.transformed = row + 1

    def _spectra(self, like: NDArray[np.complex64]) -> NDArray[np.complex64]:
        if self.spectra is None:
            self.spectra = np.empty((like.shape[0], self.room, like.shape[2]), dtype=like.dtype)
        return self.spectra

    def spectrum(self, rows: int) -> NDArray[np.complex64]:
        assert self.orientation is not None
        # Row by row, so that the values do not depend on when a map was stored.
        for row in range(self.transformed, rows):
            column = spectrum(self.orientation[row : row + 1])
            self._spectra(column)[:, row] = column[:, 0]
        self.transformed = max(self.transformed, rows)
        assert self.spectra is not None
        return self.spectra[:, :rows]


class _Block(Description):
    """The first rows of the buffers as a description whose spectrum is not computed again for each added frame."""

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
    """The frames that images are compared with, in blocks of bounded size that fill up one after the other.

    Attributes:
        frames: (n,) numbers of the frames, in the order in which they were added.
        blocks: their descriptions; all blocks but the last are full.
        size: number of frames in a full block.
    """

    frames: NDArray[np.int64]
    blocks: tuple[Description, ...]
    size: int = BLOCK

    @staticmethod
    def of(frames: Iterable[int], descriptions: Iterable[Description], limit: int | None = None) -> Gallery:
        """Return the gallery of frames and their descriptions, one frame each, in blocks of at most `limit` frames."""
        gallery = Gallery(np.empty(0, dtype=np.int64), (), min(limit or BLOCK, BLOCK))
        for frame, description in zip(frames, descriptions, strict=True):
            gallery = gallery.add(frame, description)
        return gallery

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: int, description: Description) -> Gallery:
        """Return the gallery with one more frame; of two galleries made from this one, only the later may be used."""
        rows = len(self.frames) % self.size
        full = self.blocks[:-1] if rows else self.blocks
        buffers = self._buffers(len(full)) if rows else _Buffers(description, min(_FIRST, self.size))
        if rows == buffers.room:
            buffers = _grown(buffers, description, min(2 * rows, self.size))
        buffers.write(rows, description)
        return Gallery(np.append(self.frames, frame), (*full, _Block.of(buffers, rows + 1)), self.size)

    def keep(self, rows: NDArray[Any] | Sequence[int]) -> Gallery:
        """Return the gallery of some rows, in that order, in separate blocks."""
        kept = np.arange(len(self))[rows].tolist()
        blocks = []
        for start in range(0, len(kept), self.size):
            part = kept[start : start + self.size]
            buffers = _Buffers(self.row(part[0]), min(max(_FIRST, len(part)), self.size))
            for place, row in enumerate(part):
                buffers.copy_row(place, self._buffers(row // self.size), row % self.size)
            blocks.append(_Block.of(buffers, len(part)))
        return Gallery(self.frames[rows], tuple(blocks), self.size)

    def without(self, frames: Iterable[int]) -> Gallery:
        """Return the gallery without some frames, which need not be in it."""
        kept = ~np.isin(self.frames, list(frames))
        return self if kept.all() else self.keep(kept)

    def row(self, row: int) -> Description:
        """Return the description of one row."""
        return self.blocks[row // self.size].take(slice(row % self.size, row % self.size + 1))

    def descriptions(self) -> list[Description]:
        """Return the description of each row."""
        return [self.row(row) for row in range(len(self))]

    def _buffers(self, block: int) -> _Buffers:
        buffers: _Buffers = self.blocks[block].__dict__["buffers"]
        return buffers

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


def _grown(buffers: _Buffers, like: Description, room: int) -> _Buffers:
    """Return a copy of full buffers with more room."""
    larger = _Buffers(like, room)
    for row in range(buffers.room):
        larger.copy_row(row, buffers, row)
    return larger


def spread(gallery: Gallery, frame: int, description: Description, limit: int) -> Gallery:
    """Add a frame to a gallery of at most `limit` frames.

    A full gallery takes the frame only if it is further from all others than the closest two are from each other; the
    later of those two then goes. The frames that stay cover the node as evenly as a single pass over the frames allows.
    """
    if len(gallery) < limit:
        return gallery.add(frame, description)
    least, later = gallery.closest
    position = description.position.astype(np.float64)
    if np.sqrt(np.square(gallery.positions - position).sum(axis=1).min()) <= least:
        return gallery
    return gallery.keep(np.delete(np.arange(len(gallery)), later)).add(frame, description)


def thin(gallery: Gallery, limit: int | None) -> Gallery:
    """Remove the later frame of the closest pair from a gallery until it has at most `limit` frames."""
    while limit is not None and len(gallery) > limit:
        gallery = gallery.keep(np.delete(np.arange(len(gallery)), gallery.closest[1]))
    return gallery
