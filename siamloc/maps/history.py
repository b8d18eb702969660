"""`History`: what the drives that updated a map said about its frames, and `Reason`: why frames join and leave it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.columns import Rows

UPKEEP = "upkeep"
"""Key of `VisualMap.made` under which a map keeps what its next update needs."""
_ALIKE = 0.1  # relative difference of usual distances up to which that of one map holds for both


@dataclass(frozen=True, eq=False)
class History(Rows):
    """What drives said about each of the n frames of a map, see `siamloc.maps.update`; read-only.

    Attributes:
        confirmed: (n,) number of drives that recognized the frame.
        contradicted: (n,) number of drives that passed the frame and did not recognize it, since the last that did.
        change: (n,) how unlike the frame the last drive that passed it looked there: the smallest distance between
            their descriptors, as a multiple of the usual distance between neighbours in the map; NaN if unknown.
        joined: (n,) whether the frame is of a drive that updated the map; none is if not given.

    Raises:
        ValueError: columns of other lengths, or numbers of drives that are not whole numbers from 0.
    """

    confirmed: NDArray[np.int64]
    contradicted: NDArray[np.int64]
    change: NDArray[np.float64]
    joined: NDArray[np.bool_] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.joined is None:
            object.__setattr__(self, "joined", np.zeros(len(self.confirmed), dtype=bool))
        kinds = {"change": np.float64, "joined": np.bool_}
        for one in fields(self):
            column = np.array(getattr(self, one.name))
            if column.shape != (len(self.confirmed),):
                raise ValueError(f"{one.name} has shape {column.shape}, not that of {len(self.confirmed)} frames")
            if one.name not in kinds and (column.dtype.kind not in "iu" or (column < 0).any()):
                raise ValueError(f"{one.name} must be whole numbers from 0")
            column = column.astype(kinds.get(one.name, np.int64))
            column.flags.writeable = False
            object.__setattr__(self, one.name, column)

    def __reduce__(self) -> tuple[Any, ...]:  # copies are made by the class, which keeps their arrays read-only
        return type(self), tuple(getattr(self, one.name) for one in fields(self))

    @classmethod
    def none(cls, n: int) -> History:
        """Return the history of n frames that no drive has passed."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, np.nan))


class Reason(Enum):
    """Why a frame of a map stays or leaves, or a frame of a drive joins a map or not."""

    KEPT = "nothing speaks against it"
    CONFIRMED = "the drive recognized it"
    CONTRADICTED = "the drive passed it and did not recognize it"
    OTHER_LIGHT = "the drive did not recognize it, nor most frames that were taken in the same light or on its drive"
    FORGOTTEN = "several drives in a row passed it and did not recognize it"
    UNRECOGNIZED = "the budget is spent, and the last drives that passed it did not recognize it"
    REDUNDANT = "the budget is spent, and the other frames replace it best"
    NEEDED = "it would be forgotten, but its node of an incremental map needs it"

    ADDED = "it and frames around it contradict the map"
    NEW_PLACE = "no map frame is near it"
    BEYOND = "no map frame is near it, and the map is not extended"
    EXPLAINED = "the map knows its place, and how it looks"
    ALONE = "it contradicts the map, but too few frames around it do"
    REPEATED = "a frame that joins the map shows almost the same"
    UNSURE = "its position is unknown or too uncertain"
    BLANK = "its picture shows nothing"
    HELD = "it is in the map already"
    FEW = "it contradicts the map, but with fewer frames in its node than smallest_node"


GONE = np.array([Reason.FORGOTTEN, Reason.UNRECOGNIZED, Reason.REDUNDANT])
"""Reasons for which a frame leaves a map."""
JOINED = np.array([Reason.ADDED, Reason.NEW_PLACE])
"""Reasons for which a frame joins a map."""


def upkeep_of(made: Mapping[str, Any], frames: int) -> dict[str, Any]:
    """Return what a map of some frames keeps for its updates, by its `VisualMap.made`.

    "before" is the number of frames before the first update, "frames" the same with those of new places, "drives" the
    drives that were counted, each after its building, if it has one, and "usual" the usual distance of neighbours, by
    the settings under "learned".
    """
    new = {"before": frames, "frames": frames, "drives": [], "usual": None, "learned": None}
    return new | made.get(UPKEEP, {})


def merged_upkeep(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """Return what the map of the frames of two maps keeps; it learns its usual distance if those of the two differ."""
    drives = [*dict.fromkeys([*first["drives"], *second["drives"]])]
    numbers = {key: first[key] + second[key] for key in ("before", "frames")}
    usual, other = (one["usual"] or 0.0 for one in (first, second))
    alike = first["learned"] == second["learned"] and abs(usual - other) <= _ALIKE * usual
    return first | numbers | {"drives": drives} | ({} if alike else {"usual": None, "learned": None})
