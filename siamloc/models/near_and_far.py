"""Losses over the near and the far images of a batch: all of them or those picked by a miner."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from foundation.calls import takes
from foundation.settings import fields_of
from siamloc.models.origins import Origins, ScheduledLoss, check_batch
from siamloc.models.registry import Circle, MultiSimilarity, NearAndFar, Triplet

_LEAST_SLOPE = 1e-3  # of a pair that contributes to learning
_TRIPLETS = 3  # columns: an image, a positive and a negative of it
_MINERS: dict[str, tuple[str, dict[str, Any]]] = {
    "multi_similarity": ("MultiSimilarityMiner", {}),
    "batch_hard": ("BatchHardMiner", {}),
    "batch_easy_hard": ("BatchEasyHardMiner", {}),
    "semihard": ("TripletMarginMiner", {"type_of_triplets": "semihard"}),
}


class NearAndFarLoss(ScheduledLoss):
    """Base of the losses of pytorch-metric-learning: positives and negatives follow from the distances.

    Its miners work with labels, for which two images have either the same label or different ones. Here an image may be
    near two others that are far from each other, or neither near nor far. So a miner is called for one image at a time,
    with label 1, among those near it, also with label 1, and those far from it, with label 0. None of these miners
    compares two anchor images, so that nothing is lost.

    Pairs and triplets are chosen and compared in main memory, in many small steps, which would take longer on a GPU.
    So a training step on a GPU waits four times for a copy: of the descriptors, of the descriptors again in `active`,
    and of the gradients in both directions.
    """

    def __init__(self, name: str, published: str, settings: Triplet | Circle | MultiSimilarity) -> None:
        from pytorch_metric_learning import distances, losses, miners

        super().__init__(name, settings)
        self.near, self.far = float(settings.near), float(settings.far)
        common = {"distance", *fields_of(NearAndFar)}
        parameters = {key: value for key, value in settings.plain().items() if key not in common}
        distance = (
            distances.CosineSimilarity()
            if settings.distance == "cosine"
            else distances.LpDistance(power=2 if settings.distance == "squared" else 1)
        )
        self.loss = getattr(losses, published)(distance=distance, **parameters)
        self.miner: nn.Module | None = None
        if settings.miner is not None:
            kind, further = _MINERS[settings.miner]
            if isinstance(settings, Triplet) and settings.miner == "semihard":
                further = {**further, "margin": settings.margin}
            self.miner = getattr(miners, kind)(distance=distance, **further)

    def forward(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Compute the loss of a batch, a scalar, from descriptors (N, D).

        Raises:
            DataError: other shapes.
        """
        check_batch(descriptors, origins)
        with torch.autocast(device_type=descriptors.device.type, enabled=False):
            found, picked = self._picked(descriptors, origins)
            return self.loss(found, indices_tuple=picked).to(descriptors.device, non_blocking=True)

    def lacks(self, origins: Origins) -> str | None:
        """Return what a batch lacks for this loss, in words: two frames near each other, or far from each other."""
        near, far = self.bounds("near")[1], self.bounds("far")[0]
        if not bool(origins.apart().min() <= near):
            return f"two frames up to loss.near={near:g} apart"
        return None if bool((origins.distances() > far).any()) else f"two frames more than loss.far={far:g} apart"

    def _picked(self, given: Tensor, origins: Origins) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return descriptors in main memory, and the pairs that count, or triplets if the miner returns those.

        Pairs are the first and second images of the positive pairs, then those of the negative pairs.
        """
        together = torch.cat([given.float(), origins.distances()], dim=1).cpu()
        found, apart = together.split([given.shape[1], len(given)], dim=1)
        apart = apart.detach()
        near, far = (apart <= self.near).fill_diagonal_(False), apart > self.far
        if self.miner is None:
            return found, (*near.nonzero().T, *far.nonzero().T)
        both = near.any(dim=1) & far.any(dim=1)  # a miner compares the two
        if not bool(both.any()):
            return found, (torch.zeros(0, dtype=torch.int64),) * 4
        mined, descriptors = [], found.detach()
        for image in both.nonzero().flatten().tolist():
            others = (near[image] | far[image]).nonzero().flatten()
            same = near[image, others].long()
            rows = self.miner(descriptors[image : image + 1], torch.ones_like(same[:1]), descriptors[others], same)
            # Of a triplet the first, of two pairs the first of each, is the image itself.
            firsts = (0,) if len(rows) == _TRIPLETS else (0, 2)
            mined.append([one + image if at in firsts else others[one] for at, one in enumerate(rows)])
        return found, tuple(torch.cat(column) for column in zip(*mined, strict=True))


class TripletLoss(NearAndFarLoss):
    """Make each image nearer to each of its positives than to each of its negatives, by a margin ([Schroff 2015]).

    The mean over the triplets with a non-zero loss of max(|d_a - d_p| - |d_a - d_n| + margin, 0).

    Args:
        settings: see `siamloc.models.registry.Triplet`.

    Example:
        >>> TripletLoss(miner="batch_hard", distance="cosine", margin=0.1).settings["miner"]
        'batch_hard'
    """

    @takes(Triplet)
    def __init__(self, settings: Triplet) -> None:
        super().__init__("triplet", "TripletMarginLoss", settings)

    def active(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Return the share of triplets with a non-zero loss, a scalar; 0 if there are no triplets.

        With a miner, only triplets that it picks count.
        """
        with torch.no_grad(), torch.autocast(device_type=descriptors.device.type, enabled=False):
            found, picked = self._picked(descriptors, origins)
            distance = self.loss.distance
            if len(picked) == _TRIPLETS:
                image, near, far = picked
            else:
                one, other = (picked[0][:, None] == picked[2]).nonzero().T
                image, near, far = picked[0][one], picked[1][one], picked[3][other]
            apart = distance(found)
            gaps = distance.margin(apart[image, near], apart[image, far])
            share = (gaps + self.loss.margin > 0).sum() / max(len(gaps), 1)
        return share.to(descriptors.device, non_blocking=True)


