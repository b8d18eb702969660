"""Room retrieval: is a pair from one room ([T] 5.3.4), and in which room is a query."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.columns import Columns, retrieve, room_names, rows_by_label
from siamloc.evaluation.metrics import confusion_matrix, pair_accuracy, pair_dissimilarity, pair_threshold_curve
from siamloc.maps.search import Retrieval
from siamloc.maps.visual_map import VisualMap


@dataclass(frozen=True, eq=False)
class PairResult:
    """The verdict on each pair, as columns.

    Attributes:
        columns: arrays of length n by name: what `pairs.csv` holds.
        margin: what divides the distance of the descriptors.
        threshold: dissimilarities below it mean "same room".
    """

    columns: Columns
    margin: float
    threshold: float

    def __len__(self) -> int:
        return len(self.columns["same"])

    def measures(self) -> dict[str, Any]:
        """Return all measures.

        Returns:
            margin, threshold, and the groups "overall" and "lighting" (by label): `metrics.PairAccuracy` as
            dictionaries, with the `auc`. Then `auc` of all pairs, and `curve`: one dictionary of threshold, same,
            different and overall for each threshold. The groups by lighting hold a `curve` of their own.
        """

        def accuracy(rows: NDArray) -> tuple[dict[str, Any], list[dict[str, float]]]:
            distance, same = self.columns["distance"][rows], self.columns["same"][rows]
            curve = pair_threshold_curve(distance, same, self.margin)
            parts = (curve.thresholds.tolist(), curve.same.tolist(), curve.different.tolist(), curve.overall.tolist())
            points = [dict(zip(names, values, strict=True)) for values in zip(*parts, strict=True)]
            shares = asdict(pair_accuracy(distance, same, self.margin, self.threshold))
            return {**shares, "auc": curve.auc}, points

        names = ("threshold", "same", "different", "overall")
        overall, curve = accuracy(np.arange(len(self)))
        by_lighting = {label: accuracy(rows) for label, rows in rows_by_label(self.columns["lighting"]).items()}
        return {
            "margin": self.margin,
            "threshold": self.threshold,
            "overall": overall,
            "lighting": {label: {**shares, "curve": points} for label, (shares, points) in by_lighting.items()},
            "auc": overall["auc"],
            "curve": curve,
        }


@dataclass(frozen=True, eq=False)
class RoomResult:
    """The room of each query by retrieval, as columns.

    Attributes:
        columns: arrays of length n by name: query, path, lighting, room, predicted_room, correct, ...
        labels: rooms of the map and of the queries in alphabetic order: the order of the confusion matrix.
        missing: rooms that queries are in and the map lacks: none of those can be right.
    """

    columns: Columns
    labels: tuple[str, ...]
    missing: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.columns["room"])

    def measures(self) -> dict[str, Any]:
        """Return all measures.

        Returns:
            The groups "overall", "room" (by label) and "lighting" (by label), each with `accuracy`, `correct` and
            `queries`; `confusion` with the `labels`, the `counts` of all queries (row = true room, column = room of the
            match) and those by `lighting`; and `rooms_missing_in_map`.
        """
        room, predicted, correct = (self.columns[name] for name in ("room", "predicted_room", "correct"))

        def accuracy(rows: NDArray) -> dict[str, Any]:
            hits = int(correct[rows].sum())
            return {"accuracy": hits / len(rows) if len(rows) else math.nan, "correct": hits, "queries": len(rows)}

        def confused(rows: NDArray) -> list[list[int]]:
            counts: list[list[int]] = confusion_matrix(room[rows], predicted[rows], self.labels).tolist()
            return counts

        by_lighting, every = rows_by_label(self.columns["lighting"]), np.arange(len(self))
        return {
            "overall": accuracy(every),
            "room": {label: accuracy(rows) for label, rows in rows_by_label(room).items()},
            "lighting": {label: accuracy(rows) for label, rows in by_lighting.items()},
            "confusion": {
                "labels": list(self.labels),
                "counts": confused(every),
                "lighting": {label: confused(rows) for label, rows in by_lighting.items()},
            },
            "rooms_missing_in_map": list(self.missing),
        }


def evaluate_pairs(
    first: ArrayLike,
    second: ArrayLike,
    same: ArrayLike,
    margin: float = 2.0,
    threshold: float = 0.5,
    lighting: ArrayLike | None = None,
    labels: Mapping[str, ArrayLike] | None = None,
) -> PairResult:
    """Judge pairs of descriptors by their Euclidean distance.

    Args:
        first: descriptors (n, D), n at least 1.
        second: descriptors (n, D).
        same: True for pairs from one room (n,).
        margin: the contrastive loss's margin, positive.
        threshold: dissimilarity min(distance / margin, 1) below which a pair is taken for one room; in (0, 1].
        lighting: of each pair (n,), for measures by lighting.
        labels: more columns for `pairs.csv`, such as the two paths and rooms.

    Raises:
        ConfigError: a margin or threshold out of range, or an extra column with a name that is taken.
        DataError: arrays that do not fit each other, or descriptors that are not finite.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.ndim != 2 or a.shape != b.shape or not len(a):
        raise DataError(f"pairs need two sets of descriptors of one shape (n, D), got {a.shape} and {b.shape}")
    distance = np.sqrt(np.square(a - b).sum(axis=1))
    if not np.isfinite(distance).all():
        raise DataError(f"{int((~np.isfinite(distance)).sum())} of {len(a)} pairs hold values that are not finite")
    truth = np.asarray(same)
    pair_accuracy(distance, truth, margin, threshold)  # checks all arguments before anything is built on them
    dissimilarity = pair_dissimilarity(distance, margin)
    columns: Columns = {
        "pair": np.arange(len(a)),
        "lighting": np.full(len(a), "", dtype=np.str_) if lighting is None else np.asarray(lighting, dtype=np.str_),
        "same": truth,
        "distance": distance,
        "dissimilarity": dissimilarity,
        "predicted_same": dissimilarity < threshold,
        "correct": (dissimilarity < threshold) == truth,
    }
    for name, values in (labels or {}).items():
        if name in columns:
            raise ConfigError(f"the column {name!r} of a pair is taken: {', '.join(columns)}")
        columns[name] = np.asarray(values)
    for name, column in columns.items():
        if column.shape != (len(a),):
            raise DataError(f"column {name!r} of the pairs has shape {column.shape}, expected ({len(a)},)")
    return PairResult(columns, float(margin), float(threshold))


