from .batch_losses import MetricCalibratedLoss as MetricCalibratedLoss, SoftContrastiveLoss as SoftContrastiveLoss
from .checkpoint import load as load, pretrained as pretrained, save_weights as save_weights
from .cross_entropy import CrossEntropyLoss as CrossEntropyLoss
from .describing import NetworkDescriptor as NetworkDescriptor, as_descriptor as as_descriptor
from .distillation import DistillationLoss as DistillationLoss
from .losses import ContrastiveLoss as ContrastiveLoss
from .near_and_far import (
    CircleLoss as CircleLoss,
    MultiSimilarityLoss as MultiSimilarityLoss,
    TripletLoss as TripletLoss,
)
from .network import Network as Network, build as build
from .network_stages import stages as stages
from .origins import Origins as Origins
from .places import PlaceModule as PlaceModule
from .registry import BRANCHES as BRANCHES, HEADS as HEADS, Optimizer as Optimizer
from .room_classifier import NamedRooms as NamedRooms, RoomClassifier as RoomClassifier
from .siamese import SiameseModule as SiameseModule
