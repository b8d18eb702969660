"""What cameras with a single viewpoint share: where they look, and from the directions of a panorama to pixels.

A model works in the frame of the camera: x to the right of the picture, y down, z along the optical axis. Where the
camera looks is said by three angles in the robot's frame, and every such camera gives any `PanoramaView`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from foundation.settings import Positive, Rule, Settings, Size
from siamloc.data.panorama import Array, PanoramaView
from siamloc.errors import ConfigError

ImageSize = tuple[int, int]
Angle = Annotated[float, Rule("an angle in degrees, from above 0 to 360", lambda value: 0 < value <= 360)]


@dataclass(frozen=True, kw_only=True)
class CentralCamera(Settings):
    """Base of the cameras with a single viewpoint. A model of your own needs only `to_image` and `to_ray`.

    Attributes:
        azimuth: direction of the optical axis in degrees, counter-clockwise from the robot's front.
        elevation: elevation of the optical axis in degrees: 0 for a camera that looks ahead, 90 for one that looks up.
        roll: angle in degrees by which the camera is turned clockwise about its optical axis, seen from behind it. At
            0, up is at the top of the picture; for a camera that looks up, the robot's back is, and its front at 180.
        mirrored: whether the picture is mirrored, as by a mirror.
        fov: full angle in degrees of the cone around the optical axis that the picture shows; all that the model
            allows if None.
        image_size: rows and columns of the pictures that the parameters belong to; any if None.
    """

    WHERE: ClassVar[str] = "unwrap"
    wraps: ClassVar[bool] = False

    azimuth: float = 0.0
    elevation: float = 0.0
    roll: float = 0.0
    mirrored: bool = False
    fov: Angle | None = None
    image_size: Size | None = None

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        """Return the pixels (..., 2) of unit rays (..., 3) in the camera's frame; NaN for those that are not shown."""
        raise self._lacks("to_image", "the pixels of rays")

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        """Return the rays (..., 3), of any length, in the camera's frame of pixels (..., 2); NaN for those without."""
        raise self._lacks("to_ray", "the rays of pixels")

    def project(self, directions: Array, image_size: ImageSize | None = None) -> Array:
        """Return the pixels (..., 2), column and row, at which directions (..., 3) of the robot's frame appear.

        Args:
            directions: of any length.
            image_size: rows and columns of the picture; those of the calibration if None.

        Returns:
            NaN for directions that the camera does not show; pixels may lie outside the picture.

        Raises:
            ConfigError: a picture of another size than the calibration's, or of a shape that the camera does not take.
        """
        size = self._fitting(image_size)
        rays = np.asarray(directions, dtype=np.float64) @ self._axes.T
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        pixels = np.array(self.to_image(rays, size), dtype=np.float64)
        if pixels.shape != (*rays.shape[:-1], 2):
            raise ConfigError(
                f"{type(self).__name__}.to_image must return pixels (..., 2), {(*rays.shape[:-1], 2)} for rays "
                f"{rays.shape}, got {pixels.shape}: stack columns and rows along the last axis"
            )
        pixels[self._hidden(rays)] = np.nan
        return pixels

    def back_project(self, pixels: Array, image_size: ImageSize | None = None) -> Array:
        """Return the unit directions (..., 3) in the robot's frame that pixels (..., 2) look at; NaN for none.

        Raises:
            ConfigError: as `project`.
        """
        rays = self.to_ray(np.asarray(pixels, dtype=np.float64), self._fitting(image_size))
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        rays[self._hidden(rays)] = np.nan
        return rays @ self._axes

    def shows(self, pixels: Array, image_size: ImageSize | None = None) -> Array:
        """Return which pixels (..., 2) look at something (...), bool."""
        return np.asarray(np.isfinite(self.back_project(pixels, image_size)[..., 0]))

    def sampling(self, view: PanoramaView, image_size: ImageSize) -> tuple[Array, Array]:
        """Return the columns (H, W) and rows (H, W) in the picture of a panorama's pixels, NaN where unseen."""
        pixels = self.project(view.directions(), image_size)
        return pixels[..., 0], pixels[..., 1]

    def _lacks(self, method: str, returns: str) -> ConfigError:
        return ConfigError(f"{type(self).__name__} lacks the method `{method}`, which returns {returns}: implement it")

    @cached_property
    def _axes(self) -> Array:
        """The camera's axes (3, 3) in the robot's frame: right, down, ahead."""
        azimuth, elevation, roll = np.radians([self.azimuth, self.elevation, self.roll])
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        ahead = np.cos(elevation) * flat + np.array([0.0, 0.0, np.sin(elevation)])
        level = np.array([flat[1], -flat[0], 0.0])
        below = np.cross(ahead, level)
        right = np.cos(roll) * level + np.sin(roll) * below
        return np.stack([-right if self.mirrored else right, np.cross(ahead, right), ahead])

    def _hidden(self, rays: Array) -> Array:
        """Return which unit rays (..., 3) in the camera's frame lie outside its field of view."""
        cone = self._cone
        return np.asarray(rays[..., 2] < (-2 if cone is None else np.cos(np.radians(cone / 2))))

    @property
    def _cone(self) -> float | None:
        return self.fov

    def _fitting(self, size: ImageSize | None) -> ImageSize:
        if size is None and self.image_size is None:
            raise ConfigError(f"{type(self).__name__} has no image_size: say of which size the picture is")
        if size is not None and self.image_size not in (None, tuple(size)):
            (rows, columns), (got_rows, got_columns) = self.image_size, size
            raise ConfigError(
                f"the camera was calibrated on pictures of {columns} x {rows} px, and this one has {got_columns} x "
                f"{got_rows}: give pictures of that size, or calibrate on these"
            )
        rows, columns = size or self.image_size or (0, 0)
        return rows, columns


