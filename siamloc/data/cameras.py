"""Camera models with a single viewpoint: the pixel at which a direction appears, and the direction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from foundation.settings import NotNegative, Positive, Rule, Settings, Share
from siamloc.data.central import Angle, CentralCamera, ImageSize, LensCamera, inverse, rises_to
from siamloc.data.panorama import Array, PanoramaView, PolarRing
from siamloc.data.presets import AutoRing, ColdRing
from siamloc.errors import ConfigError


def twice_as_wide(rows: int, columns: int) -> bool:
    """Return whether a picture is about twice as wide as high: exports differ by some rows that are cut off."""
    return 1.8 < columns / rows < 2.2


def two_views(rows: int, columns: int) -> str:
    """Return what to do with a picture in whose shape stereo cameras put two whole ones; "" for other shapes."""
    if not twice_as_wide(rows, 2 * columns):
        return ""
    return "; of two views above each other, keep the upper one, as `ffmpeg -i IN -vf crop=iw:ih/2:0:0 OUT` does"


@dataclass(frozen=True)
class EquirectangularCamera(CentralCamera):
    """A 360-degree picture whose columns are evenly spaced in azimuth and rows in elevation; whole, or a part of it.

    The optical axis goes through the middle of the whole picture.

    Attributes:
        highest: elevation of the picture's upper edge in degrees, seen from the camera; None for a whole picture, 90.
        lowest: elevation of its lower edge; None for a whole picture, -90.
        turn: angle in degrees that its columns cover, around the optical axis.
    """

    highest: float | None = None
    lowest: float | None = None
    turn: Angle = 360.0

    def __post_init__(self) -> None:
        super().__post_init__()
        high, low = self._edges
        if not -90 <= low < high <= 90:
            raise ConfigError(f"elevations must satisfy -90 <= unwrap.lowest < unwrap.highest <= 90, got {low}, {high}")

    @property
    def wraps(self) -> bool:  # type: ignore[override]
        """Whether the left edge continues at the right one."""
        return self.turn == 360

    @property
    def whole(self) -> bool:
        """Whether the picture shows everything."""
        return self.highest is self.lowest is None and self.turn == 360

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        """Return the pixels (..., 2) of unit rays (..., 3) in the camera's frame."""
        high, low = self._edges
        column = (np.degrees(np.arctan2(rays[..., 0], rays[..., 2])) / self.turn + 0.5) * size[1] - 0.5
        row = (high - np.degrees(np.arcsin(np.clip(-rays[..., 1], -1, 1)))) / (high - low) * size[0] - 0.5
        return np.stack([column, row], axis=-1)

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        """Return the rays (..., 3) in the camera's frame of pixels (..., 2)."""
        high, low = self._edges
        right = np.radians(((pixels[..., 0] + 0.5) / size[1] - 0.5) * self.turn)
        up = np.radians(high - (pixels[..., 1] + 0.5) / size[0] * (high - low))
        return np.stack([np.cos(up) * np.sin(right), -np.sin(up), np.cos(up) * np.cos(right)], axis=-1)

    @property
    def _edges(self) -> tuple[float, float]:
        return (90.0 if self.highest is None else self.highest, -90.0 if self.lowest is None else self.lowest)

    def _fitting(self, size: ImageSize | None) -> ImageSize:
        rows, columns = super()._fitting(size)
        if self.whole and not twice_as_wide(rows, columns):
            remedy = "cut black bars off, or of a part say unwrap.highest and unwrap.lowest in degrees"
            if twice_as_wide(columns, rows):
                remedy = "turn it upright, by 90 degrees"
            raise ConfigError(
                f"a whole equirectangular picture is twice as wide as high, and this one has {columns} x {rows} px: "
                f"{remedy}{two_views(rows, columns)}"
            )
        return rows, columns


@dataclass(frozen=True)
class FisheyeCamera(LensCamera):
    """A fisheye lens: equidistant, or with the polynomial of Kannala & Brandt 2006, as in OpenCV and Kalibr.

    A ray at the angle t from the optical axis appears at the radius t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8). Without
    a calibration, `fov` alone is enough: the bright circle then fills the shorter side of the picture, and shows 180
    degrees if `fov` is None, too.

    Attributes:
        k: coefficients k1 to k4.
    """

    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def to_plane(self, rays: Array) -> tuple[Array, Array]:
        """Return the points of the plane at which unit rays (..., 3) appear; NaN beyond the polynomial's maximum."""
        side = np.hypot(rays[..., 0], rays[..., 1])
        angle = np.arctan2(side, rays[..., 2])
        radius = self._radius(np.where(angle <= self._widest, angle, np.nan))
        scale = np.where(side > 0, radius / side, 1.0)
        return scale * rays[..., 0], scale * rays[..., 1]

    def from_plane(self, x: Array, y: Array) -> Array:
        """Return the rays (..., 3) of points of the plane; NaN beyond the polynomial's maximum."""
        radius = np.hypot(x, y)
        angle = inverse(self._radius, radius, self._widest)
        scale = np.where(radius > 0, np.sin(angle) / radius, 1.0)
        return np.stack([scale * x, scale * y, np.cos(angle)], axis=-1)

    def _radius(self, angle: Array) -> Array:
        return np.asarray(angle * np.polyval([*self.k[::-1], 1.0], angle**2))

    @cached_property
    def _widest(self) -> float:
        return min(np.pi, rises_to(self.k) ** 0.5)

    @property
    def _cone(self) -> float | None:
        return self.fov or (None if self.fx else 180.0)

    def _matrix(self, size: ImageSize) -> tuple[float, float, float, float]:
        if self.fx is not None:
            return super()._matrix(size)
        reach = self._radius(np.radians((self._cone or 180.0) / 2))
        return replace(self, fx=min(size) / 2 / float(reach))._matrix(size)


