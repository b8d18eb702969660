"""Light that knows the geometry of the view: vignetting, the shadow of a wall, the sun through a window."""

from __future__ import annotations

from collections.abc import Mapping
from math import asin, atan, ceil, floor, hypot, pi
from typing import Any, ClassVar

import torch
from torch import Tensor

from augment.layers import Layer
from augment.ranges import Range

_SUN = (1.0, 0.93, 0.78)
_PENUMBRA = 0.12
_FRAME = 0.05


class Vignette(Layer):
    """Darkness towards the edge of the lens: I' = I (1 + k q^2)^-2, the law of the fourth power of the cosine.

    q is the distance from the optical axis, 1 at the farthest edge, and k = (1 - strength)^(-1/2) - 1, so that the
    gain there is 1 - strength. A panorama's axis is a row, since its columns go round the axis of the mirror; with
    `circular=False` it is the middle of the picture.

    Args:
        strength: share of the light that is lost at the edge.
        centre: row of the axis, 0 top ... 1 bottom.
    """

    name = "vignette"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "strength": Range(0.3, 0.8, minimum=0, maximum=0.99, neutral=0),
        "centre": Range(0.4, 0.6, minimum=0, maximum=1),
    }

    def layer(self, rows: Tensor, columns: Tensor, params: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain."""
        centre = params["centre"] * (height - 1)
        farthest = abs(params["centre"] - 0.5) * (height - 1) + max(height - 1, 1) / 2
        square = (rows - centre) ** 2 + 0 * columns
        edge = farthest**2
        if not self.circular:
            square = square + (columns - (width - 1) / 2) ** 2
            edge = edge + ((width - 1) / 2) ** 2
        k = (1 - params["strength"]) ** -0.5 - 1
        return (1 + k * (square / edge)) ** -2


class Shadow(Layer):
    """The soft-edged shadow of something large: a half-space of viewing directions loses light.

    I' = I (1 - depth S(e / softness + 1/2)), with e = n . d - offset, d the unit viewing direction of the pixel, n
    the unit vector towards `column` raised by `tilt` degrees, and S the smooth step 3 t^2 - 2 t^3 on [0, 1]. A straight
    edge of a wall looks like this in a panorama: a curve that closes across the seam. Pixels are taken to be as high
    as they are wide, the horizon in the middle row. With `circular=False` e is the distance from a straight line in
    the picture, in half widths.

    Args:
        depth: share of the light that the shadow takes.
        softness: width of the edge on the unit sphere.
        tilt: in degrees; 0 makes the edge upright.
        offset: how far the edge lies from the camera's plane, positive for a smaller shadow.
    """

    name = "shadow"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "depth": Range(0.3, 0.75, minimum=0, maximum=1, neutral=0),
        "softness": Range(0.05, 0.4, minimum=0.001, maximum=2),
        "tilt": Range(-60, 60, minimum=-90, maximum=90),
        "offset": Range(-0.2, 0.6, minimum=-1, maximum=1),
    }

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Towards which column the shadow lies."""
        return {"column": Range(0, width - 1, whole=True)}

    def layer(self, rows: Tensor, columns: Tensor, params: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain."""
        tilt = torch.as_tensor(params["tilt"] * (pi / 180))
        across, up = tilt.cos(), tilt.sin()
        right = self.offset(columns, params["column"], width)
        if self.circular:
            elevation = (((height - 1) / 2 - rows) * (2 * pi / width)).clamp(-pi / 2, pi / 2)
            towards = (across * elevation.cos()) * (right * (2 * pi / width)).cos() + up * elevation.sin()
        else:
            towards = (across * right + up * ((height - 1) / 2 - rows)) * (2 / width)
        step = ((towards - params["offset"]) / params["softness"] + 0.5).clamp_(0, 1)
        return 1 - params["depth"] * _smooth(step)


class SunPatch(Layer):
    """The sun falls through a window on the floor: a bright quadrangle with the shadow of the window's cross.

    I'_k = I_k (1 + (gain - 1) sun_k M), sun the warm colour of the light. A pixel at the angle a below the horizon
    sees the floor 1 / tan a camera heights away; M is 1 inside a rectangle on that floor, 0 outside and on the two
    crossing bars, soft at every edge. Pixels are taken to be as high as they are wide; `circular=False` means a view
    of 90 degrees.

    Args:
        gain: how much brighter the floor is.
        distance: of the patch, in camera heights.
        length: of the patch away from the window, in camera heights.
        breadth: of the patch, in camera heights.
        turn: of the patch on the floor, in degrees.
        horizon: row of the horizon, 0 top ... 1 bottom.
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

    def places(self, height: int, width: int) -> dict[str, Range]:
        """In which column the middle of the patch lies."""
        return {"column": Range(0, width - 1, whole=True)}

    def layer(self, rows: Tensor, columns: Tensor, params: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain of each colour."""
        pixel = self._pixel(width)
        below = ((rows - params["horizon"] * (height - 1)) * pixel).clamp(1e-3, pi / 2 - 1e-3)
        reach = 1 / below.tan()
        azimuth = (self.offset(columns, params["column"], width) * pixel).clamp(-pi, pi)
        ahead = reach * azimuth.cos() - params["distance"]
        aside = reach * azimuth.sin()
        turn = torch.as_tensor(params["turn"] * (pi / 180))
        along = ((ahead * turn.cos() + aside * turn.sin()) * (2 / params["length"])).abs()
        across = ((aside * turn.cos() - ahead * turn.sin()) * (2 / params["breadth"])).abs()
        inside = _edge(1 - along, _PENUMBRA) * _edge(1 - across, _PENUMBRA)
        panes = _edge(along - _FRAME, _FRAME) * _edge(across - _FRAME, _FRAME)
        sun = torch.tensor(_SUN, device=rows.device).view(3, 1, 1)
        return 1 + (params["gain"] - 1) * (inside * panes) * sun

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return rows and columns around the patch."""
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


def _edge(inside: Tensor, width: float) -> Tensor:
    """Return a soft step that is 1 where `inside` exceeds the width and 0 where it is negative."""
    return _smooth((inside / width).clamp(0, 1))
