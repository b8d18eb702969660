"""From omnidirectional image to panorama: the view of a panorama, polar unwrapping, and sampling.

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

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
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

    def tilted(self, roll: float, pitch: float) -> PanoramaView:
        """Return the view that stays level while the robot is tilted: its directions turn against the robot.

        Args:
            roll: angle in rad about the axis ahead, positive where the left side is up.
            pitch: angle in rad about the axis to the left, positive where the front is down.
        """
        return _TiltedView(self.height, self.width, self.top, self.bottom, float(roll), float(pitch))


@dataclass(frozen=True)
class _TiltedView(PanoramaView):
    """The level view from a robot that is tilted by `roll` and `pitch`, in rad."""

    roll: float = 0.0
    pitch: float = 0.0

    def directions(self) -> Array:
        (sine_r, cosine_r), (sine_p, cosine_p) = ((np.sin(one), np.cos(one)) for one in (self.roll, self.pitch))
        about_ahead = np.array([[1, 0, 0], [0, cosine_r, -sine_r], [0, sine_r, cosine_r]])
        about_left = np.array([[cosine_p, 0, sine_p], [0, 1, 0], [-sine_p, 0, cosine_p]])
        return super().directions() @ about_left @ about_ahead


class OmnidirectionalCamera(Protocol, Hashable):
    """Anything that knows where each pixel of a panorama lies in the omnidirectional image.

    Attributes:
        wraps: optional; True if the left edge of the image continues at its right edge.
        shows: optional; a method that returns which pixels (..., 2), column and row, of an image of a size show
            something (...), bool: the others, such as the black around the circle of a fisheye, are not used.
    """

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return where the pixels of a panorama lie in an image: columns (H, W) and rows (H, W), NaN where unseen.

        Args:
            view: rows H, columns W and elevations of the panorama; its `directions()` are those of its pixels.
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
        ahead, left, up = np.moveaxis(view.directions(), -1, 0)
        high, low = np.tan(np.radians([view.top, view.bottom]))
        share = (high - up / np.hypot(ahead, left)) / (high - low)
        share[(share < 0) | (share > 1)] = np.nan
        radius = inner + share * (outer - inner) if self.inside_up else outer - share * (outer - inner)
        azimuth = np.arctan2(left, ahead)
        angle = np.radians(self.forward) + (azimuth if self.mirrored else -azimuth)  # clockwise from the upper edge
        x, y = cx + radius * np.sin(angle), cy - radius * np.cos(angle)
        inside = ((x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1)).mean()
        if inside < 0.5:
            raise ConfigError(
                f"only {inside:.0%} of the ring around ({cx:g}, {cy:g}) from {inner:g} to {outer:g} px lie in an "
                f"image of {columns} x {rows} px: correct unwrap.centre, unwrap.inner or unwrap.outer"
            )
        return x, y


@typed
def unwrap(image: Array, camera: OmnidirectionalCamera, view: PanoramaView | None = None) -> Array:
    """Unwrap an omnidirectional image into a panorama.

    The image is sampled bilinearly, at several points in each pixel of a panorama that is coarser than the image.

    Args:
        image: (rows, columns) or (rows, columns, 3), uint8.
        camera: a `PolarRing`, a `HyperbolicMirror`, a `FisheyeCamera` or another, which knows where the panorama's
            pixels lie in the image.
        view: size and elevations of the panorama; 128 x 512 if None.

    Returns:
        (H, W) or (H, W, 3), uint8. Pixels that the camera does not see (`seen`) show what it sees nearest to them,
        blurred: a network would take black for something dark.

    Columns run clockwise and the middle one looks straight ahead; headings run counter-clockwise, in rad.

    Raises:
        ConfigError: the camera does not fit an image of this size, or sees nothing of the panorama.
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
    view = view or PanoramaView()
    columns, rows, sees, size = _tables_for(camera, view, image.shape[:2])
    if size != image.shape[:2]:
        image = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
    found = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    if found.shape[:2] != sees.shape:
        found = cv2.resize(found, sees.shape[::-1], interpolation=cv2.INTER_AREA)
    if not sees.all():
        side = view.height // 4 | 1
        wide = cv2.copyMakeBorder(found, 0, 0, side, side, cv2.BORDER_WRAP)
        found[~sees] = cv2.blur(wide, (side, side))[:, side:-side][~sees]
    return found


