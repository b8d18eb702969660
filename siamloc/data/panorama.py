"""From omnidirectional image to panorama: polar unwrapping and the hyperbolic mirror model.

Frames of reference. The robot's frame is x forward, y left, z up; azimuth is counter-clockwise seen from above and
0 straight ahead; elevation is 0 at the horizon and positive upwards. The camera stands upright below its mirror and
looks up. With the top of the image turned to the robot's front, what is to the robot's left then appears on the
*right* of the omnidirectional image: a camera that looks up sees the floor plan mirrored. A panorama is not
mirrored: its columns run clockwise, the middle of its width (between the columns W/2 - 1 and W/2) looks straight
ahead, and the middle of column c has the azimuth (W/2 - c - 1/2) * 2 pi / W. Headings (theta) run counter-clockwise,
so when the robot turns left by delta rad, the contents of the panorama move right by delta * W / (2 pi) columns.

Axes. An image in a file or in memory (`unwrap`, `Localizer.locate`) is (rows, columns, 3). A batch of panoramas
(`PanoramaLibrary.batch`, `describe`, networks) is (B, 3, rows, columns). `Localizer.locate_panorama` takes both orders.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.settings import Count, NotNegative, Positive, Rule, Settings
from siamloc.errors import ConfigError, DataError

Array = NDArray[Any]


@typed
def column_azimuth(width: int) -> Array:
    """Return the azimuth in rad of the middle of each panorama column (W,), from +pi down to -pi."""
    return (width / 2 - np.arange(width) - 0.5) * (2 * np.pi / width)


@typed
def azimuth_column(azimuth: Array | float, width: int) -> Array:
    """Return the fractional column [-0.5, W - 0.5) at which an azimuth in rad appears; inverse of `column_azimuth`."""
    column = width / 2 - 0.5 - np.asarray(azimuth, dtype=np.float64) * width / (2 * np.pi)
    return (column + 0.5) % width - 0.5


@dataclass(frozen=True)
class PanoramaView(Settings):
    """Size of a panorama, and the elevations between which its rows lie.

    The rows divide a vertical cylinder evenly, so they are evenly spaced in the tangent of the elevation. The defaults
    give square pixels at 128 x 512 and look a little more at the floor than at the ceiling.

    Attributes:
        height: number of rows.
        width: number of columns; they cover the full turn.
        top: elevation of the upper edge in degrees.
        bottom: elevation of the lower edge in degrees.
    """

    WHERE: ClassVar[str] = "panorama"

    height: Count = 128
    width: Annotated[int, Rule("a whole number from 2", lambda value: value >= 2)] = 512
    top: float = 30.0
    bottom: float = -45.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not -90 < self.bottom < self.top < 90:
            raise ConfigError(f"elevations must satisfy -90 < bottom < top < 90 degrees, got {self.bottom}, {self.top}")

    def row_elevation(self) -> Array:
        """Return the elevation in rad of the middle of each row (H,), from the top down."""
        high, low = np.tan(np.radians([self.top, self.bottom]))
        return np.arctan(high + (np.arange(self.height) + 0.5) / self.height * (low - high))

    def directions(self) -> Array:
        """Return the unit viewing direction of every pixel in the robot's frame (H, W, 3)."""
        azimuth, elevation = np.meshgrid(column_azimuth(self.width), self.row_elevation())
        flat = np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