@dataclass(frozen=True)
class UnifiedCamera(LensCamera):
    """The unified model of Mei & Rives 2007, for mirrors and fisheye lenses, as OpenCV's `omnidir`, Kalibr's omni.

    A unit ray is seen from a point `xi` behind the centre of the unit sphere, and then distorted. A camera that looks
    up into a mirror has its optical axis, which goes through the middle of the picture, *down*: elevation=-90
    mirrored=true.

    Attributes:
        xi: distance of that point.
        distortion: coefficients k1, k2, p1, p2 of radial and tangential distortion.
    """

    xi: NotNegative = 1.0
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def to_plane(self, rays: Array) -> tuple[Array, Array]:
        """Return the points of the plane at which unit rays (..., 3) appear; NaN for those behind the model."""
        lowest = -min(self.xi, 1 / self.xi) if self.xi else 0.0
        depth = np.where(rays[..., 2] > lowest, rays[..., 2] + self.xi, np.nan)
        return self._distorted(rays[..., 0] / depth, rays[..., 1] / depth)

    def from_plane(self, x: Array, y: Array) -> Array:
        """Return the rays (..., 3) of points of the plane; NaN for none."""
        x, y = self._undistorted(x, y)
        square = x**2 + y**2
        scale = (self.xi + np.sqrt(1 + (1 - self.xi**2) * square)) / (1 + square)
        return np.stack([scale * x, scale * y, scale - self.xi], axis=-1)

    def _distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2 = self.distortion
        square = x**2 + y**2
        radial = np.where(square <= rises_to((k1, k2)), 1 + k1 * square + k2 * square**2, np.nan)
        return (
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
            y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
        )

    def _undistorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the undistorted points of distorted points: the inverse of `_distorted`, by Newton's method.

        The method begins with the points that radial distortion alone, k1 and k2, would move there.
        """
        if not any(self.distortion):
            return x, y
        k1, k2, p1, p2 = self.distortion
        radius, most = np.hypot(x, y), min(rises_to((k1, k2)) ** 0.5, 1e3)
        start = inverse(lambda one: one * (1 + k1 * one**2 + k2 * one**4), radius, most)
        u, v = (one * np.where(radius > 0, start / radius, 1) for one in (x, y))
        for _ in range(5):
            found_x, found_y = self._distorted(u, v)
            square, off_x, off_y = u**2 + v**2, x - found_x, y - found_y
            radial, slope = 1 + k1 * square + k2 * square**2, 2 * k1 + 4 * k2 * square
            xx, yy = (radial + slope * one**2 for one in (u, v))
            xx, yy = xx + 2 * p1 * v + 6 * p2 * u, yy + 6 * p1 * v + 2 * p2 * u
            xy = slope * u * v + 2 * p1 * u + 2 * p2 * v
            area = xx * yy - xy**2
            u, v = u + (yy * off_x - xy * off_y) / area, v + (xx * off_y - xy * off_x) / area
        return u, v


@dataclass(frozen=True)
class DoubleSphereCamera(LensCamera):
    """The double sphere model of Usenko, Demmel & Cremers 2018, for fisheye lenses, as Kalibr's ds.

    Attributes:
        xi: distance between the centres of the two spheres.
        alpha: share of the second sphere against the plane.
    """

    xi: float = 0.0
    alpha: Share = 0.5

    def to_plane(self, rays: Array) -> tuple[Array, Array]:
        """Return the points of the plane at which unit rays (..., 3) appear; NaN for those behind the model."""
        xi, alpha = self.xi, self.alpha
        first = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
        lowest = -(first + xi) / np.sqrt(2 * first * xi + xi**2 + 1)
        second = np.sqrt(1 + 2 * xi * rays[..., 2] + xi**2)
        depth = np.where(rays[..., 2] > lowest, alpha * second + (1 - alpha) * (xi + rays[..., 2]), np.nan)
        return rays[..., 0] / depth, rays[..., 1] / depth

    def from_plane(self, x: Array, y: Array) -> Array:
        """Return the rays (..., 3) of points of the plane; NaN for none."""
        xi, alpha, square = self.xi, self.alpha, x**2 + y**2
        z = (1 - alpha**2 * square) / (alpha * np.sqrt(1 - (2 * alpha - 1) * square) + 1 - alpha)
        scale = (z * xi + np.sqrt(z**2 + (1 - xi**2) * square)) / (z**2 + square)
        return np.stack([scale * x, scale * y, scale * z - xi], axis=-1)


@dataclass(frozen=True)
class OCamCamera(CentralCamera):
    """The polynomial model of Scaramuzza et al. 2006, for mirrors and fisheye lenses, of the toolbox OCamCalib.

    A pixel at the radius r from the centre looks along (r, -polynomial(r)), across and along the optical axis.

    Attributes:
        polynomial: coefficients of the polynomial, the constant first.
        cx: column of the centre in pixels.
        cy: row of the centre in pixels.
        affine: c, d and e of the matrix [[c, d], [e, 1]] from sensor to picture, in rows and columns.
    """

    polynomial: tuple[float, ...] = (-200.0, 0.0, 0.001)
    cx: float = 319.5
    cy: float = 239.5
    affine: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        """Return the pixels (..., 2) of unit rays (..., 3) in the camera's frame; NaN for those that are not shown."""
        side = np.hypot(rays[..., 0], rays[..., 1])
        radius = inverse(self._angle, np.arctan2(side, rays[..., 2]), float(np.hypot(*size)))
        scale = np.where(side > 0, radius / np.where(side > 0, side, 1), 0.0)
        right, down = scale * rays[..., 0], scale * rays[..., 1]
        c, d, e = self.affine
        return np.stack([e * down + right + self.cx, c * down + d * right + self.cy], axis=-1)

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        """Return the rays (..., 3) in the camera's frame of pixels (..., 2)."""
        c, d, e = self.affine
        column, row = pixels[..., 0] - self.cx, pixels[..., 1] - self.cy
        down, right = (row - d * column) / (c - d * e), (c * column - e * row) / (c - d * e)
        return np.stack([right, down, -np.polyval(self.polynomial[::-1], np.hypot(right, down))], axis=-1)

    def _angle(self, radius: Array) -> Array:
        return np.asarray(np.arctan2(radius, -np.polyval(self.polynomial[::-1], radius)))


