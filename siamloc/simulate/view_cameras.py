"""Cameras of the training images: where the ray of each pixel goes, for panoramas and for ordinary cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from siamloc.data.panorama import PanoramaView
from siamloc.simulate.camera import HEIGHT
from siamloc.simulate.layout import Array

Cameras = Literal["any", "panoramas", "built_in"]
"""Which cameras are drawn from: panorama and ordinary cameras, only panorama cameras, or only the built-in one."""
_SHARE = {"any": 1.0, "panoramas": 0.75, "built_in": 0.25}


@dataclass(frozen=True)
class ViewCamera:
    """A camera that takes training images.

    Attributes:
        rows: number of rows of its images.
        columns: number of columns of its images.
        directions: (fraction of a column, of a row) -> unit viewing directions (rows, columns, 3) in the robot's
            frame, through points that far from the middles of the pixels.
        spread: angle in rad between the columns at each pixel (rows * columns,), float32.
        wraps: whether the left edge continues at the right one.
        shown: False where the lens leaves the image dark (rows, columns); None if it does so nowhere.
    """

    rows: int
    columns: int
    directions: Callable[[float, float], Array]
    spread: Array
    wraps: bool
    shown: Array | None = None


def draw_camera(
    rng: np.random.Generator, image_size: Sequence[int], cameras: Cameras = "any"
) -> tuple[ViewCamera, float]:
    """Draw a camera and its height in metres: sometimes those of the built-in one."""
    rows, columns = image_size
    kind = rng.random() * _SHARE[cameras]
    if kind < 0.25:
        return panorama(PanoramaView(rows, columns)), HEIGHT
    height = float(rng.uniform(0.35, 1.5))
    if kind < 0.75:
        view = PanoramaView(rows, columns, float(rng.uniform(15, 45)), -float(rng.uniform(20, 50)))
        return panorama(view, float(np.exp(rng.normal(0, 0.2)))), height
    aspect, pitch = float(rng.uniform(1.2, 1.8)), float(rng.uniform(-0.15, 0.1))
    if kind < 0.87:
        return photograph(image_size, float(np.radians(rng.uniform(55, 105))), aspect, pitch), height
    radius, angle = float(rng.uniform(0.9, 1.5)), float(np.radians(rng.uniform(60, 95)))
    return fisheye(image_size, radius, angle, aspect, pitch), height


def panorama(view: PanoramaView, bend: float = 1.0) -> ViewCamera:
    """Make a panorama camera.

    Args:
        view: size and elevations of the panoramas.
        bend: 1 if rows are evenly spaced in the tangent of the elevation; otherwise the exponent of the share of the
            way from the upper edge to the lower one, as for mirrors of other shapes.
    """
    rows, columns = view.height, view.width
    high, low = np.tan(np.radians([view.top, view.bottom]))

    def directions(across: float, down: float) -> Array:
        azimuth = -(np.arange(columns) + across + 0.5 - columns / 2) * (2 * np.pi / columns)
        slope = high + ((np.arange(rows) + down + 0.5) / rows) ** bend * (low - high)
        flat = 1 / np.sqrt(1 + slope**2)
        found = np.empty((rows, columns, 3))
        found[..., 0] = np.cos(azimuth) * flat[:, None]
        found[..., 1] = np.sin(azimuth) * flat[:, None]
        found[..., 2] = (slope * flat)[:, None]
        return found

    spread = 2 * np.pi / columns * np.linalg.norm(directions(0, 0)[:, 0, :2], axis=1)
    return ViewCamera(rows, columns, directions, spread.astype(np.float32).repeat(columns), wraps=True)


def photograph(image_size: Sequence[int], width: float, aspect: float, pitch: float = 0.0) -> ViewCamera:
    """Make an ordinary camera whose images are stretched to a size.

    Args:
        image_size: rows and columns.
        width: horizontal angle of view in rad.
        aspect: ratio of width to height of its images before they are stretched.
        pitch: angle in rad by which it looks up.
    """
    rows, columns = image_size
    half = float(np.tan(width / 2))

    def directions(across: float, down: float) -> Array:
        right, up = _grid(rows, columns, across, down)
        found = np.stack([np.ones((rows, columns)), -right * half, up * (half / aspect)], axis=-1)
        return _tilted(found / np.linalg.norm(found, axis=-1, keepdims=True), pitch)

    spread = np.full(rows * columns, width / columns, dtype=np.float32)
    return ViewCamera(rows, columns, directions, spread, wraps=False)


def fisheye(image_size: Sequence[int], radius: float, angle: float, aspect: float, pitch: float = 0.0) -> ViewCamera:
    """Make a camera with an equidistant fisheye lens whose images are stretched to a size.

    Args:
        image_size: rows and columns.
        radius: radius of the bright circle, in units of half the image height.
        angle: angle in rad between the axis and the directions seen on that circle.
        aspect: ratio of width to height of its images before they are stretched.
        pitch: angle in rad by which it looks up.
    """
    rows, columns = image_size

    def directions(across: float, down: float) -> Array:
        right, up = _grid(rows, columns, across, down)
        around = np.arctan2(up, -right * aspect)
        aside = np.minimum(np.hypot(right * aspect, up) / radius * angle, np.pi - 0.1)
        sine = np.sin(aside)
        return _tilted(np.stack([np.cos(aside), sine * np.cos(around), sine * np.sin(around)], axis=-1), pitch)

    right, up = _grid(rows, columns, 0, 0)
    spread = np.full(rows * columns, 2 * aspect / columns * angle / radius, dtype=np.float32)
    return ViewCamera(rows, columns, directions, spread, wraps=False, shown=np.hypot(right * aspect, up) <= radius)


def _grid(rows: int, columns: int, across: float, down: float) -> tuple[Array, Array]:
    """Return how far right and how far up the points in the pixels are, from -1 to 1 (rows, columns)."""
    right = (np.arange(columns) + across + 0.5) / columns * 2 - 1
    up = 1 - (np.arange(rows) + down + 0.5) / rows * 2
    across_all, up_all = np.meshgrid(right, up)
    return across_all, up_all


def _tilted(directions: Array, pitch: float) -> Array:
    """Return the directions (..., 3) of a camera tilted upwards by `pitch`."""
    cosine, sine = np.cos(pitch), np.sin(pitch)
    return directions @ np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
