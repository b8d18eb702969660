"""The cameras: where each pixel looks, and how light becomes pixel values (exposure, glare, noise, gamma)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from siamloc.data.panorama import HyperbolicMirror, PanoramaView
from siamloc.errors import ConfigError, hint
from siamloc.simulate.layout import Array, single

#: Height of the viewpoint above the floor in metres.
HEIGHT = 0.95
#: Positions within a pixel of the rays that smooth edges, as fractions of a pixel; the first is the middle.
OFFSETS = ((0.0, 0.0), (-0.35, 0.15), (0.15, 0.35), (0.25, -0.3))
_RIM, _BODY = 236.0, 24.0
_VIGNETTE = 0.42


@dataclass(frozen=True)
class Pixels:
    """The pixels of an image that see something.

    Attributes:
        rows: row of each pixel (n,).
        columns: column of each pixel (n,).
        directions: unit vectors in the robot's frame for each entry of OFFSETS (4, n, 3), float32.
        spread: angle in rad that a pixel covers (n,).
        vignette: share of the light that arrives (n,).
    """

    rows: Array
    columns: Array
    directions: Array
    spread: Array
    vignette: Array


@dataclass(frozen=True)
class PanoramaCamera:
    """A camera that takes panoramas directly, like those that unwrapping produces."""

    view: PanoramaView = field(default_factory=PanoramaView)
    wraps: bool = True

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.view.height, self.view.width

    def pixels(self) -> Pixels:
        """Return all pixels."""
        return _panorama_pixels(self.view)

    def displacement(self, moves: Array, points: Array) -> tuple[Array, Array]:
        """Return how far in columns and rows points (n, 3) of the robot's frame move with `moves` (n, 3)."""
        moved = points + moves
        azimuth = np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(moved[:, 1], moved[:, 0])
        azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
        slope = points[:, 2] / np.hypot(points[:, 0], points[:, 1])
        after = moved[:, 2] / np.hypot(moved[:, 0], moved[:, 1])
        high, low = np.tan(np.radians([self.view.top, self.view.bottom]))
        rows = (after - slope) / (low - high) * self.view.height
        return azimuth * (self.view.width / (2 * np.pi)), rows


@dataclass(frozen=True)
class OmnidirectionalCamera:
    """A camera below a hyperbolic mirror; its image is a ring with the camera's own reflection in the middle."""

    mirror: HyperbolicMirror = field(default_factory=HyperbolicMirror)
    wraps: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return 480, 640

    def pixels(self) -> Pixels:
        """Return the pixels of the ring."""
        return _mirror_pixels(self.mirror)

    def displacement(self, moves: Array, points: Array) -> tuple[Array, Array]:
        """Return how far in columns and rows points (n, 3) of the robot's frame move with `moves` (n, 3)."""
        change = np.nan_to_num(self.mirror.project(points + moves) - self.mirror.project(points))
        return change[:, 0], change[:, 1]


Camera = PanoramaCamera | OmnidirectionalCamera
CAMERAS = ("omnidirectional", "panorama")


def make_camera(name: str) -> Camera:
    """Return the camera called "omnidirectional" or "panorama".

    Raises:
        ConfigError: any other name.
    """
    if name not in CAMERAS:
        raise ConfigError(f"camera {name!r} is unknown; {hint(name, CAMERAS)}")
    return PanoramaCamera() if name == "panorama" else OmnidirectionalCamera()


