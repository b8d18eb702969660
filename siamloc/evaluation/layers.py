"""Quality of a coarse layer: compactness, rooms, loop closures and cost ([C] 3, [I] 5, [T] 4.4)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import analytic
from foundation.calls import OF_FIELDS, takes
from foundation.settings import Count, NotNegative, Settings
from siamloc.data.frames import room_names
from siamloc.evaluation.offsets import overlapping_buildings
from siamloc.evaluation.result import Result
from siamloc.maps import Built
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns


@dataclass(frozen=True)
class MapMeasures(Settings):
    """Settings for loop closures.

    Attributes:
        closure_radius: a loop closure is correct if its frames lie within this radius, in the unit of the positions.
        closure_gap: number of frames that a loop closure has to span.
    """

    WHERE = "task"

    closure_radius: NotNegative = 1.0
    closure_gap: Count = 30


@takes(MapMeasures)
def mapping(
    known: VisualMap,
    built: Built,
    *,
    name: str | None = None,
    settings: MapMeasures = OF_FIELDS,
    **fields: Any,
) -> Result:
    """Measure the nodes of a map: compactness, agreement with the rooms, loop closures and cost.

    Measures that need positions are left out if there are none.

    Args:
        known: the map, its frames in capture order.
        built: nodes over its frames, from `siamloc.maps.group`.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        settings: all settings in one object, instead of one keyword each.

    Raises:
        DataError: nodes over another map.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> mapping(known, siamloc.maps.group(known, "rooms")).measures["purity"]["overall"]
        1.0
    """
    built.check_map(known)
    layer, frames, seconds = built.layer, known.frames, built.seconds
    columns: Columns = {
        "frame": np.arange(len(known)),
        "path": frames.path,
        "sequence": frames.sequence,
        "room": room_names(frames)[0],
        "x": frames.x,
        "y": frames.y,
        "node": layer.labels,
        "closes_with": closures(known, layer.labels, settings.closure_gap),
        "seconds": np.full(len(known), seconds[0] / len(known)) if len(seconds) == 1 else seconds,
    }
    if built.reasons:
        columns["reason"] = np.array(built.reasons)
    measures = {
        **mapping_measures(columns, settings.closure_radius, settings.closure_gap),
        "unit": known.unit,
        "descriptor_silhouette": math.nan if known.aligned else silhouette(known.learned, layer.labels),
        "bytes": {"representatives": layer.representatives.nbytes, "descriptors": known.descriptors.nbytes},
    }
    data = known.made.get("data", {})
    skipped = {"buildings": text} if (text := overlapping_buildings(frames)) else {}
    if unplaced := int((~frames.has_position).sum()):
        skipped["positions"] = (
            f"{unplaced} of {len(known)} map frames have no position: loop closures cannot be judged, and silhouettes, "
            "inertia and the plan are without these frames"
        )
    return Result(
        name=name or known.descriptor.name,
        parts={"mapping": measures},
        tables={"frames": columns, "nodes": _nodes(layer, columns)},
        denominators={"frames": len(known), "nodes": len(layer)},
        about={
            "data": {"map": {**data, "sequences": list(frames.rows_by("sequence"))}},
            "descriptor": known.descriptor.identity,
            "layer": layer.made,
            "edges": layer.edges,
        },
        skipped=skipped,
        settings={
            "task": settings.plain(),
            "data": data,
            **({"protocol": {"map": known.made["role"]}} if "role" in known.made else {}),
        },
    )


def mapping_measures(columns: Mapping[str, NDArray], radius: float, gap: int) -> dict[str, Any]:
    """Return the measures of a coarse layer that can be computed from the columns of `frames.csv`.

    Args:
        columns: columns of `frames.csv`.
        radius: largest distance between two frames that rightly close a loop, in the unit of the positions.
        gap: least number of frames between the two frames of a loop.

    Returns:
        frames, nodes, unassigned (frames in no node, and their share); `silhouette` of the capture points, "nearest"
        ([C] 8-11), "with_unassigned" (the same, with the frames in no node as one more node), "by_node" (that, averaged
        over nodes instead of frames) and "pooled" ([I] 12-13), NaN with fewer than two nodes; `inertia` ([C] 7);
        silhouette and inertia are computed over the frames that have a position, NaN if there are none; `purity` per
        room and overall, with the number of frames; `closures` with precision, recall, F1 and their denominators, NaN
        unless all frames have a position; `ms_per_frame` as mean, median and p95; `reasons` with their counts, if any.
    """
    labels = np.asarray(columns["node"])
    xy = np.column_stack([columns["x"], columns["y"]])
    placed = np.isfinite(xy).all(axis=1)
    pure, inertias = analytic.measures.purity(labels, columns["room"]), _inertias(xy, labels)
    pairs = np.column_stack([columns["frame"], columns["closes_with"]])[columns["closes_with"] >= 0]
    whole = bool(placed.all())
    closed = asdict(analytic.measures.closure_scores(pairs, xy if whole else np.zeros_like(xy), radius, gap))
    if not whole:
        closed |= dict.fromkeys(("precision", "recall", "f1", "right", "closed", "revisits"), math.nan)
    ms = 1000 * np.asarray(columns["seconds"], dtype=np.float64)
    unassigned = int((labels < 0).sum())
    found = {
        "frames": len(labels),
        "nodes": len(set(labels[labels >= 0].tolist())),
        "unassigned": {"frames": unassigned, "share": unassigned / len(labels)},
        "silhouette": {
            "nearest": silhouette(xy[placed], labels[placed]),
            "with_unassigned": silhouette(xy[placed], labels[placed], unassigned="cluster"),
            "by_node": silhouette(xy[placed], labels[placed], unassigned="cluster", over="nodes"),
            "pooled": silhouette(xy[placed], labels[placed], "pooled"),
        },
        "inertia": float(np.nansum(inertias)) if np.isfinite(inertias).any() else math.nan,
        "purity": {
            "overall": pure.overall,
            "room": {room: {"purity": pure.rooms[room], "frames": pure.frames_per_room[room]} for room in pure.rooms},
            "frames": pure.counted,
        },
        "closures": closed,
        "ms_per_frame": {
            "mean": float(np.nanmean(ms)),
            "median": float(np.nanmedian(ms)),
            "p95": float(np.nanpercentile(ms, 95)),
        },
    }
    if "reason" in columns:
        names, counts = np.unique(columns["reason"], return_counts=True)
        found["reasons"] = dict(zip(names.tolist(), counts.tolist(), strict=True))
    return found


def closures(known: VisualMap, labels: NDArray[np.int64], gap: int) -> NDArray[np.int64]:
    """Return the frame with which each frame closes a loop (n,), -1 for none.

    A frame closes a loop with the most similar frame of its node that is at least `gap` frames earlier.

    Args:
        known: a map of n frames in capture order.
        labels: (n,) node of each frame, -1 for none.
        gap: least number of frames between the two frames of a loop.
    """
    found = np.full(len(known), -1, dtype=np.int64)
    for node in range(int(labels.max()) + 1):
        members = np.flatnonzero(labels == node)
        part = known.description.take(members)
        apart = known.descriptor.pairwise(part, part, known.distance)
        early = members[None, :] <= members[:, None] - gap
        apart = np.where(early, apart, np.inf)
        closing = early.any(axis=1)
        found[members[closing]] = members[apart[closing].argmin(axis=1)]
    return found


def silhouette(
    values: NDArray,
    labels: NDArray[np.int64],
    mode: Literal["nearest", "pooled"] = "nearest",
    unassigned: Literal["left_out", "cluster"] = "left_out",
    over: Literal["nodes"] | None = None,
) -> float:
    """Return the average silhouette, in [-1, 1], of nodes in positions or descriptors (n, D); NaN below two nodes.

    Args:
        values: positions or descriptors of the frames (n, D).
        labels: (n,) node of each frame, -1 for none.
        mode: "nearest" or "pooled", see `analytic.measures.silhouettes`.
        unassigned: "left_out" leaves out frames without a node; "cluster" makes them one more cluster.
        over: "nodes" averages over nodes; by default the mode decides: over frames for "nearest".
    """
    if len(set(labels[labels >= 0].tolist())) < 2:
        return math.nan
    found = analytic.measures.silhouettes(values, labels, mode, unassigned=unassigned)
    return float(found.clusters.mean()) if over == "nodes" else found.mean


def _nodes(layer: CoarseLayer, columns: Columns) -> Columns:
    xy = np.column_stack([columns["x"], columns["y"]])
    pure = analytic.measures.purity(layer.labels, columns["room"])
    rooms = dict(zip(pure.labels.tolist(), pure.room_of_node, strict=True))
    shares = dict(zip(pure.labels.tolist(), pure.nodes.tolist(), strict=True))
    numbers = range(len(layer))
    return {
        "node": np.arange(len(layer)),
        "name": layer.names,
        "frames": np.bincount(layer.labels[layer.labels >= 0], minlength=len(layer)),
        "x": layer.positions[:, 0],
        "y": layer.positions[:, 1],
        "room": np.array([rooms.get(node, "") for node in numbers], dtype=np.str_),
        "purity": np.array([shares.get(node, math.nan) for node in numbers]),
        "inertia": _inertias(xy, layer.labels),
    }


def _inertias(xy: NDArray[np.float64], labels: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the moment of inertia of each node (k,), from its frames with a position; NaN if there are none."""
    used = np.isfinite(xy).all(axis=1) & (labels >= 0)
    found = np.full(int(labels.max(initial=-1)) + 1, math.nan)
    if used.any():
        found[np.unique(labels[used])] = analytic.measures.moments_of_inertia(xy[used], labels[used])
    return found
