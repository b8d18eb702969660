"""The world outside the windows: sky, sun, and a distant view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from siamloc.simulate.layout import Array, Rng, single
from siamloc.simulate.textures import sample

_LATITUDE = 48.0


@dataclass(frozen=True)
class Sky:
    """The world outside, infinitely far away.

    Attributes:
        image: radiosity by elevation (+90 to -90 degrees) and azimuth (0 to 360 degrees), (rows, columns, 3).
        sun: unit vector towards the sun (3,), or None if it does not shine.
        sun_radiosity: radiosity of a surface that faces the sun (3,).
    """

    image: Array
    sun: Array | None
    sun_radiosity: Array

    def look(self, directions: Array) -> Array:
        """Return the radiosity (n, 3) seen in n unit directions."""
        azimuth = np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi)
        elevation = np.arcsin(np.clip(directions[:, 2], -1, 1))
        column = azimuth * (self.image.shape[1] / (2 * np.pi)) - 0.5
        row = (0.5 - elevation / np.pi) * self.image.shape[0] - 0.5
        return sample(self.image, np.clip(column, 0, None), row)

    def softened(self) -> Sky:
        """Return the sky without detail, which lights rooms without speckles."""
        small = cv2.resize(self.image, (64, 16), interpolation=cv2.INTER_AREA)
        wrapped = np.concatenate([small[:, -2:], small, small[:, :2]], axis=1)
        return Sky(cv2.GaussianBlur(wrapped, (0, 0), 1.0)[:, 2:-2], self.sun, self.sun_radiosity)


def sun_direction(hour: float, north: float, declination: float) -> Array:
    """Return the unit vector towards the sun (3,) in the building's frame, z up.

    Args:
        hour: solar time in hours.
        north: direction of north in degrees counter-clockwise from +x.
        declination: declination of the sun in degrees, -23.4 (winter) to 23.4 (summer).
    """
    angle = np.radians(15 * (hour - 12))
    latitude, tilt = np.radians(_LATITUDE), np.radians(declination)
    up = np.sin(latitude) * np.sin(tilt) + np.cos(latitude) * np.cos(tilt) * np.cos(angle)
    east = -np.cos(tilt) * np.sin(angle)
    ahead = np.cos(latitude) * np.sin(tilt) - np.sin(latitude) * np.cos(tilt) * np.cos(angle)
    cosine, sine = np.cos(np.radians(north)), np.sin(np.radians(north))
    return np.array([ahead * cosine + east * sine, ahead * sine - east * cosine, up])


def overcast(hour: float, declination: float) -> float:
    """Return the brightness of an overcast sky, relative to noon: 0.3 + 21 sin(elevation) klx (Krochmann 1974).

    Args:
        hour: solar time in hours.
        declination: declination of the sun in degrees.
    """
    now, noon = (0.3 + 21 * max(0.0, float(sun_direction(at, 0, declination)[2])) for at in (hour, 12.0))
    return now / noon


def make_sky(lighting: str, rng: Rng, view: Rng, sun: Array, rows: int = 512, brightness: float = 1.0) -> Sky:
    """Paint the world outside.

    Args:
        lighting: "cloudy", "night" or "sunny".
        rng: draws clouds and brightness, different in every run.
        view: draws trees and houses, the same in every run of a building.
        sun: unit vector towards the sun (3,), as `sun_direction` returns it.
        rows: number of rows of the image; it has four times as many columns.
        brightness: factor on the brightness of a cloudy sky, as `overcast` returns it.
    """
    columns = 4 * rows
    elevation = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    height = np.sin(elevation)[:, None, None]
    sun_radiosity = np.zeros(3)
    if lighting == "night":
        sky = single((0.006, 0.008, 0.016)) + single((0.05, 0.035, 0.02)) * np.exp(-8 * np.abs(height))
        light = np.array((0.012, 0.010, 0.009))
    elif lighting == "cloudy":
        level = brightness * rng.uniform(4.5, 5.5)
        clouds = 1 + 0.16 * _clouds(rng, rows)
        sky = level * single((0.95, 1.0, 1.06)) * (1 + 1.2 * np.clip(height, 0, 1)) / 2.0 * clouds
        light = level * np.array((0.75, 0.78, 0.80))
    else:
        flat = np.cos(elevation)[:, None]
        axes = np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)[:, None])
        towards = np.clip(np.stack(axes, axis=-1) @ sun, -1, 1)[..., None]
        blue = single((7.0, 11.0, 18.0)) + single((10.0, 9.5, 7.0)) * np.exp(-4 * np.abs(height))
        glow = single((1.0, 0.93, 0.78)) * (70 * np.exp((towards - 1) * 60) + 9 * np.exp((towards - 1) * 6))
        sky = blue * (1 + 0.35 * np.clip(_clouds(rng, rows), 0, None)) + glow
        haze = float(np.exp(-0.12 / max(np.sin(np.arcsin(sun[2])), 0.05)))
        sun_radiosity = 150 * haze * np.array((1.0, 0.93 - 0.1 * (1 - haze), 0.80 - 0.25 * (1 - haze)))
        light = 0.30 * sun_radiosity * max(sun[2], 0.1) + np.array((4.0, 5.0, 6.5))
    sky = np.broadcast_to(sky, (rows, columns, 3)).astype(np.float32).copy()
    _paint_view(sky, view, light, lit_windows=lighting == "night")
    shines = lighting == "sunny" and sun[2] > 0.02
    return Sky(sky, sun if shines else None, sun_radiosity)


def _clouds(rng: np.random.Generator, rows: int) -> Array:
    columns = 4 * rows
    field = np.zeros((rows, columns), dtype=np.float32)
    for octave in range(5):
        grid = rng.standard_normal((4 << octave, 16 << octave)).astype(np.float32)
        grid = np.concatenate([grid, grid[:, :1]], axis=1)
        field += cv2.resize(grid, (columns, rows), interpolation=cv2.INTER_CUBIC) * 0.6**octave
    return field[..., None]


def _paint_view(sky: Array, rng: np.random.Generator, light: Array, lit_windows: bool) -> None:
    """Paint ground, trees and houses into the image; `light` is the radiosity of a white surface out there."""
    rows, columns = sky.shape[:2]
    pixel = rows / 512  # the sizes below are for an image with 512 rows

    def row_of(degrees: float) -> int:
        return round((0.5 - degrees / 180) * rows)

    horizon = row_of(0.0)
    depth = np.linspace(0, 1, rows - horizon, dtype=np.float32)[:, None, None]
    ground = single((0.20, 0.26, 0.12)) * (1 - depth) + single((0.30, 0.29, 0.27)) * depth
    sky[horizon:] = ground * light
    column = 0
    while column < columns:  # houses
        width = max(1, int(rng.integers(60, 190) * pixel))
        if rng.random() < 0.6:
            top = row_of(rng.uniform(4, 17))
            wall = rng.uniform(0.25, 0.75) * np.array((1.0, rng.uniform(0.85, 1.0), rng.uniform(0.7, 0.95)))
            end = min(column + width, columns)
            sky[top : row_of(-2), column:end] = wall * light
            sky[top : top + max(1, round(3 * pixel)), column:end] = (0.25, 0.12, 0.09) * light
            step, square = (max(1, round(size * pixel)) for size in (13, 6))
            for y in range(top + round(8 * pixel), row_of(-1), max(1, round(11 * pixel))):
                for x in range(column + square, end - round(8 * pixel), step):
                    lit = lit_windows and rng.random() < 0.25
                    sky[y : y + square, x : x + square] = (0.9, 0.6, 0.25) if lit else (0.10, 0.12, 0.15) * light
        column += width + int(rng.integers(0, 90) * pixel)
    for _ in range(110):  # trees
        x, base = int(rng.integers(0, columns)), row_of(rng.uniform(-6, -1))
        radius = max(1, int(rng.integers(9, 26) * pixel))
        shade = rng.uniform(0.5, 1.0)
        sky[base - radius : base + round(8 * pixel), max(x - 1, 0) : x + 2] = (0.10, 0.07, 0.05) * light
        for _ in range(14):
            dx, dy = rng.normal(0, radius / 2.4, 2)
            colour = np.array((0.10, 0.18, 0.06)) * shade * rng.uniform(0.6, 1.4) * light
            centre = (int(x + dx), int(base - radius * 1.3 + dy))
            size = max(2 if pixel == 1 else 1, radius // 3)
            cv2.circle(sky, centre, size, colour.tolist(), -1, cv2.LINE_AA)