@typed
def seen(camera: OmnidirectionalCamera, view: PanoramaView, image_size: Sequence[int]) -> Array:
    """Return which pixels of a panorama the camera sees (H, W), bool.

    Args:
        camera: the camera.
        view: size and elevations of the panorama.
        image_size: rows and columns of the camera's images.

    Raises:
        ConfigError: as `unwrap`.

    Example:
        >>> view = PanoramaView(4, 8)
        >>> seen(PolarRing(centre=(99.5, 55.0), inner=10, outer=70), view, (200, 200)).sum(axis=1).tolist()
        [6, 8, 8, 8]
    """
    rows, columns = image_size
    return np.asarray(_tables_for(camera, view, (rows, columns))[2])


def in_pixels(camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]) -> bool:
    """Return whether a camera's parameters count in pixels of images of one size, and not by their shape alone."""
    one, (rows, columns) = np.stack(camera.sampling(view, image_size)), image_size
    try:
        other = np.stack(camera.sampling(view, (2 * rows, 2 * columns)))
    except ConfigError:  # it was calibrated on images of this size
        return True
    return not np.allclose(2 * one, other, atol=2, equal_nan=True)


def finer(camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]) -> PanoramaView:
    """Return a view with a whole number of points in each pixel, so that it is about as fine as the image."""
    points = getattr(camera, "points", None)
    if points is None:
        columns, rows = _sampled(camera, view, image_size)
        points = min(max(round(_step(columns, rows)), 1), _FINEST)
    return view if points == 1 else replace(view, height=points * view.height, width=points * view.width)


def _step(columns: Array, rows: Array) -> float:
    """Return the distance in an image between neighbouring points in a row of the panorama; 1 if none are seen."""
    steps = np.hypot(np.diff(columns, axis=1), np.diff(rows, axis=1))
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if len(steps) else 1.0


