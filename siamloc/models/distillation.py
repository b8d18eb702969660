"""Distillation: a network learns which images are alike from a larger one, without any labels."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from foundation.calls import OF_FIELDS, takes
from siamloc.errors import ConfigError, DataError
from siamloc.models.checkpoint import load, pretrained
from siamloc.models.describing import describing, evaluating
from siamloc.models.network import build
from siamloc.models.origins import Origins, ScheduledLoss, check_batch
from siamloc.models.registry import Distillation


class DistillationLoss(ScheduledLoss):
    """Make the images of a batch as alike as a larger, frozen network finds them.

    One minus the cosine between two rows of similarities, the network's and the teacher's, as a mean over the images i
    of the batch; a row holds the similarities of image i with all others, minus their mean. Positions and rooms play no
    role ([Park 2019], with similarities instead of distances).

    Args:
        teacher_network: the larger network, (B, 3, H, W) -> (B, D); the one that the settings name if None.
        settings: see `siamloc.models.registry.Distillation`.

    Raises:
        ConfigError: a teacher that cannot be made.

    Example:
        >>> loss = DistillationLoss(nn.Sequential(nn.AdaptiveAvgPool2d(2), nn.Flatten()))
        >>> images = torch.rand(4, 3, 16, 64, generator=torch.Generator().manual_seed(0))
        >>> origins = Origins(*torch.zeros(4, 4).split([2, 1, 1], dim=1), torch.arange(4), taught=loss.teach(images))
        >>> loss(origins.taught, origins).item() < 1e-6
        True
    """

    @takes(Distillation)
    def __init__(
        self, teacher_network: nn.Module | None = None, *, settings: Distillation = OF_FIELDS, **fields: Any
    ) -> None:
        super().__init__("distillation", settings)
        found = _teacher(settings) if teacher_network is None else teacher_network
        self._teacher = [found.requires_grad_(False)]  # a list, so that it is neither trained nor stored

    def teach(self, images: Tensor) -> Tensor:
        """Return the teacher's descriptors (N, T) of images (N, 3, H, W), floating point in [0, 1]."""
        teacher = self._teacher[0].to(images.device)
        size = getattr(teacher, "image_size", tuple(images.shape[2:]))
        if tuple(size) != tuple(images.shape[2:]):
            images = F.interpolate(images, size, mode="bilinear", antialias=True, align_corners=False).clamp(0, 1)
        with evaluating(teacher):
            found = describing(teacher)(images.float())[0]
        return found.clone()  # outside of inference mode, for the gradients of the loss

    def forward(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Compute the loss of a batch, a scalar, from descriptors (N, D) of unit length.

        Raises:
            DataError: other shapes, or origins without the teacher's descriptors.
        """
        check_batch(descriptors, origins)
        if origins.taught is None:
            raise DataError("distillation needs the teacher's descriptors: give origins with taught=loss.teach(images)")
        with torch.autocast(device_type=descriptors.device.type, enabled=False):
            learned, taught = (_rows(one.float()) for one in (descriptors, origins.taught))
            return 1 - F.cosine_similarity(learned, taught, dim=1).mean()

    def lacks(self, origins: Origins) -> str | None:
        """Return what a batch lacks for this loss, in words: three images."""
        return None if len(origins.frame) > 2 else "three images, which can be more and less alike"


def _rows(descriptors: Tensor) -> Tensor:
    """Return the similarities (N, N) of each image with the others, minus their mean; 0 with itself."""
    unit = F.normalize(descriptors, dim=1)
    others = 1 - torch.eye(len(unit), dtype=unit.dtype, device=unit.device)
    rows = unit @ unit.T * others
    return (rows - rows.sum(dim=1, keepdim=True) / (len(unit) - 1)) * others


def _teacher(settings: Distillation) -> nn.Module:
    if settings.teacher.startswith(("timm/", "torchvision/")):
        try:
            return build(settings.teacher, "magnitudes", settings.image_size, settings.weights)
        except ConfigError as error:
            raise ConfigError(f"loss.teacher with loss.weights={settings.weights}: {error}") from error
    return pretrained() if settings.teacher == "siamloc" else load(settings.teacher)
