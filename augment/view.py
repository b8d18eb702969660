"""Another position and direction of the camera: the image moves, grows and rolls."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor

from augment.base import Effect
from augment.ranges import Range


class View(Effect):
    """Move, scale and roll the image, as by a camera in a slightly different place; parts beyond the image are black.

    With `circular=False` the image is moved by `across` W and `down` H, scaled by `zoom` stretch across and by
    `zoom` / stretch down, and rolled about its middle: for ordinary and fisheye cameras on robots that do not drive
    in the same tracks. A panorama is moved and scaled in its rows alone, and the roll of the robot towards
    `column` moves the rows of a column by (W / 2 pi) roll cos(azimuth), the azimuth from `column`; its columns are
    moved by `rotate`. Linear between pixels.

    Args:
        across: shift to the right, as a share of the width.
        down: shift downwards, as a share of the height.
        zoom: above 1 for an image that grows.
        stretch: above 1 for an image that grows more across than down.
        roll: angle in degrees.
    """

    name = "view"
    moves = True
    RANGES: ClassVar[Mapping[str, Range]] = {
        "across": Range(-0.2, 0.2, minimum=-1, maximum=1, neutral=0),
        "down": Range(-0.08, 0.08, minimum=-1, maximum=1, neutral=0),
        "zoom": Range(0.8, 1.25, minimum=0.1, maximum=10, neutral=1, log=True),
        "stretch": Range(0.87, 1.15, minimum=0.1, maximum=10, neutral=1, log=True),
        "roll": Range(-7, 7, minimum=-180, maximum=180, neutral=0),
    }

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the range of `column`, the column towards which a panorama rolls."""
        return {"column": Range(0, width - 1 if self.circular else 0, whole=True)}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch as the moved, scaled and rolled camera would see it."""
        p = {key: value[..., 0] for key, value in values.items()}  # (b, 1, 1)
        height, width = batch.shape[2:]
        rows = torch.arange(height, device=batch.device, dtype=torch.float32).view(1, -1, 1) - (height - 1) / 2
        columns = torch.arange(width, device=batch.device, dtype=torch.float32).view(1, 1, -1)
        roll, down = p["roll"] * (pi / 180), p["down"] * height
        if self.circular:
            azimuth = ((columns - p["column"]) % width) * (2 * pi / width)
            tall = p["zoom"] / p["stretch"]
            return _along_columns(batch, (rows - down - roll * azimuth.cos() * (width / (2 * pi))) / tall)
        aside, below = columns - (width - 1) / 2 - p["across"] * width, rows - down
        x = (roll.cos() * aside + roll.sin() * below) / (p["zoom"] * p["stretch"])
        y = (roll.cos() * below - roll.sin() * aside) / (p["zoom"] / p["stretch"])
        grid = torch.stack([x * (2 / width), y * (2 / height)], dim=-1)
        return F.grid_sample(batch, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def _along_columns(batch: Tensor, rows: Tensor) -> Tensor:
    """Sample each column at rows (B, H, W) from the middle row; linear between pixels, black beyond them."""
    height = batch.shape[2]
    rows = rows + (height - 1) / 2
    first = rows.floor()
    part = rows - first
    found = torch.zeros_like(batch)
    for row, weight in ((first, 1 - part), (first + 1, part)):
        there = (row >= 0) & (row < height)
        values = batch.gather(2, row.clamp(0, height - 1).long()[:, None].expand_as(batch))
        found += values * (weight * there)[:, None]
    return found