@lru_cache(maxsize=4)
def _panorama_pixels(view: PanoramaView) -> Pixels:
    rows, columns = (grid.ravel() for grid in np.mgrid[0 : view.height, 0 : view.width])
    middle = view.directions().reshape(-1, 3)
    high, low = np.tan(np.radians([view.top, view.bottom]))
    directions = []
    for dx, dy in OFFSETS:
        azimuth = -(columns + dx + 0.5 - view.width / 2) * (2 * np.pi / view.width)
        slope = high + (rows + dy + 0.5) / view.height * (low - high)
        direction = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
        directions.append(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    directions[0] = middle
    spread = (2 * np.pi / view.width) * np.cos(np.arcsin(middle[:, 2]))
    return Pixels(rows, columns, single(directions), spread.astype(np.float32), _vignette(middle))


@lru_cache(maxsize=4)
def _mirror_pixels(mirror: HyperbolicMirror) -> Pixels:
    height, width = OmnidirectionalCamera(mirror).shape
    rows, columns = (grid.ravel() for grid in np.mgrid[0:height, 0:width])
    radius = np.hypot(columns - mirror.cx, rows - mirror.cy)
    keep = (radius <= _RIM) & (radius >= _BODY)
    rows, columns = rows[keep], columns[keep]
    directions = [mirror.back_project(np.stack([columns + dx, rows + dy], axis=1)) for dx, dy in OFFSETS]
    seen = np.isfinite(np.stack(directions)).all(axis=(0, 2))
    rows, columns = rows[seen], columns[seen]
    directions = [direction[seen] for direction in directions]
    corner = mirror.back_project(np.stack([columns + 0.5, rows + 0.5], axis=1))
    spread = np.sqrt(2) * np.linalg.norm(np.nan_to_num(corner - directions[0]), axis=1)
    return Pixels(rows, columns, single(directions), spread.astype(np.float32), _vignette(directions[0]))


def _vignette(directions: Array) -> Array:
    """Return the share of the light that reaches the sensor, which falls off towards the rim of the mirror."""
    pixel = HyperbolicMirror().project(np.asarray(directions, dtype=np.float64))
    radius = np.hypot(pixel[:, 0] - 319.5, pixel[:, 1] - 239.5) / _RIM
    return (1 - _VIGNETTE * np.clip(radius, 0, 1.1) ** 4).astype(np.float32)


_KEY = 0.40
_LAG = 1.4
_GAINS = (0.04, 4.5)
_SHOT, _READ = 0.006, 0.0025
_BANK = 1 << 21


@dataclass(frozen=True)
class Exposure:
    """Camera settings for every frame of a run.

    Attributes:
        gain: pixel value per radiosity (n,).
        balance: colour gains of the run (3,).
        seconds: how long the shutter is open (n,).
    """

    gain: Array
    balance: Array
    seconds: Array


def expose(brightness: Array, colour: Array, time: Array, offset: float) -> Exposure:
    """Follow the brightness as automatic exposure does.

    Args:
        brightness: radiosity in k directions in every frame (n, k).
        colour: mean colour of the run (3,).
        time: seconds (n,).
        offset: exposure compensation of the run in stops.
    """
    wanted = np.array([metered(values) for values in brightness]) * 2.0**offset
    wanted = np.log(np.clip(wanted, *_GAINS))
    gain = wanted.copy()
    for row in range(1, len(gain)):
        share = 1 - np.exp(-min(max(time[row] - time[row - 1], 0.0), 5.0) / _LAG)
        gain[row] = gain[row - 1] + share * (wanted[row] - gain[row - 1])
    balance = (colour / colour.mean()) ** -0.7
    gain = np.exp(gain)
    seconds = np.clip(0.03 * gain / 0.5, 0.004, 0.06)
    return Exposure(gain, balance, seconds)


def metered(values: Array, steps: int = 24) -> float:
    """Return the gain at which the mean of the clipped pixels is mid grey; more steps make it more exact."""
    low, high = np.log(1e-3), np.log(1e2)
    for _ in range(steps):
        middle = (low + high) / 2
        if np.mean(np.clip(values * np.exp(middle), 0, 1) ** (1 / 2.2)) < _KEY + 0.12:
            low = middle
        else:
            high = middle
    return float(np.exp((low + high) / 2))


def develop(light: Array, gain: float, balance: Array, wraps: bool, rng: np.random.Generator, quiet: float) -> Array:
    """Turn radiosity (rows, columns, 3) into a uint8 image.

    Args:
        light: radiosity after lens and motion.
        gain: pixel value per radiosity.
        balance: colour gains (3,).
        wraps: whether the left edge continues at the right one.
        rng: draws the noise.
        quiet: scale of the noise; below 1 where unwrapping would have averaged it.
    """
    value = light * (gain * balance).astype(np.float32)
    _glare(value, wraps)
    shot = _SHOT * np.sqrt(gain)
    start = int(rng.integers(0, _BANK - value.size))
    grain = _noise_bank()[start : start + value.size].reshape(value.shape)
    spread = cv2.sqrt(np.maximum(value, 0) * np.float32(shot**2) + np.float32((_READ * gain) ** 2))
    value += grain * spread * np.float32(quiet)
    grey = value.mean(axis=-1, keepdims=True)
    value = np.clip(grey + 1.12 * (value - grey), 0, 1)
    return _curve()[(value * 4095).astype(np.int32)]


def _glare(value: Array, wraps: bool) -> None:
    """Let what is too bright spill into its surroundings, in place."""
    height, width = value.shape[:2]
    small = cv2.resize(value, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    excess = np.clip(small - 1, 0, 40)
    if not excess.any():
        return
    scale = height / 128 if wraps else 1.0  # a panorama with fewer rows has fewer pixels per degree
    pad = round(24 * scale)
    mode = "wrap" if wraps else "edge"
    excess = np.pad(excess, ((0, 0), (pad, pad), (0, 0)), mode=mode)  # type: ignore[call-overload]
    halo = 0.03 * cv2.GaussianBlur(excess, (0, 0), 6 * scale) + 0.03 * cv2.GaussianBlur(excess, (0, 0), 1.5 * scale)
    value += cv2.resize(halo[:, pad:-pad], (width, height), interpolation=cv2.INTER_LINEAR)


@lru_cache(maxsize=1)
def _noise_bank() -> Array:
    return np.random.default_rng(20110).standard_normal(_BANK, dtype=np.float32)


@lru_cache(maxsize=1)
def _curve() -> Array:
    """Return the response of the camera: gamma with a slight shoulder, 4096 values."""
    x = np.arange(4096) / 4095
    return np.clip(255 * (x ** (1 / 2.2)) * (1 + 0.06 * np.sin(np.pi * x)) + 0.5, 0, 255).astype(np.uint8)
