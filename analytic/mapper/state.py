"""The complete state of a map, and the distances between its nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.mapper.decision import NONE, Change, Reason
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters

Place = Sequence[NDArray[np.float64]]  # the representatives (D,) of one node, one for each mode

_ROOM = 32  # rows of the initial table
_GROWTH = 1.5


class Spacing:
    """A table of the distances between representatives of nodes, kept from one call to the next ([I] 4.5).

    The mean distance among all nodes needs every pair, but between two calls only few representatives move, and only
    their rows are computed. A representative is identified by its array, which never changes, so the table is valid for
    any state of the map, including a discarded draft and a map that was loaded. The place of a distance in the table
    has no effect on its value. A copy of a table, for a copy of a map or for another process, starts empty, since its
    arrays are different objects.
    """

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}  # from the identity of an array to its row
        self._known: list[NDArray[np.float64] | None] = []  # keeps the arrays alive, so that no identity is used twice
        self._centres = np.empty((0, 0))
        self._apart = np.empty((0, 0))

    def __reduce__(self) -> tuple[type[Spacing], tuple[()]]:
        """Make copies empty, since copied arrays have other identities."""
        return Spacing, ()

    def among(self, places: Sequence[Place]) -> float:
        """Return the mean distance between places, each pair by its nearest representatives; 0 for fewer than 2."""
        if len(places) < 2:
            return 0.0
        slots = self._refreshed([centre for place in places for centre in place])
        apart = self._apart[np.ix_(slots, slots)]
        if len(slots) > len(places):
            starts = _starts(places)[:-1]
            apart = np.minimum.reduceat(np.minimum.reduceat(apart, starts, axis=0), starts, axis=1)
        return float(np.mean(apart[np.triu(np.ones(apart.shape, dtype=bool), 1)]))

    def _refreshed(self, centres: list[NDArray[np.float64]]) -> list[int]:
        """Return the rows of representatives, after computing the unknown ones."""
        wanted = {id(centre) for centre in centres}
        free = [slot for slot, known in enumerate(self._known) if known is None or id(known) not in wanted]
        for centre in centres:
            if id(centre) not in self._slots:
                self._put(free.pop() if free else self._grown(len(centre)), centre)
        return [self._slots[id(centre)] for centre in centres]

    def _put(self, slot: int, centre: NDArray[np.float64]) -> None:
        # A row counts as unknown until it is complete, since an interrupted one must not be used again.
        gone, self._known[slot] = self._known[slot], None
        self._slots.pop(id(gone), None)
        self._centres[slot] = centre
        used = len(self._known)
        self._apart[slot, :used] = self._apart[:used, slot] = distances(centre, self._centres[:used])
        self._known[slot] = centre
        self._slots[id(centre)] = slot

    def _grown(self, size: int) -> int:
        """Add a row and return its index."""
        slot, room = len(self._known), len(self._apart)
        if slot == room:
            room = max(_ROOM, int(_GROWTH * room))
            centres, apart = np.zeros((room, size)), np.zeros((room, room))
            if slot:
                centres[:slot], apart[:slot, :slot] = self._centres, self._apart
            self._centres, self._apart = centres, apart
        self._known.append(None)
        return slot


@dataclass
class State:
    """A map between two frames. A frame is added to a copy, which replaces the map if everything succeeds.

    Attributes:
        rules: the parameters of the map.
        nodes: by id. Their order has no meaning.
        parked: candidates of version 1, the oldest first.
        labels: (n,) node of each frame, -1 for none.
        matches: (n,) the frame that each was most similar to when it was added, -1 for none.
        recent: the last frames and their descriptions.
        pending: the consecutive frames without a node up to the last one.
        next_id: id of the next node.
        changes: changes made while a frame was added.
        calls: number of successful calls of `add` and `maintain`.
        spacing: known distances between nodes, shared by all copies; a cache that affects no result.
    """

    rules: Parameters
    nodes: dict[int, Node] = field(default_factory=dict)
    parked: tuple[Node, ...] = ()
    labels: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    matches: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    recent: tuple[tuple[int, Description], ...] = ()
    pending: tuple[int, ...] = ()
    next_id: int = 0
    changes: tuple[Change, ...] = ()
    calls: int = 0
    spacing: Spacing = field(default_factory=Spacing, repr=False, compare=False)

    def copy(self) -> State:
        """Return a working copy; nodes and descriptions are immutable and shared."""
        return replace(self, nodes=dict(self.nodes), labels=self.labels.copy(), changes=())

    def ordered(self) -> list[Node]:
        """Return the nodes from the oldest id to the newest."""
        return [self.nodes[key] for key in sorted(self.nodes)]

    def append(self, description: Description, label: int, match: int) -> int:
        """Add a frame and return its number."""
        frame = len(self.labels)
        self.labels = np.append(self.labels, label)
        self.matches = np.append(self.matches, match)
        self.recent = (*self.recent, (frame, description))[-self.rules.memory :]
        return frame

    def descriptions(self, frames: Sequence[int]) -> list[Description]:
        """Return the descriptions of recent frames."""
        known = dict(self.recent)
        return [known[frame] for frame in frames]

    def representatives(self, without: int | None = None) -> list[list[NDArray[np.float64]]]:
        """Return the mean descriptors (D,) of the modes of each node, the oldest node first."""
        return [[mode.centre for mode in node.modes] for node in self.ordered() if node.id != without]

    def form(self, frames: Sequence[int]) -> Node:
        """Return a node of recent frames, with the next id, that is not yet part of the map."""
        node = Node(self.next_id, (Mode.of(self.rules, frames, self.descriptions(frames)),))
        self.next_id += 1
        return node

    def adopt(self, node: Node) -> None:
        """Make a node part of the map."""
        self.nodes[node.id] = node
        self.labels[node.frames] = node.id

    def leave(self, frames: Sequence[int]) -> list[int]:
        """Take frames from their nodes and return them.

        A frame stays if its node would be left with too few frames or, where exemplars are bounded, with none to
        compare images with.
        """
        left = []
        for label in np.unique(self.labels[list(frames)]).tolist():
            leaving = [frame for frame in frames if self.labels[frame] == label]
            if label != NONE:
                node = self.nodes[label]
                if len(node) - len(leaving) < self.rules.smallest_node:
                    continue
                kept = node.remove(leaving)
                if not all(len(mode.gallery) for mode in kept.modes):
                    continue
                self.nodes[label] = kept
                self.labels[leaving] = NONE
            left += leaving
        return sorted(left)

    def note(self, reason: Reason, node: int | None, frames: Sequence[int], **scores: float | bool | str) -> None:
        """Record a change for the decision and the log."""
        self.changes = (*self.changes, Change(reason, node, tuple(int(frame) for frame in frames), scores))


def mean_distance(point: NDArray[np.float64], places: Sequence[Place]) -> float:
    """Return the mean Euclidean distance of a point (D,) to places, each the nearest of its representatives."""
    apart = distances(point, np.array([centre for place in places for centre in place]))
    return float(np.mean(np.minimum.reduceat(apart, _starts(places)[:-1])))


def distances(point: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Euclidean distances (n,) of a point (D,) to others (n, D)."""
    # One by one, so that a value does not depend on which others there are.
    return np.sqrt([away.dot(away) for away in others - point])


def _starts(places: Sequence[Place]) -> NDArray[np.int64]:
    return np.cumsum([0, *(len(place) for place in places)])
