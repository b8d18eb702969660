"""Siamese networks: branches and heads, losses, Lightning modules, trained weights ([T] 5.2-5.3).

Importing this package loads no torch; each name is loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy
from siamloc.models.registry import BRANCHES, HEADS, Optimizer

if TYPE_CHECKING:
    from siamloc.models.batch_losses import MetricCalibratedLoss, SoftContrastiveLoss
    from siamloc.models.checkpoint import load, pretrained, save_weights
    from siamloc.models.cross_entropy import CrossEntropyLoss
    from siamloc.models.describing import NetworkDescriptor, as_descriptor
    from siamloc.models.losses import ContrastiveLoss
    from siamloc.models.near_and_far import CircleLoss, MultiSimilarityLoss, TripletLoss
    from siamloc.models.network import Network, build
    from siamloc.models.network_stages import stages
    from siamloc.models.origins import Origins
    from siamloc.models.places import PlaceModule
    from siamloc.models.room_classifier import NamedRooms, RoomClassifier
    from siamloc.models.siamese import SiameseModule

__all__ = [
    "BRANCHES",
    "HEADS",
    "CircleLoss",
    "ContrastiveLoss",
    "CrossEntropyLoss",
    "MetricCalibratedLoss",
    "MultiSimilarityLoss",
    "NamedRooms",
    "Network",
    "NetworkDescriptor",
    "Optimizer",
    "Origins",
    "PlaceModule",
    "RoomClassifier",
    "SiameseModule",
    "SoftContrastiveLoss",
    "TripletLoss",
    "as_descriptor",
    "build",
    "load",
    "pretrained",
    "save_weights",
    "stages",
]

_HOMES = {
    "CircleLoss": "near_and_far",
    "ContrastiveLoss": "losses",
    "CrossEntropyLoss": "cross_entropy",
    "MetricCalibratedLoss": "batch_losses",
    "MultiSimilarityLoss": "near_and_far",
    "NamedRooms": "room_classifier",
    "Network": "network",
    "NetworkDescriptor": "describing",
    "Origins": "origins",
    "PlaceModule": "places",
    "RoomClassifier": "room_classifier",
    "SiameseModule": "siamese",
    "SoftContrastiveLoss": "batch_losses",
    "TripletLoss": "near_and_far",
    "as_descriptor": "describing",
    "build": "network",
    "load": "checkpoint",
    "pretrained": "checkpoint",
    "save_weights": "checkpoint",
    "stages": "network_stages",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
