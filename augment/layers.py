"""`Layer`: effects that add a picture of light to the frame, or multiply the frame by one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import cv2
import torch
from torch import Tensor

from augment.base import Effect, Params, column_of
from augment.brushes import Brush, Frame

# Below this size torch works in one thread, which is what a frame painted in a thread of its own wants.
_BAND = 32768


class Layer(Effect):
    """An effect that is a function of the pixel's place: I' = I + layer, or I' = I layer.

    Attributes:
        additive: the layer counts in levels of 0 ... 255 and is added; else it is a gain.
    """

    additive: ClassVar[bool] = False

    @abstractmethod
    def layer(self, rows: Tensor, columns: Tensor, params: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the layer at pixels.

        Args:
            rows: (..., h, 1).
            columns: (..., 1, w); may lie beyond the seam.
            params: numbers, or tensors (B, 1, 1, 1).
            height: rows of the frame.
            width: columns of the frame.

        Returns:
            (..., h, w), or (..., 3, h, w) if it differs between the colours.
        """

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return what the layer touches: first row, row after the last, first column, column after the last.

        Columns may lie beyond the seam. The whole frame by default.
        """
        return 0, height, 0, width

    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame what lays the layer over it."""
        columns = {key: value.tolist() for key, value in params.items()}
        count = len(next(iter(columns.values())))
        return [
            [partial(self._lay, {key: values[i] for key, values in columns.items()}, height, width)]
            for i in range(count)
        ]

    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the batch with its layers."""
        height, width = batch.shape[2:]
        rows = torch.arange(height, device=batch.device, dtype=torch.float32).view(1, 1, -1, 1)
        columns = torch.arange(width, device=batch.device, dtype=torch.float32).view(1, 1, 1, -1)
        layer = self.layer(
            rows, columns, {key: column_of(value, batch) for key, value in params.items()}, height, width
        )
        return batch + layer / 255 if self.additive else batch * layer

    def offset(self, columns: Tensor, column: Any, width: int) -> Tensor:
        """Return how many columns to the right of a column others lie, the shorter way round where they wrap."""
        if not self.circular:
            return columns - column
        return (columns - column + width // 2) % width - width // 2

    def _lay(self, params: Mapping[str, float], height: int, width: int, frame: Frame) -> None:
        top, bottom, left, right = self.box(params, height, width)
        top, bottom = max(top, 0), min(bottom, height)
        if self.circular:
            right = min(right, left + width)
        else:
            left, right = max(left, 0), min(right, width)
        step = max(_BAND // max(right - left, 1), 1)
        for first in range(top, bottom if right > left else top, step):
            last = min(first + step, bottom)
            rows = torch.arange(first, last, dtype=torch.float32).view(-1, 1)
            columns = torch.arange(left, right, dtype=torch.float32).view(1, -1)
            layer = self.layer(rows, columns, params, height, width)
            layer = layer.expand(3, last - first, right - left)
            self._blend(frame[:, first:last], layer, left, width)

    def _blend(self, frame: Frame, layer: Tensor, left: int, width: int) -> None:
        blend = cv2.add if self.additive else cv2.multiply
        start, done = left % width, 0
        while done < layer.shape[2]:
            count = min(width - start, layer.shape[2] - done)
            for channel in range(3):
                part = frame[channel, :, start : start + count]
                values = layer[channel, :, done : done + count].contiguous().numpy()
                part[...] = blend(part, values, dtype=cv2.CV_8U)
            start, done = 0, done + count