class _PairLoss(NearAndFarLoss):
    """Base of the losses that add up over the pairs of each image."""

    steepest = 1.0  # roughly the largest slope of the loss of an image in the similarity of a pair

    def _picked(self, given: Tensor, origins: Origins) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return descriptors and pairs as the base class does; a lone positive and a lone negative pair appear twice.

        For one pair of each kind, which miners often leave of a small batch, the library gives a loss of 0. A repeated
        pair counts once.
        """
        found, picked = super()._picked(given, origins)
        return found, tuple(column.repeat(2) for column in picked) if len(picked[0]) == len(picked[-1]) == 1 else picked

    def active(self, descriptors: Tensor, origins: Origins) -> Tensor:
        """Return the share of pairs (an image, and one near it or far from it) that contribute to learning.

        No pair has a loss of exactly 0: pairs count if their gradient is above a thousandth of its maximum. With a
        miner, only pairs that it picks count; 0 if there are none.
        """
        with torch.enable_grad(), torch.autocast(device_type=descriptors.device.type, enabled=False):
            found, picked = self._picked(descriptors.detach(), origins)
            pairs = (*picked[:2], picked[0], picked[2]) if len(picked) == _TRIPLETS else picked
            alike = self.loss.distance(found).requires_grad_()
            cost = self.loss.loss_method(alike, pairs)["loss"]["losses"].sum()
            (slope,) = torch.autograd.grad(cost, alike)
        of_pairs = slope[torch.cat([pairs[0], pairs[2]]), torch.cat([pairs[1], pairs[3]])]
        share = (of_pairs.abs() > _LEAST_SLOPE * self.steepest).sum() / max(len(of_pairs), 1)
        return share.to(descriptors.device, non_blocking=True)


class CircleLoss(_PairLoss):
    """Pull positives and push negatives the more, the farther they are from their targets ([Sun 2020]).

    The mean over the images i with a non-zero loss of log(1 + sum_n exp(gamma [s_n + m]+ (s_n - m)) times
    sum_p exp(-gamma [1 + m - s_p]+ (s_p - 1 + m))), with the similarities s to the negatives and positives of i.

    Args:
        settings: see `siamloc.models.registry.Circle`.
    """

    @takes(Circle)
    def __init__(self, settings: Circle) -> None:
        super().__init__("circle", "CircleLoss", settings)
        self.steepest = float(settings.gamma)


class MultiSimilarityLoss(_PairLoss):
    """Weigh each pair by how it compares with the other pairs of its image ([Wang 2019]).

    The mean over the images i of log(1 + sum_p exp(-alpha (s_p - base))) / alpha
    + log(1 + sum_n exp(beta (s_n - base))) / beta, with the similarities s to the positives p and the negatives n of i.
    For distances the signs are reversed.

    Args:
        settings: see `siamloc.models.registry.MultiSimilarity`.
    """

    @takes(MultiSimilarity)
    def __init__(self, settings: MultiSimilarity) -> None:
        super().__init__("multi_similarity", "MultiSimilarityLoss", settings)
