"""The same room under different light: lamps on or off, another sky, other light behind doors and windows.

Gains are in stops of light. Pixels store light to the power of 1 / 2.2, about as sRGB does, so that s stops multiply a
pixel by 2^(s / 2.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import ceil, floor, pi
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import Effect, Numbers, Params
from augment.brushes import Brush, Frame
from augment.layers import AroundColumn, start_of
from augment.ranges import Range

Floats = NDArray[np.float32]

_GAMMA = 2.2
_WAVES = 4
_PHASES = tuple(f"phase{number}" for number in range(1, _WAVES + 1))
_TILTS = tuple(f"tilt{number}" for number in range(1, _WAVES + 1))
_SOFT = 0.01  # half width of a sector's soft edge, in widths of the frame
_WHITE = 3 * 255


class Relight(AroundColumn):
    """Light from elsewhere: a gain that changes slowly over all directions, and its colour with it.

    I'_k = I_k 2^(s_k / 2.2), with the stops

        s_k = stops (slope e + sum_n cos(n a + phase_n) (1 + tilt_n e) / n) + warmth (1, 0, -1)_k cos(a),  n = 1 ... 4

    where a is the azimuth in rad from `column` and e runs from 1 in the first row to -1 in the last. Away from the
    edges of shadows, a room seen from one point under other lamps or another sky changes in about this way.

    Args:
        stops: amplitude of the change of light.
        warmth: stops between red and blue in one direction, and the reverse in the opposite one.
        slope: how much more light there is above than below, in amplitudes.
    """

    name = "relight"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "stops": Range(0.2, 1.8, minimum=-4, maximum=4, neutral=0),
        "warmth": Range(-0.4, 0.4, minimum=-2, maximum=2, neutral=0),
        "slope": Range(-0.8, 0.8, minimum=-2, maximum=2),
    }

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of the column, and of the phase in rad and the tilt of each wave."""
        phases = {name: Range(-pi, pi, minimum=-2 * pi, maximum=2 * pi) for name in _PHASES}
        tilts = {name: Range(-0.8, 0.8, minimum=-1, maximum=1) for name in _TILTS}
        return {**super().places(height, width), **phases, **tilts}

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return each wave's phase, weight and tilt, and slope and warmth, as binary logarithms of pixel gains."""
        stops, waves = params["stops"] / _GAMMA, np.arange(1, _WAVES + 1)[:, None]
        weights = stops / waves
        return {
            "start": start_of(params, width),
            "wave": np.repeat(waves, len(stops), axis=1),
            "phase": np.stack([params[phase] for phase in _PHASES]),
            "weight": weights,
            "tilt": weights * np.stack([params[tilt] for tilt in _TILTS]),
            "slope": stops * params["slope"],
            "warmth": np.outer([1.0, 0.0, -1.0], params["warmth"] / _GAMMA),
        }

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain of each colour at the given pixels."""
        level, slope, colour = self._of_columns(columns, values, width)
        return torch.exp2(level + slope * _above(rows, height)) * colour

    def brushes(self, params: Params, height: int, width: int) -> list[Brush]:
        """Return for each frame the function that multiplies it by its gains; they are computed for the whole batch."""
        columns = torch.arange(width, dtype=torch.float32).view(1, 1, 1, -1)
        parts = (part.numpy() for part in self._of_columns(columns, self.tensors(params, height, width), width))
        above = _above(torch.arange(height, dtype=torch.float32).view(-1, 1), height).numpy()
        return [partial(_relight, above, *part) for part in zip(*parts, strict=True)]

    def _of_columns(self, columns: Tensor, values: Mapping[str, Any], width: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return powers of two: of the middle row and their growth upwards (b, 1, 1, w); and gains (b, 3, 1, w)."""
        azimuth = self.offset(columns, values["start"], width) * (2 * pi / width)
        waves = (azimuth * values["wave"] + values["phase"]).cos()
        level = (waves * values["weight"]).sum(-3, keepdim=True)
        slope = (waves * values["tilt"]).sum(-3, keepdim=True) + values["slope"]
        return level, slope, torch.exp2(values["warmth"] * azimuth.cos())


