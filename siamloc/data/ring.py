"""Find the ring of a mirror in the pictures of a drive: what moves in them is the scene, all else the camera's own.

The pixels inside the mirror change along a drive. What lies around the mirror, the robot's own parts and the camera's
reflection in the middle do not, except with the light. So the standard deviation over the pictures is a noisy picture
of the ring. A circle that separates it best gives a start; edges along rays from its centre, to a part of a pixel, and
a robust fit give the rims.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from foundation.calls import typed
from foundation.files import read_json, write_json
from siamloc.data.cameras import DualFisheyeCamera, EquirectangularCamera, HyperbolicMirror, twice_as_wide, two_views
from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import UnreadableImageError, read_image, size_of, spread
from siamloc.data.panorama import Array, OmnidirectionalCamera, PanoramaView, PolarRing, unwrap
from siamloc.data.photo_sphere import is_equirectangular, stated
from siamloc.data.presets import AutoRing
from siamloc.data.rims import changes, guess, inner_rim, moved, outer_rim, shifts
from siamloc.data.store import store_key
from siamloc.data.two_lenses import rearranged, two_circles
from siamloc.errors import ConfigError, DataError, logger

LEAST = 4
"""Fewest pictures of a drive that show what moves."""
_MOST = 30  # pictures that are looked at
_ALMOST = 0.8  # share of them that have one size, in whose pixels a ring counts
_SIDE = 800  # pixels of a picture's longer side; larger pictures are shrunk for the search
_SHAKES = 0.3  # pixels; centres that move more are lined up first
_NEAR = 15.0  # pixels from a given ring within which a drive's own ring replaces it
_INK = (0, 140, 255)  # BGR, as files are read
_BORDER = 12  # pixels next to a drawn panorama
_VERSION = 3  # of how a ring is found
_UNKNOWN = AutoRing()
_XI = 0.85, 0.99  # the unified model's parameter of mirrors that are built, 2 e / (e^2 + 1)
_OFF = 1.5  # pixels by which a picture's own radius may differ


@dataclass(frozen=True)
class RingFit:
    """The ring that `find_ring` found.

    Attributes:
        ring: centre and radii, in pixels of the given pictures; its other values are the defaults.
        deviation: standard deviation of the rim's points from the outer circle, in pixels.
        around: share of the directions in which the outer rim was found.
        pictures: number of pictures that were looked at.
        shakes: whether the centre moves from picture to picture (`find_centres`); `ring` then has the mean centre.
    """

    ring: PolarRing
    deviation: float
    around: float
    pictures: int
    shakes: bool = False

    def describe(self) -> str:
        """Say in one line what was found, and how well."""
        (x, y), inner, outer = self.ring.centre or (0.0, 0.0), self.ring.inner or 0.0, self.ring.outer or 0.0
        return (
            f"ring around ({x:.1f}, {y:.1f}) from {inner:.1f} to {outer:.1f} px, by what changes in {self.pictures} "
            f"pictures: its rim shows in {self.around:.0%} of the directions, {self.deviation:.1f} px off a circle"
        )


@typed
def find_ring(images: Array | Sequence[Any]) -> RingFit:
    """Find the ring of a camera below a mirror from a few pictures of one drive.

    Ten pictures or more, some metres apart, in changing surroundings are good; up to 30, spread over those given, are
    looked at. The mirror may be off the picture's centre, and parts of the robot may hide some of it.

    Args:
        images: files, or arrays (rows, columns, 3) or (rows, columns), uint8, of one size.

    Raises:
        DataError: too few pictures, pictures of different sizes or that cannot be read, pictures that are all alike, or
            no ring that is sure: no circle, or one that the picture's edge cuts.

    Example:
        >>> rng, (y, x) = np.random.default_rng(0), np.mgrid[0:120, 0:160]
        >>> inside = (abs(np.hypot(x - 82, y - 58) - 30) < 20)[..., None]
        >>> pictures = [np.where(inside, rng.integers(0, 255, (120, 160, 3)), 9).astype(np.uint8) for _ in range(9)]
        >>> ring = find_ring(pictures).ring
        >>> [round(value) for value in (*ring.centre, ring.outer)]
        [82, 58, 50]
    """
    if len(images) < LEAST:
        raise DataError(f"a ring is found from {LEAST} pictures of a drive or more, got {len(images)}")
    chosen = spread(images, _MOST)
    size = _grey(chosen[0]).shape
    scale = min(1.0, _SIDE / max(size))
    rows, columns = (round(side * scale) for side in size)
    shrunk = (cv2.resize(_grey(one, size), (columns, rows), interpolation=cv2.INTER_AREA) for one in chosen)
    pictures = np.stack(list(shrunk))
    y, x = np.mgrid[0:rows, 0:columns]
    corners = abs(2 * x / x.max() - 1) + abs(2 * y / y.max() - 1) > 1.7
    moving = changes(pictures, corners)
    centre, outer, deviation, around = outer_rim(moving, *guess(moving))
    grown = float(np.median(shifts(pictures, centre, outer)[:, 2]))
    off = shifts(pictures, centre, outer + grown)[:, :2]
    shakes = float(off.std(axis=0).max()) > _SHAKES
    if shakes:
        pictures = np.stack([moved(picture, -shift) for picture, shift in zip(pictures, off, strict=True)])
    radius = np.hypot(x - centre[0], y - centre[1])
    moving = changes(pictures, (radius < 0.04 * outer) | (radius > 1.04 * outer))
    if shakes:
        centre, outer, deviation, around = outer_rim(moving, centre, outer)
    inner = inner_rim(moving, centre, outer)
    drive = centre + off.mean(axis=0) * shakes
    if min(*drive, x.max() - drive[0], y.max() - drive[1]) < outer - 1:
        raise DataError(
            f"the edge of the picture cuts the ring around ({drive[0] / scale:.0f}, {drive[1] / scale:.0f}) of "
            f"{outer / scale:.0f} px: give its centre and radii, since they cannot be measured"
        )
    middle_x, middle_y = ((drive + 0.5) / scale - 0.5).tolist()
    ring = PolarRing(centre=(middle_x, middle_y), inner=inner / scale, outer=outer / scale)
    return RingFit(ring, deviation / scale, around, len(chosen), shakes)


@typed
def find_centres(images: Array | Sequence[Any], ring: PolarRing) -> Array:
    """Find the centre of the ring in each picture, for a camera that shakes against its mirror.

    Args:
        images: as for `find_ring`.
        ring: the ring of the drive, as `find_ring` returns it.

    Returns:
        Column and row of each centre in pixels (n, 2); NaN where it is not sure, or more than 8 px off.

    Raises:
        DataError: a picture that cannot be read.
        ConfigError: a ring without centre or outer radius.
    """
    if ring.centre is None or ring.outer is None:
        raise ConfigError("find_centres needs a ring with centre and outer radius, as `find_ring` returns it")
    centre = np.array(ring.centre)
    found = np.stack([shifts(_grey(image)[None], centre, ring.outer)[0] for image in images])
    return np.where(abs(found[:, 2:]) < _OFF, centre + found[:, :2], np.nan)


def fitted(preprocessing: Preprocessing, paths: Sequence[str], cache: Path) -> Preprocessing:
    """Return how the pictures of one drive become panoramas: an `AutoRing` gets the ring that the drive shows.

    A ring that was given stays where the drive shows none that is sure, or only one that is far from it. The ring is
    kept in the cache, as long as the pictures and the given ring stay the same.

    Raises:
        DataError: no ring was given, and the drive shows none that is sure.
        StorageError: the disk is full or cannot be written to.
    """
    given = preprocessing.camera
    if not isinstance(given, AutoRing):
        return preprocessing
    kept = cache / f"{store_key(paths, preprocessing)}.ring{_VERSION}.json"
    if kept.is_file():
        ring = type(given).of(read_json(kept))
    else:
        ring = _of_drive(given, paths)
        write_json(kept, ring.plain())
    return replace(preprocessing, camera=ring, size=None).sized_by(paths)


def _of_drive(given: AutoRing, paths: Sequence[str]) -> AutoRing:
    """Return the ring that the pictures of a drive show, or the given one."""
    folder = Path(paths[0]).parent
    known = given.centre is not None and given.inner is not None and given.outer is not None
    pictures = _readable(paths)
    try:
        usual = _of_one_size(pictures)
        found = find_ring(usual if len(usual) >= _ALMOST * len(pictures) else pictures)
    except DataError as error:
        if not known:
            remedies = [rearranged(picture) for picture in pictures]
            remedy = max(remedies, key=remedies.count, default=None) or (
                "if the camera is another one, name it: unwrap=fisheye unwrap.fov=180 unwrap.elevation=90 "
                "unwrap.roll=180 for a lens that looks up, for whole 360-degree pictures unwrap=equirectangular"
                f"{two_views(*pictures[0].shape[:2] if pictures else (1, 0))}"
            )
            raise DataError(f"unwrap=auto finds no ring in {folder}: {error}; {remedy}") from error
        logger.info("%s: the given ring stays (%s)", folder, error)
        return given
    ring = found.ring
    if known and (off := _apart(given, ring)) > _NEAR:
        logger.warning("%s: %s; the given one is %.0f px off and stays", folder, found.describe(), off)
        return given
    logger.info("%s: %s", folder, found.describe())
    return replace(given, centre=ring.centre, inner=ring.inner, outer=ring.outer)


@typed
def find_camera(images: Sequence[str], given: OmnidirectionalCamera | None = _UNKNOWN) -> OmnidirectionalCamera | None:
    """Find the camera of a drive by its pictures: their shape, or the ring of a mirror.

    Pictures that say so in their metadata are equirectangular. Of others, those about twice as wide as high, 1.8 to
    2.2 times, are of two lenses side by side if the corners of both halves are dark in most of them, and else whole
    equirectangular ones, unless they show a ring and are not exactly twice as wide. Wider ones are panoramas. All
    others show a ring: a lens that looks up has to be named, since its pictures do not stand still in their middle.

    Args:
        images: files of the drive's pictures; those that cannot be read are left out.
        given: an `AutoRing` with what is known of the ring, such as which way the robot faces in it; any other camera
            is returned as it is.

    Returns:
        The camera; None for panoramas.

    Raises:
        DataError: no picture can be read, or they show no ring that is sure.

    Example:
        >>> import cv2, tempfile
        >>> path = f"{tempfile.mkdtemp()}/1.png"
        >>> _ = cv2.imwrite(path, np.zeros((100, 200, 3), np.uint8))
        >>> type(find_camera([path])).__name__
        'EquirectangularCamera'
    """
    if not isinstance(given, AutoRing):
        return given
    pictures = _of_one_size(_readable(images))
    if not pictures:
        raise DataError(f"none of the {len(images)} pictures can be read")
    rows, columns = pictures[0].shape[:2]
    whole = EquirectangularCamera()
    for path in filter(is_equirectangular, spread(images, _MOST)):
        if (size := size_of(path)) and (twice_as_wide(*size) or stated(whole, path, size).highest is not None):
            return whole
    if twice_as_wide(rows, columns):
        if 2 * sum(map(two_circles, pictures)) > len(pictures):
            return DualFisheyeCamera()
        if columns == 2 * rows or not _shows_ring(pictures):  # 4096 x 2160 px are a size of films, too
            return EquirectangularCamera()
    elif columns > 2 * rows:
        return None
    return likely_mirror(PolarRing(**vars(_of_drive(given, images))))


def likely_mirror(ring: PolarRing) -> HyperbolicMirror | PolarRing:
    """Return the hyperbolic mirror that shows in a ring what a panorama shows by default, 30 to -45 degrees.

    The mirror's rim is at 30 degrees, and its eccentricity puts -45 degrees on the inner rim, within the limits of
    mirrors that are built: beyond them, the inner rim is higher or lower (`lowest_elevation`). The true elevations of
    the rims stay unknown; but the evenly spaced rows of a `PolarRing` fit no mirror at all, and show images moving in
    wrong directions. Nothing is seen within the inner rim. A ring with its inside up stays a ring.
    """
    if ring.centre is None or ring.inner is None or ring.outer is None or ring.inside_up:
        return ring
    share, (top, bottom) = ring.inner / ring.outer, np.radians([PanoramaView().top, PanoramaView().bottom])
    sines = np.cos(bottom) * np.sin(top) - share * np.cos(top) * np.sin(bottom)
    xi = float(np.clip(sines / (np.cos(bottom) - share * np.cos(top)), *_XI))  # radius ~ cos(up) / (xi - sin(up))
    eccentricity = (1 + np.sqrt(1 - xi**2)) / xi
    focal = ring.outer * (xi - np.sin(top)) / np.cos(top) / np.sqrt(1 - xi**2)
    found = HyperbolicMirror(focal, focal, *ring.centre, eccentricity, presumed=True, inner=ring.inner)
    return replace(found, forward=ring.forward, mirrored=ring.mirrored)


def draw_ring(picture: Array, ring: PolarRing, view: PanoramaView | None = None) -> Array:
    """Draw a ring and its front on a picture (rows, columns, 3), uint8, BGR, and its panorama to the right of it."""
    shown, thickness = np.ascontiguousarray(picture).copy(), max(1, round(max(picture.shape) / 320))
    if ring.centre is None or ring.inner is None or ring.outer is None:
        raise ConfigError("draw_ring needs a ring with centre and radii, as `find_ring` returns it")
    x, y = (round(16 * value) for value in ring.centre)
    for radius in (ring.inner, ring.outer):
        cv2.circle(shown, (x, y), round(16 * radius), _INK, thickness, cv2.LINE_AA, shift=4)
    front = np.radians(ring.forward)
    start, tip = (
        (round(x + 16 * radius * np.sin(front)), round(y - 16 * radius * np.cos(front)))
        for radius in (ring.inner, ring.outer)
    )
    cv2.arrowedLine(shown, start, tip, _INK, thickness, cv2.LINE_AA, shift=4, tipLength=0.1)
    cv2.drawMarker(shown, (x // 16, y // 16), _INK, cv2.MARKER_CROSS, 8 * thickness, thickness)
    panorama = unwrap(picture, ring, view)
    wide = round(panorama.shape[1] * picture.shape[0] / 2 / panorama.shape[0])
    right = np.full((picture.shape[0], wide + 2 * _BORDER, 3), 255, np.uint8)
    top = (picture.shape[0] - picture.shape[0] // 2) // 2
    size = (wide, picture.shape[0] // 2)
    right[top : top + size[1], _BORDER : _BORDER + wide] = cv2.resize(panorama, size, interpolation=cv2.INTER_AREA)
    return np.hstack([shown, right])


def _readable(paths: Sequence[str]) -> list[Array]:
    """Return up to `_MOST` pictures of a drive, spread over it, that can be read."""
    pictures = []
    for path in spread(paths, _MOST):
        with suppress(UnreadableImageError):
            pictures.append(read_image(path))
    return pictures


def _of_one_size(pictures: list[Array]) -> list[Array]:
    """Return the pictures that have the size of most of them."""
    sizes = Counter(picture.shape for picture in pictures)
    return [picture for picture in pictures if picture.shape == sizes.most_common(1)[0][0]]


def _shows_ring(pictures: Sequence[Array]) -> bool:
    with suppress(DataError):
        find_ring(pictures)
        return True
    return False


def _apart(given: PolarRing, ring: PolarRing) -> float:
    """Return by how many pixels two rings differ, in centre or radius."""
    first, second = (np.array([*one.centre, one.inner, one.outer]) for one in (given, ring))  # type: ignore[misc]
    return float(np.abs(first - second).max())


def _grey(image: str | Path | Array, size: tuple[int, ...] | None = None) -> Array:
    """Return a picture as (rows, columns), float32."""
    try:
        picture = read_image(image) if isinstance(image, str | Path) else np.asarray(image)
    except UnreadableImageError as error:
        raise DataError(f"{image} cannot be read: {error}") from error
    if picture.ndim not in (2, 3) or min(picture.shape[:2]) < 40:
        raise DataError(f"a picture of a ring has shape (rows, columns, 3), from 40 pixels a side, got {picture.shape}")
    grey = picture.astype(np.float32)
    grey = grey.mean(axis=2) if grey.ndim == 3 else grey
    if size is not None and grey.shape != size:
        raise DataError(f"the pictures of a drive have one size, got {size[::-1]} and {grey.shape[::-1]} px")
    return grey
