"""The cameras: where each pixel looks, and how light becomes pixel values (exposure, glare, noise, gamma).

`CAMERAS` are the two cameras of data sets; `draw_camera` draws those of training images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import ClassVar, Literal

import cv2
import numpy as np

from siamloc.data.cameras import HyperbolicMirror
from siamloc.data.central import CentralCamera
from siamloc.data.panorama import PanoramaView
from siamloc.simulate.layout import Array, single

#: Height of the viewpoint above the floor in metres.
HEIGHT = 0.95
#: Positions within a pixel of the rays that smooth edges, as fractions of a pixel; the first is the middle.
OFFSETS = ((0.0, 0.0), (-0.35, 0.15), (0.15, 0.35), (0.25, -0.3))
_RIM, _BODY = 236.0, 24.0
_VIGNETTE = 0.42


@dataclass(frozen=True)
class Pixels:
    """The pixels of a camera's image, and where each of them looks.

    Attributes:
        rows: row of each pixel (n,).
        columns: column of each pixel (n,).
        directions: unit viewing directions in the robot's frame (4, n, 3), float32, for each of the OFFSETS in a pixel.
        spread: angle in rad that a pixel covers (n,).
        vignette: share of the light that arrives, from 0 to 1 (n,).
    """

    rows: Array
    columns: Array
    directions: Array
    spread: Array
    vignette: Array


@dataclass(frozen=True)
class PanoramaCamera:
    """A camera that takes panoramas directly, like those that unwrapping produces."""

    wraps: ClassVar[bool] = True

    view: PanoramaView = field(default_factory=PanoramaView)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.view.height, self.view.width

    @cached_property
    def pixels(self) -> Pixels:
        """All pixels of the image."""
        rows, columns = (grid.ravel() for grid in np.mgrid[0 : self.view.height, 0 : self.view.width])
        camera = panorama(self.view)
        directions = [camera.directions(*offset).reshape(-1, 3) for offset in OFFSETS]
        return Pixels(rows, columns, single(directions), camera.spread, _vignette(directions[0]))

    def displacement(self, moves: Array, points: Array) -> tuple[Array, Array]:
        """Return how many columns and rows points (n, 3) in m shift in the image if they move by `moves` (n, 3)."""
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
    """A camera of any model: the camera of data sets, below a hyperbolic mirror, or another with its own image size.

    The image of the mirror is a ring with the camera's own reflection in the middle.

    Attributes:
        model: where each pixel looks.
        shape: rows and columns of the image.
    """

    model: HyperbolicMirror | CentralCamera = field(default_factory=HyperbolicMirror)
    shape: tuple[int, int] = (480, 640)

    @property
    def wraps(self) -> bool:
        """Whether the left edge continues at the right one."""
        return bool(getattr(self.model, "wraps", False))

    @cached_property
    def pixels(self) -> Pixels:
        """The pixels that show anything: below a mirror, the pixels of its ring."""
        model, (height, width) = self.model, self.shape
        rows, columns = (grid.ravel() for grid in np.mgrid[0:height, 0:width])
        if isinstance(model, HyperbolicMirror):
            radius = np.hypot(columns - model.cx, rows - model.cy)
            keep = (radius <= _RIM) & (radius >= _BODY)
            rows, columns = rows[keep], columns[keep]

        def seen_at(dx: float, dy: float) -> Array:
            return model.back_project(np.stack([columns + dx, rows + dy], axis=1), self.shape)

        directions = np.stack([seen_at(*offset) for offset in OFFSETS])
        seen = np.isfinite(directions).all(axis=(0, 2))
        corner, directions = seen_at(0.5, 0.5)[seen], directions[:, seen]
        spread = single(np.sqrt(2) * np.linalg.norm(np.nan_to_num(corner - directions[0]), axis=1))
        light = _vignette(directions[0]) if isinstance(model, HyperbolicMirror) else np.ones_like(spread)
        return Pixels(rows[seen], columns[seen], single(directions), spread, light)

    def displacement(self, moves: Array, points: Array) -> tuple[Array, Array]:
        """Return how many columns and rows points (n, 3) in m shift in the image if they move by `moves` (n, 3)."""
        after, before = (self.model.project(some, self.shape) for some in (points + moves, points))
        change = np.nan_to_num(after - before)
        return change[:, 0], change[:, 1]


Camera = PanoramaCamera | OmnidirectionalCamera
CameraName = Literal["omnidirectional", "panorama"]
#: The cameras of data sets.
CAMERAS: dict[str, Camera] = {"omnidirectional": OmnidirectionalCamera(), "panorama": PanoramaCamera()}


def _vignette(directions: Array) -> Array:
    """Return the share of the light that reaches the sensor, which falls off towards the rim of the mirror."""
    pixel = HyperbolicMirror().project(np.asarray(directions, dtype=np.float64))
    radius = np.hypot(pixel[:, 0] - 319.5, pixel[:, 1] - 239.5) / _RIM
    return (1 - _VIGNETTE * np.clip(radius, 0, 1.1) ** 4).astype(np.float32)


Cameras = Literal["any", "panoramas", "built_in", "ordinary"]
"""Which cameras are drawn from: panorama and ordinary cameras, only panorama cameras, only the built-in one, or only
ordinary cameras."""
_SHARE = {"any": (0.0, 1.0), "panoramas": (0.0, 0.75), "built_in": (0.0, 0.25), "ordinary": (0.75, 1.0)}


@dataclass(frozen=True)
class ViewCamera:
    """A camera that takes training images.

    Attributes:
        rows: height of its images in pixels.
        columns: width of its images in pixels.
        directions: (across, down) -> unit viewing directions (rows, columns, 3) in the robot's frame, through points
            that lie these shares of a pixel from its middle.
        spread: angle in rad between the columns at each pixel (rows * columns,), float32.
        wraps: whether the left edge continues at the right one.
        field: horizontal angle of view in rad.
        shown: False where the lens leaves the image dark (rows, columns); None if it is dark nowhere.
    """

    rows: int
    columns: int
    directions: Callable[[float, float], Array]
    spread: Array
    wraps: bool
    field: float = 2 * np.pi
    shown: Array | None = None


def draw_camera(
    rng: np.random.Generator, image_size: Sequence[int], cameras: Cameras = "any"
) -> tuple[ViewCamera, float]:
    """Draw a camera of training images and its height above the floor in metres.

    One camera in four is the built-in panorama camera, half of them are other panorama cameras, and the rest ordinary
    cameras, some of them with a fisheye lens.

    Args:
        rng: draws the kind of camera and its lens.
        image_size: rows and columns.
        cameras: "any", "panoramas", only the "built_in" panorama camera, or only "ordinary" cameras.
    """
    rows, columns = image_size
    first, last = _SHARE[cameras]
    kind = first + rng.random() * (last - first)
    if kind < 0.25:
        return panorama(PanoramaView(rows, columns)), HEIGHT
    height = rng.uniform(0.35, 1.5)
    if kind < 0.75:
        view = PanoramaView(rows, columns, rng.uniform(15, 45), -rng.uniform(20, 50))
        return panorama(view, float(np.exp(rng.normal(0, 0.2)))), height
    aspect, pitch = rng.uniform(1.2, 1.8), rng.uniform(-0.15, 0.1)
    if kind < 0.87:
        return photograph(image_size, float(np.radians(rng.uniform(55, 105))), aspect, pitch), height
    radius, angle = rng.uniform(0.9, 1.5), float(np.radians(rng.uniform(60, 95)))
    return fisheye(image_size, radius, angle, aspect, pitch), height


def panorama(view: PanoramaView, bend: float = 1.0) -> ViewCamera:
    """Make a panorama camera.

    Args:
        view: size in pixels and elevations in degrees of the panoramas.
        bend: 1 if rows are evenly spaced in the tangent of the elevation; otherwise the exponent of the share of the
            way from the upper edge to the lower one, as for mirrors of other shapes.
    """
    rows, columns = view.height, view.width
    high, low = np.tan(np.radians([view.top, view.bottom]))

    def directions(across: float, down: float) -> Array:
        azimuth = -(np.arange(columns) + across + 0.5 - columns / 2) * (2 * np.pi / columns)
        slope = high + ((np.arange(rows) + down + 0.5) / rows) ** bend * (low - high)
        flat = (1 / np.sqrt(1 + slope**2))[:, None]
        axes = np.broadcast_arrays(np.cos(azimuth) * flat, np.sin(azimuth) * flat, slope[:, None] * flat)
        return np.stack(axes, axis=-1)

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
    return ViewCamera(rows, columns, directions, spread, wraps=False, field=width)


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
    shown, field = np.hypot(right * aspect, up) <= radius, 2 * angle * min(aspect / radius, 1)
    return ViewCamera(rows, columns, directions, spread, wraps=False, field=field, shown=shown)


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


_KEY = 0.40
_LAG = 1.4
_GAINS = (0.04, 4.5)
_SHOT, _READ = 0.006, 0.0025
_BANK = 1 << 21


@dataclass(frozen=True)
class Exposure:
    """Camera settings for each of the n frames of a run.

    Attributes:
        gain: pixel value per radiosity (n,).
        balance: colour gains of the run (3,).
        seconds: how long the shutter is open (n,).
    """

    gain: Array
    balance: Array
    seconds: Array


def expose(brightness: Array, colour: Array, time: Array, offset: float) -> Exposure:
    """Return the exposure of every frame of a run, which follows the brightness with a delay.

    Args:
        brightness: radiosity in k directions in every frame (n, k).
        colour: mean colour of the run (3,).
        time: seconds (n,).
        offset: exposure compensation of the run in stops.
    """
    wanted = np.log(np.clip(np.array([metered(values) for values in brightness]) * 2.0**offset, *_GAINS))
    gain = wanted.copy()
    for row in range(1, len(gain)):
        share = 1 - np.exp(-min(max(time[row] - time[row - 1], 0.0), 5.0) / _LAG)
        gain[row] = gain[row - 1] + share * (wanted[row] - gain[row - 1])
    gain = np.exp(gain)
    colour = np.maximum(colour, 1e-6)  # without any light, pictures are dark noise
    return Exposure(gain, (colour / colour.mean()) ** -0.7, np.clip(0.03 * gain / 0.5, 0.004, 0.06))


def metered(values: Array, steps: int = 24) -> float:
    """Return the gain at which the mean of the clipped pixels is mid grey.

    Args:
        values: radiosities of the pixels, of any shape.
        steps: number of bisections of the range of gains; more make the gain more exact.
    """
    low, high = np.log(1e-3), np.log(1e2)
    for _ in range(steps):
        middle = (low + high) / 2
        if np.mean(np.clip(values * np.exp(middle), 0, 1) ** (1 / 2.2)) < _KEY + 0.12:
            low = middle
        else:
            high = middle
    return float(np.exp((low + high) / 2))


def develop(light: Array, gain: float, balance: Array, wraps: bool, rng: np.random.Generator, quiet: float) -> Array:
    """Expose an image as a camera does: gain, white balance, glare, noise and tone curve.

    Args:
        light: radiosity (rows, columns, 3), linear, after lens and motion.
        gain: pixel value, with 1 for white, per unit of radiosity.
        balance: gains of red, green and blue (3,).
        wraps: whether the left edge continues at the right one.
        rng: draws the noise.
        quiet: scale of the noise; below 1 where unwrapping would have averaged it.

    Returns:
        The image (rows, columns, 3), uint8.
    """
    value = light * (gain * balance).astype(np.float32)
    add_glare(value, wraps, joined=False)  # the images of a data set follow from its seed, their seam included
    add_noise(value, gain, rng, quiet)
    grey = ((value[..., 0] + value[..., 1] + value[..., 2]) / np.float32(3))[..., None]
    value = np.clip(grey + 1.12 * (value - grey), 0, 1)
    return _curve().take((value * 4095).astype(np.int32))


def add_noise(value: Array, gain: float, rng: np.random.Generator, quiet: float | Array) -> None:
    """Add shot and read noise to an exposed image, in place; arguments as for `develop`, or `quiet` per pixel."""
    shot = _SHOT * np.sqrt(gain)
    bank = _noise_bank(max(_BANK, 1 << value.size.bit_length()))
    start = int(rng.integers(0, len(bank) - value.size))
    grain = bank[start : start + value.size].reshape(value.shape)
    spread = cv2.sqrt(np.maximum(value, 0) * np.float32(shot**2) + np.float32((_READ * gain) ** 2))
    value += grain * spread * np.float32(quiet)


def add_glare(value: Array, wraps: bool, joined: bool = True) -> None:
    """Let what is too bright spill into its surroundings, in place.

    Args:
        value: pixel values (rows, columns, 3), with 1 for white, float32.
        wraps: whether the left edge continues at the right one.
        joined: whether the glare is also smooth across the edges of an image that wraps.
    """
    height, width = value.shape[:2]
    small = cv2.resize(value, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    excess = np.clip(small - 1, 0, 40)
    if not excess.any():
        return
    scale = height / 128 if wraps else 1.0  # a panorama with fewer rows has fewer pixels per degree
    pad = round(24 * scale)
    mode = "wrap" if wraps else "edge"
    excess = np.pad(excess, ((0, 0), (pad, pad), (0, 0)), mode=mode)  # type: ignore[call-overload]
    halo = 0.03 * cv2.GaussianBlur(excess, (0, 0), 6 * scale) + 0.03 * cv2.GaussianBlur(excess, (0, 0), 1.5 * scale)
    value += enlarged(halo[:, pad : pad + small.shape[1]], height, width, wraps and joined)


def enlarged(image: Array, rows: int, columns: int, wraps: bool) -> Array:
    """Enlarge an image (m, n, 3) to (rows, columns, 3) by linear interpolation, also between its edges if it wraps."""
    if not wraps:
        return cv2.resize(image, (columns, rows), interpolation=cv2.INTER_LINEAR)
    x, y = ((np.arange(size) + 0.5) * few / size - 0.5 for size, few in ((columns, image.shape[1]), (rows, len(image))))
    grid = np.meshgrid(single(x), single(np.clip(y, 0, len(image) - 1)))
    return cv2.remap(image, *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


@lru_cache(maxsize=1)
def _noise_bank(size: int) -> Array:
    return np.random.default_rng(20110).standard_normal(size, dtype=np.float32)


@lru_cache(maxsize=1)
def _curve() -> Array:
    """Return the response of the camera: gamma with a slight shoulder, 4096 values."""
    x = np.arange(4096) / 4095
    return np.clip(255 * (x ** (1 / 2.2)) * (1 + 0.06 * np.sin(np.pi * x)) + 0.5, 0, 255).astype(np.uint8)