class Doorway(AroundColumn):
    """A sector of the view is lit differently, like a room seen through a door: I' = I 2^(stops / 2.2) in it.

    Args:
        stops: how much more light there is.
        share: share of the columns in the sector.
    """

    name = "doorway"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "stops": Range(-2.5, 2.5, minimum=-8, maximum=8, neutral=0),
        "share": Range(0.05, 0.5, minimum=0.001, maximum=1),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the gain minus 1, and the distance from the middle, in columns, at which the soft edge ends."""
        return {
            "start": start_of(params, width),
            "more": np.exp2(params["stops"] / _GAMMA) - 1,
            "reach": params["share"] / (4 * _SOFT) + 0.5,
        }

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return the gain of the sector at the given pixels."""
        aside = self.offset(columns, values["start"], width).abs() * (1 / (2 * _SOFT * width))
        return 1 + (values["reach"] - aside).clamp(0, 1) * values["more"]

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return all rows of the sector's columns."""
        half = (params["share"] / 2 + _SOFT) * width
        return 0, height, floor(params["column"] - half), ceil(params["column"] + half) + 1


class Windows(Effect):
    """Set the brightest parts of the image to another level: windows and lamps at night, or in the sun.

    I' = I + strength (level - I) where R + G + B is among the largest of the image: the threshold is the smallest
    that at most `share` of the pixels reach. Pixels that are white in all colours either all change or none.

    Args:
        share: largest share of the pixels that change.
        level: 0 ... 255; dark like windows at night, or white as in the sun.
        strength: 1 replaces the brightest parts by `level`, less mixes both.
    """

    name = "windows"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "share": Range(0.01, 0.2, minimum=0, maximum=1),
        "level": Range(0, 25, minimum=0, maximum=255),
        "strength": Range(1, 1, minimum=0, maximum=1, neutral=0),
    }

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Change the brightest pixels of a frame."""
        share, level, strength = (np.float32(params[key]) for key in ("share", "level", "strength"))
        bright = frame.sum(axis=0, dtype=np.uint16)
        reached = np.bincount(bright.ravel(), minlength=_WHITE + 2)[::-1].cumsum()[::-1]
        threshold = int((reached > share * bright.size).sum())
        rows, columns = np.nonzero(bright >= threshold)
        old = frame[:, rows, columns].astype(np.float32)
        frame[:, rows, columns] = np.rint(old + strength * (level - old)).clip(0, 255)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the number of pixels below the threshold, the level in [0, 1] and the strength."""
        most = np.floor(params["share"].astype(np.float32) * (height * width))
        return {"darker": height * width - most, "level": params["level"] / 255, "strength": params["strength"]}

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with its brightest pixels changed."""
        bright = (batch * 255).round().sum(dim=1).long()
        counts = torch.zeros(len(batch), _WHITE + 1, dtype=torch.int64, device=batch.device)
        counts.scatter_add_(1, bright.flatten(1), counts.new_ones(()).expand_as(bright.flatten(1)))
        threshold = (counts.cumsum(1) < values["darker"][:, :, 0, 0]).sum(dim=1)
        changed = torch.lerp(batch, values["level"], values["strength"])
        return torch.where((bright > threshold.view(-1, 1, 1))[:, None], changed, batch)


def _above(rows: Tensor, height: int) -> Tensor:
    """Return 1 in the first row to -1 in the last."""
    return 1 - rows * (2 / max(height - 1, 1))


def _relight(above: Floats, level: Floats, slope: Floats, colour: Floats, frame: Frame) -> None:
    gain = np.exp2(level[0] + slope[0] * above)
    for channel, tint in zip(frame, colour, strict=True):
        cv2.multiply(channel, gain * tint, dst=channel, dtype=cv2.CV_8U)
