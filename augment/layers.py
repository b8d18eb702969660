"""Light as a layer over the frame: `Layer`, and the layers that follow the geometry of the view.

A layer is added to the frame or multiplied by it. Vignetting, the shadow of a wall and the sun through a window are
here; lamps and reflections are in `spots`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import partial
from math import asin, atan, ceil, floor, hypot, pi
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import Effect, Numbers, Params, by_frame, places_in
from augment.brushes import Brush, Frame
from augment.ranges import Range

_SUN = (1.0, 0.93, 0.78)  # colour of sunlight: red, green, blue
_PENUMBRA = 0.12  # width of a sun patch's soft edge, in half sizes of the patch
_FRAME = 0.05  # half width of the window's bars, and of their soft edge, in half sizes of the patch

# Below this size torch uses one thread, which is right for frames that are each painted in their own thread.
_BAND = 32768


class Layer(Effect):
    """An effect that adds a layer to the image or multiplies by it: I' = I + layer, or I' = I layer.

    Attributes:
        additive: whether the layer is added, in units of white; otherwise it is a gain.
    """

    additive: ClassVar[bool] = False

    @abstractmethod
    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the layer at the given pixels.

        Args:
            rows: (..., h, 1) numbers of the rows.
            columns: (..., 1, w) numbers of the columns; some may lie beyond the seam.
            values: the coefficients: (..., 1, 1, 1) or (..., k, 1, 1) each.
            height: rows of the frame.
            width: columns of the frame.

        Returns:
            (..., h, w), or (..., 3, h, w) if colours differ.
        """

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return the part of the frame that the layer changes: first row, row after the last, and the same for columns.

        Columns may lie beyond the seam. By default, the whole frame.
        """
        return 0, height, 0, width

    def brushes(self, params: Params, height: int, width: int) -> list[Brush]:
        """Return for each frame the function that applies the frame's layer to it."""
        values = self.tensors(params, height, width)
        frames = [dict(zip(values, each, strict=True)) for each in zip(*values.values(), strict=True)]
        boxes = [self.box(each, height, width) for each in by_frame(params)]
        return [partial(self._lay, *both) for both in zip(boxes, frames, strict=True)]

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with its layers applied."""
        height, width = batch.shape[2:]
        layer = self.layer(*places_in(height, width, batch.device), values, height, width)
        return batch + layer if self.additive else batch * layer

    def offset(self, columns: Tensor, start: Any, width: int) -> Tensor:
        """Return the distance of columns to the right of a column, the shorter way round if columns wrap around.

        Args:
            columns: (..., 1, w) numbers of the columns.
            start: half a width to the left of that column, see `start_of`.
            width: columns of the frame.
        """
        beyond = columns - start
        return (beyond % width if self.circular else beyond) - width // 2

    def _lay(self, box: tuple[int, int, int, int], values: Mapping[str, Tensor], frame: Frame) -> None:
        (_, height, width), (top, bottom, left, right) = frame.shape, box
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
            layer = self.layer(rows, columns, values, height, width)
            layer = (255 * layer if self.additive else layer).expand(3, last - first, right - left)
            self._blend(frame[:, first:last], layer, left, width)

    def _blend(self, frame: Frame, layer: Tensor, left: int, width: int) -> None:
        blend = cv2.add if self.additive else cv2.multiply
        before = width - left % width  # columns of the layer before the seam, if it reaches that far
        for start, part in ((width - before, layer[..., :before]), (0, layer[..., before:])):
            for channel, values in zip(frame[..., start : start + part.shape[2]], part, strict=True):
                if values.numel():
                    channel[...] = blend(channel, values.contiguous().numpy(), dtype=cv2.CV_8U)


class Vignette(Layer):
    """Darkness towards the edge of the lens: I' = I (1 + k q^2)^-2, the cosine fourth power law.

    q is the distance from the optical axis, 1 at the farthest edge, and k = (1 - strength)^(-1/2) - 1, so that the
    gain there is 1 - strength. A panorama's axis is a row, since its columns go round the axis of the mirror; with
    `circular=False` it is the centre of the image.

    Args:
        strength: share of the light that is lost at the edge.
        centre: row of the axis, from 0 at the top to 1 at the bottom.
    """

    name = "vignette"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "strength": Range(0.3, 0.8, minimum=0, maximum=0.99, neutral=0),
        "centre": Range(0.4, 0.6, minimum=0, maximum=1),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the row of the axis, and k divided by the squared distance, in pixels, of the farthest edge."""
        farthest = abs(params["centre"] - 0.5) * (height - 1) + max(height - 1, 1) / 2
        edge = farthest**2 + (0 if self.circular else ((width - 1) / 2) ** 2)
        return {"row": params["centre"] * (height - 1), "fall": ((1 - params["strength"]) ** -0.5 - 1) / edge}

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain (1 + k q^2)^-2 at the given pixels."""
        square = (rows - values["row"]) ** 2
        if not self.circular:
            square = square + (columns - (width - 1) / 2) ** 2
        return (1 + values["fall"] * square) ** -2


class AroundColumn(Layer):
    """A layer whose middle is a column that is drawn for each frame."""

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the range of `column`, the column in the middle of the layer."""
        return {"column": Range(0, width - 1, whole=True)}


