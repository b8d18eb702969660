"""Looking for frames in a map, for the commands that measure: in which map, for which frames, and what was found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig

from analytic import Description, Descriptor
from siamloc.cli.compose import plain
from siamloc.cli.steps import described, identity_of, label_of, map_file
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.maps import Retrieval, VisualMap, estimated_headings, match
from siamloc.runs import Run

Vectors = np.ndarray[Any, np.dtype[np.float32]]


@dataclass
class Search:
    """Frames to be looked for in a map, and what was found so far.

    Attributes:
        known: map frames that have what the task needs.
        rows: of the frames that have it (n,), in order.
        k: neighbours wanted.
        headings_of: by how many of the neighbours the heading is wanted.
        with_distances: whether the distances to all map frames are kept, n x m float64.
    """

    known: VisualMap
    rows: NDArray[np.int64]
    k: int
    headings_of: int = 1
    with_distances: bool = False
    _found: list[Retrieval] = field(default_factory=list)
    _turned: list[NDArray[np.float64]] = field(default_factory=list)
    _apart: list[NDArray[np.float64]] = field(default_factory=list)

    def take_in(self, queries: Description, descriptor: Descriptor) -> None:
        """Look for the next frames."""
        found = match(self.known, queries, descriptor, self.k)
        self._found.append(found)
        self._turned.append(headings_by(self.known, queries, descriptor, found, self.headings_of))
        if self.with_distances:
            from siamloc.maps.sequence_filter import frame_distances

            self._apart.append(frame_distances(self.known, queries, descriptor))

    @property
    def retrieval(self) -> Retrieval:
        """The nearest map frames of all."""
        return Retrieval.concatenate(self._found)

    @property
    def distances(self) -> NDArray[np.float64]:
        """Distances to all map frames (n, m)."""
        return np.concatenate(self._apart)

    @property
    def headings(self) -> NDArray[np.float64] | None:
        """Headings told by each of the first neighbours (n, headings_of), NaN if unknown; None where none is known."""
        turned = np.concatenate(self._turned)
        return turned if np.isfinite(turned).any() else None


def headings_by(
    known: VisualMap, queries: Description, descriptor: Descriptor, found: Retrieval, count: int = 1
) -> NDArray[np.float64]:
    """Return the headings (n, count) that the first neighbours of each query tell, NaN where that is unknown."""
    turned = np.full((len(queries), count), np.nan)
    for place in range(min(count, found.indices.shape[1])):
        column = slice(place, place + 1)
        one = Retrieval(found.indices[:, column], found.distances[:, column])
        told = estimated_headings(known, queries, descriptor, one)
        if told is not None:
            turned[:, place] = told
    return turned


def parts_of(descriptor: Descriptor, library: PanoramaLibrary, frames: FrameTable, what: str) -> Iterable[Description]:
    """Return the descriptions of frames, in one part unless the descriptor compares after turning.

    The parts of such descriptors are large, so that only those of a batch are there at once.
    """
    parts = described(descriptor, library, frames, what)
    return parts if descriptor.aligned else [Description.concatenate(list(parts))]


def run_searches(
    descriptor: Descriptor,
    library: PanoramaLibrary,
    frames: FrameTable,
    searches: Mapping[str, Search],
    what: str,
) -> Vectors | None:
    """Describe frames and look for them; return the position parts, or None for such as are not kept."""
    start, vectors = 0, []
    for part in parts_of(descriptor, library, frames, what):
        for search in searches.values():
            inside = search.rows[(search.rows >= start) & (search.rows < start + len(part))] - start
            if len(inside):
                search.take_in(part if len(inside) == len(part) else part.take(inside), descriptor)
        start += len(part)
        vectors.append(part.position)
        if descriptor.aligned:
            vectors.clear()
    return vectors[0] if vectors else None


def saved_map(config: DictConfig, run: Run, descriptor: Descriptor) -> VisualMap | None:
    """Return the map that `siamloc map` made for this descriptor, if there is one.

    Raises:
        ConfigError: it was made by another descriptor, or of other frames than are asked for.
    """
    path = map_file(run, label_of(plain(config.descriptor)))
    if not path.is_file():
        return None
    known = VisualMap.load(path)
    known.check_describer(identity_of(config, descriptor))
    role = known.made.get("role")
    if role is not None and role != plain(config.protocol.map):
        raise ConfigError(
            f"{path} was made of other frames than protocol.map asks for now: run `siamloc map` again, with the "
            "protocol.map keys that are wanted"
        )
    return known


def check_apart(kind: str, known: FrameTable, queries: FrameTable) -> None:
    """Make sure that no query comes from the map's own run, unless the protocol says so."""
    if kind == "same_run":
        return
    if what := shared_with(known, queries):
        raise ConfigError(
            f"{what} is in the map and among the queries, so that the result would not be honest: query another "
            "sequence, or say protocol.kind=same_run"
        )


def shared_with(known: FrameTable, frames: FrameTable) -> str:
    """Return the first sequence or image that two tables share, in words; nothing if there is none."""
    sequences = sorted(set(known.sequence.tolist()) & set(frames.sequence.tolist()))
    copies = np.flatnonzero(np.isin(frames.path, known.path))
    if sequences:
        return f"sequence {sequences[0]!r}"
    return f"image {frames.path[copies[0]]}" if len(copies) else ""


def lacking(config: DictConfig, has: NDArray[np.bool_], what: str) -> str:
    """Return how many frames lack something, in words; nothing if all have it.

    Raises:
        DataError: some lack it, others do not, and data.on_error is "raise".
    """
    if has.all():
        return ""
    text = f"{int((~has).sum())} of {len(has)} {what}"
    if has.any() and config.data.on_error == "raise":
        raise DataError(f"{text}: data.on_error=skip leaves them out")
    return text
