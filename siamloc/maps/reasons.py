"""`Reason`: why a frame stays in a map, leaves it or joins it."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray


class Reason(Enum):
    """Why a frame of a map stays or leaves, or a frame of a drive joins a map or not."""

    KEPT = "nothing speaks against it"
    CONFIRMED = "the drive recognized it"
    CONTRADICTED = "the drive passed it and did not recognize it"
    OTHER_LIGHT = "the drive did not recognize it, nor most frames that were taken in the same light or on its drive"
    FORGOTTEN = "several drives in a row passed it and did not recognize it"
    UNRECOGNIZED = "the budget is spent, and the last drives that passed it did not recognize it"
    REDUNDANT = "the budget is spent, and another frame nearby shows almost the same"
    NEEDED = "it would be forgotten, but its node of an incremental map needs it"

    ADDED = "it and frames around it contradict the map"
    NEW_PLACE = "no map frame is near it"
    BEYOND = "no map frame is near it, and the map is not extended"
    EXPLAINED = "the map knows its place, and how it looks"
    ALONE = "it contradicts the map, but too few frames around it do"
    REPEATED = "a frame that joins the map shows almost the same"
    UNSURE = "its position is unknown or too uncertain"
    HELD = "it is in the map already"
    FEW = "it contradicts the map, but with fewer frames in its node than smallest_node"


GONE = (Reason.FORGOTTEN, Reason.UNRECOGNIZED, Reason.REDUNDANT)
"""Reasons for which a frame leaves a map."""
JOINED = (Reason.ADDED, Reason.NEW_PLACE)
"""Reasons for which a frame joins a map."""


def among(reason: NDArray[np.object_], wanted: Sequence[Reason]) -> NDArray[np.bool_]:
    """Return which reasons (n,) are among some (n,)."""
    return np.array([one in wanted for one in reason.tolist()], dtype=bool)