class Shadow(AroundColumn):
    """The soft-edged shadow of something large: a half-space of viewing directions loses light.

    I' = I (1 - depth S(e / softness + 1/2)), with e = n . d - offset, d the unit viewing direction of the pixel, n
    the unit vector towards `column` raised by `tilt` degrees, and S the smooth step 3 t^2 - 2 t^3 on [0, 1]. A straight
    edge of a wall looks like this in a panorama: a curve that closes across the seam. Pixels are taken to be as high
    as they are wide, the horizon in the middle row. With `circular=False` e is the distance from a straight line in
    the image, in half widths.

    Args:
        depth: share of the light that the shadow takes.
        softness: width of the edge on the unit sphere.
        tilt: angle in degrees; 0 makes the edge upright.
        offset: how far the edge lies from the camera's plane, positive for a smaller shadow.
    """

    name = "shadow"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "depth": Range(0.3, 0.75, minimum=0, maximum=1, neutral=0),
        "softness": Range(0.05, 0.4, minimum=0.001, maximum=2),
        "tilt": Range(-60, 60, minimum=-90, maximum=90),
        "offset": Range(-0.2, 0.6, minimum=-1, maximum=1),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the direction of the shadow, and `steep` and `lift` of the smooth step's argument steep e + lift."""
        tilt, steep = np.radians(params["tilt"]), 1 / params["softness"]
        lift = 0.5 - params["offset"] * steep
        scale = 1 if self.circular else 2 / width
        of_tilt = {"across": np.cos(tilt) * scale * steep, "up": np.sin(tilt) * scale * steep}
        return {"start": start_of(params, width), "depth": params["depth"], "lift": lift, **of_tilt}

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain of the shadow at the given pixels."""
        right, above = self.offset(columns, values["start"], width), (height - 1) / 2 - rows
        if self.circular:
            elevation = (above * (2 * pi / width)).clamp(-pi / 2, pi / 2)
            right, above = (right * (2 * pi / width)).cos() * elevation.cos(), elevation.sin()
        step = (values["across"] * right + (values["up"] * above + values["lift"])).clamp_(0, 1)
        return 1 - values["depth"] * _smooth(step)


class SunPatch(AroundColumn):
    """Sunlight through a window onto the floor: a bright quadrangle with the shadow of the window's crossing bars.

    I'_k = I_k (1 + (gain - 1) sun_k M), sun the warm colour of the light. A pixel at the angle a below the horizon
    sees the floor 1 / tan a camera heights away; M is 1 inside a rectangle on that floor, 0 outside and on the two
    crossing bars, soft at every edge. Pixels are taken to be as high as they are wide; `circular=False` means a view
    of 90 degrees.

    Args:
        gain: how much brighter the floor is.
        distance: distance of the patch, in camera heights.
        length: length of the patch away from the window, in camera heights.
        breadth: breadth of the patch, in camera heights.
        turn: turn of the patch on the floor, in degrees.
        horizon: row of the horizon, from 0 at the top to 1 at the bottom.
    """

    name = "sun_patch"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "gain": Range(1.6, 3.0, minimum=0, maximum=20, neutral=1),
        "distance": Range(1.6, 3.0, minimum=0.1, maximum=50),
        "length": Range(0.8, 2.0, minimum=0.05, maximum=50),
        "breadth": Range(0.6, 1.4, minimum=0.05, maximum=50),
        "turn": Range(-60, 60, minimum=-180, maximum=180),
        "horizon": Range(0.5, 0.5, minimum=0, maximum=1),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the row that looks straight down, and the place and axes of the patch, in units of its half sizes.

        A point ahead and aside lies at ahead `along` + aside `across` - `middle` from the middle, along each axis. The
        soft edges of the patch and of its bars are the smooth steps of `steep` |place| + `lift`.
        """
        turn, halves = np.radians(params["turn"]), 2 / np.stack([params["length"], params["breadth"]])
        along = np.stack([np.cos(turn), -np.sin(turn)]) * halves
        edges = np.repeat([[-1 / _PENUMBRA], [1 / _FRAME]], 2, axis=0), np.repeat([[1 / _PENUMBRA], [-1.0]], 2, axis=0)
        steep, lift = (np.broadcast_to(edge, (4, len(turn))) for edge in edges)
        return {
            "start": start_of(params, width),
            "nadir": params["horizon"] * (height - 1) + pi / 2 / self._pixel(width),
            "along": along,
            "across": np.stack([np.sin(turn), np.cos(turn)]) * halves,
            "middle": along * params["distance"],
            "steep": steep,
            "lift": lift,
            "sun": (params["gain"] - 1) * np.array(_SUN)[:, None],
        }

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain of each colour at the given pixels."""
        pixel = self._pixel(width)
        reach = ((values["nadir"] - rows) * pixel).clamp(1e-3, pi / 2 - 1e-3).tan()
        azimuth = self.offset(columns, values["start"], width) * pixel
        place = (reach * (azimuth.cos() * values["along"] + azimuth.sin() * values["across"]) - values["middle"]).abs()
        steps = (torch.cat([place, place], dim=-3) * values["steep"] + values["lift"]).clamp_(0, 1)
        return 1 + _smooth(steps).prod(dim=-3, keepdim=True) * values["sun"]

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return the rows and columns that the patch can cover; see `Layer.box`."""
        pixel = self._pixel(width)
        horizon = params["horizon"] * (height - 1)
        radius = hypot(params["length"], params["breadth"]) / 2
        distance = params["distance"]
        top = ceil(horizon + atan(1 / (distance + radius)) / pixel)
        if radius >= distance:
            return top, height, 0, width
        bottom = floor(horizon + atan(1 / (distance - radius)) / pixel) + 1
        half = asin(radius / distance) / pixel
        column = params["column"]
        return top, bottom, floor(column - half), ceil(column + half) + 1

    def _pixel(self, width: int) -> float:
        """Angle that a pixel covers, rad."""
        return (2 * pi if self.circular else pi / 2) / width


def _smooth(step: Tensor) -> Tensor:
    return step * step * (3 - 2 * step)


def start_of(params: Numbers, width: int) -> NDArray[np.float64]:
    """Return the column half a width to the left of the parameter `column`, for `Layer.offset`."""
    return params["column"] - width // 2
