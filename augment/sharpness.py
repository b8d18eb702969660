"""Sharpening, blur, and the blur of a turning robot: convolutions that wrap around in azimuth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from augment.base import Effect, Numbers, places_in
from augment.brushes import Frame
from augment.errors import AugmentError
from augment.ranges import Range

_WHOLE = 1 << 20  # steps from black to white


class Sharpen(Effect):
    """Crisper edges: I' = I + strength (m * I - I), m = [0 -1 0; -1 5 -1; 0 -1 0] ([T] 5.3.2, table 5.3).

    Columns wrap around; the first and the last row are repeated beyond the border.

    Args:
        strength: 1 as published; 0 leaves the image as it is.
    """

    name = "sharpen"
    RANGES: ClassVar[Mapping[str, Range]] = {"strength": Range(1, 1, minimum=0, maximum=10, neutral=0)}

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Sharpen a frame."""
        s = params["strength"]
        mask = np.array([[0, -s, 0], [-s, 1 + 4 * s, -s], [0, -s, 0]], dtype=np.float32)
        _filter(frame, _convolution(mask), 1, self.circular)

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the sharpened images: the originals with a scaled Laplacian added."""
        wide = _extended(batch, 1, 1, self.circular)
        across = wide[:, :, 1:-1, :-2] + wide[:, :, 1:-1, 2:]
        down = wide[:, :, :-2, 1:-1] + wide[:, :, 2:, 1:-1]
        return torch.addcmul(batch, values["strength"], 4 * batch - across - down)


class Blur(Effect):
    """An image out of focus: I' = I + strength (m * I - I), m a box of size x size ones over its area.

    Columns wrap around; the first and the last row are repeated beyond the border ([T] 5.3.2, table 5.3).

    Args:
        strength: 1 as published; 0 leaves the image as it is.
        size: pixels, odd; 5 as published.
    """

    name = "blur"
    RANGES: ClassVar[Mapping[str, Range]] = {"strength": Range(1, 1, minimum=0, maximum=1, neutral=0)}
    OPTIONS: ClassVar[Mapping[str, Any]] = {"size": 5}

    def __init__(self, **params: Any) -> None:
        super().__init__(**params)
        size = self.options["size"]
        if isinstance(size, bool) or not isinstance(size, int) or size < 1 or size % 2 == 0:
            raise AugmentError(f"size of {self.name} must be an odd number of pixels, got {size!r}")

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Blur a frame with a box filter, mixed with the original by strength."""
        size, strength = self.options["size"], params["strength"]
        mask = np.full((size, size), strength / size**2, dtype=np.float32)
        mask[size // 2, size // 2] += 1 - strength
        work = _box(size, size) if strength == 1 else _convolution(mask)
        _filter(frame, work, size // 2, self.circular)

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the mean of each pixel's neighbours, mixed with the original by strength."""
        size = self.options["size"]
        wide = _extended(batch, size // 2, size // 2, self.circular)
        mean = F.avg_pool2d(F.avg_pool2d(wide, (1, size), 1), (size, 1), 1)
        return torch.lerp(batch, mean, values["strength"])


class MotionBlur(Effect):
    """The robot turns while the shutter is open: I'(y, x) = mean of I(y, x + i), i = -r ... r, n = 2 r + 1.

    Args:
        length: n in columns of a frame of 512 columns, rounded to an odd number; it scales with the width of the
            frame. 1 leaves the image as it is.
    """

    name = "motion_blur"
    RANGES: ClassVar[Mapping[str, Range]] = {"length": Range(3, 15, minimum=1, maximum=255, neutral=1)}

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Blur a frame along its rows."""
        length = _odd(params["length"], frame.shape[2])
        _filter(frame, _box(length, 1), length // 2, self.circular)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the radius r of the blur, in columns."""
        return {"radius": np.array([_odd(length, width) // 2 for length in params["length"].tolist()])}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the mean of n pixels along the rows, from differences of cumulative sums."""
        before = _odd(self.ranges["length"].maximum, batch.shape[3]) // 2 + 1
        # Whole numbers, whose sums have no rounding, and do not depend on the order of their addition.
        sums = (_extended(batch, before, 0, self.circular) * _WHOLE).round().long().cumsum(3)
        _, columns = places_in(*batch.shape[2:], batch.device)
        ends = (columns + (values["radius"] + before), columns - (values["radius"] + (1 - before)))
        last, first = (sums.gather(3, end.long().expand_as(batch)) for end in ends)
        return (last - first) / (_WHOLE * (2 * values["radius"] + 1))


def _odd(length: float, width: int) -> int:
    return 2 * round((length * width / 512 - 1) / 2) + 1


def _extended(batch: Tensor, columns: int, rows: int, circular: bool) -> Tensor:
    """Extend a batch by columns on both sides and by rows above and below."""
    width = batch.shape[3]
    if circular and columns <= width:
        batch = torch.cat([batch[..., width - columns :], batch, batch[..., :columns]], dim=3)
    elif circular:
        index = torch.arange(-columns, width + columns, device=batch.device) % width
        batch = batch.index_select(3, index)
    else:
        batch = F.pad(batch, (columns, columns, 0, 0), mode="replicate")
    return F.pad(batch, (0, 0, rows, rows), mode="replicate") if rows else batch


def _filter(frame: Frame, work: Callable[[Frame], Any], columns: int, circular: bool) -> None:
    """Filter the channels of a frame, extended on both sides by columns beyond the seam, or by repeating the edge."""
    border = cv2.BORDER_WRAP if circular else cv2.BORDER_REPLICATE
    for channel in frame:
        wide = cv2.copyMakeBorder(channel, 0, 0, columns, columns, border)
        channel[:] = work(wide)[:, columns : columns + channel.shape[1]]


def _convolution(mask: np.ndarray) -> Callable[[Frame], Any]:
    return partial(cv2.filter2D, ddepth=-1, kernel=mask, borderType=cv2.BORDER_REPLICATE)


def _box(columns: int, rows: int) -> Callable[[Frame], Any]:
    return partial(cv2.blur, ksize=(columns, rows), borderType=cv2.BORDER_REPLICATE)
