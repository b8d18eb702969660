"""Turning the robot on the spot ([T] 5.3.2): the panorama's columns move, nothing is lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import ceil, floor, pi
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from augment.base import Effect, Params
from augment.brushes import Brush, Frame
from augment.ranges import Range


class Rotate(Effect):
    """Turn the robot: I'(y, x) = I(y, x - s mod W), s whole columns ([T] 5.3.2, figure 5.4 h).

    The parameters are `shift`, s columns to the right, and `heading`, what this adds to the robot's heading: 2 pi
    s / W rad, brought to (-pi, pi], positive when the robot turns left. Exact: turning back gives the same picture.

    Args:
        degrees: of the turn, to the left; the whole columns in between are drawn. 10 ... 350 as published.
        circular: an ordinary camera cannot be turned this way; with False the shift is 0.
    """

    name = "rotate"
    RANGES: ClassVar[Mapping[str, Range]] = {"degrees": Range(10, 350, minimum=-360, maximum=360)}

    def spans(self, height: int, width: int) -> dict[str, Range]:
        """The shift in columns."""
        degrees = self.ranges["degrees"]
        low, high = ceil(degrees.low * width / 360), floor(degrees.high * width / 360)
        if not self.circular:
            low = high = 0
        elif low > high:  # a range narrower than a column
            low = high = round((degrees.low + degrees.high) / 2 * width / 360)
        return {"shift": Range(low, high, neutral=0, whole=True)}

    def complete(self, params: Params, height: int, width: int) -> Params:
        """Add the heading."""
        return {**params, "heading": wrapped(params["shift"] * (2 * pi / width))}

    def limits(self, height: int, width: int) -> dict[str, Range]:
        """Any shift, and the heading."""
        return {"shift": Range(0, 0, whole=True), "heading": Range(0, 0)}

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame the move of its columns."""
        return [[partial(_turn, int(shift) % width)] if int(shift) % width else [] for shift in params["shift"]]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the batch with moved columns."""
        width = batch.shape[3]
        columns = torch.arange(width, device=batch.device)
        source = (columns - params["shift"].to(batch.device).view(-1, 1)) % width
        return batch.gather(3, source.view(-1, 1, 1, width).expand_as(batch))


def wrapped(angle: Tensor) -> Tensor:
    """Return angles in (-pi, pi]."""
    return pi - (pi - angle) % (2 * pi)


def _turn(shift: int, frame: Frame) -> None:
    frame[:] = np.concatenate([frame[:, :, -shift:], frame[:, :, :-shift]], axis=2)
