"""What 360-degree pictures say of themselves: which part of the sphere they show, and how the camera was tilted.

Cameras, telephones and programs write it into the file, as Google's Photo Sphere properties in XMP:
https://developers.google.com/streetview/spherical-metadata.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from siamloc.data.cameras import EquirectangularCamera

_HEADER = 1 << 18  # bytes in which a file says what it is, after a thumbnail
_PROPERTY = re.compile(rb"""GPano:(\w+)\s*(?:=\s*["']|>)\s*([^"'<\s]+)""")  # an attribute, or an element
_PLACED = "FullPanoWidthPixels", "CroppedAreaImageWidthPixels", "CroppedAreaLeftPixels"
_SHAPES = 0.02  # by which two ratios of width and height may differ


def properties(path: str | Path) -> dict[str, str]:
    """Return the Photo Sphere properties of a picture by their names; none if it has none, or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            found = _PROPERTY.findall(file.read(_HEADER))
    except (OSError, ValueError):
        return {}
    return {name.decode(): value.decode(errors="replace") for name, value in found}


def is_equirectangular(path: str | Path) -> bool:
    """Return whether a picture says that it is equirectangular, whole or a part."""
    return properties(path).get("ProjectionType", "").lower() == "equirectangular"


def framed(
    camera: EquirectangularCamera, path: str | Path, size: tuple[int, int] | None = None
) -> EquirectangularCamera:
    """Return the camera that shows the part of the sphere that a picture says it shows.

    Args:
        camera: is returned as it is unless it is whole, or if the picture says nothing that fits its shape.
        path: the picture.
        size: its rows and columns; not compared if None.
    """
    said = properties(path)
    full, wide, left = (_number(said, name) for name in _PLACED)
    whole, high, top = (_number(said, name.replace("Width", "Height").replace("Left", "Top")) for name in _PLACED)
    sane = min(full, wide, whole, high) > 0 <= min(left, top) and left + wide <= full and top + high <= whole
    if not (camera.whole and sane and _alike(full, 2 * whole)) or (wide, high) == (full, whole):
        return camera
    if size is not None and not _alike(wide * size[0], high * size[1]):  # edited since, without a word
        return camera
    middle = (left + wide / 2) / full - 0.5
    return replace(
        camera,
        highest=90 - 180 * top / whole,
        lowest=90 - 180 * (top + high) / whole,
        turn=360 * wide / full,
        azimuth=camera.azimuth - 360 * middle,
    )


def levelled(camera: EquirectangularCamera, path: str | Path) -> EquirectangularCamera:
    """Return the camera with the tilt that a picture says it had; as it is if its own tilt is given."""
    if camera.elevation or camera.roll:
        return camera
    said = properties(path)
    pitch, roll = (_number(said, f"Pose{name}Degrees") for name in ("Pitch", "Roll"))
    return replace(camera, elevation=pitch, roll=roll)


def _number(said: dict[str, str], name: str) -> float:
    """Return the number of a property; 0 if it is not there, or is none."""
    with suppress(ValueError):
        if math.isfinite(number := float(said.get(name, "0"))):
            return number
    return 0.0


def _alike(one: float, other: float) -> bool:
    return abs(one / other - 1) <= _SHAPES
