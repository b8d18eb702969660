"""Where the images of a batch come from, and what losses over all its pairs have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from siamloc.errors import DataError
from siamloc.settings import Settings


@dataclass(frozen=True)
class Origins:
    """Where the images of a batch come from, one entry for each of N images, on the device of the descriptors.

    Attributes:
        xy: (N, 2) floating point, in the unit of the positions, from the middle of the building; NaN where unknown.
        building: (N,) whole numbers.
        room: (N,) whole numbers, those of two buildings different; negative where unknown.
        frame: (N,) whole numbers: a frame that is drawn twice has the same one.
        theta: (N,) headings in rad, NaN where unknown; None where nobody asks for them.
    """

    xy: Tensor
    building: Tensor
    room: Tensor
    frame: Tensor
    theta: Tensor | None = None

    def distances(self) -> Tensor:
        """Return the distances (N, N): infinite between buildings, NaN where a position is unknown."""
        apart = torch.linalg.vector_norm(self.xy[:, None] - self.xy[None], dim=2)
        return torch.where(self.building[:, None] == self.building[None], apart, math.inf)

    def same_room(self) -> Tensor:
        """Return (N, N) bool: True where both show the same known room."""
        return (self.room[:, None] == self.room[None]) & (self.room >= 0)[:, None]

    def other_room(self) -> Tensor:
        """Return (N, N) bool: True where the rooms are known and differ."""
        return (self.room[:, None] != self.room[None]) & (self.room >= 0)[:, None] & (self.room >= 0)[None]


class ScheduledLoss(nn.Module):
    """Base of losses of which a number may change along the training: with `sigma_start` that is `sigma`."""

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        starts = {key: value for key, value in settings.plain().items() if key.endswith("_start") and value is not None}
        names = {key.removesuffix("_start"): value for key, value in starts.items()}
        self._courses = {name: (start, getattr(settings, name)) for name, start in names.items()}

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the most that a number is along the training."""
        course = self._courses.get(name, (getattr(self, name),))
        return min(course), max(course)

    def progress(self, share: float) -> None:
        """Set what changes to what it is after a share of the training, from 0 in the first step to 1 in the last."""
        for name, (first, last) in self._courses.items():
            setattr(self, name, float(first ** (1 - share) * last**share))


def check_batch(descriptors: Tensor, origins: Origins) -> None:
    """Raise DataError unless there is a descriptor (N, D) for each of N origins."""
    if descriptors.ndim != 2 or 0 in descriptors.shape or origins.xy.shape != (len(descriptors), 2):
        raise DataError(
            "a loss over a batch needs descriptors (N, D) and as many origins, "
            f"got {tuple(descriptors.shape)} and {tuple(origins.xy.shape)}"
        )
