"""Find out what a batch lacks that its loss cannot learn without."""

from __future__ import annotations

import torch

from siamloc.models.batch_losses import MetricCalibratedLoss, SoftContrastiveLoss
from siamloc.models.near_and_far import NearAndFarLoss
from siamloc.models.origins import Origins


def what_is_lacking(loss: object, origins: Origins) -> str | None:
    """Describe which images a batch lacks for its loss, and what to do; None if nothing is missing or it is unknown.

    Two images count only if they are different frames, by their numbers among the origins.

    Example:
        >>> from siamloc.models import TripletLoss
        >>> origins = Origins(torch.tensor([[0.0, 0], [3, 0]]), torch.zeros(2), torch.zeros(2), torch.arange(2))
        >>> what_is_lacking(TripletLoss(near=0.5), origins).partition(":")[0]
        'two frames up to loss.near=0.5 apart, the nearest are 3 apart'
    """
    if isinstance(loss, SoftContrastiveLoss):
        return None if bool(loss.positives(origins).any()) else _without_neighbours(loss, origins)
    apart, different = origins.distances(), origins.frame[:, None] != origins.frame[None]
    if isinstance(loss, MetricCalibratedLoss):
        cap = loss.bounds("cap")[1]
        if not bool(((apart < cap) & different).any()):
            return f"two frames less than loss.cap={cap:g} apart, {_nearest(origins, 'loss.cap')}"
    if isinstance(loss, NearAndFarLoss):
        near, far = loss.bounds("near")[1], loss.bounds("far")[0]
        if not bool(((apart <= near) & different).any()):
            return f"two frames up to loss.near={near:g} apart, {_nearest(origins, 'loss.near')}"
        if not bool((apart > far).any()):
            return f"two frames more than loss.far={far:g} apart: set loss.far smaller"
    return None


def _without_neighbours(loss: SoftContrastiveLoss, origins: Origins) -> str:
    if loss.room == 1:
        return (
            "two frames of one room, which loss.room=1 needs: give the rooms more frames, draw several images of a "
            "place (pairs.images), or set loss.room lower"
        )
    rooms = f"of one room (loss.room={loss.room:g}), or " if loss.room else ""
    return f"two frames {rooms}near enough for loss.sigma={loss.sigma:g}, {_nearest(origins, 'loss.sigma')}"


def _nearest(origins: Origins, key: str) -> str:
    """Describe how near the frames come to each other, and what to do if that is not enough."""
    apart = origins.distances()[origins.frame[:, None] != origins.frame[None]]
    known = apart[torch.isfinite(apart)]
    least = f"the nearest are {float(known.min()):.3g} apart" if len(known) else "no two of a building with positions"
    return (
        f"{least}: set {key} larger, draw frames nearer each other (pairs.images above 1 within a larger pairs.radius, "
        "or pairs.near above 0), or let an augmentation make views of one image"
    )