class OmnidirectionalCamera(Protocol, Hashable):
    """Anything that knows where each pixel of a panorama lies in the omnidirectional image."""

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return where the pixels of a panorama lie in an image: columns (H, W) and rows (H, W).

        Args:
            view: rows H, columns W and elevations of the panorama.
            image_size: rows and columns of the omnidirectional image.
        """
        ...


@dataclass(frozen=True)
class PolarRing(Settings):
    """Polar unwrapping of the ring between two radii, with rows evenly spaced in the radius.

    Attributes:
        centre: column and row of the ring's centre in pixels; the middle of the image if None.
        inner: inner radius in pixels; a fifth of the outer radius if None.
        outer: outer radius in pixels; up to the nearest image border if None.
        forward: direction of the robot's front in the image, in degrees clockwise from the image's upper edge.
        mirrored: whether the camera looks up into the mirror, so that the image shows the left on its right.
        inside_up: whether the ring's inner rim becomes the panorama's upper row (cameras that look down into a mirror
            on the floor side); otherwise the outer rim does.
    """

    WHERE: ClassVar[str] = "unwrap"

    centre: tuple[float, float] | None = None
    inner: NotNegative | None = None
    outer: Positive | None = None
    forward: float = 0.0
    mirrored: bool = True
    inside_up: bool = False

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return the columns (H, W) and rows (H, W) in the omnidirectional image of a panorama's pixels.

        Raises:
            ConfigError: a ring thinner than a pixel, or of which less than half lies in the image.
        """
        rows, columns = image_size
        cx, cy = self.centre if self.centre is not None else ((columns - 1) / 2, (rows - 1) / 2)
        outer = self.outer if self.outer is not None else min(cx, cy, columns - 1 - cx, rows - 1 - cy)
        inner = self.inner if self.inner is not None else outer / 5
        if outer - inner < 1:
            raise ConfigError(
                f"the ring from {inner:g} to {outer:g} px is thinner than a pixel: give "
                f"unwrap.inner and unwrap.outer in pixels of images of {columns} x {rows}"
            )
        share = (np.arange(view.height) + 0.5) / view.height
        radius = inner + share * (outer - inner) if self.inside_up else outer - share * (outer - inner)
        azimuth = column_azimuth(view.width)
        angle = np.radians(self.forward) + (azimuth if self.mirrored else -azimuth)  # clockwise from the upper edge
        x, y = cx + radius[:, None] * np.sin(angle), cy - radius[:, None] * np.cos(angle)
        inside = ((x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1)).mean()
        if inside < 0.5:
            raise ConfigError(
                f"only {inside:.0%} of the ring around ({cx:g}, {cy:g}) from {inner:g} to {outer:g} px lie in an "
                f"image of {columns} x {rows} px: correct unwrap.centre, unwrap.inner or unwrap.outer"
            )
        return x, y


