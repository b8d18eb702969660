"""Labelled pairs of frames for training and testing a siamese network ([T] 5.3.4, 5.3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.columns import Rows
from foundation.settings import Count, Positive, Seed, Settings, Share, checked
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError


@dataclass(frozen=True)
class PairSettings(Settings):
    """Which pairs of frames an epoch has, and their labels.

    Attributes:
        label: "room": 0 for the same room, 1 for different rooms ([T] 5.3.4). "distance": the distance between the
            two positions divided by `scale` within a room, 1 across rooms ([T] 5.3.5); of positions with deviations,
            the root of the mean squared distance. "auto": "room" if there are at least two rooms, otherwise "distance".
        same_room_share: share of same-room pairs; exact up to rounding. None: one half, or 1 if there is only one
            room.
        epoch_pairs: pairs in an epoch; the number of frames if None.
        scale: divisor of "distance", in the unit of the positions: a number for all frames, or numbers by building.
            Buildings without a number get the largest distance between two of their frames in the same room (18.99 m
            in Freiburg A).
    """

    WHERE = "pairs"
    needs_positions: ClassVar[str] = (
        "distance labels need (pairs.label=room needs several rooms instead; experiment=adapt, for panoramas, and "
        "experiment=photographs, for ordinary cameras, need neither)"
    )

    label: Literal["auto", "room", "distance"] = "auto"
    same_room_share: Share | None = None
    epoch_pairs: Count | None = None
    scale: Positive | Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Pairs(Rows):
    """Pairs as columns of equal length n.

    Attributes:
        first: rows of the frame table (n,).
        second: rows of the frame table (n,), never equal to `first`.
        label: dissimilarity in [0, 1] (n,) float32, the target of the contrastive loss.
        same: True where both frames show the same room (n,).
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    label: NDArray[np.float32]
    same: NDArray[np.bool_]


class PairSampler:
    """Draw the pairs of an epoch.

    A pair is two different frames of the same room, or two frames of different rooms. Frames without a room label count
    as one room; `fit` leaves unlabelled frames out if other frames of their building have a label. Rooms of different
    buildings are different rooms. Which pairs an epoch has depends only on the seed, the epoch and the pair's number:
    not on workers, ranks, or earlier draws.

    Args:
        frames: the frames to pair (N).
        settings: label, number and share of same-room pairs; the defaults of `PairSettings` if None.
        seed: seed from which the pairs of all epochs follow.

    Attributes:
        label: "room" or "distance".
        same_room_share: share of same-room pairs.
        epoch_pairs: pairs in an epoch.
        scale: divisor of "distance", in a form that `PairSettings` accepts: a number if the settings have a number or
            all frames are of one building, otherwise numbers by building; NaN for label "room".

    Raises:
        ConfigError: pairs that cannot exist, such as different-room pairs if there is only one room; label "room" with
            only one room, unless a `same_room_share` of 1 is given.
        DataError: fewer than two frames, or "distance" for frames without positions.

    Example:
        >>> frames = FrameTable(path=["a.png", "b.png", "c.png"], room=["office", "office", "kitchen"])
        >>> pairs = PairSampler(frames, PairSettings(epoch_pairs=4), seed=0).epoch(0)
        >>> pairs.label.tolist() == (frames.room[pairs.first] != frames.room[pairs.second]).tolist()
        True
        >>> int(pairs.same.sum())
        2
    """

    @typed
    def __init__(self, frames: FrameTable, settings: PairSettings | None = None, *, seed: Seed = 0) -> None:
        if len(frames) < 2:
            raise DataError(f"pairs need at least two frames, got {len(frames)}")
        self.settings = settings = PairSettings() if settings is None else settings
        self.frames = frames
        self.seed = int(seed)
        self._rooms = _Rooms(frames)
        single = self._rooms.count == 1
        self.label = ("distance" if single else "room") if settings.label == "auto" else settings.label
        share = settings.same_room_share
        self.same_room_share = (1.0 if single else 0.5) if share is None else share
        self.epoch_pairs = settings.epoch_pairs or len(frames)
        self._check_possible()
        self.scale: float | dict[str, float] = float("nan")
        if self.label == "distance":
            self.scale, self._divisor = _scales(frames, settings.scale)
            self._variance = np.nan_to_num(frames.deviation) ** 2

    def __len__(self) -> int:
        return self.epoch_pairs

    def summary(self) -> str:
        """Describe the pairs of an epoch in a line: their number and their labels."""
        return f"{self.epoch_pairs} {self.label} pairs"

    def epoch(self, epoch: int, rank: int = 0, world_size: int = 1) -> Pairs:
        """Draw the pairs of an epoch, or the share of one process among `world_size`.

        Process r, its `rank`, gets the pairs r, r + world_size, r + 2 world_size, ...: no pair goes to two processes,
        and together the processes get the whole epoch.
        """
        uniform = np.random.Generator(np.random.Philox(key=[self.seed, epoch])).random((self.epoch_pairs, 4))
        same = np.zeros(self.epoch_pairs, dtype=bool)
        same[np.argsort(uniform[:, 0], kind="stable")[: round(self.same_room_share * self.epoch_pairs)]] = True
        uniform, same = uniform[rank::world_size], same[rank::world_size]
        first, second = np.empty((2, len(same)), dtype=np.int64)
        for kind in (True, False):
            rows = same == kind
            # Without the unused column 1, seeds would draw other pairs.
            first[rows] = self._rooms.anchors(uniform[rows, 2], same=kind)
            second[rows] = self._rooms.partners(first[rows], uniform[rows, 3], same=kind)
        label = ~same
        if self.label == "distance":
            apart = np.linalg.norm(self.frames.xy[first] - self.frames.xy[second], axis=1)
            if self._variance.any():
                apart = np.sqrt(apart**2 + 2 * (self._variance[first] + self._variance[second]))
            label = np.where(same, np.minimum(apart / self._divisor[first], 1), 1)
        return Pairs(first, second, label.astype(np.float32), same)

    def _check_possible(self) -> None:
        same_pairs = round(self.same_room_share * self.epoch_pairs)
        unasked = self.label == "room" and self.settings.same_room_share is None
        if self._rooms.count == 1 and (unasked or same_pairs < self.epoch_pairs):
            room = self.frames.room[0] or "(no label)"
            raise ConfigError(
                f"all {len(self.frames)} frames belong to one room, {room}, so there are no different-room pairs: "
                "name the rooms, add frames of another one, or ask for same-room pairs only (pairs.same_room_share=1), "
                "with distance labels, which need positions (pairs.label=distance)"
            )
        if same_pairs > 0 and not (self._rooms.size > 1).any():
            raise ConfigError(
                f"each of the {self._rooms.count} rooms has only one frame, so there are no same-room pairs: "
                "ask for different-room pairs only (pairs.same_room_share=0 pairs.label=room), or add frames"
            )
        if self.label == "distance" and not self.frames.has_position.all():
            missing = int((~self.frames.has_position).sum())
            raise DataError(
                f"{missing} of {len(self.frames)} frames have no position, which distance labels need: "
                "give their x and y, leave them out, or use room labels (pairs.label=room)"
            )


