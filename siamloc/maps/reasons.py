"""`Reason`: why frames stay in a map, leave it, or join it."""

from __future__ import annotations

from enum import Enum


class Reason(Enum):
    """Why a frame stays in a map or leaves it."""

    KEPT = "nothing speaks against it"
    UNRECOGNIZED = "the budget is spent, and the last drives that passed it did not recognize it"
    REDUNDANT = "the budget is spent, and another frame nearby shows almost the same"
