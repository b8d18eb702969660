"""What the mapper answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class Reason(str, Enum):
    """Why a frame belongs where it does, or why the map changed."""

    FIRST_FRAMES = "the map has no node yet"
    ASSIGNED = "it closes a loop with a node"
    NO_CANDIDATE_NODE = "it is unlike every node"
    NOT_PROMINENT = "the most similar image does not stand out"
    MOVES_CENTROID = "it would move the node's centre more than any of its frames"
    NEW_NODE = "frames without a node, or that changed node too often, form one"
    JOINED_PARKED = "it is like a candidate that waits to become a node"
    NODE_PARKED = "frames without a node are too like the map to form a node, and wait"
    PARKED_FORGOTTEN = "too many candidates wait, and this is the oldest"
    NODES_MERGED = "two nodes are too alike"
    REASSIGNED = "it is more similar to another node"
    MAINTAINED = "it shows another appearance of a known node"


@dataclass(frozen=True)
class Change:
    """A change of the map beyond the frame that was added.

    Attributes:
        reason: NEW_NODE, NODE_PARKED, PARKED_FORGOTTEN, NODES_MERGED or REASSIGNED.
        node: what was created, parked, forgotten or kept, or where frames went; None if they lost their node.
        frames: those concerned.
        scores: what was measured, against which limit.
    """

    reason: Reason
    node: int | None
    frames: tuple[int, ...]
    scores: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Decision:
    """What became of one frame.

    Attributes:
        node: its node, or None.
        reason: why.
        scores: what was measured, against which limits: plain numbers, by name.
        frame: its number in the map, from 0.
        changes: what else changed, in order.
    """

    node: int | None
    reason: Reason
    scores: dict[str, Any]
    frame: int
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True)
class Location:
    """Where a query is in the map.

    Attributes:
        node: the coarse answer.
        frame: the most similar frame in that node.
        pose: what was given with that frame.
        heading: how far the robot has turned left since that frame, rad in (-pi, pi]; None without orientation.
        closes: whether the node passed the node-level condition; otherwise it is merely the least unlike.
        scores: as of a decision.
    """

    node: int
    frame: int
    pose: Any
    heading: float | None
    closes: bool
    scores: dict[str, Any]
