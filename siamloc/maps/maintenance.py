"""Map maintenance ([T] 1.2): `update` finds where a located drive shows that a map is out of date, and mends it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.settings import Count, Positive
from siamloc.data.frames import FrameTable, concatenate
from siamloc.errors import ConfigError, DataError
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.describing import build
from siamloc.maps.grouping import Built
from siamloc.maps.matching import match
from siamloc.maps.visual_map import VisualMap

if TYPE_CHECKING:
    from siamloc.data.library import PanoramaLibrary


@dataclass(frozen=True, eq=False, repr=False)
class Update:
    """What a located drive says about a map, and the map after maintenance.

    Attributes:
        known: the map with the frames that were added; the map as it was if none were.
        built: the nodes over the frames of `known`; None if no nodes were given.
        drive: the n readable frames of the drive, in their order.
        known_place: (n,) whether a frame was taken in a place of the map: within the radius of a map frame.
        contradicted: (n,) whether a frame taken in a known place was located in another place.
        added: (n,) whether a frame was added to the map.
    """

    known: VisualMap
    built: Built | None
    drive: FrameTable
    known_place: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]
    added: NDArray[np.bool_]

    def summary(self) -> str:
        """Return one line about the places of the drive and the frames added."""
        places = f"{self.known_place.sum()} of {len(self.drive)} frames in known places"
        added = (
            f"{self.added.sum()} added, where the map is out of date" if self.added.any() else "the map is up to date"
        )
        return f"update: {places}, {self.contradicted.sum()} of them located elsewhere; {added}"


@typed
def update(
    known: VisualMap,
    images: PanoramaLibrary,
    drive: FrameTable,
    *,
    built: Built | None = None,
    radius: Positive = 1.0,
    contradicted: Count = 15,
    window: Count = 20,
    progress: bool = True,
) -> Update:
    """Find where a map is out of date, on a drive whose positions are known, and add the drive's frames there.

    A frame contradicts the map if it was taken within `radius` of a map frame and is located farther away than that.
    A place is out of date once `contradicted` of the last `window` frames taken there contradict the map; the frames of
    such windows are added. The counts are those with which [T] 4.6 decides, from frames that are in no node, that a map
    needs a new node; in a place that the map has, they call for another appearance of it instead. A single frame is no
    evidence, because a person in view is enough to mislocate it.

    A place is a node of `built`, or the whole map without one. In an incremental map, the mapper locates the frames,
    and the added frames become another mode of their node (`IncrementalMapper.maintain`); nodes with fewer frames
    than a mode needs are left as they are.

    Args:
        known: a map whose frames all have positions; it is not changed.
        images: panoramas of the drive.
        drive: frames with positions in the map's coordinates, in capture order.
        built: nodes over the map's frames. Nodes of an incremental map need their mapper, as `siamloc.maps.group`
            returns it, able to grow.
        radius: distance within which frames show the same place, in the unit of the positions.
        contradicted: number of contradicting frames in a window that call for an update; at most `window`.
        window: number of last frames taken in a place that are considered.
        progress: whether to show the progress of describing the drive.

    Raises:
        ConfigError: more frames to be contradicted than a window has, or an image size or descriptor other than the
            map's.
        DataError: a frame without a position, positions in two units, nodes over another map, or an incremental map
            without its mapper.
        AnalyticError: a mapper that is read-only.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example(frames=40)
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> found = update(known, images, tuesday, progress=False)
        >>> int(found.known_place.sum()), int(found.added.sum())  # tuesday looks as monday did
        (40, 0)
    """
    from scipy.spatial import cKDTree

    if contradicted > window:
        raise ConfigError(f"contradicted={contradicted} frames cannot be among the last window={window}: lower it")
    both = concatenate([known.frames, drive])  # refuses positions in two units
    if lacking := int((~both.has_position).sum()):
        raise DataError(f"{lacking} of the {len(both)} frames of map and drive have no position: leave them out")
    labels, mapper = np.zeros(len(known), dtype=np.int64), None
    if built is not None:
        built.check_map(known)
        labels, mapper = built.layer.labels, built.mapper
        if mapper is None and "ids" in built.layer.made:
            raise DataError("an incremental map is updated with its mapper, which a layer read from a file lacks")
    seen = build(known.descriptor, images, drive, heading=known.heading_descriptor, progress=progress)
    if mapper is None:
        found = match(known, seen.description).indices[:, 0]
    else:
        found = np.array([mapper.locate(seen.description.take(slice(row, row + 1))).frame for row in range(len(seen))])
    rows = np.flatnonzero(labels >= 0)
    away, nearest = cKDTree(known.frames.xy[rows]).query(seen.frames.xy)
    place, inside = labels[rows[nearest]], away <= radius
    wrong = inside & (np.linalg.norm(known.frames.xy[found] - seen.frames.xy, axis=1) > radius)
    least = 1 if mapper is None else mapper.parameters.smallest_node
    parts = [
        _outdated(np.flatnonzero(inside & (place == node)), wrong, contradicted, window) for node in np.unique(place)
    ]
    parts = [part for part in parts if len(part) >= least]
    mask = np.zeros(len(seen), dtype=bool)
    if parts:
        order = np.concatenate(parts)
        mask[order], known = True, known.merge(seen.take(order))
        if built is not None:
            built = _taught(built, known, [(int(place[part[0]]), seen.take(part)) for part in parts])
    return Update(known, built, seen.frames, inside, wrong, mask)


def _outdated(rows: NDArray[np.int64], wrong: NDArray[np.bool_], contradicted: int, window: int) -> NDArray[np.int64]:
    """Return those of the frames taken in a place that lie in windows in which enough of them contradict the map."""
    if len(rows) < window:
        return rows[:0]
    windows = np.lib.stride_tricks.sliding_window_view(rows, window)
    return np.unique(windows[wrong[windows].sum(axis=1) >= contradicted])


def _taught(built: Built, known: VisualMap, parts: list[tuple[int, VisualMap]]) -> Built:
    """Return nodes over an updated map, whose last frames are those added to each node in turn."""
    layer, mapper = built.layer, deepcopy(built.mapper)
    labels = np.concatenate([layer.labels, *(np.full(len(part), node) for node, part in parts)])
    for node, part in parts:
        poses = np.column_stack([part.frames.xy, part.frames.theta])
        frames = [pose.tolist() if np.isfinite(pose).all() else None for pose in poses]
        if mapper is not None:
            mapper.maintain(layer.made["ids"][node], part.description, frames)
    more = len(labels) - len(layer.labels)
    return replace(
        built,
        layer=replace(CoarseLayer.of_labels(known, labels, layer.names, layer.made), classifier=layer.classifier),
        seconds=built.seconds if len(built.seconds) == 1 else np.append(built.seconds, np.zeros(more)),
        map_digest=known.digest,
        reasons=(*built.reasons, *["MAINTAINED"] * more) if built.reasons else (),
        mapper=mapper,
    )
