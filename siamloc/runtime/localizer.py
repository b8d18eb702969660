"""`Localizer`: locate images on the robot, with numpy, opencv and onnxruntime only."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import typed
from foundation.files import real_path
from foundation.settings import Count, checked
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import room_names
from siamloc.data.image_files import UnreadableImageError
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.errors import ConfigError, DataError, FormatError, say_once
from siamloc.maps import (
    ErrorModel,
    HierarchicalSearch,
    LayerSearch,
    MotionModel,
    PoseFilter,
    RefinedPoses,
    Refinement,
    Retrieval,
    SequenceFilter,
    VisualMap,
    frame_distances,
    headings,
    match,
    temperature_of_map,
)
from siamloc.maps.sequence_filter import spacing_of
from siamloc.memory import returned_memory
from siamloc.runtime.bundle import ERRORS, LAYER, MAP, REFINEMENT, Bundle, read_whole
from siamloc.runtime.collecting import MOST, Collector
from siamloc.runtime.describing import coarse_map, with_own_descriptor
from siamloc.runtime.location import Candidate, Location

Tracker = PoseFilter | SequenceFilter
"""Follows a robot from image to image, see `Localizer.tracker`."""

_STANDING = 0.01  # step in a map whose frames are all in one place
# The refined pose of an image whose map frames say nothing.
_UNKNOWN, _ZERO = np.full((1, 2), np.nan), np.zeros(1)
_NOWHERE = RefinedPoses(_UNKNOWN, _UNKNOWN[0, :1], np.zeros((1, 2, 2)), _ZERO, np.zeros(1, np.int64), _ZERO - np.inf)


class Localizer:
    """Locates images with a bundle written by `siamloc.runtime.export`.

    The map is prepared for search once, which takes the memory of its descriptors as float32, or of rounded spectra for
    descriptors that are compared at every turn. Nothing is kept between images: each answer depends on its
    image alone, unless a `tracker` is given. Several threads may share one.

    If the bundle has a coarse layer, it is searched first: the map frames come from the nodes that resemble the image
    most. If these hold fewer frames than the estimates need, the whole map is searched.

    Args:
        bundle_path: the bundle's folder.
        top: how many candidates a location lists.
        collect: folder in which panoramas that were located well are kept with their poses, for
            `siamloc.runtime.update`; none are kept if None.
        most: number of pictures in that folder, of those there at the start and of this robot's; the oldest are removed
            for others.
        hierarchical: whether to search the coarse layer first; if None, only if the bundle has one.
        threads: number of onnxruntime threads; onnxruntime chooses if None.
        providers: onnxruntime's execution providers in order of preference, such as ("CUDAExecutionProvider",
            "CPUExecutionProvider"); if None, a GPU or OpenVINO before the processor, where onnxruntime has them. A
            provider that does not work here is a warning, and the next one computes.
        camera: another camera than the bundle's, as `PanoramaLibrary` takes it; its panoramas show the same view.

    Raises:
        FormatError: not a bundle, an altered one, one of another version, or one that is replaced again and again.
        ConfigError: a bundle without a map, or without the requested coarse layer, or that refines poses by comparison
            in a map that is not in metres, top, threads or most below 1, a provider that this onnxruntime lacks, a
            bundle that cannot say which images were located well, or a folder for them in the bundle.
        StorageError: the folder for collected images cannot be written to.
    """

    @typed
    @returned_memory()
    def __init__(
        self,
        bundle_path: str | Path,
        top: Count = 3,
        threads: Count | None = None,
        providers: Sequence[str] | None = None,
        hierarchical: bool | None = None,
        camera: OmnidirectionalCamera | Mapping[str, Any] | None = None,
        collect: str | Path | None = None,
        most: Count = MOST,
    ) -> None:
        self._top = top
        read_whole(bundle_path, partial(self._read, bundle_path, camera, threads, providers, hierarchical))
        self._placed = self.map.placed() if self.map.frames.has_position.any() else None
        self._rooms, building = room_names(self.map.frames)[0], self.map.frames.building
        if len(set(building.tolist()) - {""}) > 1:
            self._rooms = np.where(self._rooms == "", building, self._rooms)
        self._placed_rooms = self._rooms[self.map.frames.has_position]
        network = self._network
        self._compare = network.compare if network is not None and network.compares else None
        relative = self._refinement is not None and self._refinement.method == "relative"
        if relative and self._compare is None:
            raise FormatError(
                f"{bundle_path} says that poses are refined by comparison, but holds no network for it: export again"
            )
        if relative and self.map.frames.unit != "m":
            raise ConfigError(
                f"{bundle_path} refines poses by comparison, which answers in metres, and its map is in "
                f"{self.map.frames.unit!r}: make the map with x and y in metres, or export it with "
                "task.refine=interpolate"
            )
        judges = self._errors is not None or relative
        if collect is not None and not (judges and self._placed is not None):
            raise ConfigError(
                f"{bundle_path} cannot say which images were located well: export it with an error model or refined "
                "poses, or leave collect out"
            )
        if collect is not None and real_path(collect).is_relative_to(real_path(bundle_path)):
            raise ConfigError(f"{collect} is in the bundle, which an update replaces: collect outside of it")
        headed = self.map.orientation is not None
        self._collector = None if collect is None else Collector(collect, most, headed)
        looked_at = [one.neighbours for one in (self._errors, self._refinement) if one is not None]
        self._wanted = max(self._top, *looked_at, 1)
        for known in (self.map, self._placed):
            if known is not None:
                match(known, known.description.take(slice(0, 1)))  # prepares it here, not with the first image
        if self._search is not None:
            self._search.rank(self._search.coarse.description.take(slice(0, 1)))

    @property
    def providers(self) -> tuple[str, ...]:
        """The execution providers of onnxruntime in use, in order; empty if numpy and OpenCV describe the images."""
        return () if self._network is None else tuple(self._network.session.get_providers())

    @property
    def unit(self) -> str:
        """Unit of x and y."""
        return self.map.unit

    @typed
    def tracker(self, step: float | None = None) -> Tracker:
        """Return a tracker that follows a robot from image to image, for `locate`; use one per drive.

        Images that are collected from then on are another drive.

        If poses are refined by comparison with map frames, the poses are tracked (`siamloc.maps.PoseFilter`); otherwise
        the robot is tracked from map frame to map frame (`siamloc.maps.SequenceFilter`). With the `motion` in `locate`,
        the tracker knows sooner that the robot was carried away, and goes on where nothing is recognized.

        Args:
            step: roughly how far the robot moves between two images; the map's frame-to-frame distance if None.

        Raises:
            ConfigError: no map frame has a position, or the step is not positive.
        """
        if self._placed is None:
            raise ConfigError(f"{self.bundle.path} cannot follow a robot: none of its map frames has a position")
        if self._collector is not None:
            self._collector.begin()
        if self._refinement is not None and self._refinement.method == "relative":
            return PoseFilter(spacing_of(self._placed.frames) or _STANDING if step is None else step)
        return SequenceFilter(MotionModel.learn(self._placed.frames, step=step), temperature_of_map(self._placed))

    def locate(
        self,
        image: str | Path | NDArray[np.uint8],
        tracker: Tracker | None = None,
        seen: Callable[[NDArray[np.uint8]], None] | None = None,
        motion: ArrayLike | None = None,
        tilt: ArrayLike | None = None,
    ) -> Location:
        """Locate an image: a file, or pixels (rows, columns, 3) RGB uint8 as they come from the camera.

        Args:
            image: the file, or the pixels.
            tracker: takes the preceding images into account: position, heading and covariance are those of the tracked
                robot; the expected error and whether it is lost are still those of this image alone. If None, each
                answer depends on its image alone.
            seen: called with the panorama (3, H, W), uint8, RGB, made from the image.
            motion: how the robot moved since the last image that the tracker got, as its wheels tell, seen from itself
                at that image (3,): distances ahead and to the left in the map's unit, and turn to the left in rad; NaN
                if unknown.
            tilt: roll and pitch of the robot in rad (2,), which are taken out of the image of a camera; see
                `siamloc.data.PanoramaView.tilted`. A bundle without a camera model warns once, and leaves them in.

        Raises:
            ConfigError: a motion without a tracker.
            DataError: the image cannot be read, is empty, or has another shape; a motion or tilt of another form; or
                motions in another unit than the map, once enough images are recognized along a way.
        """
        start = time.perf_counter()
        _check_motion(tracker, motion)
        panorama = self._panorama(image, tilt)
        if seen is not None:
            seen(panorama)
        return self._located(panorama, self.describe(panorama[None]), tracker, motion, start)

    @typed
    def locate_panorama(
        self, panorama: NDArray[np.uint8], tracker: Tracker | None = None, motion: ArrayLike | None = None
    ) -> Location:
        """Locate a panorama of the bundle's size (H, W), uint8, RGB; see `locate`, which resizes images.

        Args:
            panorama: (3, H, W), as from a library, or (H, W, 3), as from `siamloc.data.unwrap` or a camera.
            tracker: see `locate`.
            motion: see `locate`.

        Raises:
            ConfigError: a motion without a tracker.
            DataError: another shape or type; a motion of another form; or motions in another unit, as for `locate`.
        """
        start = time.perf_counter()
        _check_motion(tracker, motion)
        expected = (3, *self.bundle.image_size)
        if panorama.dtype != np.uint8 or panorama.shape not in (expected, (*expected[1:], 3)):
            raise DataError(
                f"a panorama has shape {expected} and dtype uint8, got {panorama.shape} {panorama.dtype}: resize it to "
                "the bundle's size, or give the camera's image to `locate`, which does"
            )
        if panorama.shape != expected:
            panorama = np.ascontiguousarray(panorama.transpose(2, 0, 1))
        return self._located(panorama, self.describe(panorama[None]), tracker, motion, start)

    @typed
    def locate_batch(self, images: Sequence[str | Path | NDArray[np.uint8]]) -> list[Location]:
        """Locate several images at once: faster if the provider gains from batches, as a GPU does.

        Each answer equals that of `locate`, on a CPU to the last digit; its `ms` is the mean.

        Args:
            images: any number of images, as in `locate`.

        Raises:
            DataError: one of them cannot be read, is empty, or has another shape.
        """
        if not len(images):
            return []
        start = time.perf_counter()
        panoramas = np.stack([self._panorama(image) for image in images])
        queries = self.describe(panoramas)
        found = [
            self._located(panorama, queries.take(slice(row, row + 1)), None, None, start)
            for row, panorama in enumerate(panoramas)
        ]
        mean = 1000 * (time.perf_counter() - start) / len(images)
        return [replace(one, ms=mean) for one in found]

    def _located(
        self,
        panorama: NDArray[np.uint8],
        query: Description,
        tracker: Tracker | None,
        motion: ArrayLike | None,
        start: float,
    ) -> Location:
        found, frames = self._found(panorama, query), self.map.frames
        rows, apart = found.indices[0, : self._top].tolist(), found.distances[0, : self._top].tolist()
        candidates = tuple(
            Candidate(str(frames.path[row]), x, y, str(self._rooms[row]), distance, row)
            for row, (x, y), distance in zip(rows, frames.xy[rows].tolist(), apart, strict=True)
        )
        pose, error, lost = self._estimates(query, found)
        known, rooms, row, covariance, of_map = self.map, self._rooms, candidates[0].row, None, 0.0
        if isinstance(tracker, SequenceFilter):
            assert self._placed is not None
            known, rooms, pose = self._placed, self._placed_rooms, None
            row = int(tracker.step(frame_distances(known, query)[0], motion).argmax())
            found = Retrieval(np.array([[row]]), np.zeros((1, 1)))
            # A frame stands for all places up to half a spacing from it, in either direction.
            of_map = tracker.motion.spacing**2 / 12
            variance = tracker.spread(row) ** 2 / 2 + of_map
            if of_map:  # without any spacing nobody knows how large the place of a frame is
                covariance = ((variance, 0.0), (0.0, variance))
        elif pose is not None or (tracker is not None and motion is not None):
            pose = _NOWHERE if pose is None else pose
            pose = pose if tracker is None else tracker.step(pose, motion)
            (xx, xy), (_, yy) = pose.covariance()[0].tolist()
            covariance = None if math.isnan(xx) else ((xx, xy), (xy, yy))
            of_map = 0.0 if pose.map_variance is None else float(pose.map_variance[0])
        xy, theta = (
            (known.frames.xy[row], headings(known, query, found)[:, 0]) if pose is None else (pose.xy[0], pose.theta)
        )
        location = Location(
            x=float(xy[0]),
            y=float(xy[1]),
            theta=float(theta[0]),
            room=str(rooms[found.most_alike[0]]),
            error_m=error,
            lost=lost,
            candidates=candidates,
            ms=1000 * (time.perf_counter() - start),
            covariance=covariance,
            agreement=math.nan if pose is None else float(pose.agreement[0]),
        )
        if self._collector is not None:
            told = None if isinstance(tracker, SequenceFilter) else motion  # which goes from frame to frame
            self._collector.take(panorama, location, tracker is not None, of_map, told)
        return location

    @typed
    def describe(self, panoramas: NDArray[np.uint8]) -> Description:
        """Describe panoramas (B, 3, H, W), uint8, RGB, of the bundle's size, as the map's frames were described.

        Raises:
            DataError: another shape or type.
        """
        rows, columns = self.bundle.image_size
        if panoramas.dtype != np.uint8 or panoramas.ndim != 4 or panoramas.shape[1:] != (3, rows, columns):
            raise DataError(
                f"panoramas have shape (B, 3, {rows}, {columns}) and dtype uint8, got {panoramas.shape} "
                f"{panoramas.dtype}"
            )
        found = self.map.describe(panoramas)
        return Description(found.position, found.orientation)  # by the map's descriptor: nothing to compare each time

    def _read(
        self,
        path: str | Path,
        camera: OmnidirectionalCamera | Mapping[str, Any] | None,
        threads: int | None,
        providers: Sequence[str] | None,
        hierarchical: bool | None,
    ) -> None:
        """Read all parts of the bundle; the arguments are those of the constructor."""
        self.bundle = Bundle.open(path)
        if camera is not None:
            own = self.bundle.preprocessing
            edges = own.view.top, own.view.bottom
            other = Preprocessing.checked(self.bundle.image_size, camera, edges, own.level)
            self.bundle = replace(self.bundle, preprocessing=other)
        known: VisualMap | None = self.bundle.load(MAP)
        if known is None:
            raise ConfigError(f"{path} holds no map: run `siamloc map`, then `siamloc export` again")
        known.check_descriptor(self.bundle.identity)
        self.bundle.thumbnail(0)  # read with the map, which an update replaces
        self.map, self._network = with_own_descriptor(self.bundle, known, threads, providers)
        self._search = self._layered(hierarchical)
        self._errors: ErrorModel | None = self.bundle.load(ERRORS)
        self._refinement: Refinement | None = self.bundle.load(REFINEMENT)

    def _layered(self, wanted: bool | None) -> HierarchicalSearch | None:
        """Return the search through the coarse layer; None if there is none, or if it is not to be used."""
        layer = None if wanted is False else self.bundle.load(LAYER)
        if layer is None and wanted:
            raise ConfigError(
                f"{self.bundle.path} holds no coarse layer: run `siamloc map build=spectral`, then `siamloc export "
                "build=spectral`"
            )
        if layer is None:
            return None
        coarse = coarse_map(self.bundle)
        try:
            settings = LayerSearch.of(self.bundle.about.get("search") or {})
            return HierarchicalSearch(self.map, layer, coarse=coarse, settings=settings)
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
        """Return the refined pose, the expected error, and whether that means lost.

        All rest on the map frames that have a position; none of them exists if the nearest frame has no position.
        """
        if self._placed is None or not self.map.frames.has_position[found.indices[0, 0]]:
            return None, math.nan, None
        if self._placed is not self.map:
            found = match(self._placed, query, self._wanted)
        pose, expected, lost = None, math.nan, None
        if self._refinement is not None:
            pose = replace(self._refinement, widening=1.0).poses(self._placed, query, found, self._compare)
        if self._errors is not None:
            errors, verdict = self._errors.judged(found, self._placed.frames.xy, pose)
            expected, lost = float(errors[0]), None if verdict is None else bool(verdict[0])
            if lost and self._errors.foreign(found, self._placed.frames.xy)[0]:
                expected = math.nan  # the expected error holds for images from the map's surroundings only
        if self._refinement is not None and pose is not None:
            pose = pose.widened(self._refinement.widening)
        return pose, expected, lost

    def _panorama(self, image: Any, tilt: ArrayLike | None = None) -> NDArray[np.uint8]:
        angles = None if tilt is None else np.asarray(tilt, dtype=np.float64)
        if angles is not None and not (angles.shape == (2,) and np.isfinite(angles).all()):
            raise DataError(f"a tilt is roll and pitch in rad, two numbers, got {tilt!r}")
        make = self.bundle.preprocessing
        if make.camera is None and angles is not None and angles.any():
            say_once(f"{self.bundle.path} knows no camera model: the tilt of the robot stays in its images")
        pixels = None if isinstance(image, (str, Path)) else np.asarray(image)
        if pixels is not None and pixels.size == 0:
            raise DataError("the image is empty: the camera returned no data")
        if pixels is not None and not isinstance(image, np.ndarray):  # of PIL, it may have to be turned
            raise DataError(
                f"an image is a file or an array of pixels, got {type(image).__name__}: give the file's path, or the "
                "pixels of the upright image, numpy.asarray(image)"
            )
        if pixels is not None and (pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8):
            raise DataError(f"an image has shape (rows, columns, 3) and dtype uint8, got {pixels.shape} {pixels.dtype}")
        try:
            return make.panorama(image, angles) if pixels is None else make.prepare(pixels, angles)
        except (UnreadableImageError, ConfigError) as error:  # damaged, or too small for the camera's ring
            what = image if pixels is None else f"an image of {pixels.shape[0]} x {pixels.shape[1]}"
            whose = " (unwrap is that of the map, which the bundle keeps)" if "unwrap" in str(error) else ""
            raise DataError(f"{what} cannot be located: {error}{whose}") from error


def _check_motion(tracker: Tracker | None, motion: ArrayLike | None) -> None:
    if tracker is not None:
        checked(tracker, Tracker, "tracker")
    elif motion is not None:
        raise ConfigError("a motion says how a tracked robot moved: give the tracker of its drive, localizer.tracker()")