Lens = FisheyeCamera | UnifiedCamera | DoubleSphereCamera


@dataclass(frozen=True)
class DualFisheyeCamera(CentralCamera):
    """Two lenses back to back, in the two halves of one picture or in two pictures, as 360-degree cameras store them.

    Each direction is taken from the lens whose axis is nearer; the distance between the lenses is neglected.

    Attributes:
        front: the lens of the left half, whose `azimuth`, `elevation` and `roll` are those from the camera's front.
        back: the lens of the right half; its angles are those from the camera's back.
        second: for two pictures, a part of the front picture's name and what replaces it in the name of the other one,
            such as ("_00_", "_10_"). In memory, both are one picture, side by side.
        fov: if given, both lenses get it in place of their own; it is None afterwards.
    """

    front: Lens = FisheyeCamera(fov=190.0)
    back: Lens = FisheyeCamera(fov=190.0)
    second: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fov is not None:  # a cone around the front's axis would cut the back lens off
            for name in ("front", "back"):
                object.__setattr__(self, name, replace(getattr(self, name), fov=self.fov))
            object.__setattr__(self, "fov", None)

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        """Return the pixels (..., 2) of unit rays (..., 3) in the camera's frame; NaN for those that are not shown."""
        half = (size[0], size[1] // 2)
        found, nearness = [], []
        for number, (lens, sign) in enumerate(((self.front, 1.0), (self.back, -1.0))):
            outer = np.stack([sign * rays[..., 2], -sign * rays[..., 0], -rays[..., 1]], axis=-1)
            pixels = lens.project(outer, half)
            pixels[(np.abs(pixels[..., 0] + 0.5 - half[1] / 2) > half[1] / 2)] = np.nan
            found.append(pixels + np.array([number * half[1], 0]))
            nearness.append(np.where(np.isnan(pixels[..., 0]), -2.0, outer @ lens._axes[2]))
        return np.where((nearness[0] >= nearness[1])[..., None], *found)

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        """Return the rays (..., 3) in the camera's frame of pixels (..., 2); NaN for those without."""
        half = (size[0], size[1] // 2)
        front = self.front.back_project(pixels, half)
        back = self.back.back_project(pixels - [half[1], 0], half) * [-1, -1, 1]
        outer = np.where((pixels[..., 0] < half[1] - 0.5)[..., None], front, back)
        return np.stack([-outer[..., 1], -outer[..., 2], outer[..., 0]], axis=-1)

    def _fitting(self, size: ImageSize | None) -> ImageSize:
        rows, columns = super()._fitting(size)
        if not twice_as_wide(rows, columns) and not (self.front.image_size and self.back.image_size):
            raise ConfigError(
                f"a picture of two fisheye lenses side by side is twice as wide as high, and this one has {columns} x "
                f"{rows} px: give such pictures, or unwrap.front.image_size and unwrap.back.image_size"
            )
        return rows, columns


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
        presumed: whether the eccentricity is presumed, as by `siamloc.data.ring.likely_mirror`: a height of the camera
            above the floor then says nothing about lengths.
        inner: radius in pixels around the principal point within which the image shows the camera itself, or no mirror:
            directions that would appear there are not seen.

    Raises:
        ConfigError: an eccentricity that is not above 1, a focal parameter or focal length that is not positive, a
            negative radius, or a panorama that looks higher than the mirror shows.
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
    presumed: bool = False
    inner: NotNegative = 0.0

    @property
    def camera_depth(self) -> float:
        """Distance in metres of the camera's centre below the mirror's focus."""
        return 2 * self.eccentricity * self.focal_parameter / (self.eccentricity**2 - 1)

    @property
    def highest_elevation(self) -> float:
        """Elevation in rad that the mirror's rim would reach if the mirror were infinite: asin(1 / e)."""
        return float(np.arcsin(1 / self.eccentricity))

    @property
    def lowest_elevation(self) -> float:
        """Elevation in rad that appears on the inner rim."""
        return float(np.arcsin(self._unified.back_project(np.array([self.cx + self.inner, self.cy]))[2]))

    def project(self, directions: Array, image_size: ImageSize | None = None) -> Array:
        """Return the pixels (..., 2), column and row, at which directions (..., 3) of the robot's frame appear.

        Directions need not have unit length; those above `highest_elevation` or within the inner rim give NaN.
        """
        seen = np.asarray(directions, dtype=np.float64)
        pixels = self._unified.project(seen)
        pixels[self._beyond(seen) | self._within(pixels)] = np.nan
        return pixels

    def back_project(self, pixels: Array, image_size: ImageSize | None = None) -> Array:
        """Return the unit directions (..., 3) in the robot's frame that pixels (..., 2) look at.

        Pixels beyond the mirror's asymptote or within the inner rim give NaN.
        """
        found = self._unified.back_project(pixels)
        found[self._beyond(found) | self._within(np.asarray(pixels))] = np.nan
        return found

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return the columns (H, W) and rows (H, W) in the omnidirectional image of a panorama's pixels."""
        if np.radians(view.top) >= self.highest_elevation:
            raise ConfigError(
                f"the panorama looks up to {view.top} degrees, but a mirror of eccentricity {self.eccentricity} "
                f"shows nothing above {np.degrees(self.highest_elevation):.1f} degrees: lower the view's top"
            )
        pixels = self.project(view.directions())
        return pixels[..., 0], pixels[..., 1]

    @cached_property
    def _unified(self) -> UnifiedCamera:
        """The same projection in the unified model, whose optical axis is that of the mirror, downwards."""
        square = self.eccentricity**2
        scale = (square - 1) / (square + 1)
        return UnifiedCamera(
            fx=self.fx * scale,
            fy=self.fy * scale,
            cx=self.cx,
            cy=self.cy,
            xi=2 * self.eccentricity / (square + 1),
            elevation=-90.0,
            azimuth=-self.forward if self.mirrored else self.forward,
            mirrored=self.mirrored,
            image_size=(1, 1),
        )

    def _beyond(self, directions: Array) -> Array:
        """Return which directions (..., 3) no ray from the camera reaches, even by an infinite mirror."""
        return np.asarray(self.eccentricity * directions[..., 2] >= np.linalg.norm(directions, axis=-1))

    def _within(self, pixels: Array) -> Array:
        """Return which pixels (..., 2) lie within the inner rim."""
        return np.asarray(np.hypot(pixels[..., 0] - self.cx, pixels[..., 1] - self.cy) < self.inner)


CAMERAS: dict[str, type[PolarRing] | type[HyperbolicMirror] | type[CentralCamera] | None] = {
    "none": None,
    "polar": PolarRing,
    "auto": AutoRing,
    "cold": ColdRing,
    "hyperbolic": HyperbolicMirror,
    "unified": UnifiedCamera,
    "double_sphere": DoubleSphereCamera,
    "fisheye": FisheyeCamera,
    "dual_fisheye": DualFisheyeCamera,
    "ocam": OCamCamera,
    "equirectangular": EquirectangularCamera,
}
"""The camera models by the name that `unwrap.kind` has on the command line."""
