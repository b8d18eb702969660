"""`VisualMap`: the frames a robot knows and their descriptors, in memory and in a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor, Fused
from analytic.descriptors.fused import NUMBERS
from analytic.distances import DISTANCES
from foundation.calls import typed
from foundation.columns import chosen_rows
from foundation.files import plain
from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.mounting import Mounting
from siamloc.errors import ConfigError, DataError
from siamloc.maps.aligned import AlignedIndex
from siamloc.maps.checked_arrays import check_distance, checked_descriptors, checked_orientation
from siamloc.maps.heading import (
    NetworkHeading,
    described,
    descriptor_of,
    halved,
    is_analytic,
    parts_of,
)
from siamloc.maps.history import UPKEEP, History, merged_upkeep, upkeep_of
from siamloc.maps.identities import BY_DRIVE, differences, exchangeable
from siamloc.maps.map_file import read_map, write_map
from siamloc.maps.packing import Precision, shares_values
from siamloc.maps.search import Retrieval, VectorIndex
from siamloc.models.registry import COLOURS

_SAMPLE = 512  # frames
_SAME_COLOURS = 1e-6  # distance of colours that differ by rounding alone, as those of turned copies


@dataclass(frozen=True, eq=False, repr=False)
class VisualMap:
    """The frames that a robot knows and their descriptors (n, D); immutable. Built by `siamloc.maps.build`.

    Attributes:
        descriptors: (n, D) float32, read-only.
        frames: n frames; poses and rooms may be missing, and the tasks that need them raise an error.
        identity: what computed the descriptors (name, parameters, hash of the weights) and, under "images", how images
            became panoramas, as plain values.
        distance: how descriptors are compared: a name in `analytic.DISTANCES`.
        made: what the frames were read from, and what updates need, as plain values.
        orientation: (n, K, F) orientation parts that give the headings, read-only; in half precision those that
            `heading` describes, see `siamloc.maps.heading.halved`; None if there are none.
        heading: identity of what computed the orientation parts, if it was not an analytic descriptor together with the
            descriptors: {"name": "network"} for the network that describes the map, or another descriptor's.
        describes: the descriptor, ready to describe queries; not saved. Use `descriptor`, which creates an analytic one
            from the identity, or `with_descriptor`.
        history: what drives said about the frames, see `siamloc.maps.update`; that of a new map if None.

    Raises:
        DataError: no frames, a different number of descriptors, orientation parts or rows of history than frames, or
            values that are not finite.
        ConfigError: an unknown distance, or one that is meaningless for so few values.

    Example:
        >>> known = VisualMap([[0.0, 1.0], [1.0, 0.0]], FrameTable(path=["a.png", "b.png"], x=[0, 5], y=[0, 0]))
        >>> known
        VisualMap(2 frames, 2 numbers each, compared by euclidean)
        >>> known.frames.x[known.search([[0.9, 0.2]]).indices[:, 0]]
        array([5.])
    """

    descriptors: NDArray[np.float32]
    frames: FrameTable
    identity: dict[str, Any] = field(default_factory=dict)
    distance: str = "euclidean"
    made: dict[str, Any] = field(default_factory=dict)
    orientation: NDArray[Any] | None = None
    heading: dict[str, Any] | None = None
    describes: Descriptor | None = None
    history: History = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        descriptors = checked_descriptors(self.descriptors, self.frames)
        check_distance(self.distance, descriptors.shape[1])
        if self.has_colours and descriptors.shape[1] <= COLOURS:
            raise DataError(
                f"a map with colours needs descriptors of more than {COLOURS} numbers, and these have "
                f"{descriptors.shape[1]}"
            )
        object.__setattr__(self, "descriptors", descriptors)
        if self.heading is not None:
            object.__setattr__(self, "heading", plain(dict(self.heading)))
        if self.orientation is not None or self.heading is not None:
            orientation = checked_orientation(self.orientation, descriptors, halved=self.heading is not None)
            object.__setattr__(self, "orientation", orientation)
        object.__setattr__(self, "identity", plain(dict(self.identity)))
        if self.history is None:
            object.__setattr__(self, "history", History.none(len(self)))
        if len(self.history) != len(self):
            raise DataError(f"a map needs one row of history per frame, got {len(self.history)} for {len(self)} frames")

    def __reduce__(self) -> tuple[Any, ...]:  # copies are made by the class, which keeps their arrays read-only
        return type(self), tuple(getattr(self, one.name) for one in fields(self))

    def __len__(self) -> int:
        return len(self.descriptors)

    def __repr__(self) -> str:
        name = f" by {self.identity['name']}" if "name" in self.identity else ""
        heading = ""
        if self.heading is not None and self.heading.get("circular", True):
            heading = f", headings by {self.heading['name']}"
        return f"VisualMap({len(self)} frames, {self.width} numbers each{name}, compared by {self.distance}{heading})"

    @property
    def unit(self) -> str:
        """Unit of x and y, which is that of the frames."""
        return self.frames.unit

    @property
    def width(self) -> int:
        """Number of values in a descriptor, D."""
        return self.descriptors.shape[1]

    @property
    def bytes(self) -> int:
        """Size of descriptors and orientation parts in memory."""
        parts = self.orientation
        shared = parts is None or shares_values(parts, self.descriptors)
        return self.descriptors.nbytes + (0 if parts is None or shared else parts.nbytes)

    @cached_property
    def descriptor(self) -> Descriptor:
        """The descriptor that describes queries as the map's frames were described.

        Raises:
            ConfigError: the map holds no descriptor: load a network from its run, or create a custom descriptor
                yourself.
        """
        if self.describes is not None:
            return self.describes
        if not is_analytic(self.identity):
            raise ConfigError(
                f"the map was described by {self.identity.get('name', 'an unknown descriptor')!r}, which it does not "
                "hold: give it with VisualMap.load(path, descriptor) or known.with_descriptor(descriptor)"
            )
        return descriptor_of(self.identity)

    @cached_property
    def heading_by(self) -> Descriptor:
        """The descriptor that compares the orientation parts: the map's own, a second, or one without its network.

        Raises:
            AnalyticError: a descriptor or a parameter that this version does not know.
        """
        return self.descriptor if self.heading is None else descriptor_of(self.heading)

    @property
    def heading_descriptor(self) -> Descriptor | None:
        """The second descriptor, whose orientation parts give the headings; None without one."""
        return None if self.heading is None or self.heading_by_network else self.heading_by

    @property
    def heading_by_network(self) -> bool:
        """Whether the orientation parts come from the network that describes the map."""
        return self.heading is not None and self.heading.get("name") == NetworkHeading.name

    def describe(self, batch: ArrayLike) -> Description:
        """Describe images as the frames of the map were described, including the parts that give their headings.

        Args:
            batch: images, as for `analytic.Descriptor.describe`.

        Raises:
            ConfigError: the map holds no descriptor, see `descriptor`.
        """
        return described(self.descriptor, self.heading_descriptor, batch, self.mounting)

    @cached_property
    def mounting(self) -> Mounting:
        """How the camera is mounted; panoramas are described as if it looked straight ahead."""
        return Mounting.of(self.made.get("mounting", {}))

    @property
    def aligned(self) -> bool:
        """Whether descriptors are turned into alignment before they are compared."""
        return (self.describes is not None or is_analytic(self.identity)) and self.descriptor.aligned

    @cached_property
    def description(self) -> Description:
        """The map as a description that its descriptor can compare; its spectrum is computed once for all queries."""
        return Description(self.descriptors, self.orientation if self.heading is None else None)

    @cached_property
    def index(self) -> VectorIndex:
        """The descriptors, prepared once for exact search with any number of queries."""
        return VectorIndex(self.descriptors, self.distance)

    @property
    def has_colours(self) -> bool:
        """Whether descriptors end with colours, which are not learned; see `siamloc.models.colours`.

        In a map by a fused descriptor whose first part is a network with colours, they end with these colours and with
        the other parts, which are not learned either. If that network has the weight 0, they are only other parts.
        """
        weights = self.identity.get("weights")  # of the parts; of a network alone, a hash
        idle = isinstance(weights, Mapping) and next(iter(weights.values()), None) == 0
        network = next(iter(parts_of(self.identity).values()), self.identity)  # the first part of a fused descriptor
        return bool(network.get("colours")) and not idle

    @property
    def learned(self) -> NDArray[np.float32]:
        """What is learned of the descriptors, without colours (n, D): what means, nodes and filters are made of."""
        if not self.has_colours:
            return self.descriptors
        fused = list(self.identity.get("widths", {}).values())
        return self.descriptors[:, : fused[0] - COLOURS if fused else -COLOURS]

    @cached_property
    def learned_index(self) -> VectorIndex:
        """The learned part of the descriptors, prepared as `index` is; `index` itself where that is all."""
        return VectorIndex(self.learned, self.distance) if self.has_colours else self.index

    @cached_property
    def colour_spacing(self) -> float:
        """Median distance from the colours of a frame to the most similar other colours in the map.

        Of 512 frames at most; infinite if all frames have the same colours.
        """
        colours = self.descriptors[:, self.learned.shape[1] :]
        apart = DISTANCES["euclidean"](colours[:: -(-len(self) // _SAMPLE)], colours)
        nearest = np.where(apart > _SAME_COLOURS, apart, np.inf).min(axis=1)
        finite = nearest[np.isfinite(nearest)]
        return float(np.median(finite)) if len(finite) else np.inf

    @cached_property
    def aligned_index(self) -> AlignedIndex:
        """The frames of a map that is `aligned`, prepared once for comparison with queries at every turn."""
        return AlignedIndex(self.descriptor, self.description, self.distance)

    @cached_property
    def digest(self) -> str:
        """A hash of descriptors, distance, frames and identity, without orientation parts and history."""
        digest = hashlib.sha256(json.dumps([self.identity, self.distance], sort_keys=True).encode())
        digest.update("\0".join([*self.frames.path.tolist(), *self.frames.place.tolist()]).encode())
        for array in (self.descriptors, self.frames.xy):
            digest.update(array.tobytes())
        return digest.hexdigest()

    def take(self, rows: ArrayLike | slice) -> VisualMap:
        """Return the map of some rows, given by row numbers, a mask (n,) or a slice, in that order.

        Raises:
            DataError: rows that do not exist, or none.
        """
        key = chosen_rows(rows, len(self))
        orientation = None if self.orientation is None else self.orientation[key]
        frames, history = self.frames.take(key), self.history.take(key)
        return replace(self, descriptors=self.descriptors[key], frames=frames, orientation=orientation, history=history)

    def without(self, frames: FrameTable | ArrayLike) -> VisualMap:
        """Return the map without some frames, given as a table, such as `known.frames.select(...)`, by row or by mask.

        Raises:
            DataError: a frame that the map does not hold, or no frame would be left.
        """
        if isinstance(frames, FrameTable):
            left = self.frames.rows_in(frames) < 0
            if missing := set(frames.take(frames.rows_in(self.frames) < 0).identities()):
                raise DataError(
                    f"{len(missing)} of {len(frames)} frames to leave out are not in the map, such as {min(missing)[1]}"
                )
        else:
            left = np.ones(len(self), dtype=bool)
            left[chosen_rows(frames, len(self))] = False
        if not left.any():
            raise DataError(f"all {len(self)} frames of the map would be left out: a map needs at least one")
        return self.take(left)

    @typed
    def add(self, frames: FrameTable, description: Description) -> VisualMap:
        """Return the map with further frames, such as those of a place under another light.

        `siamloc.maps.update` adds only the frames that the map lacks.

        Args:
            frames: n frames, in the unit of the map.
            description: what `describe` returned for their panoramas.

        Raises:
            ConfigError: a description by another descriptor; those by networks and by several descriptors together
                do not name theirs.
            DataError: a frame that the map holds already, positions in another unit, or a description of another form.

        Example:
            >>> known = VisualMap([[0.0, 1.0], [1.0, 0.0]], FrameTable(path=["a.png", "b.png"]))
            >>> known.add(FrameTable(path=["c.png"]), Description(np.array([[1.0, 1.0]])))
            VisualMap(3 frames, 2 numbers each, compared by euclidean)
        """
        return self.merge(self.like(frames, description))

    def like(self, frames: FrameTable, description: Description) -> VisualMap:
        """Return the map of other frames (n) that were described as those of this map; see `add`."""
        self.check_descriptor(description.identity)
        parts = description.orientation if self.orientation is not None else None
        if parts is not None and self.heading is not None:
            parts = halved(self.heading_by, parts)
        made = {key: value for key, value in self.made.items() if key != UPKEEP}
        own: dict[str, Any] = {"frames": frames, "orientation": parts, "history": None, "made": made}
        return replace(self, descriptors=description.position, **own)

    @typed
    def merge(self, other: VisualMap) -> VisualMap:
        """Return the map of the frames of this map, followed by the frames of another map.

        The positions of both have to be in the same axes, which is not checked: `siamloc.maps.survey` of the drives of
        both finds such positions, and `siamloc.maps.update` refuses a drive in other axes.

        Raises:
            ConfigError: the other map was described differently.
            DataError: a frame that both maps hold, positions in another unit, or a map with headings and one without.
        """
        self.check_descriptor({"images": {}, **other.identity})
        if other.width != self.width:
            raise DataError(f"descriptors of {other.width} numbers do not fit a map of {self.width}")
        if both := set(self.frames.identities()) & set(other.frames.identities()):
            raise DataError(
                f"{len(both)} frames are in both maps, such as {min(both)[1]}: leave them out of one, with "
                "other.without(...)"
            )
        if self.heading != other.heading or (self.orientation is None) != (other.orientation is None):
            raise DataError("a map with headings and one without, or with headings found otherwise, cannot be merged")
        if self.mounting != other.mounting:
            raise ConfigError(
                f"the cameras of the maps are mounted differently, {self.mounting} and {other.mounting}: if they are "
                "not, make the other map with mounting=known.mounting; if they are, turn its panoramas where they are "
                "unwrapped"
            )
        oriented = [one.orientation for one in (self, other) if one.orientation is not None]
        parts = np.concatenate(oriented) if oriented else None
        descriptors = np.concatenate([self.descriptors, other.descriptors])
        frames = concatenate([self.frames, other.frames])
        made = {**self.made, "sequences": list(frames.rows_by("sequence")), "frames": len(frames)}
        if UPKEEP in {*self.made, *other.made}:
            made[UPKEEP] = merged_upkeep(*(upkeep_of(one.made, len(one)) for one in (self, other)))
        history = History.concatenate([self.history, other.history])
        return replace(self, descriptors=descriptors, frames=frames, orientation=parts, made=made, history=history)

    def placed(self) -> VisualMap:
        """Return the map with only the frames that have a position: the map itself if all have one.

        Raises:
            DataError: no frame has a position.
        """
        placed = self.frames.has_position
        if not placed.any():
            raise DataError("no map frame has a position: give x and y in a manifest")
        return self if placed.all() else self.take(placed)

    def turning(self, rows: NDArray[np.int64] | slice = slice(None)) -> Description:
        """Return the description of some rows (p,), by default all, with the parts that headings are estimated from."""
        if self.heading is None or self.orientation is None:
            return self.description.take(rows)
        parts = self.orientation[rows].astype(np.float32)
        return Description(self.descriptors[rows], parts if parts.ndim == 3 else parts.view(np.complex64)[..., 0])

    @typed
    def search(self, descriptors: ArrayLike, k: int = 1, *, excluded: ArrayLike | None = None) -> Retrieval:
        """Find the min(k, len(map)) nearest map frames of each descriptor (n, D), exactly.

        The first search prepares the map for all others, which takes the memory of its descriptors as float32.

        Args:
            descriptors: (n, D).
            k: number of map frames to return, at least 1.
            excluded: (n, len(map)) bool, True where a query must not find a map frame.

        Raises:
            ConfigError, DataError: as for `siamloc.maps.VectorIndex.search`.
        """
        return self.index.search(descriptors, k, excluded=excluded)

    def with_descriptor(self, descriptor: Descriptor) -> VisualMap:
        """Return the map with the descriptor for its queries.

        A fused descriptor gets the order of its parts from the map, and weights and typical distances if it has none.

        Raises:
            ConfigError: the map was described by another descriptor.
        """
        if isinstance(descriptor, Fused) and self.identity.get("name") == Fused.name:
            held: dict[str, Any] = {key: self.identity.get(key) for key in NUMBERS if getattr(descriptor, key) is None}
            if set(order := parts_of(self.identity)) == set(descriptor.parts):
                descriptor = replace(descriptor, parts={name: descriptor.parts[name] for name in order}, **held)
        self.check_descriptor(descriptor.identity)
        return replace(self, describes=descriptor)

    def with_distance(self, distance: str | None) -> VisualMap:
        """Return the map with another distance between descriptors; the map itself if None.

        Raises:
            ConfigError: an unknown distance, or one that is meaningless for the map's descriptors.

        Example:
            >>> known = VisualMap([[0.0, 1.0], [1.0, 0.0]], FrameTable(path=["a.png", "b.png"]))
            >>> known.with_distance("cosine").search([[3.0, 0.0]]).distances
            array([[0.]])
        """
        return self if distance in (None, self.distance) else replace(self, distance=distance)

    def with_heading(self, heading: Descriptor | None) -> VisualMap:
        """Return the map with headings from this descriptor; if None, only those from the map's own descriptor, if any.

        Raises:
            ConfigError: the map holds no heading part of this descriptor.
        """
        if heading is None:
            return self if self.heading_descriptor is None else replace(self, orientation=None, heading=None)
        wanted = plain(heading.identity)
        if self.heading == wanted:
            return self
        found = "holds nothing to find headings by"
        if self.heading is not None:
            found = f"finds headings in another way: {differences(self.heading, wanted)}"
        raise ConfigError(
            f"the map {found}: make it again with `siamloc map heading={heading.name}` and the same heading keys, or "
            "evaluate with heading=none"
        )

    def check_frames(self, frames: FrameTable, *, whole: bool = True) -> FrameTable:
        """Check that a data set still holds the map's frames at the positions and in the rooms stored in the map.

        Frames without a position or a room in the data, such as those that an update located, agree with any.

        Args:
            frames: the frames of the data set.
            whole: whether the data must hold all frames of the map but those that joined it by an update.

        Returns:
            The frames of the map that are not in the data.

        Raises:
            ConfigError: a frame is missing, or has another position or room than in the map.
        """
        row = self.frames.rows_in(frames)
        missing = self.frames.path[(row < 0) & ~self.history.joined]
        if whole and len(missing):
            raise ConfigError(
                f"{len(missing)} of the map's {len(self)} frames are not in the data, the first is {missing[0]}: "
                "use the data that the map was made of, or make the map again"
            )
        there, found = self.frames.take(row >= 0), frames.take(row[row >= 0])
        moved = (np.isfinite(found.xy) & ~np.isclose(found.xy, there.xy, rtol=0, atol=1e-9)).any(axis=1)
        changed = there.path[moved | ((found.room != there.room) & (found.room != ""))]
        if len(changed):
            raise ConfigError(
                f"{len(changed)} of the map's {len(self)} frames have another position or room in the data now, the "
                f"first is {changed[0]}: make the map again with `siamloc map`"
            )
        return self.frames.take(row < 0)

    def check_images(self, preprocessing: Mapping[str, Any], size: tuple[int, int] | None = None) -> None:
        """Check that panoramas of queries are made in the same way as panoramas of the map.

        Two cameras whose models know the elevation of each pixel give the same panoramas, and may differ. So may rings
        that each drive's own pictures show.

        Args:
            preprocessing: `images.preprocessing.parameters()` of a library.
            size: its `images.preprocessing.size`.

        Raises:
            ConfigError: the panoramas are made in another way; the message lists the keys that differ, with both
                values. Or the camera's parameters count in the pixels of pictures of another size than the map's.
        """
        if "images" in self.identity:
            camera, other = ((one or {}).get("camera") for one in (self.identity["images"], preprocessing))
            had = self.made.get("size")
            fixed = camera and camera["kind"] not in BY_DRIVE and plain(camera) == plain(other)
            if fixed and size and had and tuple(had) != size:
                (rows, columns), (height, width) = had, size
                raise ConfigError(
                    f"the camera's parameters count in the map's pictures of {columns} x {rows} px, and these have "
                    f"{width} x {height} px: give pictures of that size"
                )
            if exchangeable(camera, other):
                preprocessing = {**preprocessing, "camera": camera}
            self.check_descriptor({**self.identity, "images": preprocessing})

    def check_descriptor(self, identity: Mapping[str, Any] | None) -> None:
        """Check that queries were described as the frames of the map were, as far as both identities say how.

        Args:
            identity: identity of the descriptor of the queries, None if unknown; with the key "images", how these
                became panoramas is compared, too.

        Raises:
            ConfigError: another descriptor, or other panoramas; the message lists the keys that differ, with both
                values.
        """
        if not self.identity or identity is None:
            return
        if listed := differences(self.identity, plain({"images": self.identity.get("images", {}), **identity})):
            raise ConfigError(
                f"the map was described differently from the queries: {listed}. "
                "Describe the queries with the map's model, or build the map again"
            )

    @typed
    def save(self, path: str | Path, precision: Precision = "float32") -> None:
        """Write the map to an npz file, atomically; equal maps give equal files.

        Args:
            path: the file to write.
            precision: how descriptors are stored. "float16" and "int8" also store a scale for each row, and are read
                back as float32 with about 3 and 2 significant digits; orientation parts have at least float16.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        write_map(path, self, precision)

    @classmethod
    @typed
    def load(cls, path: str | Path, descriptor: Descriptor | None = None) -> VisualMap:
        """Read a map that `save` wrote.

        Args:
            path: the file.
            descriptor: the descriptor for queries; an analytic one is created from the file when it is needed.

        Raises:
            ConfigError: the map was described by another descriptor.
            FormatError: the file is missing, truncated, altered, not a map, or of another version.
        """
        loaded = read_map(path, cls)
        return loaded if descriptor is None else loaded.with_descriptor(descriptor)
