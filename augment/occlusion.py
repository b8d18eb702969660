"""Something stands between the camera and the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

import torch
from torch import Tensor

from augment.base import Effect, Params, column_of
from augment.brushes import Brush, Frame
from augment.ranges import Range

_MOST = 4
_PLACES = tuple(f"place{number}" for number in range(_MOST))


class Occlude(Effect):
    """Vertical bars of one grey hide a share of the columns ([T] 3.4.2).

    The frame is divided into as many sectors as there are bars, counted from `column`; in each sector stands one
    bar of equal width, at a place of its own in it. So bars never overlap and the share is what it says, down to
    whole columns.

    Args:
        share: of the columns that are hidden. 5 ... 40 % as published.
        bars: how many, 1 ... 4.
        level: their grey, 0 ... 255; black as published.
        circular: sectors begin anywhere and wrap around.
    """

    name = "occlude"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "share": Range(0.05, 0.4, minimum=0, maximum=1, neutral=0),
        "bars": Range(1, _MOST, minimum=1, maximum=_MOST, whole=True),
        "level": Range(0, 0, minimum=0, maximum=255, whole=True),
    }

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Where the first sector begins, and where each bar stands in its sector."""
        column = Range(0, width - 1 if self.circular else 0, whole=True)
        return {"column": column, **{place: Range(0, 1, minimum=0, maximum=1) for place in _PLACES}}

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame what fills its bars."""
        starts, lengths = (value.tolist() for value in _bars(params, width))
        frames = zip(starts, lengths, params["level"].tolist(), strict=True)
        return [[partial(_fill, list(zip(start, length, strict=True)), level)] for start, length, level in frames]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the batch behind the bars."""
        width = batch.shape[3]
        starts, lengths = (value[..., None] for value in _bars(params, width))
        hidden = ((torch.arange(width) - starts) % width < lengths).any(dim=1).to(batch.device)
        return torch.where(hidden[:, None, None], column_of(params["level"], batch) / 255, batch)


def _bars(params: Params, width: int) -> tuple[Tensor, Tensor]:
    """Return first columns and numbers of columns of the bars, each (B, 4) int64; bars that are not there have 0."""
    bars = params["bars"].view(-1, 1)
    number = torch.arange(_MOST)
    place = torch.stack([params[key] for key in _PLACES], dim=1)
    sector = number * width // bars
    room = (number + 1) * width // bars - sector
    wanted = (params["share"].double().view(-1, 1) * width / bars + 0.5).floor().long()
    length = torch.minimum(wanted, room)
    start = sector + torch.minimum((place * (room - length + 1)).long(), room - length)
    return (start + params["column"].view(-1, 1)) % width, torch.where(number < bars, length, 0)


def _fill(bars: list[tuple[int, int]], level: int, frame: Frame) -> None:
    width = frame.shape[2]
    for start, length in bars:
        frame[:, :, start : start + length] = level
        if start + length > width:
            frame[:, :, : start + length - width] = level
