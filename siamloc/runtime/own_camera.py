"""A camera of the user's own in a bundle: where the panorama's pixels lie in its pictures, without the code for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import read_headed, write_arrays
from siamloc.data.panorama import OmnidirectionalCamera, PanoramaView, finer, points_of
from siamloc.errors import ConfigError, FormatError

_FORMAT, _VERSION = "siamloc camera", 1


@dataclass(frozen=True, eq=False)
class SampledCamera:
    """A camera for panoramas of one view, from pictures of one size.

    Attributes:
        columns: column in the picture of each of the `points` x `points` points in a pixel of the panorama (kH, kW).
        rows: row in the picture of each of these points (kH, kW).
        points: k, the number of points along each side of a pixel.
        image_size: rows and columns of the pictures.
        wraps: whether the left edge of the picture continues at its right edge.
    """

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    points: int
    image_size: tuple[int, int]
    wraps: bool

    @classmethod
    def of(cls, camera: OmnidirectionalCamera, view: PanoramaView, image_size: tuple[int, int]) -> SampledCamera:
        """Sample a camera."""
        fine = finer(camera, view, image_size)
        columns, rows = (np.asarray(one, dtype=np.float32) for one in points_of(camera, fine, image_size))
        return cls(columns, rows, fine.height // view.height, image_size, bool(getattr(camera, "wraps", False)))

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return where the pixels of a panorama lie in a picture; see `OmnidirectionalCamera`.

        Raises:
            ConfigError: a picture of another size, or a tilted view.
        """
        if image_size != self.image_size or type(view) is not PanoramaView:
            rows, columns = self.image_size
            raise ConfigError(
                f"the bundle holds its camera for level pictures of {columns} x {rows} px, got {image_size[1]} x "
                f"{image_size[0]}: import the module of its class first, or give it, Localizer(bundle, camera=...)"
            )
        first, step = (0, 1) if view.height == len(self.rows) else (self.points // 2, self.points)
        return self.columns[first::step, first::step], self.rows[first::step, first::step]

    def save(self, path: str | Path) -> None:
        """Write the camera to an npz file."""
        header = {"format": _FORMAT, "version": _VERSION, "points": self.points, "image_size": self.image_size}
        write_arrays(path, {**header, "wraps": self.wraps}, {"columns": self.columns, "rows": self.rows})

    @classmethod
    def load(cls, path: str | Path) -> SampledCamera:
        """Read a camera that `save` wrote.

        Raises:
            FormatError: the file is missing, damaged, or no such camera.
        """
        header, arrays = read_headed(path, _FORMAT, _VERSION, "export again")
        try:
            rows, columns = (int(one) for one in header["image_size"])
            return cls(arrays["columns"], arrays["rows"], int(header["points"]), (rows, columns), bool(header["wraps"]))
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{path} is not a whole camera ({error}): export again") from error
