"""How well the nodes of a map respect rooms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analytic.arrays import Floats, Integers
from analytic.clustering import checks
from analytic.errors import AnalyticError


@dataclass(frozen=True)
class Purity:
    """Shares of frames that lie in a node of their own room.

    A node belongs to the room that most of its labelled frames come from; ties go to the first room by name.

    Attributes:
        overall: share of all counted frames; NaN if there are none.
        rooms: for each room, the share of its counted frames that lie in nodes of that room.
        frames_per_room: counted frames of each room, the denominators of `rooms`.
        nodes: for each node, the share of its counted frames that come from its room; in the order of `labels`.
        labels: labels of the nodes with counted frames, ascending (k,).
        room_of_node: the room that each of these nodes belongs to.
        counted: frames with a room label and a node.
    """

    overall: float
    rooms: dict[str, float]
    frames_per_room: dict[str, int]
    nodes: Floats
    labels: Integers
    room_of_node: list[str]
    counted: int


def purity(labels: ArrayLike, rooms: ArrayLike) -> Purity:
    """Measure the share of frames that lie in a node of their own room: overall, by room and by node.

    Args:
        labels: the node of each frame, a whole number (n,); a negative one means no node.
        rooms: the room of each frame (n,); "" means unknown.

    Raises:
        AnalyticError: wrong shapes, different lengths, or rooms that are not strings.

    Examples:
        >>> found = purity([0, 0, 0, 1], ["kitchen", "kitchen", "corridor", "corridor"])
        >>> found.overall, found.rooms
        (0.75, {'corridor': 0.5, 'kitchen': 1.0})
    """
    names = np.asarray(rooms)
    if names.ndim != 1 or not all(isinstance(name, str) for name in names.tolist()):
        raise AnalyticError(f"rooms must be strings (n,), '' if unknown, got {names.dtype} of shape {names.shape}")
    texts = names.astype(np.str_)
    node = checks.cluster_labels(np.asarray(labels, dtype=np.int64) if not np.size(labels) else labels, len(texts))
    counted = (texts != "") & (node >= 0)
    present, node_rank = np.unique(node[counted], return_inverse=True)
    room_names, room_rank = np.unique(texts[counted], return_inverse=True)
    table = np.zeros((len(present), len(room_names)), dtype=np.int64)
    np.add.at(table, (node_rank.reshape(-1), room_rank.reshape(-1)), 1)
    major = table.argmax(axis=1) if table.size else np.zeros(0, dtype=np.int64)
    right = np.where(np.arange(len(room_names)) == major[:, None], table, 0)
    per_room = table.sum(axis=0)
    total = int(table.sum())
    return Purity(
        overall=float(right.sum() / total) if total else math.nan,
        rooms={str(room): float(right[:, i].sum() / per_room[i]) for i, room in enumerate(room_names)},
        frames_per_room={str(room): int(per_room[i]) for i, room in enumerate(room_names)},
        nodes=right.sum(axis=1) / table.sum(axis=1),
        labels=present,
        room_of_node=[str(room_names[i]) for i in major],
        counted=total,
    )
