"""Siamese networks: branches, heads, the contrastive loss and the Lightning module ([T] 5.2-5.3).

Importing this package loads no torch; each name is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy
from siamloc.models.registry import BRANCHES, HEADS

if TYPE_CHECKING:
    from siamloc.models.checkpoint import read_hyperparameters
    from siamloc.models.losses import ContrastiveLoss
    from siamloc.models.network import Network, build
    from siamloc.models.siamese import SiameseModule

__all__ = ["BRANCHES", "HEADS", "ContrastiveLoss", "Network", "SiameseModule", "build", "read_hyperparameters"]

_HOMES = {
    "ContrastiveLoss": "losses",
    "Network": "network",
    "SiameseModule": "siamese",
    "build": "network",
    "read_hyperparameters": "checkpoint",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
