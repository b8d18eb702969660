"""`CoarseLayer`: which frames of a map belong together, with a representative for each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.mapper.graph import connections
from foundation.arrays import read_headed, write_arrays
from foundation.calls import typed
from siamloc.errors import DataError, FormatError
from siamloc.maps.visual_map import VisualMap
from siamloc.models.room_classifier import RoomClassifier

_FORMAT = "coarse layer"
_VERSION = 1
UNASSIGNED = -1


@dataclass(frozen=True, eq=False)
class CoarseLayer:
    """Nodes over the frames of a map: rooms, clusters, or the places of an incremental map. Immutable.

    Attributes:
        labels: (n,) the node of each map frame, 0 ... k - 1 and none of them empty; UNASSIGNED for frames in no node.
        representatives: (k, D) float32, the mean descriptor of each node ([C] 4).
        positions: (k, 2) the mean position of each node's frames, NaN where no frame has one.
        names: (k,) names of the nodes: room codes for rooms, numbers otherwise.
        edges: (e, 2) pairs of nodes between which the robot moved, each pair once, the smaller number first.
        made: how the layer was built (method, parameters) and what that cost, as plain values.
        classifier: predicts the node of a descriptor, with classes in the order of the nodes. None unless the nodes
            are rooms and the network that described the map was trained to name them.

    Raises:
        DataError: parts that do not match each other.
    """

    labels: NDArray[np.int64]
    representatives: NDArray[np.float32]
    positions: NDArray[np.float64]
    names: NDArray[np.str_]
    edges: NDArray[np.int64]
    made: dict[str, Any] = field(default_factory=dict)
    classifier: RoomClassifier | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.representatives) != 2:
            raise DataError(f"a coarse layer needs representatives (k, D), got {np.shape(self.representatives)}")
        k = len(self.representatives)
        labels = np.asarray(self.labels)
        if labels.ndim != 1 or labels.dtype.kind not in "iu" or (labels < UNASSIGNED).any():
            raise DataError(f"a coarse layer needs a whole number from -1 for each frame, got {labels.dtype}")
        if not k or sorted(set(labels.tolist()) - {UNASSIGNED}) != list(range(k)):
            raise DataError(f"a coarse layer of {k} representatives needs frames in each node, 0 ... {k - 1}")
        if self.positions.shape != (k, 2) or self.names.shape != (k,) or self.edges.shape != (len(self.edges), 2):
            raise DataError(
                f"{k} nodes need positions ({k}, 2), names ({k},) and edges (e, 2), got {self.positions.shape}, "
                f"{self.names.shape} and {self.edges.shape}"
            )
        if self.edges.size and not 0 <= self.edges.min() <= self.edges.max() < k:
            raise DataError(f"the edges of a coarse layer lie between its nodes, 0 to {k - 1}")
        if self.classifier is not None and (
            self.classifier.names.tolist() != np.asarray(self.names).tolist()
            or self.classifier.weight.shape[1] != self.representatives.shape[1]
        ):
            raise DataError("the classifier of a coarse layer has a class for each node, and reads its descriptors")
        for name in _ARRAYS:
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.representatives)

    @classmethod
    def of_labels(
        cls, known: VisualMap, labels: ArrayLike, names: ArrayLike | None = None, made: Mapping[str, Any] | None = None
    ) -> CoarseLayer:
        """Build a layer from labels of a map's frames.

        Two nodes are connected if consecutive frames of a sequence lie in them.

        Args:
            known: a map of n frames.
            labels: (n,) node of each frame, 0 ... k - 1, or UNASSIGNED.
            names: (k,) names of the nodes; their numbers if None.
            made: how the layer was built.

        Raises:
            AnalyticError: not one label for each frame, or no frame in a node.
            DataError: a node without frames.
        """
        from analytic.clustering import positions, representatives

        labels = np.asarray(labels, dtype=np.int64)
        means = representatives(known.learned, labels).astype(np.float32)
        return cls(
            labels=labels,
            representatives=means,
            positions=positions(known.frames.xy, labels),
            names=np.array([str(node) for node in range(len(means))] if names is None else names, dtype=np.str_),
            edges=connections(labels, known.frames.sequence),
            made=dict(made or {}),
        )

    @classmethod
    def of_rooms(cls, known: VisualMap) -> CoarseLayer:
        """Build a layer with a node for each room; frames without a room label are in no node.

        If the map's network was trained to name all of these rooms, the layer has its classifier.

        Raises:
            DataError: no frame has a room label.
        """
        places = np.where(known.frames.room != "", known.frames.place, "")
        names = sorted(set(places.tolist()) - {""})
        if not names:
            raise DataError("no map frame has a room label: rooms cannot be the coarse layer of this map")
        layer = cls.of_labels(known, numbered(places, names), names, {"name": "rooms"})
        return replace(layer, classifier=naming(known, layer))

    @typed
    def save(self, path: str | Path) -> None:
        """Write the layer to an npz file, atomically.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        header = {"format": _FORMAT, "version": _VERSION, "nodes": len(self), "made": self.made}
        classes = () if self.classifier is None else (self.classifier.weight, self.classifier.bias)
        arrays = {name: getattr(self, name) for name in _ARRAYS} | dict(zip(_CLASSES, classes, strict=False))
        write_arrays(path, header, arrays)

    @classmethod
    @typed
    def load(cls, path: str | Path) -> CoarseLayer:
        """Read a layer that `save` wrote.

        Raises:
            FormatError: the file is missing, truncated, not a coarse layer, or of another version.
        """
        header, held = read_headed(
            path, _FORMAT, _VERSION, "build the layer with `siamloc map build=...`", "siamloc-coarse-layer"
        )
        try:
            classes = [held[name] for name in _CLASSES if name in held]
            classifier = RoomClassifier(held["names"], *classes) if classes else None
            arrays = {name: held[name] for name in _ARRAYS}
            return cls(**arrays, made=header.get("made", {}), classifier=classifier)
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{path} is not a whole coarse layer ({error}): build it again") from error


_ARRAYS = ("labels", "representatives", "positions", "names", "edges")
_CLASSES = ("class_weight", "class_bias")


def naming(known: VisualMap, layer: CoarseLayer) -> RoomClassifier | None:
    """Return the map's room classifier, limited to the nodes of a layer; None unless it knows all of their names."""
    rooms = getattr(known.describes, "rooms", None)
    if not isinstance(rooms, RoomClassifier) or not set(layer.names.tolist()) <= set(rooms.names.tolist()):
        return None
    return rooms.of(layer.names.tolist())


def numbered(places: NDArray[Any], names: Sequence[Any]) -> NDArray[np.int64]:
    """Return the number of each place (n,) among the names of nodes; UNASSIGNED for a place that is no node."""
    number = {name: node for node, name in enumerate(names)}
    return np.array([number.get(place, UNASSIGNED) for place in places.tolist()], dtype=np.int64)
