"""From images to maps: `build` describes the frames of a map, `describe` the queries that are located in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analytic import DESCRIPTORS, Description, Descriptor, Fused, descriptor
from analytic.descriptors.base import check_own
from analytic.descriptors.fused import distinct
from foundation.calls import typed
from foundation.errors import known
from siamloc.data.frames import FrameTable, check_units
from siamloc.data.mounting import Mounting, estimate
from siamloc.errors import ConfigError, DataError, logger
from siamloc.maps.fusing import check_apart, weighted
from siamloc.maps.heading import HEADINGS, NetworkHeading, described, halved
from siamloc.maps.visual_map import VisualMap
from siamloc.progress import track
from siamloc.stopwatch import Stopwatch

if TYPE_CHECKING:
    from torch import nn

    from siamloc.data.library import PanoramaLibrary

UNPOSED_YAW = 5.0
"""Degrees of yaw that are left as they are without poses: a straight camera's yaw is off by up to 3 then."""


@typed
def build(
    described_by: Descriptor | nn.Module | str | Sequence[str | Descriptor],
    images: PanoramaLibrary,
    frames: FrameTable,
    *,
    validation: FrameTable | None = None,
    heading: Descriptor | str | None = None,
    distance: str | None = None,
    device: str | None = "auto",
    mounting: Mounting | None = None,
    made: Mapping[str, Any] | None = None,
    progress: bool = True,
) -> VisualMap:
    """Describe frames and return the map in which queries are searched.

    A network that compares images also estimates how the camera is mounted, as `siamloc.data.find_mounting` does; the
    map takes that into account whenever it describes panoramas or refines poses. Without positions, the robot is taken
    to drive ahead.

    Args:
        described_by: a network (B, 3, H, W) -> (B, D), any descriptor, or the name of an analytic one such as "hog"; or
            a list of several that become one, such as ["pretrained", "hsv", "hog"], see `analytic.Fused`.
        images: panoramas of the frames.
        frames: the frames of the map; those whose image cannot be read are left out.
        validation: frames of other drives, from which the weights of fused descriptors are learned: those with which
            the nearest map frames are nearest to them, or in their room if there are no positions. Without them, the
            weights are equal.
        heading: an analytic descriptor, or its name, that gives headings alongside a network. If None, a network that
            wraps around and has the head `fourier` or `magnitudes` gives them itself, and other networks give none.
        distance: how descriptors are compared, a name in `analytic.DISTANCES`; the descriptor's default if None.
        device: where a network computes: "auto" is the GPU if torch finds one, see `siamloc.models.as_descriptor`; a
            network stays where it is if None.
        mounting: how the camera is mounted; estimated if None, and `Mounting()` for straight ahead.
        made: further plain values for reference (`VisualMap.made`).
        progress: whether to show the progress.

    Raises:
        ConfigError: an unknown name, distance or device, descriptors that do not work together, or validation frames
            from the map's drives.
        AnalyticError: a descriptor of the user's own whose identity is no dictionary, or whose descriptions depend on
            chance or on the other images of a batch.
        DataError: no image can be read, descriptors are not finite, or positions of validation frames in another unit.

    Example:
        >>> import cv2, numpy as np, tempfile
        >>> from siamloc.data import FrameTable, PanoramaLibrary
        >>> folder = tempfile.mkdtemp()
        >>> for name, level in (("dark", 20), ("light", 220)):
        ...     _ = cv2.imwrite(f"{folder}/{name}.png", np.full((16, 64, 3), level, np.uint8))
        >>> frames = FrameTable(path=[f"{folder}/dark.png", f"{folder}/light.png"], x=[0, 1], y=[0, 0])
        >>> images = PanoramaLibrary(frames, f"{folder}/cache", image_size=(16, 64))
        >>> build("hog", images, frames, progress=False)
        VisualMap(2 frames, 256 numbers each by hog, compared by correlation)
    """
    by = descriptor_from(described_by, circular=images.circular, device=device)
    second = None if heading is None else descriptor_from(heading, circular=images.circular, device=device)
    turned = [f"heading={second.name}"] if second is not None else []
    turned += [f"mounting.yaw={mounting.yaw:g}"] if mounting is not None and mounting.yaw else []
    if turned and not images.circular:
        raise ConfigError(
            f"{turned[0]} needs columns that are a full turn, and circular=false says that they are not: leave it out"
        )
    if second is not None and (by.aligned or second.name not in HEADINGS):
        raise ConfigError(
            f"{second.name} cannot find the headings of a map by {by.name}: the descriptors {', '.join(HEADINGS)} can, "
            "in a map whose descriptors are not turned before they are compared"
        )
    _check_elevations(by, images)
    if not len(frames):
        raise DataError("there are no frames to describe: the table is empty")
    readable = images.readable(frames)
    if not len(readable):
        raise DataError(f"none of the images of the {len(frames)} map frames could be read")
    for part in by.parts.values() if isinstance(by, Fused) else (by,):
        if type(part).__module__.partition(".")[0] not in ("analytic", "siamloc"):  # a descriptor of the user's own
            some = readable.take(np.unique([0, len(readable) // 2, len(readable) - 1]))
            check_own(part, images.batch(images.rows(some)))
    if isinstance(by, Fused) and not by.complete:
        validation = validation if by.weights is None else None
        check_apart(readable, validation)
        check_units(one for one in (readable, validation) if one is not None and one.has_position.any())
        by = by.measured(next(iter(images.batches(readable.take([0])))))
    if getattr(by, "compares", False) and images.circular and readable.unit != "m":
        logger.warning(
            "positions are in %r: the network compares images in metres, and so is not used to put frames in order or "
            "to refine poses; give x and y in metres",
            readable.unit,
        )
    what = "describing the map" if progress else None

    def descriptions(mounting: Mounting | None, frames: FrameTable = readable) -> Description:
        return Description.concatenate(
            list(describe(by, images, frames, heading=second, mounting=mounting, progress=what))
        )

    found = descriptions(mounting)
    if mounting is None and second is None and images.circular and getattr(by, "compares", False):
        assert found.orientation is not None
        posed = bool(readable.has_position.any())
        estimated = estimate(readable, found.orientation, by.compare, posed)  # type: ignore[attr-defined]
        mounting = estimated.mounting if posed or abs(estimated.yaw) > UNPOSED_YAW else Mounting()
        if mounting != Mounting():
            logger.warning("the camera is not mounted straight, which the map makes up for: %s", estimated.summary())
            if replace(mounting, ahead=0.0, left=0.0) != Mounting():  # an offset leaves the panoramas as they are
                found = descriptions(mounting)
    if isinstance(by, Fused) and not by.complete:
        asked = None if validation is None else images.readable(validation)
        seen = None if asked is None or not len(asked) else descriptions(mounting, asked).position
        by, fusion = weighted(by, found.position, readable, seen, asked)
        found = Description(by.joined(by.split(found.position)), found.orientation)
        made = {**(made or {}), "fusion": fusion}
    turning, orientation = second, found.orientation
    own = by.oriented_by if isinstance(by, Fused) else by
    if own is not None and own.name == NetworkHeading.name and second is None:
        wanted = images.circular if by.tells_heading else getattr(by, "compares", False)
        turning = NetworkHeading(by.tells_heading) if wanted else None
        orientation = None if turning is None else orientation
    elif own is not None and second is None and not (own.tells_heading or own.aligned):
        orientation = None  # which nothing would compare
    if turning is not None and orientation is not None:
        orientation = halved(turning, orientation)
    made = {**(made or {}), **({} if mounting in (None, Mounting()) else {"mounting": mounting.plain()})}
    drive = str(readable.sequence[0])
    camera, size = images.cameras[drive], images.sizes[drive]
    read = {"data": {**readable.source, **images.settings()}, "size": size, "frames": len(readable)}
    return VisualMap(
        found.position,
        readable,
        {**by.identity, "images": replace(images.preprocessing, camera=camera).parameters()},
        by.default_distance if distance is None else distance,
        made={**read, "sequences": list(readable.rows_by("sequence")), **made},
        orientation=orientation,
        heading=None if turning is None or orientation is None else turning.identity,
        describes=by,
    )


@typed
def describe(
    by: VisualMap | Descriptor,
    images: PanoramaLibrary,
    frames: FrameTable,
    *,
    heading: Descriptor | None = None,
    mounting: Mounting | None = None,
    progress: str | None = None,
    clock: Stopwatch | None = None,
) -> Iterator[Description]:
    """Yield the descriptions of frames batch by batch, in order; `Description.concatenate(list(...))` joins them.

    Descriptions that are compared after turning are large, so it is better to search batch by batch.

    Args:
        by: a descriptor, or the map in which the frames are to be found: then its descriptors, after a check that the
            panoramas are made in the same way.
        images: panoramas of the frames.
        frames: n frames, all readable.
        heading: a second descriptor, whose orientation parts are used; that of the map if `by` is a map.
        mounting: how the camera is mounted, straight if None; that of the map if `by` is a map.
        progress: label of the progress bar; None to show nothing.
        clock: measures the time spent on describing, without decoding, as its step "describe".

    Raises:
        ConfigError: the map has no descriptor, or its panoramas were made in another way.
    """
    if isinstance(by, VisualMap):
        by.check_images(images.preprocessing.parameters(), images.preprocessing.size)
        heading, mounting = by.heading_descriptor, by.mounting
        by = by.descriptor
    timed = Stopwatch() if clock is None else clock

    def descriptions() -> Iterator[Description]:
        for batch in images.batches(frames):
            with timed.of("describe", len(batch)):
                found = described(by, heading, batch, mounting)
            yield found

    return descriptions() if progress is None else track(descriptions(), len(frames), progress, size=len)


def _check_elevations(by: Descriptor, images: PanoramaLibrary) -> None:
    """Raise ConfigError if panoramas show other elevations than those that a network was trained on."""
    wanted, there = getattr(by, "elevations", None), images.preprocessing.elevations
    if wanted is not None and there is not None and not np.allclose(wanted, there, atol=0.5):
        raise ConfigError(
            f"the network was trained on panoramas from {wanted[0]:g} to {wanted[1]:g} degrees of elevation, and these "
            f"show {there[0]:g} to {there[1]:g}: set unwrap.top={wanted[0]:g} unwrap.bottom={wanted[1]:g} (in Python "
            "PanoramaLibrary(frames, unwrap=camera, **network.view))"
        )


def descriptor_from(
    by: Descriptor | nn.Module | str | Sequence[str | Descriptor], *, circular: bool, device: str | None = "auto"
) -> Descriptor:
    """Return the descriptor for a descriptor (as it is), a network (wrapped) or a name (with default parameters).

    Args:
        by: a descriptor, a network, a name in `analytic.DESCRIPTORS`, or "pretrained" for the network that ships with
            siamloc; or a list of several, which are fused.
        circular: whether the columns of the images are a full turn; ignored unless `by` is a name.
        device: where a network computes.

    Raises:
        ConfigError: an unknown name.
    """
    if isinstance(by, Descriptor):
        return by
    if isinstance(by, Sequence) and not isinstance(by, str):
        names = [one if isinstance(one, str) else one.name for one in by]
        made = (descriptor_from(one, circular=circular, device=device) for one in by)
        return Fused(dict(zip(distinct(names), made, strict=True)))
    if isinstance(by, str) and by != "pretrained":
        return descriptor(known(by, ("pretrained", *DESCRIPTORS), "descriptor"), circular=circular)
    from siamloc.models import as_descriptor, pretrained

    return as_descriptor(pretrained(circular=circular) if isinstance(by, str) else by, device)
