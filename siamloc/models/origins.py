"""Where the images of a batch come from, and the base of losses over all its pairs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from foundation.settings import Settings
from siamloc.errors import DataError


@dataclass(frozen=True)
class Origins:
    """Where the images of a batch come from: one entry for each of N images, on the device of the descriptors.

    Attributes:
        xy: (N, 2) floating point, in the unit of the positions, relative to the middle of the building; NaN if unknown.
        building: (N,) whole numbers.
        room: (N,) whole numbers, different across buildings; negative if unknown.
        frame: (N,) whole numbers: a frame that is drawn twice has the same number.
        theta: (N,) headings in rad, NaN if unknown; None if not needed.
        deviation: (N, 2) standard deviations of each coordinate of the positions, in their unit, and of the headings,
            in rad; None if positions and headings are exact. They count as independent from frame to frame.
        overlap: (N, N) share of the surfaces that two images have in common, from 0 to 1: 0 between buildings, NaN
            where unknown; None if it is unknown for all images.
        taught: (N, T) descriptors of the images by the teacher of a `DistillationLoss`; None for other losses.
    """

    xy: Tensor
    building: Tensor
    room: Tensor
    frame: Tensor
    theta: Tensor | None = None
    overlap: Tensor | None = None
    deviation: Tensor | None = None
    taught: Tensor | None = None

    def distances(self) -> Tensor:
        """Return the distances between images (N, N): infinite between buildings, NaN where a position is unknown.

        Of positions with deviations, they are the roots of the mean squared distances: two frames at one point, each of
        them give or take 10 cm along x and along y, are 20 cm apart.
        """
        apart = torch.linalg.vector_norm(self.xy[:, None] - self.xy[None], dim=2)
        if self.deviation is not None:
            variance, other = self.deviation[:, 0].square(), self.frame[:, None] != self.frame
            apart = (apart.square() + 2 * other * (variance[:, None] + variance)).sqrt()
        return torch.where(self.building[:, None] == self.building[None], apart, math.inf)

    def apart(self) -> Tensor:
        """Return the distances (N, N) between different frames; infinite where unknown and for views of one frame."""
        itself = self.frame[:, None] == self.frame[None]
        return self.distances().nan_to_num(math.inf, posinf=math.inf).masked_fill(itself, math.inf)

    def same_room(self) -> Tensor:
        """Return (N, N) bool: True where two images show the same known room."""
        return (self.room[:, None] == self.room[None]) & (self.room >= 0)[:, None]

    def other_room(self) -> Tensor:
        """Return (N, N) bool: True where two images show different known rooms."""
        return (self.room[:, None] != self.room[None]) & (self.room >= 0)[:, None] & (self.room >= 0)[None]


class ScheduledLoss(nn.Module):
    """Base of losses over batches. Parameters with a start, such as `sigma` with `sigma_start`, change while training.

    Descriptors of another length than 1 are refused, unless the loss sets `unit_length = False`. If it has a method
    `lacks(origins) -> str | None`, a training in which every batch lacks something is refused, too.

    Args:
        name: name of the loss in `siamloc.models.registry.LOSSES`.
        settings: its parameters.
    """

    unit_length: ClassVar[bool] = True

    def __init__(self, name: str, settings: Settings) -> None:
        super().__init__()
        self.settings = {"name": name, **settings.plain()}
        starts = {key: value for key, value in settings.plain().items() if key.endswith("_start") and value is not None}
        names = {key.removesuffix("_start"): value for key, value in starts.items()}
        self._courses = {name: (start, getattr(settings, name)) for name, start in names.items()}

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the smallest and the largest value of a parameter during training, by its name, such as "sigma"."""
        course = self._courses.get(name, (getattr(self, name),))
        return min(course), max(course)

    def progress(self, share: float) -> None:
        """Set the changing parameters for a share of the training, from 0 in the first step to 1 in the last."""
        for name, (first, last) in self._courses.items():
            setattr(self, name, float(first ** (1 - share) * last**share))


def required(batch: Mapping[str, Tensor], keys: Sequence[str], what: str) -> None:
    """Raise DataError unless a batch has all of these keys; `what` names its contents, such as "places"."""
    if missing := [key for key in keys if key not in batch]:
        raise DataError(f"a batch of {what} needs {', '.join(keys)}; missing: {', '.join(missing)}")


def check_batch(descriptors: Tensor, origins: Origins) -> None:
    """Raise DataError unless there is a descriptor (N, D) for each of N origins."""
    if descriptors.ndim != 2 or 0 in descriptors.shape or origins.xy.shape != (len(descriptors), 2):
        raise DataError(
            "a loss over a batch needs descriptors (N, D) and as many origins, "
            f"got {tuple(descriptors.shape)} and {tuple(origins.xy.shape)}"
        )
