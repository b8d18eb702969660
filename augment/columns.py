"""Effects on whole columns: turning the robot on the spot moves them, an obstacle hides them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import ceil, floor, pi
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import Effect, Numbers, Params, as_numbers, places_in
from augment.brushes import Brush, Frame
from augment.ranges import Range

_MOST = 4  # bars
_PLACES = tuple(f"place{number}" for number in range(_MOST))


class Rotate(Effect):
    """Turn the robot on the spot: I'(y, x) = I(y, x - s mod W), s whole columns ([T] 5.3.2, figure 5.4 h).

    The parameters are `shift`, s columns to the right, and `heading`, what this adds to the robot's heading: 2 pi
    s / W rad, wrapped to (-pi, pi], positive when the robot turns left. Exact: turning back gives the same image.

    Args:
        degrees: angle of the turn to the left; whole columns within this range are drawn, or, if it holds none, the one
            nearest to its middle, which may be no turn at all. 10 ... 350 as published.
        circular: the image of an ordinary camera cannot be turned this way; with False the shift is 0.
    """

    name = "rotate"
    moves = True
    RANGES: ClassVar[Mapping[str, Range]] = {"degrees": Range(10, 350, minimum=-360, maximum=360)}

    def spans(self, height: int, width: int) -> dict[str, Range]:
        """Return the range of `shift`, in whole columns."""
        degrees = self.ranges["degrees"]
        low, high = ceil(degrees.low * width / 360), floor(degrees.high * width / 360)
        if not self.circular:
            low = high = 0
        elif low > high:  # a range narrower than a column
            low = high = round((degrees.low + degrees.high) / 2 * width / 360)
        return {"shift": Range(low, high, neutral=0, whole=True)}

    def complete(self, params: Params, count: int, height: int, width: int) -> Params:
        """Add the parameter `heading`, in rad, that follows from the shift."""
        return {**params, "heading": wrapped(params["shift"].float() * (2 * pi / width))}

    def active(self, params: Mapping[str, Tensor]) -> NDArray[np.bool_]:
        """Return which frames (B,) are turned."""
        return (params["shift"] != 0).numpy()

    def limits(self, height: int, width: int) -> dict[str, Range]:
        """Return the limits of `shift` and `heading`: none."""
        return {"shift": Range(0, 0, whole=True), "heading": Range(0, 0)}

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Move the columns of a frame to the right by its shift."""
        shift = int(params["shift"]) % frame.shape[2]
        frame[:] = np.concatenate([frame[:, :, -shift:], frame[:, :, :-shift]], axis=2)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the shift to the right in columns, in [0, W)."""
        return {"shift": params["shift"] % width}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with the columns of each frame moved to the right by its shift."""
        _, columns = places_in(*batch.shape[2:], batch.device)
        source = ((columns - values["shift"]) % batch.shape[3]).long()
        return batch.gather(3, source.expand_as(batch))


class Occlude(Effect):
    """Hide a share of the columns behind vertical bars of one grey level ([T] 3.4.2).

    The frame is divided into as many sectors as there are bars, counted from `column`. Each sector has one bar, at an
    independent place; all are equally wide. Bars therefore never overlap, and each hides its part of the share, to half
    a column.

    Args:
        share: share of the columns that are hidden. 5 ... 40 % as published.
        bars: number of bars, 1 ... 4.
        level: grey level of the bars, 0 ... 255; black as published.
        circular: sectors begin anywhere and wrap around.
    """

    name = "occlude"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "share": Range(0.05, 0.4, minimum=0, maximum=1, neutral=0),
        "bars": Range(1, _MOST, minimum=1, maximum=_MOST, whole=True),
        "level": Range(0, 0, minimum=0, maximum=255, whole=True),
    }

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of the first sector's first column and of each bar's place in its sector, from 0 to 1."""
        column = Range(0, width - 1 if self.circular else 0, whole=True)
        return {"column": column, **{place: Range(0, 1, minimum=0, maximum=1) for place in _PLACES}}

    def brushes(self, params: Params, height: int, width: int) -> list[Brush]:
        """Return for each frame the function that fills the columns of its bars."""
        starts, lengths = (value.T.astype(int).tolist() for value in _bars(as_numbers(params), width))
        return [partial(_fill, *bars) for bars in zip(starts, lengths, params["level"].tolist(), strict=True)]

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the first column and the width of each bar, in columns, and the grey level of the bars in [0, 1]."""
        starts, lengths = _bars(params, width)
        return {"start": starts, "length": lengths, "level": params["level"] / 255}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with the columns of the bars in the bars' grey level."""
        _, columns = places_in(*batch.shape[2:], batch.device)
        hidden = ((columns - values["start"]) % batch.shape[3] < values["length"]).any(dim=1, keepdim=True)
        return torch.where(hidden, values["level"], batch)


def wrapped(angle: Tensor) -> Tensor:
    """Wrap angles in rad to (-pi, pi]."""
    return pi - (pi - angle) % (2 * pi)


def _bars(params: Numbers, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the first column and the width of each bar, whole numbers (4, B); absent bars have width 0."""
    bars, number = params["bars"], np.arange(_MOST)[:, None]
    place = np.stack([params[key] for key in _PLACES])
    sector = number * width // bars
    room = (number + 1) * width // bars - sector
    length = np.minimum(np.floor(params["share"] * width / bars + 0.5), room)
    start = sector + np.minimum(np.floor(place * (room - length + 1)), room - length)
    return (start + params["column"]) % width, np.where(number < bars, length, 0)


def _fill(starts: list[int], lengths: list[int], level: int, frame: Frame) -> None:
    for start, length in zip(starts, lengths, strict=True):
        frame[:, :, start : start + length] = level
        frame[:, :, : max(start + length - frame.shape[2], 0)] = level
