"""Spots of light and darkness: lamps, reflections and windows ([T] 5.3.2, local effects)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from math import ceil, floor
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from augment.base import Effect, Numbers
from augment.errors import AugmentError
from augment.layers import AroundColumn, start_of
from augment.ranges import Range
from foundation.errors import hint

TONES = ("light", "dark", "any")

_SPOT = {
    "radius": Range(15, 40, minimum=0.5),
    "intensity": Range(100, 160, minimum=0, maximum=255, neutral=0),
    "rim": Range(5, 5, minimum=0, maximum=255),
}


class Spot(AroundColumn):
    """A patch of light or shadow that fades from its centre to its rim.

    I' = I +- a(rho), with a(rho) = c + (rim - c) rho for rho <= 1 and 0 beyond; rho is 0 at the centre and 1 at the
    rim, and the shape of the spot defines it in between. A rim above c counts as c. All channels change alike.

    Args:
        tone: "light", "dark", or "any" for either with equal chance.
        radius: radius in pixels of a frame of 128 rows; it scales with the height of the frame. 15 ... 40 as published.
        intensity: c, in levels of 0 ... 255. 100 ... 160 as published.
        rim: the levels left at the rim. 5 as published.
        aspect: width over height, at a constant area.
        circular: a spot across the seam continues on the other side.
    """

    additive: ClassVar[bool] = True
    OPTIONS: ClassVar[Mapping[str, Any]] = {"tone": "any"}

    def __init__(self, **params: Any) -> None:
        super().__init__(**params)
        tone = self.options["tone"]
        if tone not in TONES:
            raise AugmentError(f"unknown tone {tone!r} of {self.name}: {hint(tone, TONES)}")

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of the centre's column and row, and of `light`: 1 for a light spot, 0 for a dark one."""
        low, high, neutral = {"light": (1, 1, None), "dark": (0, 0, None), "any": (0, 1, 0.5)}[self.options["tone"]]
        return {
            **super().places(height, width),
            "row": Range(0, height - 1, whole=True),
            "light": Range(low, high, minimum=0, maximum=1, neutral=neutral, whole=True),
        }

    @cached_property
    def renderer(self) -> Effect:
        """The effect that renders spots of all shapes in one formula."""
        return _AnySpot(circular=self.circular) if type(self) in (Bulb, Square, Trapezoid) else self

    def distance(self, across: Tensor, down: Tensor, values: Mapping[str, Any]) -> Tensor:
        """Return rho at offsets from the centre, in units of the half width and the half height; a trapezoid's here."""
        half = down.clamp(-1, 1) * values["lean"] + values["middle"]
        return torch.maximum(across.abs() / half, down.abs())

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the place, half sizes and taper of the spot, and `centre` and `slope` of the layer centre + slope rho.

        The half width at the height v is `middle` + `lean` v.
        """
        half_height = params["radius"] * (height / 128) / params["aspect"] ** 0.5
        centre, rim = params["intensity"], np.minimum(params["rim"], params["intensity"])
        levels = (2 * params["light"] - 1) / 255
        taper = params.get("taper", np.zeros(len(centre)))
        return {
            "start": start_of(params, width),
            "row": params["row"],
            "across": 1 / (half_height * params["aspect"]),
            "down": 1 / half_height,
            "centre": centre * levels,
            "slope": (rim - centre) * levels,
            "middle": 1 / (1 + abs(taper)),
            "lean": taper / (1 + abs(taper)),
            "round": np.full(len(centre), float(type(self) is Bulb)),
        }

    def layer(self, rows: Tensor, columns: Tensor, values: Mapping[str, Any], height: int, width: int) -> Tensor:
        """Return what the spot adds to the given pixels, in units of white."""
        across = self.offset(columns, values["start"], width) * values["across"]
        rho = self.distance(across, (rows - values["row"]) * values["down"], values)
        return (rho * values["slope"] + values["centre"]) * (rho <= 1)

    def box(self, params: Mapping[str, float], height: int, width: int) -> tuple[int, int, int, int]:
        """Return the rows and columns that the spot covers."""
        half_height = params["radius"] * (height / 128) / params["aspect"] ** 0.5
        half_width = half_height * params["aspect"]
        row, column = params["row"], params["column"]
        return (
            ceil(row - half_height),
            floor(row + half_height) + 1,
            ceil(column - half_width),
            floor(column + half_width) + 1,
        )


class Bulb(Spot):
    """A round spot, like that of a light bulb ([T] 5.3.2, figure 5.3 a, b).

    rho = sqrt(u^2 + v^2) at offsets u, v from the centre, measured in half widths and half heights. Everything else
    as in `Spot`.
    """

    name = "bulb"
    RANGES: ClassVar[Mapping[str, Range]] = {**_SPOT, "aspect": Range(0.8, 1.25, minimum=0.05, maximum=20, log=True)}

    def distance(self, across: Tensor, down: Tensor, values: Mapping[str, Any]) -> Tensor:
        """Return the distance rho from the centre for a round spot."""
        return torch.hypot(across, down)


class Square(Spot):
    """A rectangular spot, like that of a reflection ([T] 5.3.2, figure 5.3 c).

    rho = max(|u|, |v|) at offsets u, v from the centre, measured in half widths and half heights. Everything else as
    in `Spot`.
    """

    name = "square"
    RANGES: ClassVar[Mapping[str, Range]] = {**_SPOT, "aspect": Range(0.7, 1.4, minimum=0.05, maximum=20, log=True)}


class Trapezoid(Spot):
    """A spot with horizontal upper and lower edges of different lengths, like a window ([T] 5.3.2, figure 5.3 d).

    rho = max(|v|, |u| / w(v)) with w(v) = (1 + taper v) / (1 + |taper|): the half width w changes from the upper
    edge (v = -1) to the lower edge (v = 1). Everything else as in `Spot`.

    Args:
        taper: positive for the wider edge below, negative for the wider edge above; 0 gives a square.
    """

    name = "trapezoid"
    RANGES: ClassVar[Mapping[str, Range]] = {
        **_SPOT,
        "aspect": Range(0.8, 2.0, minimum=0.05, maximum=20, log=True),
        "taper": Range(-0.6, 0.6, minimum=-0.95, maximum=0.95),
    }


class _AnySpot(Spot):
    """Spots of different shapes in one batch: a square is a trapezoid without taper."""

    name = "spot"

    def distance(self, across: Tensor, down: Tensor, values: Mapping[str, Any]) -> Tensor:
        """Euclidean for round spots."""
        return torch.lerp(super().distance(across, down, values), torch.hypot(across, down), values["round"])
