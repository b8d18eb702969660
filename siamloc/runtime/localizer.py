"""`Localizer`: locate images on the robot, with numpy, opencv and onnxruntime alone."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from siamloc.data.decoding import UnreadableImageError
from siamloc.errors import ConfigError, DataError
from siamloc.files import write_text
from siamloc.maps import ErrorModel, Retrieval, VisualMap, headings
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
        theta: heading in rad in (-pi, pi], counter-clockwise; NaN where the bundle gives no headings, or that of the
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

    def describe(self, unit: str = "m") -> str:
        """Say in one line where the image was taken, and which map frames resemble it."""
        heading = "" if math.isnan(self.theta) else f", heading {math.degrees(self.theta):.0f} deg"
        room = f" in {self.room}" if self.room else ""
        expected = "" if math.isnan(self.error_m) else f"; expected error {self.error_m:.2f} {unit}"
        lost = ", lost" if self.lost else ""
        others = ", ".join(f"{Path(c.image).name} ({c.distance:.3g})" for c in self.candidates)
        known = not (math.isnan(self.x) or math.isnan(self.y))
        position = f"x {self.x:.2f} {unit}, y {self.y:.2f} {unit}" if known else "position unknown"
        return f"{position}{heading}{room}{expected}{lost}; nearest {others}; {self.ms:.1f} ms"


class Localizer:
    """Locates images by a bundle that `siamloc.runtime.export` wrote.

    The map is made ready for search once, which takes the memory of its descriptors once more. Nothing is kept between
    images: each answer depends on its image alone.

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
        if self.bundle.map is None:
            raise ConfigError(f"{bundle_path} holds no map: run `siamloc map`, then `siamloc export` again")
        self.map = VisualMap.load(self.bundle.map)
        self.map.check_describer(self.bundle.identity)
        self.map.index  # noqa: B018 (prepared here, and not with the first image)
        self._top = top
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        if threads is not None:
            options.intra_op_num_threads = threads

        def session(path: Path) -> Any:
            return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

        self._session = session(self.bundle.model)
        self._heading = None if self.bundle.heading is None else session(self.bundle.heading)
        self._errors = None if self.bundle.errors is None else ErrorModel.load(self.bundle.errors)
        self._placed = self.map.placed() if self.map.frames.has_position.any() else None

    @property
    def unit(self) -> str:
        """What x and y count in."""
        return self.map.unit

    def locate(self, image: str | Path | NDArray[np.uint8]) -> Location:
        """Locate an image: a file, or pixels (rows, columns, 3) RGB uint8 as the camera gives them.

        Raises:
            DataError: the image cannot be read, is empty, or has another shape.
        """
        start = time.perf_counter()
        panorama = self._panorama(image)
        pixels = panorama[None].astype(np.float32) / np.float32(255)
        descriptor, *orientation = self._session.run(None, {"panorama": pixels})
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
            theta=self._theta(pixels, descriptor, orientation, found),
            room=best.room,
            error_m=error,
            lost=lost,
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
        )

    def _theta(
        self,
        pixels: NDArray[np.float32],
        descriptor: NDArray[np.float32],
        orientation: list[NDArray[np.float32]],
        found: Retrieval,
    ) -> float:
        """Return the heading by the nearest map frame, NaN if there is none."""
        if self._heading is not None:
            orientation = self._heading.run(None, {"panorama": pixels})
        if self.map.heading is None or not orientation:
            return math.nan
        return float(headings(self.map, Description(descriptor, orientation[0]), found)[0, 0])

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
        if pixels.size == 0:
            raise DataError("the image is empty: the camera gave no picture")
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise DataError(f"an image has shape (rows, columns, 3) and dtype uint8, got {pixels.shape} {pixels.dtype}")
        return self.bundle.preprocessing.prepare(pixels)


def write_locations(path: str | Path, located: Mapping[str, Location]) -> None:
    """Write where images were taken into a CSV file, a row for each.

    Args:
        path: of the file.
        located: by image file; one at least.

    Raises:
        StorageError: the disk refuses.
    """
    rows = [_row(image, location) for image, location in located.items()]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def _row(image: str, location: Location) -> dict[str, object]:
    best = location.candidates[0]
    return {
        "image": image,
        "x": _cell(location.x),
        "y": _cell(location.y),
        "theta": _cell(location.theta),
        "room": location.room,
        "error_m": _cell(location.error_m),
        "lost": "" if location.lost is None else location.lost,
        "match": best.image,
        "distance": best.distance,
        "ms": round(location.ms, 2),
    }


def _cell(value: float) -> object:
    return "" if math.isnan(value) else value