def evaluate_rooms(
    visual_map: VisualMap, descriptors: ArrayLike | None, frames: FrameTable, retrieval: Retrieval | None = None
) -> RoomResult:
    """Take the room of the nearest map frame for each query's room.

    Args:
        visual_map: m frames, all with room labels.
        descriptors: of the queries (n, D), n at least 1; None where their retrieval is given.
        frames: the queries (n), all with room labels. Rooms of different buildings are different rooms.
        retrieval: what the map's search gave, to search only once.

    Raises:
        DataError: frames without room labels, or descriptors that do not fit the frames or the map.
    """
    _require_rooms(frames, "queries")
    _require_rooms(visual_map.frames, "map frames")
    found = retrieve(visual_map, descriptors, frames, 1, retrieval)
    if len(found) != len(frames):
        raise DataError(f"the retrieval must be that of the {len(frames)} queries, got one of {len(found)}")
    match = found.indices[:, 0]
    room, known = room_names(frames, visual_map.frames)
    predicted = known[match]
    columns: Columns = {
        "query": np.arange(len(frames)),
        "path": frames.path,
        "sequence": frames.sequence,
        "lighting": frames.lighting,
        "room": room,
        "predicted_room": predicted,
        "correct": room == predicted,
        "match": match,
        "match_path": visual_map.frames.path[match],
        "descriptor_distance": found.distances[:, 0],
    }
    rooms, in_map = set(room.tolist()), set(known.tolist())
    return RoomResult(columns, tuple(sorted(rooms | in_map)), tuple(sorted(rooms - in_map)))


def _require_rooms(frames: FrameTable, what: str) -> None:
    bare = frames.room == ""
    if bare.any():
        raise DataError(
            f"{int(bare.sum())} of {len(frames)} {what} have no room label, the first is "
            f"{frames.path[np.flatnonzero(bare)[0]]}: room retrieval needs one for every frame"
        )
