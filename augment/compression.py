"""What JPEG compression does to images (ITU-T T.81), as tensor operations for a GPU; see `augment.sensor.Jpeg`."""

from __future__ import annotations

from contextlib import nullcontext
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

# Tables K.1 and K.2 of the standard: steps of the coefficients of brightness and of colour at quality 50.
_BRIGHTNESS = """
16 11 10 16 24 40 51 61     12 12 14 19 26 58 60 55     14 13 16 24 40 57 69 56     14 17 22 29 51 87 80 62
18 22 37 56 68 109 103 77   24 35 55 64 81 104 113 92   49 64 78 87 103 121 120 101 72 92 95 98 112 100 103 99
"""
_COLOUR = """
17 18 24 47 99 99 99 99 18 21 26 66 99 99 99 99 24 26 56 99 99 99 99 99 47 66 99 99 99 99 99 99
99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99 99
"""
QUANTA = tuple(np.array(table.split(), dtype=np.float64) for table in (_BRIGHTNESS, _COLOUR))
_BLOCK = 8
_TO_COLOURS = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
_FROM_COLOURS = ((1.0, 0.0, 1.402), (1.0, -0.344136, -0.714136), (1.0, 1.772, 0.0))


def compressed(batch: Tensor, brightness: Tensor, colour: Tensor) -> Tensor:
    """Compress and decode images, in float32 even under autocast.

    Args:
        batch: (B, 3, H, W), RGB in [0, 1].
        brightness: (B, 64, 1, 1) steps of the coefficients of each block, row by row.
        colour: the same of the two colours.
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
