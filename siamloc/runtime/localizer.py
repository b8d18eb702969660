"""`Localizer`: locate images on the robot, with numpy, opencv and onnxruntime alone."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from siamloc.data.decoding import UnreadableImageError
from siamloc.errors import ConfigError, DataError
from siamloc.maps import Retrieval, VisualMap, estimated_headings
from siamloc.maps.error_model import ErrorModel
from siamloc.runtime.bundle import Bundle


@dataclass(frozen=True)
class Candidate:
    """A map frame that resembles the image.

    Attributes:
        image: the map frame's file, as the map names it.
        x: its position, in the unit of the map; NaN where the map does not know it.
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
        x: position of the nearest map frame, in the unit of the map; NaN where the map does not know it.
        y: position of the nearest map frame.
        theta: heading in rad in (-pi, pi], counter-clockwise; NaN where the bundle tells no headings, or that of the
            nearest map frame is unknown.
        room: room of the nearest map frame, or "".
        error_m: expected error of x and y in their unit, metres by default; NaN where the bundle holds no error model.
        lost: whether the expected error is above the threshold that the error model was learned with; None where there
            is none.
        candidates: the map frames that resemble the image most, the nearest first.
        ms: time that preparing, describing, searching and all estimates took, in milliseconds.
    """

    x: float
    y: float
    theta: float
    room: str
    error_m: float
    lost: bool | None
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

        def session(path: Path) -> Any:
            return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

        self._session = session(self.bundle.model)
        self._heading = None
        if self.bundle.has_heading and self.map.heading is not None:
            self._heading = (session(self.bundle.heading), self.map.heading.descriptor())
        self._errors = ErrorModel.load(self.bundle.errors) if self.bundle.has_errors else None
        placed = self.map.frames.has_position
        self._placed = self.map if placed.all() else self.map.take(placed) if placed.any() else None

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
        pixels = panorama[None].astype(np.float32) / np.float32(255)
        descriptor = self._session.run(None, {"panorama": pixels})[0]
        found = self.map.search(descriptor, max(self._top, self._errors.neighbours if self._errors else 1))
        frames = self.map.frames
        candidates = tuple(
            Candidate(
                image=str(frames.path[row]),
                x=float(frames.x[row]),
                y=float(frames.y[row]),
                room=str(frames.room[row]),
                distance=float(distance),
            )
            for row, distance in zip(found.indices[0, : self._top], found.distances[0, : self._top], strict=True)
        )
        best = candidates[0]
        error, lost = self._expected_error(descriptor, found)
        return Location(
            x=best.x,
            y=best.y,
            theta=self._theta(pixels, descriptor, found),
            room=best.room,
            error_m=error,
            lost=lost,
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
        )

    def _theta(self, pixels: NDArray[np.float32], descriptor: NDArray[np.float32], found: Retrieval) -> float:
        """Return the heading that the nearest map frame tells, NaN if it tells none."""
        if self._heading is None:
            return math.nan
        session, teller = self._heading
        nearest = self.map.take(found.indices[0, :1]).oriented()
        seen = Description(descriptor, session.run(None, {"panorama": pixels})[0])
        told = estimated_headings(nearest, seen, teller, Retrieval(np.zeros((1, 1), dtype=np.int64), np.zeros((1, 1))))
        return math.nan if told is None else float(told[0])

    def _expected_error(self, descriptor: NDArray[np.float32], found: Retrieval) -> tuple[float, bool | None]:
        """Return the expected error and whether it means lost, by the map frames that have a position."""
        if self._errors is None or self._placed is None or not self.map.frames.has_position[found.indices[0, 0]]:
            return math.nan, None
        if self._placed is not self.map:
            found = self._placed.search(descriptor, self._errors.neighbours)
        expected = self._errors.predict(found, self._placed.frames.xy)
        return float(expected[0]), None if self._errors.lost_above is None else bool(self._errors.lost(expected)[0])

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