@dataclass(frozen=True, kw_only=True)
class LensCamera(CentralCamera):
    """Base of the cameras whose model maps a ray to a point of a plane, in front of a camera matrix.

    Attributes:
        fx: focal length in pixels along the columns.
        fy: focal length in pixels along the rows; fx if None.
        cx: column of the principal point in pixels; the middle of the picture if None.
        cy: row of the principal point in pixels; the middle of the picture if None.
        skew: entry of the camera matrix next to fx, in pixels.
    """

    fx: Positive | None = None
    fy: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    skew: float = 0.0

    def to_plane(self, rays: Array) -> tuple[Array, Array]:
        """Return the points (...), (...) of the plane at which unit rays (..., 3) appear; NaN for none."""
        raise self._lacks("to_plane", "the points of the plane at which rays appear")

    def from_plane(self, x: Array, y: Array) -> Array:
        """Return the rays (..., 3) of points of the plane; NaN for none."""
        raise self._lacks("from_plane", "the rays of points of the plane")

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        """Return the pixels (..., 2) of unit rays (..., 3) in the camera's frame; NaN for those that are not shown."""
        fx, fy, cx, cy = self._matrix(size)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = self.to_plane(rays)
        return np.stack([fx * x + self.skew * y + cx, fy * y + cy], axis=-1)

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        """Return the rays (..., 3) in the camera's frame of pixels (..., 2); NaN for those without."""
        fx, fy, cx, cy = self._matrix(size)
        y = (pixels[..., 1] - cy) / fy
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.from_plane((pixels[..., 0] - cx - self.skew * y) / fx, y)

    def _matrix(self, size: ImageSize) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy."""
        if self.fx is None:
            raise ConfigError("unwrap.fx is not set: give the focal length in pixels, from a calibration")
        cx = (size[1] - 1) / 2 if self.cx is None else self.cx
        cy = (size[0] - 1) / 2 if self.cy is None else self.cy
        return self.fx, self.fx if self.fy is None else self.fy, cx, cy


def rises_to(coefficients: Sequence[float]) -> float:
    """Return the square of the argument up to which t (1 + k1 t^2 + k2 t^4 + ...) rises with t."""
    slope = [1.0, *((2 * power + 1) * k for power, k in enumerate(coefficients, 1))]
    roots = np.roots(slope[::-1])
    ends = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(ends.min(initial=np.inf))


def inverse(function: Callable[[Array], Array], values: Array, most: float) -> Array:
    """Invert a function that rises from 0: return the arguments up to `most` at which it has the given values.

    Values beyond the first maximum of the function give NaN.
    """
    grid = np.linspace(0, most, 4096)
    made = function(grid)
    end = np.flatnonzero(np.append(np.diff(made), -1.0) <= 0)[0] + 1
    found = np.interp(values, made[:end], grid[:end], right=np.nan)
    step = 1e-3 * grid[1]
    for _ in range(3):
        slope = (function(found + step) - function(found - step)) / (2 * step)
        found = found - np.clip((function(found) - values) / slope, -grid[1], grid[1])
    return found
