"""Map maintenance ([T] 1.2): `update` finds where a located drive shows that a map is out of date, and mends it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import NDArray

from foundation.calls import OF_FIELDS, takes
from foundation.settings import Count, Positive, Settings
from siamloc.data.frames import FrameTable, concatenate
from siamloc.errors import ConfigError, DataError
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.describing import build
from siamloc.maps.grouping import Built
from siamloc.maps.matching import match
from siamloc.maps.visual_map import VisualMap

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from siamloc.data.library import PanoramaLibrary


@dataclass(frozen=True)
class Evidence(Settings):
    """How much evidence calls for an update of a map.

    Attributes:
        radius: distance within which frames show the same place, in the unit of the positions.
        contradicted: number of contradicting frames in a window that call for an update; at most `window`.
        window: number of consecutive frames of the drive that are judged together, of those taken in known places.
    """

    WHERE = "update"

    radius: Positive = 1.0
    contradicted: Count = 15
    window: Count = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contradicted > self.window:
            raise ConfigError(f"contradicted={self.contradicted} frames cannot be among window={self.window}: lower it")


class EvidenceFields(TypedDict, total=False):
    """Keyword arguments with the names and types of the fields of `Evidence`, for type checkers."""

    radius: float
    contradicted: int
    window: int


@dataclass(frozen=True, eq=False, repr=False)
class Update:
    """What a located drive says about a map, and the map after maintenance.

    Attributes:
        known: the map with the frames that were added; the map as it was if none were.
        built: the nodes over the frames of `known`; None if no nodes were given.
        drive: the n readable frames of the drive, in their order.
        known_place: (n,) whether a frame was taken in a place of the map: within the radius of a map frame.
        contradicted: (n,) whether a frame taken in a known place was located in another place.
        outdated: (n,) whether a frame was taken where the map is out of date.
        added: (n,) whether a frame was added to the map: the frames of `outdated`, except groups with fewer frames in a
            node of an incremental map than a mode needs (`smallest_node`).
        window: number of frames in known places without which a map is not judged.
    """

    known: VisualMap
    built: Built | None
    drive: FrameTable
    known_place: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]
    outdated: NDArray[np.bool_]
    added: NDArray[np.bool_]
    window: int

    def summary(self) -> str:
        """Return one line about the places of the drive, the evidence, and the frames added."""
        known, added, left = self.known_place.sum(), self.added.sum(), (self.outdated & ~self.added).sum()
        text = f"update: {known} of {len(self.drive)} frames in known places, "
        text += f"{self.contradicted.sum()} of them located elsewhere; "
        if known < self.window:
            return f"{text}too few frames in known places to judge the map, at least window={self.window} are needed"
        if not added + left:
            return f"{text}the map is up to date"
        text += f"{added} added, where the map is out of date"
        return f"{text}; {left} left out, fewer in their node than smallest_node" if left else text


@takes(Evidence)
def update(
    known: VisualMap,
    images: PanoramaLibrary,
    drive: FrameTable,
    *,
    built: Built | None = None,
    progress: bool = True,
    settings: Evidence = OF_FIELDS,
    **fields: Unpack[EvidenceFields],
) -> Update:
    """Find where a map is out of date, on a drive whose positions are known, and add the drive's frames there.

    A frame contradicts the map if it was taken within `radius` of a map frame and is located farther away than that.
    The map is out of date where `contradicted` of `window` consecutive frames contradict the map, counting only frames
    taken in known places; all frames of such windows are added. The counts are those with which [T] 4.6 decides, from
    frames that are in no node, that a map needs a new node; in a place that the map has, they call for another
    appearance of it instead. A single frame is no evidence, because a person in view is enough to mislocate it.

    An added frame belongs to the node of the nearest map frame. In an incremental map, the mapper locates the frames of
    the drive, and the frames added to a node become another mode of it (`IncrementalMapper.maintain`); groups smaller
    than a mode needs are left out.

    Args:
        known: a map whose frames all have positions; it is not changed.
        images: panoramas of the drive.
        drive: frames with positions in the map's coordinates, in capture order.
        built: nodes over the map's frames. Nodes of an incremental map need their mapper, as `siamloc.maps.group`
            returns it, able to grow.
        progress: whether to show the progress of describing the drive.
        settings: all settings in one object, instead of one keyword each.

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

    both = concatenate([known.frames, drive])  # refuses positions in two units
    if lacking := int((~both.has_position).sum()):
        raise DataError(f"{lacking} of the {len(both)} frames of map and drive have no position: leave them out")
    labels, mapper = np.zeros(len(known), dtype=np.int64), None
    if built is not None:
        built.check_map(known)
        labels, mapper = built.layer.labels, built.mapper
        if mapper is None and "ids" in built.layer.made:
            raise DataError("an incremental map is updated with its mapper, which a layer read from a file lacks")
    described = build(known.descriptor, images, drive, heading=known.heading_descriptor, progress=progress)
    if mapper is None:
        located = match(known, described.turning()).indices[:, 0]
    else:
        frames = (described.description.take(slice(row, row + 1)) for row in range(len(described)))
        located = np.array([mapper.locate(frame).frame for frame in frames])
    xy, in_nodes = described.frames.xy, np.flatnonzero(labels >= 0)
    distance, nearest = cKDTree(known.frames.xy[in_nodes]).query(xy)
    node, in_place = labels[in_nodes[nearest]], distance <= settings.radius
    mislocated = in_place & (np.linalg.norm(known.frames.xy[located] - xy, axis=1) > settings.radius)
    outdated, added = np.zeros(len(described), dtype=bool), np.zeros(len(described), dtype=bool)
    outdated[in_place] = _outdated(mislocated[in_place], settings)
    smallest = 1 if mapper is None else mapper.parameters.smallest_node
    groups = {int(one): np.flatnonzero(outdated & (node == one)) for one in np.unique(node[outdated])}
    groups = {one: rows for one, rows in groups.items() if len(rows) >= smallest}
    if groups:
        order = np.concatenate(list(groups.values()))
        added[order], known = True, known.merge(described.take(order))
        if built is not None:
            built = _taught(built, known, {one: described.take(rows) for one, rows in groups.items()})
    return Update(known, built, described.frames, in_place, mislocated, outdated, added, settings.window)