@dataclass(frozen=True)
class HyperbolicMirror(Settings):
    """A pinhole camera below a hyperbolic mirror with a single viewpoint.

    The mirror is the sheet r(u) = p / (1 - e u_z) around its focus, where u is the unit direction of the scene; the
    camera is at the other focus, 2 e p / (e^2 - 1) below, and looks up. The mirror's focus is the viewpoint of the
    panorama. In such a central system the image depends only on the eccentricity: p sets the size in metres.

    Attributes:
        fx: focal length in pixels along the columns.
        fy: focal length in pixels along the rows.
        cx: column of the principal point in pixels.
        cy: row of the principal point in pixels.
        eccentricity: e > 1. Nothing above the elevation asin(1 / e) is seen.
        focal_parameter: p in metres (semi-latus rectum).
        forward: direction of the robot's front in the image, in degrees clockwise from the image's upper edge.
        mirrored: False for images that were flipped left to right after they were taken.

    Raises:
        ConfigError: an eccentricity that is not above 1, a focal parameter or focal length that is not positive, or a
            panorama that looks higher than the mirror shows.
    """

    WHERE: ClassVar[str] = "unwrap"

    fx: Positive = 340.0
    fy: Positive = 340.0
    cx: float = 319.5
    cy: float = 239.5
    eccentricity: Annotated[float, Rule("a number above 1", lambda value: value > 1)] = 1.4
    focal_parameter: Positive = 0.03
    forward: float = 0.0
    mirrored: bool = True

    @property
    def camera_depth(self) -> float:
        """Distance in metres of the camera's centre below the mirror's focus."""
        return 2 * self.eccentricity * self.focal_parameter / (self.eccentricity**2 - 1)

    @property
    def highest_elevation(self) -> float:
        """Elevation in rad that the mirror's rim would reach if the mirror were infinite: asin(1 / e)."""
        return float(np.arcsin(1 / self.eccentricity))

    def project(self, directions: Array) -> Array:
        """Return the pixels (..., 2), column and row, at which directions (..., 3) of the robot's frame appear.

        Directions need not have unit length; those above `highest_elevation` give NaN.
        """
        unit = np.asarray(directions, dtype=np.float64)
        unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
        denominator = 1 - self.eccentricity * unit[..., 2]
        reach = self.focal_parameter / np.where(denominator > 0, denominator, np.nan)
        depth = reach * unit[..., 2] + self.camera_depth
        side = 1 if self.mirrored else -1
        right, front = _turned(side * reach * unit[..., 1] / depth, reach * unit[..., 0] / depth, self.forward)
        return np.stack([self.cx + self.fx * right, self.cy - self.fy * front], axis=-1)

    def back_project(self, pixels: Array) -> Array:
        """Return the unit directions (..., 3) in the robot's frame that pixels (..., 2) look at.

        Pixels beyond the mirror's asymptote give NaN.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        right = (pixels[..., 0] - self.cx) / self.fx
        front = (self.cy - pixels[..., 1]) / self.fy
        side, ahead = _turned(right, front, -self.forward)
        left = side if self.mirrored else -side
        ray = np.stack([ahead, left, np.ones_like(left)], axis=-1)
        e, p = self.eccentricity, self.focal_parameter
        a = p / (e**2 - 1)
        denominator = a * e - a * np.linalg.norm(ray, axis=-1)
        reach = np.where(denominator > 0, a * p / np.where(denominator > 0, denominator, 1), np.nan)
        point = reach[..., None] * ray - np.array([0.0, 0.0, self.camera_depth])
        return point / np.linalg.norm(point, axis=-1, keepdims=True)

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return the columns (H, W) and rows (H, W) in the omnidirectional image of a panorama's pixels."""
        if np.radians(view.top) >= self.highest_elevation:
            raise ConfigError(
                f"the panorama looks up to {view.top} degrees, but a mirror of eccentricity {self.eccentricity} "
                f"shows nothing above {np.degrees(self.highest_elevation):.1f} degrees: lower the view's top"
            )
        pixels = self.project(view.directions())
        return pixels[..., 0], pixels[..., 1]


CAMERAS: dict[str, type[PolarRing] | type[HyperbolicMirror] | None] = {
    "none": None,
    "polar": PolarRing,
    "hyperbolic": HyperbolicMirror,
}


@typed
def unwrap(image: Array, camera: OmnidirectionalCamera, view: PanoramaView | None = None) -> Array:
    """Unwrap an omnidirectional image into a panorama by bilinear sampling.

    Args:
        image: (rows, columns) or (rows, columns, 3), uint8.
        camera: a `PolarRing` or a `HyperbolicMirror`, which knows where the panorama's pixels lie in the image.
        view: size and elevations of the panorama; 128 x 512 if None.

    Returns:
        (H, W) or (H, W, 3), uint8. Pixels whose sample lies outside the image are black.

    Columns run clockwise and the middle one looks straight ahead; headings run counter-clockwise, in rad.

    Raises:
        DataError: the image has no pixels or the wrong shape.

    Example:
        >>> ring = np.zeros((480, 640), np.uint8)
        >>> ring[:200] = 255  # what lies in front of the robot appears at the top of the picture
        >>> panorama = unwrap(ring, PolarRing(), PanoramaView(64, 256))
        >>> panorama.shape, int(panorama[0, 128]), int(panorama[0, 0])
        ((64, 256), 255, 0)
    """
    if image.ndim not in (2, 3) or min(image.shape[:2]) < 2:
        raise DataError(f"an omnidirectional image has shape (rows, columns[, 3]), got {image.shape}")
    columns, rows = _remap_tables(camera, view or PanoramaView(), image.shape[:2])
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


@lru_cache(maxsize=8)
def _remap_tables(
    camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]
) -> tuple[Array, Array]:
    columns, rows = camera.sampling(view, image_size)
    return columns.astype(np.float32), rows.astype(np.float32)


def _turned(right: Array, front: Array, degrees: float) -> tuple[Array, Array]:
    """Turn image-plane vectors (right, up) clockwise."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return right * cosine + front * sine, front * cosine - right * sine
