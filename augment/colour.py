"""Effects that look at a whole frame's histogram or at all colours of a pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

import cv2
import numpy as np
from torch import Tensor

from augment.base import Effect, Params, column_of
from augment.brushes import Brush, Frame
from augment.photometric import look_up
from augment.ranges import Range
from augment.torchvision_compat import ensure_torchvision


class Equalize(Effect):
    """Spread the histogram of each channel evenly ([T] 5.3.2).

    I' = I + strength (eq(I) - I), eq being torchvision's `equalize`: with the cumulative histogram C and the step
    q = (pixels - pixels of the last occupied level) // 255, level i becomes (C(i - 1) + q // 2) // q. Float batches
    are equalized in 256 levels.

    Args:
        strength: 1 as published; below, a mixture with the original.
    """

    name = "equalize"
    RANGES: ClassVar[Mapping[str, Range]] = {"strength": Range(1, 1, minimum=0, maximum=1, neutral=0)}

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame the lookup of the tables that its histograms give."""
        return [[partial(_equalize, strength)] if strength else [] for strength in params["strength"].tolist()]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return torchvision's result, mixed by strength."""
        ensure_torchvision()
        from torchvision.transforms.v2.functional import equalize

        return batch + column_of(params["strength"], batch) * (equalize(batch) - batch)


class Saturate(Effect):
    """Stronger or weaker colours: S' = min(1, c S) in HSV ([T] 5.3.2, figure 5.4 g).

    Hue and value stay, so that no conversion is needed: with V = max(R, G, B) and m = min(R, G, B), each channel
    becomes I' = V - k (V - I), k = min(c, V / (V - m)).

    Args:
        factor: c, above 1 for more colour, 0 for grey. The thesis gives no range.
    """

    name = "saturate"
    RANGES: ClassVar[Mapping[str, Range]] = {"factor": Range(0.2, 2.0, minimum=0, maximum=20, neutral=1)}

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame the formula on its three planes."""
        return [[partial(_saturate, factor)] if factor != 1 else [] for factor in params["factor"].tolist()]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the formula, written so that c = 1 leaves the batch alone to the last bit."""
        value, least = batch.amax(1, keepdim=True), batch.amin(1, keepdim=True)
        limit = value / (value - least).clamp(min=1e-6)
        scale = column_of(params["factor"], batch).minimum(limit)
        grey = value == least
        return batch + ((1 - scale) * (value - batch)).masked_fill(grey, 0)


def _equalize(strength: float, frame: Frame) -> None:
    tables = np.empty((3, 256), dtype=np.uint8)
    levels = np.arange(256)
    for channel in range(3):
        counts = cv2.calcHist([frame[channel]], [0], None, [256], [0, 256]).ravel().astype(np.int64)
        step = (counts.sum() - counts[np.flatnonzero(counts)[-1]]) // 255
        if step == 0:
            tables[channel] = levels
            continue
        before = np.concatenate([[0], counts.cumsum()[:-1]])
        table = np.minimum((before + step // 2) // step, 255)
        tables[channel] = np.rint(levels + strength * (table - levels))
    look_up(tables, frame)


def _saturate(factor: float, frame: Frame) -> None:
    value = np.maximum(np.maximum(frame[0], frame[1]), frame[2])
    if factor < 1:
        for channel in range(3):
            cv2.addWeighted(value, 1 - factor, frame[channel], factor, 0, dst=frame[channel])
        return
    least = np.minimum(np.minimum(frame[0], frame[1]), frame[2])
    scale = np.divide(value, np.maximum(value - least, 1), dtype=np.float32)
    np.minimum(scale, np.float32(factor), out=scale)
    for channel in range(3):
        below = cv2.multiply(value - frame[channel], scale, dtype=cv2.CV_8U)
        np.subtract(value, below, out=frame[channel])