def _outdated(mislocated: NDArray[np.bool_], settings: Evidence) -> NDArray[np.bool_]:
    """Return which of the n frames taken in known places lie in a window with enough mislocated frames."""
    if len(mislocated) < settings.window:
        return np.zeros(len(mislocated), dtype=bool)
    window = np.ones(settings.window, dtype=np.int64)
    enough = np.convolve(mislocated, window, "valid") >= settings.contradicted
    return np.convolve(enough, window) > 0


def _taught(built: Built, known: VisualMap, groups: dict[int, VisualMap]) -> Built:
    """Return nodes over an updated map, whose last frames are those added to each node in turn."""
    layer, mapper = built.layer, deepcopy(built.mapper)
    labels = np.concatenate([layer.labels, *(np.full(len(part), node) for node, part in groups.items())])
    for node, part in groups.items():
        poses = np.column_stack([part.frames.xy, part.frames.theta])
        frames = [pose.tolist() if np.isfinite(pose).all() else None for pose in poses]
        if mapper is not None:
            mapper.maintain(layer.made["ids"][node], part.description, frames)
    more = len(labels) - len(layer.labels)
    return replace(
        built,
        layer=replace(CoarseLayer.of_labels(known, labels, layer.names, layer.made), classifier=layer.classifier),
        seconds=built.seconds if len(built.seconds) == 1 else np.append(built.seconds, np.full(more, np.nan)),
        map_digest=known.digest,
        reasons=(*built.reasons, *["MAINTAINED"] * more) if built.reasons else (),
        mapper=mapper,
    )
