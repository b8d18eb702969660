"""Siamese networks: branches and heads, losses, the Lightning modules, trained weights ([T] 5.2-5.3).

Importing this package loads no torch; each name is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy
from siamloc.models.registry import BRANCHES, HEADS, Optimizer

if TYPE_CHECKING:
    from siamloc.models.batch_losses import (
        CircleLoss,
        MetricCalibratedLoss,
        MultiSimilarityLoss,
        Origins,
        SoftContrastiveLoss,
        TripletLoss,
    )
    from siamloc.models.checkpoint import load
    from siamloc.models.describing import NetworkDescriptor, as_descriptor
    from siamloc.models.losses import ContrastiveLoss
    from siamloc.models.network import Network, build
    from siamloc.models.network_stages import stages
    from siamloc.models.places import PlaceModule
    from siamloc.models.siamese import SiameseModule

__all__ = [
    "BRANCHES",
    "HEADS",
    "CircleLoss",
    "ContrastiveLoss",
    "MetricCalibratedLoss",
    "MultiSimilarityLoss",
    "Network",
    "NetworkDescriptor",
    "Optimizer",
    "Origins",
    "PlaceModule",
    "SiameseModule",
    "SoftContrastiveLoss",
    "TripletLoss",
    "as_descriptor",
    "build",
    "load",
    "stages",
]

_HOMES = {
    "CircleLoss": "batch_losses",
    "ContrastiveLoss": "losses",
    "MetricCalibratedLoss": "batch_losses",
    "MultiSimilarityLoss": "batch_losses",
    "Network": "network",
    "NetworkDescriptor": "describing",
    "Origins": "batch_losses",
    "PlaceModule": "places",
    "SiameseModule": "siamese",
    "SoftContrastiveLoss": "batch_losses",
    "TripletLoss": "batch_losses",
    "as_descriptor": "describing",
    "build": "network",
    "load": "checkpoint",
    "stages": "network_stages",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
