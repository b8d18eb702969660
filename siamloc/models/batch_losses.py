"""Losses over all pairs of a batch: each image is described once and compared with every other one."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import torch
from torch import Tensor, nn

from foundation.calls import takes
from foundation.errors import known
from siamloc.errors import DataError
from siamloc.models.origins import Origins, ScheduledLoss, check_batch
from siamloc.models.registry import LOSSES, MetricCalibrated, SoftContrastive


class SoftContrastiveLoss(ScheduledLoss):
    """Make descriptors of images the more similar, the nearer the images were taken in the building.

    The mean over the images i of the cross-entropy, over all other images j, between the softmax of the similarities
    and a kernel of the distances in the building, for example a Gaussian:

        p_ij = exp(-|x_i - x_j|^2 / 2 sigma^2) / sum_k,    q_ij = exp(d_i . d_j / temperature) / sum_k.

    This is InfoNCE with a target that fades with the distance instead of ending at a radius. The kernel "overlap" is a
    power of the share of visible surfaces that two images have in common: walls separate, and open spaces connect. With
    rooms, p_ij is the weighted mean of this target, without the images of other rooms, and of a target that is equal
    for all images of the room of i, and 0 for others. For this second target, q_ij is a softmax without the images
    whose room is unknown. Images without a neighbour or another image of their room in the batch do not count.

    With distances r in `beyond`, half of the loss is this one, and half the mean of one for each r, in which images
    nearer than r to each other are left out of both softmaxes, and the target is the visual overlap to the power 1.5:
    where the map has no frame within r, the one that shows most of the same surfaces should be found.

    Args:
        settings: see `siamloc.models.registry.SoftContrastive`.

    Raises:
        ConfigError: a parameter that is not positive.

    Example:
        >>> xy = torch.tensor([[0.0, 0.0], [0.1, 0.0], [5.0, 0.0]])
        >>> origins = Origins(xy, torch.zeros(3), torch.zeros(3), torch.arange(3))
        >>> alike = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> bool(SoftContrastiveLoss()(alike, origins) < SoftContrastiveLoss()(alike.roll(1, 0), origins))
        True
    """

    @takes(SoftContrastive)
    def __init__(self, settings: SoftContrastive) -> None:
        super().__init__("soft_contrastive", settings)
        self.temperature, self.sigma = float(settings.temperature), float(settings.sigma)
        self.kernel, self.room, self.beyond = settings.kernel, float(settings.room), settings.beyond

    def forward(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Compute the loss of a batch, a scalar.

        Args:
            descriptors: (N, D), of unit length.
            origins: origins of the N images; images without a position have no neighbours.

        Raises:
            DataError: other shapes, or no visual overlap where the kernel asks for it.
        """
        check_batch(descriptors, origins)
        with torch.autocast(device_type=descriptors.device.type, enabled=False):
            found = descriptors.float()
            itself = torch.eye(len(found), dtype=torch.bool, device=found.device)
            similarity = (found @ found.T / self.temperature).masked_fill(itself, -math.inf)
            near, mates, unknown = self._wanted(origins, itself)
            counts = (near + mates).sum(dim=1) > 0
            # The softmax of an image with itself is 0; its logarithm must not be multiplied by the target of 0.
            told = similarity.log_softmax(dim=1).masked_fill(itself, 0)
            cost = -(near * told).sum(dim=1)
            if self.room > 0:
                told = similarity.masked_fill(unknown, -math.inf).log_softmax(dim=1).masked_fill(itself | unknown, 0)
                cost = cost - (mates * told).sum(dim=1)
            loss = (cost * counts).sum() / counts.sum().clamp(min=1)
            if not self.beyond:
                return loss
            farther = [self._farther(similarity, origins, itself, distance) for distance in self.beyond]
            return (loss + torch.stack(farther).mean()) / 2

    def lacks(self, origins: Origins) -> str | None:
        """Return what a batch lacks for this loss, in words: two different frames that should be similar."""
        if self.beyond:
            _overlap(origins, "beyond=[]")  # refused before the training
        near, mates, _ = self._wanted(origins, origins.frame[:, None] == origins.frame[None])
        if bool((near + mates > 0).any()):
            return None
        rooms = f"two frames of one room, for loss.room={self.room:g}"
        near_enough = f"two frames near enough for loss.sigma={self.sigma:g}"
        return near_enough if self.room == 0 else rooms if self.room == 1 else f"{near_enough}, or {rooms}"

    def _wanted(self, origins: Origins, itself: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the target similarities (N, N), for being near and for their room; together, rows sum to 1.

        Also return where the room of the second is unknown (N, N), in rows that compare rooms; `itself`: the diagonal.
        """
        wanted = mates = torch.zeros(itself.shape, device=itself.device)
        if self.room < 1:
            near = self._kernel(origins)
            aside = itself | origins.other_room() if self.room > 0 else itself
            wanted = (1 - self.room) * _shares(near.nan_to_num(0).masked_fill(aside, 0))
        if self.room > 0:
            mates = self.room * _shares(origins.same_room().float().masked_fill(itself, 0))
        whole = (wanted + mates).sum(dim=1, keepdim=True)
        share = torch.where(whole > _LEAST_WEIGHT, 1 / whole.clamp(min=_LEAST_WEIGHT), 0)
        unknown = (origins.room < 0)[None] & (mates.sum(dim=1) > 0)[:, None]
        return share * wanted, share * mates, unknown

    def _farther(self, similarity: Tensor, origins: Origins, itself: Tensor, distance: float) -> Tensor:
        """Return the loss of images at least `distance` from each other; rows that show almost nothing do not count."""
        aside = itself | (origins.distances() < distance)
        wanted = (_overlap(origins, "beyond=[]") ** _BEYOND_POWER).masked_fill(aside, 0).nan_to_num(0)
        total = wanted.sum(dim=1)
        counts = total > _LEAST_OVERLAP
        told = similarity.masked_fill(aside, -math.inf).log_softmax(dim=1).masked_fill(aside, 0)
        cost = -(wanted * told).sum(dim=1) / total.clamp(min=_LEAST_OVERLAP)
        return (cost * counts).sum() / counts.sum().clamp(min=1)

    def _kernel(self, origins: Origins) -> Tensor:
        """Return how similar images should be (N, N), from 0 to 1; NaN where unknown."""
        if self.kernel == "overlap":
            return _overlap(origins, "kernel=exponential or gaussian") ** (1 / self.sigma)
        apart = origins.distances().float() / self.sigma
        return torch.exp(-apart if self.kernel == "exponential" else -apart.square() / 2)


def _overlap(origins: Origins, instead: str) -> Tensor:
    if origins.overlap is None:
        raise DataError(
            "the loss needs the visual overlap of the images, which only those of pretraining have (siamloc pretrain): "
            f"set loss.{instead}, which needs positions only"
        )
    return origins.overlap.float()


def _shares(weights: Tensor) -> Tensor:
    """Divide rows by their sums; a row that is almost 0 becomes 0."""
    total = weights.sum(dim=1, keepdim=True)
    return torch.where(total > _LEAST_WEIGHT, weights / total.clamp(min=_LEAST_WEIGHT), 0)


class MetricCalibratedLoss(ScheduledLoss):
    """Make the distance of two descriptors grow with the distance of the images' positions, up to a cap.

    The mean over all pairs of images, from one building or two, of (|d_i - d_j| - sqrt(2) min(x_ij / cap, 1))^2. At the
    cap two descriptors of unit length are orthogonal. After training, the distance of descriptors measures metres.
    Pairs with an unknown position do not count.

    Args:
        settings: see `siamloc.models.registry.MetricCalibrated`.

    Raises:
        ConfigError: a cap that is not positive.
    """

    @takes(MetricCalibrated)
    def __init__(self, settings: MetricCalibrated) -> None:
        super().__init__("metric_calibrated", settings)
        self.cap = float(settings.cap)

    def forward(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Compute the loss of a batch, a scalar, from descriptors (N, D) of unit length.

        Raises:
            DataError: other shapes.
        """
        check_batch(descriptors, origins)
        with torch.autocast(device_type=descriptors.device.type, enabled=False):
            found = descriptors.float()
            one, other = torch.triu_indices(len(found), len(found), offset=1, device=found.device)
            apart = torch.linalg.vector_norm(found[one] - found[other], dim=1)
            wanted = 2**0.5 * (origins.distances()[one, other].float() / self.cap).clamp(max=1)
            known = torch.isfinite(wanted)
            cost = torch.where(known, apart - wanted.nan_to_num(0), 0).square()
            return cost.sum() / known.sum().clamp(min=1)

    def lacks(self, origins: Origins) -> str | None:
        """Return what a batch lacks for this loss, in words: two different frames nearer each other than the cap."""
        cap = self.bounds("cap")[1]
        return None if bool(origins.apart().min() < cap) else f"two frames less than loss.cap={cap:g} apart"


_LEAST_WEIGHT = 1e-6
_LEAST_OVERLAP = 0.01  # of an image with all others together, to the power
_BEYOND_POWER = 1.5


def make_loss(name: str, **parameters: Any) -> nn.Module:
    """Make a loss over a batch by its name.

    Raises:
        ConfigError: an unknown name or parameter.
    """
    module, _, kind = LOSSES[known(name, LOSSES, "loss")][1].partition(".")
    loss: nn.Module = getattr(import_module(f"siamloc.models.{module}"), kind)(settings=parameters)
    return loss
