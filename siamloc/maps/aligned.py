"""Compare queries with a map's frames at every turn, for descriptors that are aligned first ([T] 3.3.4-3.3.6)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor
from analytic.alignment import moments
from analytic.description import spectrum
from analytic.descriptors.base import AlignedDescriptor
from siamloc.maps.packing import Packed, packed
from siamloc.maps.search import Retrieval, check_excluded, check_neighbours, slices

_PAIRS = 1 << 17  # distances held at once
_VALUES = 1 << 22  # of some frames, compared at once: 16 MiB, and as much for their spectra
_UNPACKED = 1 << 19  # of some frames of a packed map, which become float32 for every batch of queries


class AlignedIndex:
    """A map's frames, prepared once for comparison at every turn, as `VectorIndex` is for vectors.

    The turn of a pair comes from the spectra of both orientation parts. Those of a map are computed at the first
    comparison; in float32 they take as much memory as the map. For a map at lower precision (`Packed`) they are
    rounded to eight bits, with a scale for each frequency of each frame, and a few frames at a time become float32;
    frequency 0, which is the sum of the values and by far the largest, is not rounded. A correlation is a sum of so
    many rounded products that their errors mostly cancel: almost all pairs keep their turn. Manhattan distances, and
    any distance between very similar frames, are computed from the map's values at that turn. Other distances come
    from the correlation and change by 0.01 % on average, by up to 2 % for short descriptors that are just not similar
    enough. Where values are whole numbers, ties must be exact: these spectra are not rounded, but computed again for
    every batch of queries.

    Args:
        descriptor: the descriptor of the map.
        description: m frames by this descriptor, in float32 or packed.
        distance: a name in `analytic.DISTANCES`.
    """

    def __init__(self, descriptor: Descriptor, description: Description, distance: str) -> None:
        self._descriptor, self._description, self._distance = descriptor, description, distance
        held = description.orientation
        self._packed = isinstance(held, Packed) or isinstance(description.position, Packed)
        self._turned = isinstance(descriptor, AlignedDescriptor) and descriptor.tells_heading and held is not None
        self._rounded = isinstance(held, Packed) and not getattr(descriptor, "whole", False)

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
                apart = np.where(mask[part], np.inf, apart)
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
        if within is None and not self._packed:
            return self._descriptor.pairwise(queries, self._description, self._distance)
        rows = np.arange(len(self)) if within is None else within
        apart = np.empty((len(queries), len(rows)))
        for part in self._blocks(len(rows)):
            apart[:, part] = self._descriptor.pairwise(queries, self._frames(rows[part]), self._distance)
        return apart

    def _blocks(self, count: int) -> Iterator[slice]:
        return slices(count, (_UNPACKED if self._packed else _VALUES) // self._description.position.shape[1])

    def _frames(self, rows: NDArray[np.int64]) -> Description:
        """Return some frames in float32, with all that is kept for their comparison."""
        consecutive = rows[-1] - rows[0] == len(rows) - 1
        which = slice(int(rows[0]), int(rows[-1]) + 1) if consecutive else rows  # a slice is not copied
        if not self._turned:
            return self._description.take(which)
        frames = self._turnable(which)
        frames.kept("squares", lambda _: self._squares[which])
        if self._distance == "correlation":
            frames.kept("moments", lambda _: tuple(column[which] for column in self._moments))
        if self._rounded:
            frames.kept("spectrum", lambda _: self._unrounded(which))
        elif not isinstance(self._description.orientation, Packed):
            frames.kept("spectrum", lambda _: self._description.spectrum[:, which])
        return frames

    def _turnable(self, which: Any) -> Description:
        """Return some frames in float32, with their orientation parts as position parts too: turned, they are alike."""
        turnable = self._description.turnable[which]
        return Description(turnable.reshape(len(turnable), -1), turnable, self._description.identity)

    @cached_property
    def _squares(self) -> NDArray[np.float64]:
        return np.concatenate([self._turnable(part).squares for part in self._blocks(len(self))])

    @cached_property
    def _moments(self) -> tuple[NDArray[np.float64], ...]:
        found = [moments(self._turnable(part)) for part in self._blocks(len(self))]
        return tuple(np.concatenate(column) for column in zip(*found, strict=True))

    @cached_property
    def _rounded_spectra(self) -> tuple[NDArray[np.float32], NDArray[np.int8], NDArray[np.float32]]:
        """Frequency 0 of all frames (m, F), the others rounded (m, U - 1, 2 F), and the scales of these (m, U - 1)."""
        held = self._description.turnable
        m, steps, features = held.shape
        lowest = np.empty((m, features), dtype=np.float32)
        others = np.empty((m, steps // 2, 2 * features), dtype=np.int8)
        scale = np.empty((m, steps // 2), dtype=np.float32)
        for row in range(m):
            one = spectrum(held[row : row + 1])[:, 0]
            lowest[row] = one[0].real
            short = packed("others", one[1:], "int8")
            others[row], scale[row] = short["others"].reshape(others.shape[1:]), short["others_scale"]
        return lowest, others, scale

    def _unrounded(self, which: Any) -> NDArray[np.complex64]:
        """Return the spectra (U, p, F) of p frames from the rounded ones."""
        lowest, others, scale = (part[which] for part in self._rounded_spectra)
        full = np.empty((len(lowest), others.shape[1] + 1, lowest.shape[1]), dtype=np.complex64)
        full[:, 0] = lowest
        np.multiply(others, scale[..., None], out=full.view(np.float32)[:, 1:])
        return full.transpose(1, 0, 2)
