"""Compare queries with a map's frames at every turn, for descriptors that are aligned first ([T] 3.3.4-3.3.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor
from analytic.alignment import moments
from analytic.descriptors.base import AlignedDescriptor
from siamloc.maps.search import Retrieval, check_excluded, slices

_VALUES = 1 << 22  # of some frames, compared at once: 16 MiB, and as much for their spectra


class AlignedIndex:
    """A map's frames, prepared once for comparison at every turn, as `VectorIndex` is for vectors.

    The turn of a pair comes from the spectra of both orientation parts. Those of a map are computed at the first
    comparison, and take as much memory as the map.

    Args:
        descriptor: the descriptor of the map.
        description: m frames by this descriptor.
        distance: a name in `analytic.DISTANCES`.
    """

    def __init__(self, descriptor: Descriptor, description: Description, distance: str) -> None:
        self._descriptor, self._description, self._distance = descriptor, description, distance
        held = description.orientation
        self._turned = isinstance(descriptor, AlignedDescriptor) and descriptor.tells_heading and held is not None

    def __len__(self) -> int:
        return len(self._description)

    def search(
        self,
        queries: Description,
        k: int = 1,
        *,
        excluded: ArrayLike | None = None,
        within: NDArray[np.int64] | None = None,
    ) -> Retrieval:
        """Return the min(k, m) nearest frames of each query; of equally near ones the smaller row comes first.

        Args:
            queries: n descriptions.
            k: number of frames to return, at least 1.
            excluded: (n, m) bool, True where a query must not find a frame.
            within: the only rows to search, increasing, not together with `excluded`; all if None.

        Raises:
            AnalyticError, ConfigError, DataError: descriptions that cannot be compared, a k below 1, or a query with
                fewer than k frames that are not excluded.
        """
        m = len(self) if within is None else len(within)
        k = min(k, m)
        apart = self.distances(queries, within)
        if excluded is not None:
            apart = np.where(check_excluded(excluded, (len(queries), len(self)), k), np.inf, apart)
        order = np.argsort(apart, axis=1, kind="stable")[:, :k]
        return Retrieval(order if within is None else within[order], np.take_along_axis(apart, order, axis=1))

    def distances(self, queries: Description, within: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
        """Return the distances (n, m) of n queries to all m map frames, or only to the map frames in rows `within`.

        Raises:
            AnalyticError: descriptions that cannot be compared.
        """
        if within is None:
            return self._descriptor.pairwise(queries, self._description, self._distance)
        apart = np.empty((len(queries), len(within)))
        for part in slices(len(within), _VALUES // self._description.position.shape[1]):
            apart[:, part] = self._descriptor.pairwise(queries, self._frames(within[part]), self._distance)
        return apart

    def _frames(self, rows: NDArray[np.int64]) -> Description:
        """Return some frames, with all that is kept for their comparison."""
        known = self._description
        consecutive = rows[-1] - rows[0] == len(rows) - 1
        which = slice(int(rows[0]), int(rows[-1]) + 1) if consecutive else rows  # a slice is not copied
        frames = known.take(which)
        if self._turned:
            frames.kept("squares", lambda _: known.squares[which])
            frames.kept("spectrum", lambda _: known.spectrum[:, which])
            if self._distance == "correlation":
                frames.kept("moments", lambda _: tuple(column[which] for column in known.kept("moments", moments)))
        return frames