class _Rooms:
    """The frames sorted by room, so that partners can be drawn by table lookup, without trial and error."""

    def __init__(self, frames: FrameTable) -> None:
        _, self.room = np.unique(frames.place, return_inverse=True)
        self.order = np.argsort(self.room, kind="stable")
        self.rank = np.empty_like(self.order)
        self.rank[self.order] = np.arange(len(self.order))
        self.size = np.bincount(self.room)
        self.start = np.cumsum(self.size) - self.size
        self.count = len(self.size)

    def anchors(self, uniform: NDArray[np.float64], *, same: bool) -> NDArray[np.int64]:
        """Return the first frame of each pair; rooms with only one frame have no same-room pairs."""
        candidates = self.order[self.size[self.room[self.order]] > 1] if same else self.order
        return candidates[_scaled(uniform, len(candidates))]

    def partners(self, anchor: NDArray[np.int64], uniform: NDArray[np.float64], *, same: bool) -> NDArray[np.int64]:
        """Return the second frame: the k-th of the anchor's room, not counting the anchor, or of all other rooms."""
        start, size = self.start[self.room[anchor]], self.size[self.room[anchor]]
        if same:
            k = _scaled(uniform, size - 1)
            k = start + k + (k >= self.rank[anchor] - start)
        else:
            k = _scaled(uniform, len(self.order) - size)
            k = k + np.where(k >= start, size, 0)
        return self.order[k]


def _scales(
    frames: FrameTable, scale: float | Mapping[str, float] | None
) -> tuple[float | dict[str, float], NDArray[np.float64]]:
    """Return the value of `PairSampler.scale`, and the divisor of each frame's distances (N,).

    Raises:
        ConfigError: a scale that is not a positive number.
        DataError: a building whose largest distance is 0, since all frames of each room have one position.
    """
    if scale is not None and not isinstance(scale, Mapping):
        return float(scale), np.full(len(frames), float(scale))
    scales = {str(building): checked(value, Positive, "pairs.scale") for building, value in (scale or {}).items()}
    divisor = np.empty(len(frames))
    for building, rows in frames.rows_by("building").items():
        if building not in scales:
            own = frames.take(rows)
            scales[building] = max(diameter(own.xy[room]) for room in own.rows_by("place").values())
            if not scales[building] > 0:
                where = f" of building {building}" if building else ""
                raise DataError(f"all frames of a room{where} were taken at one point, so distances have no scale")
        divisor[rows] = scales[building]
    return (scales if len(scales) > 1 else divisor[0].item()), divisor


def diameter(points: NDArray[np.float64]) -> float:
    """Return the largest distance between two of several points (n, 2).

    The two points that are farthest apart are corners of the convex hull: only corners are compared.
    """
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    points = np.unique(points, axis=0)
    if len(points) > 1000:
        try:
            points = points[ConvexHull(points).vertices]
        except QhullError:  # all on one line: its ends are the farthest apart
            along = points @ (points.max(axis=0) - points.min(axis=0))
            points = points[[along.argmin(), along.argmax()]]
    return float(pdist(points).max(initial=0.0))


def _scaled(uniform: NDArray[np.float64], count: Any) -> NDArray[np.int64]:
    return (uniform * count).astype(np.int64)
