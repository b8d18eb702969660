"""Effects of the camera's electronics: noise and compression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import ClassVar

import cv2
import numpy as np
import torch
from torch import Tensor

from augment.base import Effect, Params, Range, column_of
from augment.brushes import Brush, Frame, flat

_TABLE = 1 << 21


class Noise(Effect):
    """Gaussian noise: I' = I + n, n ~ N(0, variance) on [0, 1], separately for each pixel and channel ([T] 3.4.2).

    n = sqrt(variance) (t(a) + t(b)) / sqrt 2: the normalized sum of two stretches of one fixed table of 2^21 normal
    numbers, which begin at `first` and `second`. Every device thus gets the same noise, from two numbers per frame.

    Args:
        variance: variance for images in [0, 1]. .0025 ... .05 as published.
    """

    name = "noise"
    RANGES: ClassVar[Mapping[str, Range]] = {"variance": Range(0.0025, 0.05, minimum=0, maximum=1, neutral=0)}

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Where the two stretches begin, and how far the noise is turned."""
        return {
            "first": Range(0, _TABLE // 2 - 1, minimum=0, maximum=_TABLE - 1, whole=True),
            "second": Range(_TABLE // 2, _TABLE - 1, minimum=0, maximum=_TABLE - 1, whole=True),
            "column": Range(0, 0, whole=True),
        }

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame the addition of its noise."""
        stretches = zip(*(params[key].tolist() for key in ("variance", "first", "second", "column")), strict=True)
        return [[partial(_add_noise, *stretch)] if stretch[0] else [] for stretch in stretches]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the batch with its noise."""
        table = _normal(str(batch.device))
        shape = batch.shape[1:]
        noise = torch.empty_like(batch, memory_format=torch.contiguous_format)
        places = zip(*(params[key].tolist() for key in ("first", "second", "column")), strict=True)
        for frame, (first, second, column) in zip(noise, places, strict=True):
            torch.add(_stretch(table, first, shape), _stretch(table, second, shape), out=frame)
            if column:
                frame.copy_(frame.roll(int(column), dims=2))
        return batch + column_of(params["variance"] / 2, batch).sqrt() * noise


class Jpeg(Effect):
    """Compression, as by a camera or for a slow link: I' = I + strength (jpeg(I) - I).

    jpeg(I) is the 8-bit image, compressed at the given quality and decoded again (opencv's codec, 4:2:0). Images on a
    GPU are copied to main memory and back. Blocks do not wrap around the seam.

    Args:
        quality: 1 ... 100, as libjpeg defines it.
        strength: 1 for the compressed image, 0 for the original.
    """

    name = "jpeg"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "quality": Range(10, 60, minimum=1, maximum=100, whole=True),
        "strength": Range(1, 1, minimum=0, maximum=1, neutral=0),
    }

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame the pass through the codec."""
        pairs = zip(params["quality"].tolist(), params["strength"].tolist(), strict=True)
        return [[partial(_compress, int(quality), strength)] if strength else [] for quality, strength in pairs]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the compressed images, mixed by strength."""
        frames = (batch.detach() * 255).round().to(torch.uint8).cpu().contiguous().numpy().copy()
        for frame, quality in zip(frames, params["quality"].tolist(), strict=True):
            _compress(int(quality), 1.0, frame)
        done = torch.from_numpy(frames).to(batch.device).float() / 255
        return batch + column_of(params["strength"], batch) * (done - batch)


@lru_cache(maxsize=4)
def _normal(device: str) -> Tensor:
    return torch.randn(_TABLE, generator=torch.Generator().manual_seed(20230705)).to(device)


def _stretch(table: Tensor, start: int, shape: torch.Size) -> Tensor:
    count = shape.numel()
    rest = start + count - len(table)
    if rest <= 0:
        return table[start : start + count].view(shape)
    return torch.cat([table[start:], *[table] * (rest // len(table)), table[: rest % len(table)]]).view(shape)


def _add_noise(variance: float, first: int, second: int, column: int, frame: Frame) -> None:
    table = _normal("cpu")
    scale = 255 * (variance / 2) ** 0.5
    shape = torch.Size(flat(frame).shape)
    a, b = _stretch(table, first, shape).numpy(), _stretch(table, second, shape).numpy()
    noise = cv2.addWeighted(a, scale, b, scale, 0)
    if column:
        noise = np.roll(noise, column, axis=1)
    cv2.add(flat(frame), noise, dst=flat(frame), dtype=cv2.CV_8U)


def _compress(quality: int, strength: float, frame: Frame) -> None:
    packed = cv2.imencode(".jpg", cv2.merge(list(frame[::-1])), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    planes = cv2.split(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR)))[::-1]
    for channel in range(3):
        if strength == 1:
            frame[channel] = planes[channel]
        else:
            cv2.addWeighted(frame[channel], 1 - strength, planes[channel], strength, 0, dst=frame[channel])
