"""Learn to name the room: the loss of the single networks that [T] table 5.19 compares with."""

from __future__ import annotations

from collections.abc import Sequence
from operator import index

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from foundation.calls import takes
from siamloc.errors import ConfigError, DataError
from siamloc.models.origins import Origins, check_batch
from siamloc.models.registry import CrossEntropy


class CrossEntropyLoss(nn.Module):
    """Train one fully connected layer to name the room of an image from its descriptor.

    The mean over the images with a room of -log of the room's share in the softmax of (W d + b) / temperature. The
    layer is part of the loss and is trained with the network. The network itself describes images as usual: the
    descriptor is the input of the class layer ([T] 5.4.3, "CNN simple"). `siamloc.models.load` returns the layer as
    `network.rooms`.

    Args:
        settings: see `siamloc.models.registry.CrossEntropy`.

    Attributes:
        rooms: the names of the classes; empty until `open`.
        layer: the class layer; None until `open`.

    Raises:
        ConfigError: a temperature that is not positive.

    Example:
        >>> loss = CrossEntropyLoss()
        >>> loss.open(["hall", "office"], width=3)
        >>> origins = Origins(torch.zeros(2, 2), torch.zeros(2), torch.tensor([0, 1]), torch.arange(2))
        >>> loss(torch.rand(2, 3), origins).shape
        torch.Size([])
    """

    room = 1.0
    """Share of the target that depends on rooms; see `siamloc.models.registry.SoftContrastive`."""

    @takes(CrossEntropy)
    def __init__(self, settings: CrossEntropy) -> None:
        super().__init__()
        self.temperature = float(settings.temperature)
        self.settings = {"name": "cross_entropy", **settings.plain()}
        self.rooms: tuple[str, ...] = ()
        self.layer: nn.Linear | None = None

    def open(self, rooms: Sequence[str], width: int, seed: int = 0) -> None:
        """Make a new class layer, with weights drawn from the seed alone; `siamloc.training.fit` calls this.

        Args:
            rooms: names of the rooms; the rooms of a batch are indices into them.
            width: numbers in a descriptor.
            seed: seed of the weights.

        Raises:
            DataError: fewer than two rooms.
        """
        if len(rooms) < 2:
            raise DataError(f"naming rooms needs two of them at least, got {len(rooms)}")
        self.rooms = tuple(rooms)
        self.layer = nn.utils.skip_init(nn.Linear, width, len(rooms))
        with torch.no_grad():
            self.layer.weight.normal_(std=width**-0.5, generator=torch.Generator().manual_seed(index(seed)))
            self.layer.bias.zero_()

    def forward(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Compute the loss of a batch, a scalar, from descriptors (N, D); images without a room do not count.

        Raises:
            ConfigError: there is no class layer yet.
            DataError: other shapes.
        """
        check_batch(descriptors, origins)
        known = origins.room >= 0
        with torch.autocast(device_type=descriptors.device.type, enabled=False):
            cost = F.cross_entropy(self.scores(descriptors), origins.room.clamp(min=0), reduction="none")
            return (cost * known).sum() / known.sum().clamp(min=1)

    def scores(self, descriptors: Tensor) -> Tensor:
        """Return the scores (N, r) of r rooms for descriptors (N, D); their softmax gives the probabilities.

        Raises:
            ConfigError: there is no class layer yet.
        """
        if self.layer is None:
            raise ConfigError(
                "loss=cross_entropy has no rooms to name yet: train with siamloc.training.fit (siamloc train), which "
                "takes them from the frames, or call its open(rooms, width)"
            )
        return self.layer(descriptors.float()) / self.temperature

    def accuracy(self, descriptors: Tensor, room: Tensor) -> Tensor:
        """Return the share of descriptors (N, D) with a room that are named correctly; NaN if none has a room.

        Args:
            descriptors: (N, D).
            room: (N,) numbers of the rooms, negative where unknown; rooms that are not classes are never named.
        """
        right = self.scores(descriptors.detach()).detach().argmax(dim=1) == room
        known = room >= 0
        return (right & known).sum() / known.sum()