def shows_nothing(panoramas: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which panoramas (n, 3, H, W), uint8, show hardly more than one colour (n,), as a covered camera does."""
    return np.asarray(panoramas.std(axis=(2, 3), dtype=np.float32).max(axis=1) <= _BLANK)


_BLANK = 5.0  # standard deviation of each channel
_FINEST = 4  # points in a pixel of the panorama, along each of its sides
_LEAST = 0.02  # share of the panorama that a camera must see
_CLEAR = 0.99  # weight of the pixels that show something, among those between which a point lies
_BLOCKS = 768  # of an image, along a side, at most: a block shows something if all its corners do


def _tables(
    camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]
) -> tuple[Array, Array, Array, tuple[int, int]]:
    """Return the columns and rows of an image to sample (kH, kW), float32, for k x k points in each pixel; which pixels
    are seen (H, W); and the size to which the image is shrunk before, since points that lie more than a pixel apart
    would alias. Points that are not seen are moved to the nearest ones that are."""
    columns, rows = _sampled(camera, view, image_size)
    sees = _inside(columns, rows, image_size)
    if sees.mean() < _LEAST:
        raise ConfigError(
            f"the camera sees {sees.mean():.0%} of a panorama from {view.top:g} to {view.bottom:g} degrees in an image "
            f"of {image_size[1]} x {image_size[0]} px: correct its parameters, where it looks, or the view"
        )
    columns, rows = points_of(camera, finer(camera, view, image_size), image_size)
    inside = _inside(columns, rows, image_size)
    height, width = _shrunk_size(columns, rows, image_size)
    columns, rows = _filled(*_shrunk(columns, rows, image_size, (height, width)), inside)
    if not getattr(camera, "wraps", False):
        columns = columns.clip(0, width - 1)
    return columns.astype(np.float32), rows.clip(0, height - 1).astype(np.float32), sees, (height, width)


_cached_tables = lru_cache(maxsize=8)(_tables)


def _tables_for(
    camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]
) -> tuple[Array, Array, Array, tuple[int, int]]:
    """Return the tables of a view, kept from picture to picture unless it is tilted: every tilt has its own.

    Raises:
        ConfigError: a camera by which tables cannot be kept.
    """
    if type(view) is not PanoramaView:
        return _tables(camera, view, image_size)
    try:
        hash(camera)
    except TypeError as error:
        raise ConfigError(
            f"{type(camera).__name__} cannot be told from other cameras ({error}): make it a frozen dataclass with "
            "plain values, tuples instead of lists and arrays"
        ) from error
    return _cached_tables(camera, view, image_size)


def _sampled(camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
    """Return what a camera's `sampling` returns, which may be the user's own, after checking its shape.

    Raises:
        ConfigError: anything but two arrays (H, W).
    """
    found, size = camera.sampling(view, image_size), (view.height, view.width)
    parts = found if isinstance(found, tuple | list | np.ndarray) and len(found) == 2 else (found,)
    got = [getattr(part, "shape", type(part).__name__) for part in parts]
    if got != [size, size]:
        raise ConfigError(
            f"`sampling` of {type(camera).__name__} must return two arrays (H, W) = {size}, the columns and the rows "
            f"in the image, got {' and '.join(map(str, got))}"
        )
    return parts[0], parts[1]


def points_of(camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
    """Return where the pixels of a panorama (H, W) lie in an image, NaN where unseen.

    Where a camera tells what it `shows`, points between pixels that do not all show something are moved to the nearest
    others: the black around the circle of a fisheye is not mixed in.

    Raises:
        ConfigError: the camera samples in another shape.
    """
    columns, rows = _sampled(camera, view, image_size)
    if not hasattr(camera, "shows"):
        return columns, rows
    inside, size = _inside(columns, rows, image_size), _shrunk_size(columns, rows, image_size)
    column, row = (np.nan_to_num(one).astype(np.float32) for one in _shrunk(columns, rows, image_size, size))
    shown = cv2.remap(_shown(camera, image_size, size), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    clear = inside & (shown > _CLEAR)
    if not clear.any() or (clear == inside).all():
        return columns, rows
    column, row = _filled(columns, rows, clear)
    return np.where(inside, column, np.nan), np.where(inside, row, np.nan)


@lru_cache(maxsize=8)  # the same for every tilt
def _shown(camera: Any, image_size: tuple[int, int], size: tuple[int, int]) -> Array:
    """Return 1 for each pixel of a shrunk image, or block of pixels, that shows something at all its corners, else 0.

    Returns:
        float32, of the shrunk size.
    """
    y, x = (
        np.linspace(-0.5, side - 0.5, min(count, _BLOCKS) + 1) for side, count in zip(image_size, size, strict=True)
    )
    corner = camera.shows(np.stack(np.meshgrid(x, y), axis=-1), image_size)
    whole = corner[1:, 1:] & corner[1:, :-1] & corner[:-1, 1:] & corner[:-1, :-1]
    return cv2.resize(whole.astype(np.float32), size[::-1])


def _shrunk_size(columns: Array, rows: Array, image_size: tuple[int, int]) -> tuple[int, int]:
    """Return the size to which an image is shrunk so that neighbouring points lie about a pixel apart."""
    shrink = max(1, int(_step(columns, rows)))
    height, width = (max(2, round(side / shrink)) for side in image_size)
    return height, width


def _shrunk(columns: Array, rows: Array, image_size: tuple[int, int], size: tuple[int, int]) -> tuple[Array, Array]:
    """Return where points of an image lie after it was shrunk."""
    if size == image_size:
        return columns, rows
    return (columns + 0.5) * (size[1] / image_size[1]) - 0.5, (rows + 0.5) * (size[0] / image_size[0]) - 0.5


def _inside(columns: Array, rows: Array, image_size: tuple[int, int]) -> Array:
    """Return which points lie in an image, NaN does not."""
    height, width = image_size
    beside, above = np.abs(columns + 0.5 - width / 2), np.abs(rows + 0.5 - height / 2)  # the middle of the image
    return np.asarray((beside <= width / 2) & (above <= height / 2))


def _filled(columns: Array, rows: Array, known: Array) -> tuple[Array, Array]:
    """Replace unknown points by the nearest known ones on the panorama, whose left edge continues at the right one."""
    if known.all():
        return columns, rows
    width = known.shape[1]
    turns = np.tile(np.where(known, 0, 255).astype(np.uint8), 3)
    _, labels = cv2.distanceTransformWithLabels(turns, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.zeros(labels.max() + 1, dtype=np.int64)
    nearest[labels[turns == 0]] = np.flatnonzero(turns == 0)
    at = nearest[labels[:, width : 2 * width]]
    row, column = at // (3 * width), at % (3 * width) % width
    return columns[row, column], rows[row, column]
