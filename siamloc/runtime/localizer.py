"""`Localizer`: locate images on the robot, with numpy, opencv and onnxruntime alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from siamloc.calls import typed
from siamloc.data.decoding import UnreadableImageError
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import (
    HierarchicalSearch,
    LayerSearch,
    MotionModel,
    PoseFilter,
    RefinedPoses,
    Retrieval,
    SequenceFilter,
    VisualMap,
    frame_distances,
    headings,
    match,
    temperature_of_map,
)
from siamloc.memory import returned_memory
from siamloc.runtime.bundle import Bundle
from siamloc.runtime.describing import Describer, analytic_descriptor
from siamloc.settings import Count, checked

_STANDING = 0.01  # step in a map whose frames are all in one place


@dataclass(frozen=True)
class Candidate:
    """A map frame that resembles the image.

    Attributes:
        image: the map frame's file, as the map names it.
        x: its position, in the unit of the map; NaN where the map does not know it.
        y: its position.
        room: its room, or "".
        distance: descriptor distance.
        row: its number in the map, -1 if unknown; `Bundle.thumbnail` gives its picture where the bundle holds any.
    """

    image: str
    x: float
    y: float
    room: str
    distance: float
    row: int = -1


@dataclass(frozen=True)
class Location:
    """Where an image was taken.

    Attributes:
        x: position, in the unit of the map: finer than the map where the bundle refines it, else that of the nearest
            map frame; NaN where the map does not know it.
        y: the same.
        theta: heading in rad in (-pi, pi], counter-clockwise; NaN where the bundle gives no headings, or that of the
            nearest map frame is unknown.
        room: room of the nearest map frame, or "".
        error_m: expected error of x and y in their unit, metres by default; NaN where the bundle holds no error model,
            and where the image shows nothing of what the map shows.
        lost: whether the expected error is above the threshold that the error model was learned with, or the image
            shows nothing of what the map shows, as one of another building or camera; None where there is no threshold.
        candidates: the map frames that resemble the image most, the nearest first.
        ms: time that preparing, describing, searching and all estimates took, in milliseconds.
        covariance: of x and y, in their squared unit, as ((xx, xy), (xy, yy)); None where nothing tells it. Where
            `lost` is true it says nothing: it is that of a pose in the map.
        agreement: share of the map frames looked at that agree on a refined pose, from 0 to 1; NaN for one that is not.
    """

    x: float
    y: float
    theta: float
    room: str
    error_m: float
    lost: bool | None
    candidates: tuple[Candidate, ...]
    ms: float
    covariance: tuple[tuple[float, float], tuple[float, float]] | None = None
    agreement: float = math.nan

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


class FrameFilter:
    """Where a robot is among the frames of a map, given one image after the other: `siamloc.maps.SequenceFilter`.

    Args:
        known: m frames, all with positions.
        step: how far the robot goes between two images, about; as far as the map's from frame to frame if None.

    Raises:
        ConfigError: a step that is not positive.
    """

    def __init__(self, known: VisualMap, step: float | None = None) -> None:
        self._filter = SequenceFilter(MotionModel.learn(known.frames, step=step), temperature_of_map(known))

    def reset(self) -> None:
        """Forget all images: the robot may be anywhere."""
        self._filter.reset()

    def step(self, distances: NDArray[np.float64]) -> tuple[int, float]:
        """Take in the distances of an image to all frames (m,); return the likeliest frame, and how far off it may be.

        That is the root mean square distance of where the robot may be from that frame.
        """
        belief, xy = self._filter.step(distances), self._filter.motion.xy
        best = int(belief.argmax())
        return best, float(np.sqrt(belief @ np.square(xy - xy[best]).sum(axis=1)))


class Localizer:
    """Locates images by a bundle that `siamloc.runtime.export` wrote.

    The map is made ready for search once, which takes the memory of its descriptors as float32. Nothing is kept between
    images: each answer depends on its image alone, but where a `tracker` is given. Several threads may share one.

    A bundle with a coarse layer is searched through it: the map frames come from the nodes that resemble the image
    most. Where these hold fewer frames than the estimates look at, the whole map is searched.

    Args:
        bundle_path: folder or archive of the bundle.
        top: how many candidates a location lists.
        hierarchical: whether the coarse layer is searched first; where the bundle has one if None.
        threads: threads of onnxruntime; its own choice if None.
        providers: what onnxruntime computes with, the first that can, such as ("CUDAExecutionProvider",
            "CPUExecutionProvider").

    Raises:
        FormatError: no bundle, an altered one, or one of a newer version.
        ConfigError: a bundle without a map, or without the coarse layer that is asked for, top or threads below 1, or
            a provider that this onnxruntime lacks.
    """

    @typed
    def __init__(
        self,
        bundle_path: str | Path,
        top: int = 3,
        threads: int | None = None,
        providers: Sequence[str] = ("CPUExecutionProvider",),
        hierarchical: bool | None = None,
    ) -> None:
        checked(top, Count, "top")
        self._top = top
        with returned_memory():
            self._start(bundle_path, threads, providers, hierarchical)

    def _start(
        self, bundle_path: str | Path, threads: int | None, providers: Sequence[str], hierarchical: bool | None
    ) -> None:
        """Read the bundle, and make all ready for the first image."""
        self.bundle = Bundle.open(bundle_path)
        known = self.bundle.load_map()
        if known is None:
            raise ConfigError(f"{bundle_path} holds no map: run `siamloc map`, then `siamloc export` again")
        known.check_describer(self.bundle.identity)
        self._describer = Describer(self.bundle, known, threads, providers)
        self.map = self._describer.known
        self._search = self._layered(hierarchical)
        self._errors, self._refinement = self.bundle.load_errors(), self.bundle.load_refinement()
        self._placed = self.map.placed() if self.map.frames.has_position.any() else None
        if self._refinement is not None and self._refinement.method == "relative" and not self._describer.compares:
            raise FormatError(
                f"{bundle_path} says that poses are refined by comparison, and holds nothing to compare by: export "
                "again"
            )
        method = "none" if self._refinement is None else self._refinement.method
        if self._errors is not None and self._errors.refine != method:
            raise FormatError(
                f"{bundle_path} expects errors of poses with refine={self._errors.refine}, and makes them with "
                f"refine={method}: export again"
            )
        looked_at = [one.neighbours for one in (self._errors, self._refinement) if one is not None]
        self._wanted = max(self._top, *looked_at, 1)
        for one in {id(one): one for one in (self.map, self._placed) if one is not None}.values():
            match(one, one.description.take(slice(0, 1)))  # made ready here, and not with the first image

    @property
    def unit(self) -> str:
        """What x and y count in."""
        return self.map.unit

    @typed
    def tracker(self, step: float | None = None) -> PoseFilter | FrameFilter:
        """Return what follows a robot from image to image, for `locate`; one for each drive.

        Poses that are made by comparison with map frames are followed as such (`siamloc.maps.PoseFilter`), others from
        map frame to map frame (`siamloc.maps.SequenceFilter`).

        Args:
            step: how far the robot goes between two images, about; as far as the map's from frame to frame if None.

        Raises:
            ConfigError: no map frame has a position, or a step that is not positive.
        """
        if self._placed is None:
            raise ConfigError(f"{self.bundle.path} cannot follow a robot: none of its map frames has a position")
        if self._refinement is not None and self._refinement.method == "relative":
            return PoseFilter(_spacing(self._placed) if step is None else step)
        return FrameFilter(self._placed, step)

    def locate(
        self,
        image: str | Path | NDArray[np.uint8],
        tracker: PoseFilter | FrameFilter | None = None,
        seen: Callable[[NDArray[np.uint8]], None] | None = None,
    ) -> Location:
        """Locate an image: a file, or pixels (rows, columns, 3) RGB uint8 as the camera gives them.

        Args:
            image: the file, or pixels.
            tracker: follows the robot from the images before: position, heading and covariance are those of the robot
                on its way; the expected error and whether it is lost are still those of this image alone. Each image
                counts for its answer alone if None.
            seen: is given the panorama (3, H, W), uint8, RGB, that the image becomes.

        Raises:
            DataError: the image cannot be read, is empty, or has another shape.
        """
        start = time.perf_counter()
        panorama = self._panorama(image)
        if seen is not None:
            seen(panorama)
        return self._located(panorama, self.describe(panorama[None]), tracker, start)

    @typed
    def locate_panorama(self, panorama: NDArray[np.uint8], tracker: PoseFilter | FrameFilter | None = None) -> Location:
        """Locate a panorama (3, H, W), uint8, RGB, of the bundle's size; see `locate`."""
        start = time.perf_counter()
        return self._located(panorama, self.describe(panorama[None]), tracker, start)

    @typed
    def locate_batch(self, images: Sequence[str | Path | NDArray[np.uint8]]) -> list[Location]:
        """Locate several images, described together: faster where the provider is, such as a GPU.

        Each answer is the one that `locate` gives, on a CPU to the last digit; its `ms` is the mean.

        Args:
            images: as `locate` takes them, any number.

        Raises:
            DataError: one of them cannot be read, is empty, or has another shape.
        """
        if not len(images):
            return []
        start = time.perf_counter()
        panoramas = np.stack([self._panorama(image) for image in images])
        queries = self.describe(panoramas)
        found = [
            self._located(panorama, queries.take(slice(row, row + 1)), None, start)
            for row, panorama in enumerate(panoramas)
        ]
        mean = 1000 * (time.perf_counter() - start) / len(images)
        return [replace(one, ms=mean) for one in found]

    def _located(
        self, panorama: NDArray[np.uint8], query: Description, tracker: PoseFilter | FrameFilter | None, start: float
    ) -> Location:
        found = self._found(panorama, query)
        frames = self.map.frames
        candidates = tuple(
            Candidate(
                image=str(frames.path[row]),
                x=float(frames.x[row]),
                y=float(frames.y[row]),
                room=str(frames.room[row]),
                distance=float(distance),
                row=int(row),
            )
            for row, distance in zip(found.indices[0, : self._top], found.distances[0, : self._top], strict=True)
        )
        best = candidates[0]
        pose, error, lost = self._estimates(query, found)
        if isinstance(tracker, FrameFilter):
            return self._followed(query, tracker, candidates, error, lost, start)
        if pose is not None and tracker is not None:
            pose = tracker.step(pose)
        return Location(
            x=best.x if pose is None else float(pose.xy[0, 0]),
            y=best.y if pose is None else float(pose.xy[0, 1]),
            theta=float((headings(self.map, query, found)[:, 0] if pose is None else pose.theta)[0]),
            room=best.room,
            error_m=error,
            lost=lost,
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
            covariance=None if pose is None else _told(pose),
            agreement=math.nan if pose is None else float(pose.agreement[0]),
        )

    def _followed(
        self,
        query: Description,
        tracker: FrameFilter,
        candidates: tuple[Candidate, ...],
        error: float,
        lost: bool | None,
        start: float,
    ) -> Location:
        """Return the likeliest map frame of a robot on its way."""
        assert self._placed is not None
        row, spread = tracker.step(frame_distances(self._placed, query)[0])
        frames, found = self._placed.frames, Retrieval(np.array([[row]]), np.zeros((1, 1)))
        variance = spread**2 / 2  # of x and of y
        return Location(
            x=float(frames.x[row]),
            y=float(frames.y[row]),
            theta=float(headings(self._placed, query, found)[0, 0]),
            room=str(frames.room[row]),
            error_m=error,
            lost=lost,
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
            covariance=((variance, 0.0), (0.0, variance)),
        )

    @typed
    def describe(self, panoramas: NDArray[np.uint8]) -> Description:
        """Describe panoramas (B, 3, H, W), uint8, RGB, of the bundle's size, as the map's frames were described.

        Raises:
            DataError: another shape or type.
        """
        return self._describer.describe(panoramas)

    def _layered(self, wanted: bool | None) -> HierarchicalSearch | None:
        """Return the search through the coarse layer, if that is wanted."""
        held = None if wanted is False else self.bundle.load_layer()
        if held is None:
            if wanted:
                raise ConfigError(
                    f"{self.bundle.path} holds no coarse layer: run `siamloc map build=spectral`, then `siamloc export "
                    "build=spectral`"
                )
            return None
        layer, coarse = held
        if coarse is not None:
            coarse = coarse.with_descriptor(
                analytic_descriptor(coarse.identity, self.bundle, coarse.width, coarse.orientation)
            )
        try:
            return LayerSearch.of(self.bundle.about.get("search") or {}).of_map(self.map, layer, coarse)
        except (ConfigError, DataError) as error:
            raise FormatError(f"{self.bundle.path} cannot search its coarse layer ({error}): export again") from error

    def _found(self, panorama: NDArray[np.uint8], query: Description) -> Retrieval:
        """Return the map frames that resemble an image most."""
        if self._search is not None:
            coarse = self._search.coarse
            ranked = self._search.rank(query if coarse is self.map else coarse.descriptor.describe(panorama))
            found = self._search.search(query, ranked, self._wanted).found
            if np.isfinite(found.distances).all():
                return found
        return match(self.map, query, self._wanted)

    def _estimates(self, query: Description, found: Retrieval) -> tuple[RefinedPoses | None, float, bool | None]:
        """Return the pose finer than the map, the expected error, and whether that means lost.

        All rest on the map frames that have a position; there is none of them where the nearest frame has none.
        """
        if self._placed is None or not self.map.frames.has_position[found.indices[0, 0]]:
            return None, math.nan, None
        if self._placed is not self.map:
            found = match(self._placed, query, self._wanted)
        pose, expected, lost = None, math.nan, None
        if self._refinement is not None:
            pose = replace(self._refinement, widening=1.0).poses(self._placed, query, found, self._describer.compare)
        if self._errors is not None:
            errors, verdict = self._errors.judged(found, self._placed.frames.xy, pose)
            expected, lost = float(errors[0]), None if verdict is None else bool(verdict[0])
            if lost and self._errors.foreign(found, self._placed.frames.xy, pose)[0]:
                expected = math.nan  # what is expected of pictures of the map, and this is none
        if self._refinement is not None and pose is not None:
            pose = pose.widened(self._refinement.widening)
        return pose, expected, lost

    def _panorama(self, image: Any) -> NDArray[np.uint8]:
        if isinstance(image, (str, Path)):
            try:
                return self.bundle.preprocessing.panorama(image)
            except (UnreadableImageError, ConfigError) as error:  # damaged, or too small for the camera's ring
                raise DataError(f"{image} cannot be located: {error}") from error
        pixels = np.asarray(image)
        if pixels.size == 0:
            raise DataError("the image is empty: the camera gave no picture")
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise DataError(f"an image has shape (rows, columns, 3) and dtype uint8, got {pixels.shape} {pixels.dtype}")
        try:
            return self.bundle.preprocessing.prepare(pixels)
        except ConfigError as error:
            raise DataError(f"an image of {pixels.shape[0]} x {pixels.shape[1]} cannot be located: {error}") from error


def _spacing(known: VisualMap) -> float:
    """Return the median distance between consecutive frames of a map that are not in one place."""
    frames = known.frames
    steps = [np.hypot(*np.diff(frames.xy[rows], axis=0).T) for rows in frames.rows_by("sequence").values()]
    length = np.concatenate(steps)
    return float(np.median(length[length > 0])) if (length > 0).any() else _STANDING


def _told(pose: RefinedPoses) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the covariance of one pose; None where nothing tells it."""
    (xx, xy), (_, yy) = pose.covariance()[0].tolist()
    return None if math.isnan(xx) else ((xx, xy), (xy, yy))
