"""Room retrieval: whether a pair is from the same room ([T] 5.3.4), and in which room a query is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable, room_names
from siamloc.evaluation.columns import confusions, map_columns, query_columns, right_share
from siamloc.evaluation.metrics import pair_accuracy, pair_dissimilarity, pair_threshold_curve
from siamloc.evaluation.result import Result
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap
from siamloc.results import Columns, by_label

TOP = (1, 5, 10)  # numbers of retrieved frames among which the right room must be


def pair_measures(columns: Mapping[str, NDArray], margin: float, threshold: float) -> dict[str, Any]:
    """Return all measures of judged pairs, from the columns of `pairs.csv`.

    Returns:
        margin, threshold, and the groups "overall" and "lighting" (by label): `metrics.PairAccuracy` as dictionaries,
        with the `auc`. Then the `auc` of all pairs, and `curve`: a dictionary of threshold, same, different and overall
        for each threshold. Each group by lighting has its own `curve`.
    """

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        distance, same = columns["distance"][rows], columns["same"][rows]
        curve = pair_threshold_curve(distance, same, margin)
        parts = np.column_stack([curve.thresholds, curve.same, curve.different, curve.overall]).tolist()
        points = [dict(zip(("threshold", "same", "different", "overall"), part, strict=True)) for part in parts]
        return {**asdict(pair_accuracy(distance, same, margin, threshold)), "auc": curve.auc, "curve": points}

    groups = by_label(columns, group, "lighting")
    curve = groups["overall"].pop("curve")
    return {"margin": margin, "threshold": threshold, **groups, "auc": groups["overall"]["auc"], "curve": curve}


def room_measures(columns: Mapping[str, NDArray], labels: Sequence[str], missing: Sequence[str]) -> dict[str, Any]:
    """Return all measures of room retrieval, from the columns of `rooms.csv`.

    Args:
        columns: room, predicted_room, correct, lighting, first_rank and chance of each query.
        labels: rooms of the map and of the queries, in the order of the confusion matrix.
        missing: rooms of queries that the map lacks, so these queries cannot be right.

    Returns:
        The groups "overall", "room" (by label) and "lighting" (by label), each with `accuracy`, `correct`, `queries`,
        `top` (the share of queries with a frame of their room among the k nearest, by k), `mean_average_precision` (of
        the `siamloc.results.DEPTH` nearest frames) and `chance` (the accuracy of a map frame drawn at random);
        `confusion` with the `labels`, the `counts` of all queries (row = true room, column = room of the match) and
        those by `lighting`; and `rooms_missing_in_map`.
    """

    def group(rows: NDArray) -> dict[str, Any]:
        rank = columns["first_rank"][rows]
        return {
            **right_share(columns, rows),
            "top": {str(k): float(((rank > 0) & (rank <= k)).mean()) for k in TOP},
            "mean_average_precision": float(columns["average_precision"][rows].mean()),
            "chance": float(columns["chance"][rows].mean()),
        }

    return {
        **by_label(columns, group, "room", "lighting"),
        "confusion": {"labels": list(labels), **confusions(columns, "room", labels)},
        "rooms_missing_in_map": list(missing),
    }


def evaluate_pairs(
    first: ArrayLike,
    second: ArrayLike,
    same: ArrayLike,
    margin: float = 2.0,
    threshold: float = 0.5,
    lighting: ArrayLike | None = None,
    labels: Mapping[str, ArrayLike] | None = None,
) -> Result:
    """Judge pairs of descriptors by their Euclidean distance.

    Args:
        first: descriptors (n, D), n at least 1.
        second: descriptors (n, D).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        threshold: dissimilarity min(distance / margin, 1) below which a pair is judged to be from one room; in (0, 1].
        lighting: lighting of each pair (n,), for measures by lighting.
        labels: more columns for `pairs.csv`, such as the two paths and rooms.

    Raises:
        ConfigError: a margin or threshold out of range.
        DataError: arrays that do not match each other, or descriptors that are not finite.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    distance, truth = np.sqrt(np.square(a - b).sum(axis=1)), np.asarray(same)
    dissimilarity = pair_dissimilarity(distance, margin)
    columns: Columns = {
        "pair": np.arange(len(a)),
        "lighting": np.full(len(a), "", dtype=np.str_) if lighting is None else np.asarray(lighting, dtype=np.str_),
        "same": truth,
        "distance": distance,
        "dissimilarity": dissimilarity,
        "predicted_same": dissimilarity < threshold,
        "correct": (dissimilarity < threshold) == truth,
        **{name: np.asarray(values) for name, values in (labels or {}).items()},
    }
    return Result(
        name="room_pairs",
        parts={"room_pairs": pair_measures(columns, float(margin), float(threshold))},
        tables={"pairs": columns},
        denominators={"pairs": len(a)},
    )


def evaluate_rooms(
    visual_map: VisualMap, frames: FrameTable, found: Retrieval, excluded: NDArray[np.bool_] | None = None
) -> Result:
    """Predict that each query is in the room of the map frame that looks most like it.

    That frame counts as the first retrieved frame.

    Args:
        visual_map: a map of m frames, all with room labels.
        frames: the queries (n), all with room labels, n at least 1. Rooms of different buildings are different rooms.
        found: the nearest map frames of each query, `siamloc.results.DEPTH` or fewer: then top-k and average precision
            use only these.
        excluded: (n, m) map frames that a query was not compared with.
    """
    order = (found.indices != found.most_alike[:, None]).argsort(axis=1, kind="stable")
    found = Retrieval(np.take_along_axis(found.indices, order, 1), np.take_along_axis(found.distances, order, 1))
    match = found.indices[:, 0]
    room, known = room_names(frames, visual_map.frames)
    predicted = known[match]
    columns: Columns = {
        **query_columns(frames, room),
        "predicted_room": predicted,
        "correct": room == predicted,
        **_ranking(room, known, found, excluded),
        "match": match,
        "match_path": visual_map.frames.path[match],
        "descriptor_distance": found.distances[:, 0],
    }
    rooms, in_map = set(room.tolist()), set(known.tolist())
    labels, missing = tuple(sorted(rooms | in_map)), tuple(sorted(rooms - in_map))
    return Result(
        name="room_retrieval",
        parts={"room_retrieval": room_measures(columns, labels, missing)},
        tables={"rooms": columns, "map": map_columns(visual_map.frames, frames)},
        denominators={"queries": len(frames)},
    )


def _ranking(
    room: NDArray[np.str_], known: NDArray[np.str_], found: Retrieval, excluded: NDArray[np.bool_] | None
) -> Columns:
    """Return the columns that depend on the rooms of all frames retrieved for a query.

    Average precision of the k retrieved frames: the sum, over frames of the right room, of the share of that room among
    the frames up to each of them, divided by k or by the number of frames of that room in the map, whichever is
    smaller.
    """
    right = known[found.indices] == room[:, None]
    precision = np.cumsum(right, axis=1) / np.arange(1, right.shape[1] + 1)
    of_room = known[None, :] == room[:, None]
    allowed = np.ones_like(of_room) if excluded is None else ~excluded
    findable = (of_room & allowed).sum(axis=1)
    return {
        "first_rank": np.where(right.any(axis=1), right.argmax(axis=1) + 1, 0),
        "average_precision": (precision * right).sum(axis=1) / np.clip(findable, 1, right.shape[1]),
        "chance": findable / allowed.sum(axis=1),
    }
