"""`OccupancyMap`: the map of a map server, which says of each square of a floor whether something stands there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import expanded
from siamloc.data.frames import parsed_yaml, read_file
from siamloc.data.image_files import UnreadableImageError, read_image
from siamloc.data.moves import composed, inverse
from siamloc.errors import DataError

_GREY = (92, 104, 115)  # shows on white and on black paper
_FREE, _OCCUPIED = 0.08, 0.6  # how much of it covers the paper
_BEYOND = 3.0  # m that a plan shows beyond the frames
_MODES = ("trinary", "scale", "raw")
_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """The floor of a building in squares.

    Attributes:
        occupancy: how certainly each square is occupied (rows, columns), from 0 (free) to 1; NaN if unknown. The first
            row is the upper one, with the largest y.
        resolution: length of the side of a square in m.
        origin: x, y in m and heading in rad of the lower left corner, in the frame of the map.
    """

    occupancy: NDArray[np.float32]
    resolution: float
    origin: tuple[float, float, float]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in m."""
        rows, columns = self.occupancy.shape
        return columns * self.resolution, rows * self.resolution

    def check(self, xy: NDArray[np.float64], unit: str = "m") -> None:
        """Refuse positions (n, 2) that are not on the map.

        Raises:
            DataError: positions in another unit than m, or none of them on the map.
        """
        if unit != "m":
            raise DataError(f"an occupancy map is in m, and the positions are in {unit}: leave plan out")
        corner = np.array([self.origin])
        inside = composed(inverse(corner), np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
        if not ((inside >= 0) & (inside <= self.size)).all(axis=1).any():
            low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
            raise DataError(
                f"no position lies on the occupancy map: x is {low[0]:.1f} to {high[0]:.1f} m and y {low[1]:.1f} to "
                f"{high[1]:.1f} m, and the map of {self.size[0]:.1f} x {self.size[1]:.1f} m begins at x "
                f"{self.origin[0]:.1f} m, y {self.origin[1]:.1f} m: is it of this building, in the frame of the poses?"
            )

    def around(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the lowest and the highest x and y, in m (2, 2), of a plan that shows positions (n, 2).

        The plan shows all positions, and what the map knows up to 3 m beyond them.
        """
        here = np.array([np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)])
        rows, columns = np.nonzero(np.isfinite(self.occupancy))
        if not len(rows):
            return here
        up = len(self.occupancy) - 1 - rows
        corners = self.resolution * np.concatenate([np.column_stack([columns + k, up + k]) for k in (0, 1)])
        placed = composed(np.array([self.origin]), np.column_stack([corners, np.zeros(len(corners))]))[:, :2]
        known = np.array([placed.min(axis=0), placed.max(axis=0)])
        low, high = np.clip(known, here[0] - _BEYOND, here[1] + _BEYOND)
        return np.array([np.minimum(low, here[0]), np.maximum(high, here[1])])

    def picture(self) -> NDArray[np.uint8]:
        """Return the map as a picture (rows, columns, 4), RGBA: what is occupied dark, what is unknown transparent."""
        cover = np.nan_to_num(_FREE + (_OCCUPIED - _FREE) * self.occupancy)
        colours = np.broadcast_to(np.array(_GREY, dtype=np.uint8), (*cover.shape, 3))
        return np.dstack([colours, (255 * cover).round().astype(np.uint8)])

    def png(self) -> bytes:
        """Return the picture as a PNG file."""
        return cv2.imencode(".png", cv2.cvtColor(self.picture(), cv2.COLOR_RGBA2BGRA))[1].tobytes()

    def placed(self) -> dict[str, float]:
        """Return where the picture lies: x, y and heading of its lower left corner, width and height."""
        return dict(zip(("x", "y", "heading", "width", "height"), (*self.origin, *self.size), strict=True))


@typed
def read_occupancy(path: str | Path) -> OccupancyMap:
    """Read the map of a map server: a YAML file and the picture that it names.

    A pixel is as occupied as it is dark, with `negate` as it is bright. In the mode "trinary", it is occupied above
    `occupied_thresh`, free below `free_thresh`, and otherwise unknown; in "scale", what lies between is a share; in
    "raw", its value is a percentage. Transparency is ignored.

    Args:
        path: the YAML file, such as "map.yaml".

    Raises:
        DataError: a file that cannot be read, or a key that is missing or has a wrong value.

    Example:
        >>> from pathlib import Path
        >>> _ = Path("map.pgm").write_bytes(b"P5 3 1 255 " + bytes([0, 205, 254]))
        >>> about = "{image: map.pgm, resolution: 0.05, origin: [-1, 2, 0], negate: 0, "
        >>> _ = Path("map.yaml").write_text(about + "occupied_thresh: 0.65, free_thresh: 0.196}")
        >>> read_occupancy("map.yaml").occupancy.tolist()
        [[1.0, nan, 0.0]]
    """
    file = expanded(path)
    about = parsed_yaml(read_file(file, "the map"), f"the map {file}")
    missing = [key for key in _NEEDED if key not in about] if isinstance(about, Mapping) else list(_NEEDED)
    if missing:
        raise DataError(f"{file} is not the YAML file of a map server: {', '.join(missing)} missing")
    resolution, occupied, free, negate = (
        _number(file, key, about[key]) for key in ("resolution", "occupied_thresh", "free_thresh", "negate")
    )
    origin, mode = about["origin"], str(about.get("mode", "trinary"))
    numbers = [_number(file, "origin", one) for one in origin] if isinstance(origin, list) else []
    if len(numbers) != 3:
        raise DataError(f"{file}: origin is x, y and heading, three numbers, got {origin!r}")
    if resolution <= 0 or mode not in _MODES:
        raise DataError(
            f"{file}: resolution is above 0 and mode one of {', '.join(_MODES)}, got {resolution:g} and {mode!r}"
        )
    if free > occupied:
        raise DataError(f"{file}: free_thresh, {free:g}, must not be above occupied_thresh, {occupied:g}")
    image = file.parent / str(about["image"])
    try:
        pixels = read_image(image).mean(axis=2, dtype=np.float32)
    except UnreadableImageError as error:
        raise DataError(f"{image}, the picture of {file}, cannot be read: {error}") from error
    if mode == "raw":
        occupancy = np.where(pixels <= 100, pixels / 100, np.nan)
    else:
        dark = pixels / 255 if negate else 1 - pixels / 255
        share = (dark - free) / max(occupied - free, 1e-9) if mode == "scale" else np.nan
        occupancy = np.where(dark > occupied, 1.0, np.where(dark < free, 0.0, share))
    return OccupancyMap(occupancy.astype(np.float32), resolution, (numbers[0], numbers[1], numbers[2]))


def _number(file: Path, key: str, value: Any) -> float:
    with suppress(TypeError, ValueError, OverflowError):
        if math.isfinite(number := float(value)):  # YAML takes 5e-2 for a word
            return number
    raise DataError(f"{file}: {key} is a number, got {value!r}")
