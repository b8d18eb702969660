"""What 360-degree pictures say of themselves: which part of the sphere they show, and how the camera was tilted.

Cameras, telephones and programs write it into the file, as Google's Photo Sphere properties in XMP:
https://developers.google.com/streetview/spherical-metadata.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from siamloc.data.cameras import EquirectangularCamera
from siamloc.data.central import ImageSize
from siamloc.data.names import NUMBER
from siamloc.data.panorama import Array

_HEADER = 1 << 18  # bytes in which a file says what it is, after a thumbnail
_PROPERTY = re.compile(rb"""GPano:(\w+)\s*(?:=\s*["']|>)\s*([^"'<\s]+)""")  # an attribute, or an element
_PLACED = (
    *("FullPanoWidthPixels", "CroppedAreaImageWidthPixels", "CroppedAreaLeftPixels"),
    *("FullPanoHeightPixels", "CroppedAreaImageHeightPixels", "CroppedAreaTopPixels"),
)
_SHAPES = 0.02  # by which two ratios of width and height may differ


@dataclass(frozen=True)
class _Part(EquirectangularCamera):
    """A part of an equirectangular picture, whose middle lies `right` degrees to the right of the whole one's."""

    right: float = 0.0

    def to_image(self, rays: Array, size: ImageSize) -> Array:
        return super().to_image(rays @ self._turned.T, size)

    def to_ray(self, pixels: Array, size: ImageSize) -> Array:
        return super().to_ray(pixels, size) @ self._turned

    @property
    def _turned(self) -> Array:
        sine, cosine = np.sin(np.radians(self.right)), np.cos(np.radians(self.right))
        return np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])


def is_equirectangular(path: str | Path) -> bool:
    """Return whether a picture says that it is equirectangular, whole or a part."""
    return _properties(path).get("ProjectionType", "").lower() == "equirectangular"


def stated(camera: Any, path: str | Path, size: ImageSize, *, levelled: bool = False) -> Any:
    """Return the camera of one picture: a whole `EquirectangularCamera` with what the picture says of itself.

    Args:
        camera: cameras of other kinds are returned as they are. A tilt or a part that the camera has already stays.
        path: the picture.
        size: its rows and columns. A part of another shape is ignored: the picture was edited since.
        levelled: whether the tilt is known and taken out elsewhere.
    """
    if not isinstance(camera, EquirectangularCamera) or not (said := _properties(path)):
        return camera
    numbers = {
        name: float(text) for name, text in said.items() if re.fullmatch(NUMBER, text.strip()) and isfinite(float(text))
    }
    camera = _placed(camera, [numbers.get(name) for name in _PLACED], size)
    pitch, roll = numbers.get("PosePitchDegrees", 0.0), numbers.get("PoseRollDegrees", 0.0)
    if levelled or camera.elevation or camera.roll or abs(pitch) > 90 or abs(roll) > 180:
        return camera
    return replace(camera, elevation=pitch, roll=roll)


def _placed(camera: EquirectangularCamera, numbers: list[float | None], size: ImageSize) -> EquirectangularCamera:
    """Return the camera that shows a part of the sphere, of `_PLACED`; as it is if that makes no sense."""
    known = [number for number in numbers if number is not None]
    if len(known) < len(_PLACED) or not camera.whole:
        return camera
    full, wide, left, whole, high, top = known
    inside = 0 <= left <= left + wide <= full and 0 <= top <= top + high <= whole
    if not inside or min(wide, high) <= 0 or (wide, high) == (full, whole) or not _alike(full, 2 * whole):
        return camera
    if not _alike(wide * size[0], high * size[1]):
        return camera
    own = {one.name: getattr(camera, one.name) for one in fields(camera)}
    own |= {"highest": 90 - 180 * top / whole, "lowest": 90 - 180 * (top + high) / whole, "turn": 360 * wide / full}
    return _Part(**own, right=360 * ((left + wide / 2) / full - 0.5))


def _properties(path: str | Path) -> dict[str, str]:
    """Return the Photo Sphere properties of a picture by their names; none if it has none, or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            found = _PROPERTY.findall(file.read(_HEADER))
    except (OSError, ValueError):
        return {}
    return {name.decode(): value.decode(errors="replace") for name, value in found}


def _alike(one: float, other: float) -> bool:
    return abs(one / other - 1) <= _SHAPES
