"""Compare queries with a map's frames at every turn, for descriptors that are aligned first ([T] 3.3.4-3.3.6)."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor
from analytic.description import spectrum
from analytic.descriptors.base import AlignedDescriptor
from siamloc.maps.packing import Packed, packed, shares_values, unpacked
from siamloc.maps.search import Retrieval, check_excluded, check_neighbours, slices

_PAIRS = 1 << 17  # distances held at once
_VALUES = 1 << 19  # of frames that become float32 at once: 2 MiB, and as much for their spectra


class AlignedIndex:
    """A map's frames, prepared once for comparison at every turn, as `VectorIndex` is for vectors.

    The turn of a pair comes from the spectra of both orientation parts. Those of a map are computed at the first
    comparison; in float32 they take as much memory as the map. For a map at lower precision (`Packed`) they are
    rounded to eight bits, with a scale for each frequency of each frame, and a few frames at a time become float32. A
    correlation is a sum of so many rounded products that their errors cancel: almost all pairs keep their turn, and
    distances that come from the correlation change by up to about 0.2 %. Manhattan distances, and all of similar
    frames, are those of the map's values at that turn. Where values are whole numbers, ties must be exact: these
    spectra are not rounded, but computed again for every query.

    Args:
        descriptor: the descriptor of the map.
        description: m frames by this descriptor, in float32 or packed.
        distance: a name in `analytic.DISTANCES`.
    """

    def __init__(self, descriptor: Descriptor, description: Description, distance: str) -> None:
        self._descriptor, self._description, self._distance = descriptor, description, distance
        self._held = description.orientation if isinstance(description.orientation, Packed) else None
        turned = isinstance(descriptor, AlignedDescriptor) and descriptor.tells_heading
        self._by_spectrum = turned and not (self._held is not None and descriptor.whole)

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
        k = min(check_neighbours(k), m)
        mask = None if excluded is None else check_excluded(excluded, (len(queries), len(self)), k)
        found = Retrieval(np.zeros((len(queries), k), dtype=np.int64), np.zeros((len(queries), k)))
        for part in slices(len(queries), _PAIRS // m):
            apart = self._distances(queries.take(part), within)
            if mask is not None:
                apart[mask[part]] = np.inf
            order = np.argsort(apart, axis=1, kind="stable")[:, :k]
            found.indices[part] = order if within is None else within[order]
            found.distances[part] = np.take_along_axis(apart, order, axis=1)
        return found

    def distances(self, queries: Description) -> NDArray[np.float64]:
        """Return the distances (n, m) of n queries to all frames.

        Raises:
            AnalyticError: descriptions that cannot be compared.
        """
        apart = np.empty((len(queries), len(self)))
        for part in slices(len(queries), _PAIRS // len(self)):
            apart[part] = self._distances(queries.take(part))
        return apart

    def _distances(self, queries: Description, within: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
        if within is None and self._held is None:
            return self._descriptor.pairwise(queries, self._description, self._distance)
        rows = np.arange(len(self)) if within is None else within
        apart = np.empty((len(queries), len(rows)))
        for part in slices(len(rows), _VALUES // self._description.position.shape[1]):
            apart[:, part] = self._descriptor.pairwise(queries, self._frames(rows[part]), self._distance)
        return apart

    def _frames(self, rows: NDArray[np.int64]) -> Description:
        """Return some frames in float32, with their spectra if these are kept."""
        consecutive = rows[-1] - rows[0] == len(rows) - 1
        which = slice(int(rows[0]), int(rows[-1]) + 1) if consecutive else rows  # a slice is not copied
        frames = self._description.take(which) if self._held is None else self._unpacked(self._held, which)
        if self._by_spectrum:
            frames.kept("spectrum", lambda _: self._spectrum(which))
        return frames

    def _unpacked(self, held: Packed, rows: Any) -> Description:
        position, orientation = self._description.position, held[rows]
        if shares_values(position, held):
            return Description(orientation.reshape(len(orientation), -1), orientation)
        return Description(position[rows], orientation)

    def _spectrum(self, rows: Any) -> NDArray[np.complex64]:
        """Return the spectra (U, p, F) of p frames."""
        if self._held is None:
            return self._description.spectrum[:, rows]
        values, scale = self._packed_spectra
        values, scale = values[rows], scale[rows]
        p, frequencies, features = values.shape[:3]
        full = unpacked(values.reshape(p * frequencies, features, 2), scale.ravel())
        return full.view(np.complex64).reshape(p, frequencies, features).transpose(1, 0, 2)

    @cached_property
    def _packed_spectra(self) -> tuple[NDArray[Any], NDArray[np.float32]]:
        """The rounded spectra (m, U, F, 2) of a packed map, and the scales (m, U)."""
        held = self._held
        assert held is not None
        m, steps, features = held.shape
        frequencies = steps // 2 + 1
        values = np.empty((m, frequencies, features, 2), dtype=np.int8)
        scale = np.empty((m, frequencies), dtype=np.float32)
        for row in range(m):
            short = packed("values", spectrum(held[row : row + 1])[:, 0], "int8")
            values[row], scale[row] = short["values"], short["values_scale"]
        return values, scale
