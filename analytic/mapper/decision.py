"""The decisions of the mapper, and their log.

The log has one line of JSON for each frame, from which a run can be replayed and explained.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from analytic.arrays import Integers
from analytic.errors import AnalyticError

NONE = -1  # the label of a frame without a node
FORMAT = "analytic.mapper.log"
VERSION = 1


class Reason(str, Enum):
    """Why a frame belongs where it does, or why the map changed."""

    FIRST_FRAMES = "the map has no node yet"
    ASSIGNED = "it closes a loop with a node"
    NO_CANDIDATE_NODE = "it is unlike every node"
    NOT_PROMINENT = "the most similar image does not stand out"
    MOVES_CENTROID = "it would move the node's centre more than any of its frames"
    NEW_NODE = "frames without a node, or that changed node too often, form one"
    JOINED_PARKED = "it is like a candidate that waits to become a node"
    NODE_PARKED = "frames without a node are too similar to the map to form a node, and wait"
    PARKED_FORGOTTEN = "too many candidates wait, and this is the oldest"
    NODES_MERGED = "two nodes are too alike"
    REASSIGNED = "it is more similar to another node"
    MAINTAINED = "it shows another appearance of a known node"
    FORGOTTEN = "its place does not look so any more"


@dataclass(frozen=True)
class Change:
    """A change of the map apart from the frame that was added.

    Attributes:
        reason: NEW_NODE, NODE_PARKED, PARKED_FORGOTTEN, NODES_MERGED, REASSIGNED, MAINTAINED or FORGOTTEN.
        node: the node that was created, parked, forgotten or kept, or that frames moved to; None if frames lost it.
        frames: numbers of the frames that the change affects.
        scores: measured numbers and the limit, by name.
    """

    reason: Reason
    node: int | None
    frames: tuple[int, ...]
    scores: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Decision:
    """The node of one frame, and why the frame belongs there.

    Attributes:
        node: the node of the frame, or None.
        reason: why the frame belongs there.
        scores: measured numbers and limits, by name.
        frame: number of the frame in the map, from 0.
        changes: further changes of the map, in order.
    """

    node: int | None
    reason: Reason
    scores: dict[str, Any]
    frame: int
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True)
class Location:
    """Where a query is in the map, as `locate` returns it.

    Attributes:
        node: id of the node, the coarse answer.
        frame: number of the most similar frame in that node.
        pose: the pose that was added with that frame.
        heading: how far the robot has turned left since that frame, rad in (-pi, pi]; None without orientation.
        closes: whether the node passed the node-level condition; otherwise it is the closest node.
        scores: measured numbers and limits, by name.
    """

    node: int
    frame: int
    pose: Any
    heading: float | None
    closes: bool
    scores: dict[str, Any]


def header(rules: Mapping[str, Any], identity: Mapping[str, Any]) -> str:
    """Return the first line of a log, with version, parameters and descriptor."""
    return json.dumps({"format": FORMAT, "version": VERSION, "parameters": rules, "descriptor": identity}, default=str)


def line_of(decision: Decision, poses: list[Any]) -> str:
    """Return the line of a decision in a log, with numbers rounded to six digits.

    Args:
        decision: on one frame, or on several that were added at once; then its `frame` is the last.
        poses: the identifiers or poses with which the frames were added, one for each frame.
    """
    event = {
        "frames": list(range(decision.frame - len(poses) + 1, decision.frame + 1)),
        "poses": poses,
        "node": decision.node,
        "reason": decision.reason.name,
        "scores": _short(decision.scores),
        "changes": [_short(vars(change) | {"reason": change.reason.name}) for change in decision.changes],
    }
    return json.dumps(event, separators=(",", ":"))


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    return [_short(item) for item in value] if isinstance(value, list) else value


def replay(events: Iterable[str | Mapping[str, Any]]) -> Integers:
    """Rebuild the node of each frame (n,), -1 for none, from the lines of a log.

    Args:
        events: lines of JSON, or their contents; a header may come first, and empty lines are skipped.

    Raises:
        AnalyticError: a line that is not an event, frames out of order, or a log of another version.

    Examples:
        >>> line = '{"frames": [0], "poses": [null], "node": 3, "reason": "ASSIGNED", "scores": {}, "changes": []}'
        >>> replay([line]).tolist()
        [3]
    """
    labels: list[int] = []
    for number, line in enumerate(events, start=1):
        if line in ("", "\n"):
            continue
        try:
            _apply(labels, json.loads(line) if isinstance(line, str) else line)
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
            raise AnalyticError(
                f"event {number} of the log is not a line that a mapper wrote ({error!r}): give a log of this version, "
                "whole and in order"
            ) from error
    return np.array(labels, dtype=np.int64)


def _apply(labels: list[int], event: Mapping[str, Any]) -> None:
    """Add the frames of an event to the labels of those before it, and make its changes; check a header."""
    if "format" in event:
        if (event["format"], event.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"{event['format']} in version {event.get('version')}, not {FORMAT} in version {VERSION}")
        return
    frames = [int(frame) for frame in event["frames"]]
    if frames != list(range(len(labels), len(labels) + len(frames))):
        raise ValueError(f"it is about frames {frames}, but {len(labels)} came before it")
    labels += [NONE if event["node"] is None else int(event["node"])] * len(frames)
    for change in event["changes"]:
        reason = Reason[change["reason"]]
        if reason is Reason.NODES_MERGED:
            gone = change["scores"]["gone"]
            labels[:] = [change["node"] if label == gone else label for label in labels]
        elif reason in (Reason.NEW_NODE, Reason.REASSIGNED, Reason.MAINTAINED, Reason.FORGOTTEN):
            for frame in change["frames"]:
                labels[frame] = NONE if reason is Reason.FORGOTTEN else change["node"]
