"""The complete state of a map between two frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.mapper.decision import NONE, Change, Reason
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters


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

    def form(self, frames: Sequence[int]) -> Node:
        """Return a node of recent frames, with the next id, that is not yet part of the map."""
        node = Node(self.next_id, (Mode.of(self.rules, frames, self.descriptions(frames)),))
        self.next_id += 1
        return node

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
