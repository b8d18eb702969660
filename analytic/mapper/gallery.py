"""The frames of a node that images are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description


@dataclass(frozen=True)
class Gallery:
    """Frames with their descriptions. Immutable: methods return another gallery.

    The spectrum of each frame is computed once, on its own, so that its values depend on no other frame.

    Attributes:
        frames: (n,) numbers of the frames, in the order in which they were added.
        shown: their descriptions.
    """

    frames: NDArray[np.int64]
    shown: Description

    @staticmethod
    def of(frames: Sequence[int], descriptions: Sequence[Description]) -> Gallery:
        """Return the gallery of frames, given their descriptions."""
        shown = Description.concatenate(descriptions)
        if shown.orientation is not None:
            shown.kept("spectrum", lambda _: np.concatenate([part.spectrum for part in descriptions], axis=1))
        return Gallery(np.array(frames, dtype=np.int64), shown)

    def __len__(self) -> int:
        return len(self.frames)

    def keep(self, rows: Any) -> Gallery:
        """Return the gallery of some rows, given as an index array or a mask."""
        shown = self.shown.take(rows)
        if shown.orientation is not None:
            shown.kept("spectrum", lambda _: self.shown.spectrum[:, rows])
        return Gallery(self.frames[rows], shown)

    def join(self, other: Gallery) -> Gallery:
        """Return the gallery of the frames of both."""
        return Gallery.of(np.append(self.frames, other.frames).tolist(), [self.shown, other.shown])

    def spread(self, other: Gallery, limit: int | None) -> Gallery:
        """Add one frame to a gallery of at most `limit` frames.

        A full gallery takes the frame only if it is further from all others than the closest two are from each other;
        the later of those two then goes. The frames that stay cover the node as evenly as a single pass over the frames
        allows.
        """
        if limit is None or len(self) < limit:
            return self.join(other)
        least, later = self.closest
        apart = self.shown.position.astype(np.float64) - other.shown.position
        if np.sqrt(np.square(apart).sum(axis=1).min()) <= least:
            return self
        return self.keep(np.arange(len(self)) != later).join(other)

    def thin(self, limit: int | None) -> Gallery:
        """Remove the later frame of the closest pair until at most `limit` frames are left."""
        gallery = self
        while limit is not None and len(gallery) > limit:
            gallery = gallery.keep(np.arange(len(gallery)) != gallery.closest[1])
        return gallery

    @cached_property
    def closest(self) -> tuple[float, int]:
        """The least distance between two frames, and the row of the later one of them."""
        from scipy.spatial.distance import cdist

        points = self.shown.position.astype(np.float64)
        apart = cdist(points, points)
        apart[np.tril_indices(len(self))] = np.inf
        first, second = np.unravel_index(np.argmin(apart), apart.shape)
        return float(apart[first, second]), int(second)
