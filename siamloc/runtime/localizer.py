"""`Localizer`: locate images on the robot, with numpy, opencv and onnxruntime alone."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.data.decoding import UnreadableImageError
from siamloc.errors import ConfigError, DataError
from siamloc.maps import VisualMap
from siamloc.runtime.bundle import Bundle


@dataclass(frozen=True)
class Candidate:
    """A map frame that resembles the image.

    Attributes:
        image: the map frame's file, as the map names it.
        x: its position, in the unit of the map.
        y: its position.
        room: its room, or "".
        distance: descriptor distance.
    """

    image: str
    x: float
    y: float
    room: str
    distance: float


@dataclass(frozen=True)
class Location:
    """Where an image was taken.

    Attributes:
        x: position of the nearest map frame, in the unit of the map.
        y: position of the nearest map frame.
        theta: heading in rad, counter-clockwise; NaN where the descriptor does not tell it.
        room: room of the nearest map frame, or "".
        error_m: expected error in metres; NaN where the bundle holds no calibration.
        candidates: the map frames that resemble the image most, the nearest first.
        ms: time that preparing, describing and searching took, in milliseconds.
    """

    x: float
    y: float
    theta: float
    room: str
    error_m: float
    candidates: tuple[Candidate, ...]
    ms: float


class Localizer:
    """Locates images by a bundle that `siamloc export` wrote.

    Nothing is kept between images: each answer depends on its image alone.

    Args:
        bundle_path: folder of the bundle.
        top: how many candidates a location lists.
        threads: threads of onnxruntime; its own choice if None.

    Raises:
        FormatError: no bundle, an altered one, or one of a newer version.
        ConfigError: a bundle without a map, or top below 1.
    """

    def __init__(self, bundle_path: str | Path, top: int = 3, threads: int | None = None) -> None:
        import onnxruntime

        if top < 1:
            raise ConfigError(f"top must be at least 1, got {top}")
        self.bundle = Bundle.open(bundle_path)
        if not self.bundle.has_map:
            raise ConfigError(f"{bundle_path} holds no map: run `siamloc map`, then `siamloc export` again")
        self.map = VisualMap.load(self.bundle.map)
        self.map.check_describer(self.bundle.identity)
        self._top = top
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        if threads is not None:
            options.intra_op_num_threads = threads
        self._session = onnxruntime.InferenceSession(
            str(self.bundle.model), options, providers=["CPUExecutionProvider"]
        )

    @property
    def unit(self) -> str:
        """What x and y count in."""
        return self.map.unit

    def locate(self, image: str | Path | NDArray[np.uint8]) -> Location:
        """Locate an image: a file, or pixels (rows, columns, 3) RGB uint8 as the camera gives them.

        Raises:
            DataError: the image cannot be read or has another shape.
        """
        start = time.perf_counter()
        panorama = self._panorama(image)
        descriptor = self._session.run(None, {"panorama": panorama[None].astype(np.float32) / np.float32(255)})[0]
        found = self.map.search(descriptor, self._top)
        frames = self.map.frames
        candidates = tuple(
            Candidate(
                image=str(frames.path[row]),
                x=float(frames.x[row]),
                y=float(frames.y[row]),
                room=str(frames.room[row]),
                distance=float(distance),
            )
            for row, distance in zip(found.indices[0], found.distances[0], strict=True)
        )
        best = candidates[0]
        return Location(
            x=best.x,
            y=best.y,
            theta=float("nan"),
            room=best.room,
            error_m=float("nan"),
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
        )

    def _panorama(self, image: Any) -> NDArray[np.uint8]:
        if isinstance(image, (str, Path)):
            try:
                return self.bundle.preprocessing.panorama(image)
            except UnreadableImageError as error:
                raise DataError(f"{image} cannot be located: {error}") from error
        pixels = np.asarray(image)
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise DataError(f"an image has shape (rows, columns, 3) and dtype uint8, got {pixels.shape} {pixels.dtype}")
        return self.bundle.preprocessing.prepare(pixels)
