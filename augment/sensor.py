"""Effects of the camera's electronics: noise and compression."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from functools import lru_cache
from typing import ClassVar

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from augment.base import Effect, Numbers
from augment.brushes import Frame, flat
from augment.columns import Rotate
from augment.ranges import Range

_TABLE = 1 << 21
# Tables K.1 and K.2 of the standard: steps of the coefficients of brightness and of colour at quality 50.
_BRIGHTNESS = """
16 11 10 16 24 40 51 61     12 12 14 19 26 58 60 55     14 13 16 24 40 57 69 56     14 17 22 29 51 87 80 62
18 22 37 56 68 109 103 77   24 35 55 64 81 104 113 92   49 64 78 87 103 121 120 101 72 92 95 98 112 100 103 99
"""
_COLOUR = """
17 18 24 47 99 99 99 99 18 21 26 66 99 99 99 99 24 26 56 99 99 99 99 99 47 66 99 99 99 99 99 99
99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99
"""
_QUANTA = tuple(np.array(table.split(), dtype=np.float64) for table in (_BRIGHTNESS, _COLOUR))
_BLOCK = 8
_TO_COLOURS = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
_FROM_COLOURS = ((1.0, 0.0, 1.402), (1.0, -0.344136, -0.714136), (1.0, 1.772, 0.0))


class Noise(Effect):
    """Gaussian noise: I' = I + n, n ~ N(0, variance) on [0, 1], separately for each pixel and channel ([T] 3.4.2).

    The channels of a pixel differ, as those of a sensor do; the luma of a frame has 0.447 of the variance. Queries of a
    test get noise of exactly that variance in luma from `analytic.disturb.noise`.

    n = sqrt(variance) (t(a) + t(b)) / sqrt 2: the normalized sum of two stretches of one fixed table of 2^21 normal
    numbers, which begin at `first` and `second`. Every device thus gets the same noise, from two numbers per frame.

    Args:
        variance: variance for images in [0, 1]. .0025 ... .05 as published.
    """

    name = "noise"
    RANGES: ClassVar[Mapping[str, Range]] = {"variance": Range(0.0025, 0.05, minimum=0, maximum=1, neutral=0)}

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of the starts of the two stretches in the table, and of the noise's shift in columns."""
        return {
            "first": Range(0, _TABLE // 2 - 1, minimum=0, maximum=_TABLE - 1, whole=True),
            "second": Range(_TABLE // 2, _TABLE - 1, minimum=0, maximum=_TABLE - 1, whole=True),
            "column": Range(0, 0, whole=True),
        }

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Add noise to a frame."""
        scale, stretches = 255 * (params["variance"] / 2) ** 0.5, _stretches("cpu", frame.size)
        a, b = (stretches[int(params[start])].view(flat(frame).shape).numpy() for start in ("first", "second"))
        noise = cv2.addWeighted(a, scale, b, scale, 0)
        if params["column"]:
            noise = np.roll(noise, int(params["column"]), axis=1)
        cv2.add(flat(frame), noise, dst=flat(frame), dtype=cv2.CV_8U)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the factor on the sum of the stretches, their starts, and the shift if any frame has one."""
        turn = {"column": params["column"] % width} if params["column"].any() else {}
        starts = np.stack([params["first"], params["second"]])
        return {"scale": (params["variance"] / 2) ** 0.5, "starts": starts, **turn}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with noise added."""
        stretches = _stretches(str(batch.device), batch[0].numel())
        both = stretches.index_select(0, values["starts"].long().flatten())
        noise = both.view(-1, 2, *batch.shape[1:]).sum(dim=1)
        if "column" in values:
            noise = Rotate().render(noise, {"shift": values["column"]})
        return torch.addcmul(batch, values["scale"], noise)


class Jpeg(Effect):
    """Compression, as by a camera or for a slow link: I' = I + strength (jpeg(I) - I).

    jpeg(I) is the 8-bit image, compressed at the given quality and decoded again (4:2:0). In main memory opencv's codec
    does this. A GPU computes the steps of the standard (ITU-T T.81) that lose something, in floating point: colours at
    half the resolution, and the rounding of the coefficients of each block. Blocks do not wrap around the seam.

    Args:
        quality: 1 ... 100, as libjpeg defines it.
        strength: 1 for the compressed image, 0 for the original.
    """

    name = "jpeg"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "quality": Range(10, 60, minimum=1, maximum=100, whole=True),
        "strength": Range(1, 1, minimum=0, maximum=1, neutral=0),
    }

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Compress and decode a frame with opencv's codec."""
        quality, strength = int(params["quality"]), params["strength"]
        packed = cv2.imencode(".jpg", cv2.merge(list(frame[::-1])), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        planes = cv2.split(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR)))[::-1]
        for channel, plane in zip(frame, planes, strict=True):
            channel[:] = plane if strength == 1 else cv2.addWeighted(channel, 1 - strength, plane, strength, 0)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the quantization steps of brightness and of colour for the quality, as libjpeg scales them."""
        quality = params["quality"]
        scale = np.where(quality < 50, np.floor(5000 / quality), 200 - 2 * quality)
        steps = [np.floor((np.outer(table, scale) + 50) / 100).clip(1, 255) for table in _QUANTA]
        return {"quality": quality, "strength": params["strength"], "brightness": steps[0], "colour": steps[1]}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the compressed images, mixed with the originals by strength."""
        if batch.device.type == "cpu":
            frames = (batch * 255).round().to(torch.uint8).numpy()
            for frame, quality in zip(frames, values["quality"].flatten().tolist(), strict=True):
                self.paint({"quality": quality, "strength": 1}, frame)
            done = torch.from_numpy(frames).float() / 255
        else:
            done = compressed(batch, values["brightness"], values["colour"])
        return torch.lerp(batch, done, values["strength"])


@lru_cache(maxsize=4)
def _stretches(device: str, length: int) -> Tensor:
    """Return all stretches of the table as a view (2^21, length): it begins again after its end."""
    generator = torch.Generator().manual_seed(20230705)
    normal = torch.randn(_TABLE, generator=generator, device="cpu", dtype=torch.float32)
    longer = normal.repeat(2 + length // _TABLE)[: _TABLE + length - 1]
    return longer.to(device).unfold(0, length, 1)


def compressed(batch: Tensor, brightness: Tensor, colour: Tensor) -> Tensor:
    """Apply the losses of JPEG compression (ITU-T T.81) to images, on any device, in float32 even under autocast.

    Args:
        batch: (B, 3, H, W), RGB in [0, 1].
        brightness: (B, 64, 1, 1) quantization steps of the 8 x 8 coefficients of a block, row by row.
        colour: (B, 64, 1, 1) quantization steps of the two colour channels.
    """
    height, width = batch.shape[2:]
    there, back, waves, lift = _constants(str(batch.device))
    device = batch.device.type
    with torch.autocast(device, enabled=False) if torch.amp.is_autocast_available(device) else nullcontext():
        levels = torch.einsum("kc,bchw->bkhw", there, (batch * 255).round()).round()
        levels = F.pad(levels, (0, -width % (2 * _BLOCK), 0, -height % (2 * _BLOCK)), mode="replicate")
        light = _rounded(levels[:, :1] - 128, brightness, waves)
        quarters = F.avg_pool2d(levels[:, 1:], 2)  # halves of a level go down and up in turn, as in the codec
        colours = _rounded((quarters + lift.repeat(quarters.shape[3] // 2)).floor(), colour, waves)
        # Bilinear between the middles of the colours' pixels, like the decoder's triangle filter.
        colours = F.interpolate(colours, scale_factor=2, mode="bilinear", align_corners=False).round()
        decoded = torch.cat([light + 128, colours], dim=1)[..., :height, :width]
        return torch.einsum("kc,bchw->bkhw", back, decoded).round().clamp(0, 255) / 255


def _rounded(levels: Tensor, steps: Tensor, waves: Tensor) -> Tensor:
    """Round the cosine coefficients of each block of levels (B, C, H, W) to whole steps."""
    blocks = levels.unflatten(3, (-1, _BLOCK)).unflatten(2, (-1, _BLOCK)).transpose(3, 4)  # (B, C, h, w, 8, 8)
    steps = steps.view(-1, 1, 1, 1, _BLOCK, _BLOCK)
    found = ((waves @ blocks @ waves.T) / steps).round() * steps
    return (waves.T @ found @ waves).round().transpose(3, 4).flatten(4, 5).flatten(2, 3)


@lru_cache(maxsize=4)
@torch.inference_mode(False)
def _constants(device: str) -> tuple[Tensor, ...]:
    """Return the colour transform, its inverse, the cosine transform of 8 values, and how two means are rounded."""
    number = np.arange(_BLOCK)
    waves = np.cos((2 * number + 1) * number[:, None] * np.pi / (2 * _BLOCK)) / 2
    waves[0] /= np.sqrt(2)
    tables = (_TO_COLOURS, _FROM_COLOURS, waves, (0.25, 0.5))
    return tuple(torch.tensor(table, dtype=torch.float32, device=device) for table in tables)
