"""Nodes follow their map: `followed` lets frames leave the nodes of a coarse layer, and join them."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analytic.mapper import IncrementalMapper
from siamloc.data.frames import FrameTable
from siamloc.maps.buildings import nearest
from siamloc.maps.coarse import UNASSIGNED, CoarseLayer
from siamloc.maps.grouping import Built
from siamloc.maps.visual_map import VisualMap


def numbers_of(layer: CoarseLayer) -> NDArray[np.int64]:
    """Return the number in the mapper of each frame of an incremental map (m,)."""
    return np.asarray(layer.made.get("frames", range(len(layer.labels))), dtype=np.int64)


def nodes_of(layer: CoarseLayer, known: FrameTable, drive: FrameTable) -> NDArray[np.int64]:
    """Return for each frame of a drive (n,) the node of the nearest map frame; map frames in no node do not count.

    Args:
        layer: nodes over the m frames of a map.
        known: these frames, with positions.
        drive: n frames with positions.
    """
    rows = np.flatnonzero(layer.labels >= 0)
    return layer.labels[rows[nearest(known.take(rows), drive)]]


def left_by(built: Built, leaving: NDArray[np.int64]) -> tuple[IncrementalMapper, NDArray[np.int64]]:
    """Let frames leave the nodes of an incremental map.

    Args:
        built: the nodes, with their mapper, which is not changed.
        leaving: rows of the map (k,).

    Returns:
        A copy of the mapper without the frames, and the rows that could leave: a node keeps `smallest_node` frames.
    """
    mapper = deepcopy(built.mapper)
    assert mapper is not None
    numbers = numbers_of(built.layer)
    gone = mapper.forget(numbers[leaving].tolist())
    return mapper, leaving[np.isin(numbers[leaving], gone)]


def followed(
    built: Built,
    known: VisualMap,
    kept: NDArray[np.int64],
    node: NDArray[np.int64],
    mapper: IncrementalMapper | None = None,
) -> Built:
    """Return the nodes over an updated map: without frames that left it, and with frames that joined.

    A node without frames vanishes. Frames that join a node of an incremental map become another mode of it.

    Args:
        built: the nodes over the map before.
        known: the updated map: the kept frames, followed by those that joined.
        kept: rows of the map before (k,) that the updated map begins with.
        node: (n,) node of each frame that joined.
        mapper: the incremental map, already without the frames that left; it is extended.
    """
    before = built.layer
    labels = np.concatenate([before.labels[kept], node])
    nodes = np.unique(labels[labels >= 0])
    number = np.full(len(before) + 1, UNASSIGNED)
    number[nodes] = np.arange(len(nodes))
    made = dict(before.made)
    if mapper is not None:
        numbers = np.concatenate([numbers_of(before)[kept], _taught(mapper, before, known, node)]).tolist()
        if numbers != list(range(len(known))):
            made["frames"] = numbers
        made["ids"] = [made["ids"][one] for one in nodes.tolist()]
    names = before.names[nodes]
    layer = CoarseLayer.of_labels(known, number[labels], names, made)
    edges = number[before.edges]
    layer = replace(
        layer,
        edges=edges[(edges >= 0).all(axis=1)],
        classifier=None if before.classifier is None else before.classifier.of(names.tolist()),
    )
    one_by_one = len(built.seconds) == len(before.labels)
    return replace(
        built,
        layer=layer,
        seconds=np.append(built.seconds[kept], np.full(len(node), np.nan)) if one_by_one else built.seconds,
        map_digest=known.digest,
        reasons=(*(built.reasons[row] for row in kept.tolist()), *["MAINTAINED"] * len(node)) if built.reasons else (),
        mapper=mapper,
    )


def _taught(
    mapper: IncrementalMapper, layer: CoarseLayer, known: VisualMap, node: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Teach a mapper the last frames of a map as further modes of their nodes; return the frames' numbers in it."""
    numbers, first = np.zeros(len(node), dtype=np.int64), len(known) - len(node)
    for one in np.unique(node).tolist():
        rows = np.flatnonzero(node == one)
        part = known.take(first + rows)
        poses = np.column_stack([part.frames.xy, part.frames.theta])
        frames = [pose.tolist() if np.isfinite(pose).all() else None for pose in poses]
        numbers[rows] = len(mapper) + np.arange(len(rows))
        mapper.maintain(layer.made["ids"][one], part.description, frames)
    return numbers
