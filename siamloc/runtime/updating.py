"""`update`: let the map in a bundle follow the building, by pictures that the robot collected; needs no torch."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from foundation.calls import OF_FIELDS, takes
from foundation.files import atomic_folder, file_hash, read_json, write_json
from siamloc.data.frames import FrameTable
from siamloc.data.image_files import UnreadableImageError, read_image
from siamloc.data.panorama import shows_nothing
from siamloc.errors import DataError, SiamlocError, logger
from siamloc.maps import Built, CoarseLayer, VisualMap
from siamloc.maps.axes import WrongAxesError
from siamloc.maps.buildings import buildings_of, nearest
from siamloc.maps.checked_arrays import check_placed
from siamloc.maps.history import UPKEEP
from siamloc.maps.maintenance import Maintenance, Update, updated
from siamloc.maps.thinning import Budget, thin
from siamloc.runtime import bundle as files
from siamloc.runtime.collecting import SINCE, collected
from siamloc.runtime.describing import coarse_map
from siamloc.runtime.exportable import check_replaceable
from siamloc.runtime.localizer import Localizer
from siamloc.runtime.thumbnails import jpeg, write_thumbnails

_AT_ONCE = 16  # panoramas that are described together


@takes(Maintenance)
def update(bundle: str | Path, folder: str | Path, *, settings: Maintenance = OF_FIELDS, **fields: Any) -> list[Update]:
    """Update the map of a bundle by the drives that `Localizer(bundle, collect=folder)` collected.

    The map follows as by `siamloc.maps.update`, and so do its coarse layer and its thumbnails; the expected errors and
    the refinement stay as they were learned. The old bundle is replaced only once the new one is complete and was
    opened. Pictures that the map counted before are left out; those that came since count as another drive. A frame
    that joins gets the room of the nearest map frame, and a path from the folder on. A drive that cannot update the map
    is left out with a warning. Without any drive, the map is not thinned to its budget.

    Args:
        bundle: folder of the bundle.
        folder: folder of the collected pictures, which stay.
        settings: all settings in one object, instead of one keyword each.

    Returns:
        An update for each drive; none if the bundle stays as it was.

    Raises:
        FormatError: not a bundle, or an altered one.
        ConfigError: a bundle without a map, or with other files in its folder, or a setting out of range.
        DataError: no collected pictures, a map frame without a position, or only drives that cannot update the map,
            with pictures of another size or poses in other axes.
        StorageError: the disk is full or cannot be written to.
        SiamlocError: the bundle was replaced meanwhile.

    Example:
        >>> updates = siamloc.runtime.update("bundle", "collected")  # doctest: +SKIP
    """
    localizer = Localizer(bundle)
    check_replaceable(Path(bundle))
    known, held = localizer.map, localizer.bundle
    check_placed(known.frames, "an update")
    layer: CoarseLayer | None = held.load(files.LAYER)
    built = None
    if layer is not None:  # the robot has no mapper: frames join the node of the nearest map frame
        made = {key: value for key, value in layer.made.items() if key not in ("ids", "frames")}
        built = Built(replace(layer, made=made), np.zeros(1), known.digest)
    parts = _Parts(localizer)
    updates, faults, fits = list[Update](), list[str](), False
    for whole in collected(folder):
        drive = _uncounted(whole, known.made.get(UPKEEP, {}).get("drives", []))
        try:
            drive, panoramas = _read(drive, held.image_size)
            if not len(drive):  # counted before
                fits = True
                continue
            described = [localizer.describe(panoramas[at : at + _AT_ONCE]) for at in range(0, len(panoramas), _AT_ONCE)]
            seen = known.like(drive, Description.concatenate(described))
            found = updated(known, _placed_in(known, seen, settings.radius), built=built, settings=settings)
        except DataError as error:
            why = error.finding if isinstance(error, WrongAxesError) else error
            faults.append(f"{Path(whole.path[0]).parent} cannot update the map: {why}. Move it out of {folder}")
            continue
        parts.follow(found, panoramas[found.added])
        known, built = found.known, found.built
        updates.append(found)
    if faults and not (fits or updates):
        raise DataError("; ".join(faults))
    for fault in faults:
        logger.warning("%s; left out", fault)
    if updates:
        parts.write(Path(bundle), known, built)
    elif len(thin(known, settings=settings.narrowed(Budget)).known) < len(known):
        logger.warning("the map keeps %d frames, more than its budget: the next drive thins it", len(known))
    return updates


class _Parts:
    """The parts of a bundle that have a row for each map frame, besides the map itself."""

    def __init__(self, localizer: Localizer) -> None:
        self.bundle = localizer.bundle
        self.thumbnails: list[bytes | None] | None = self.bundle.load(files.THUMBNAILS)
        self.coarse = coarse_map(self.bundle)

    def follow(self, found: Update, joined: NDArray[np.uint8]) -> None:
        """Let the rows of frames leave that left the map, and rows of panoramas (k, 3, H, W) join."""
        kept = np.flatnonzero(~found.forgotten)
        if self.thumbnails is not None:
            self.thumbnails = [*(self.thumbnails[row] for row in kept.tolist()), *map(jpeg, joined)]
        if self.coarse is not None:
            self.coarse = self.coarse.take(kept)
            if len(joined):
                self.coarse = self.coarse.add(found.drive.take(found.added), self.coarse.describe(joined))

    def write(self, path: Path, known: VisualMap, built: Built | None) -> None:
        """Write the bundle with another map, in place of the old one."""
        about = dict(self.bundle.about)

        def unchanged(older: Path) -> None:
            if not older.exists() or read_json(older / files.DESCRIPTION) != self.bundle.about:
                raise SiamlocError(f"{path} was replaced while its map was updated: it stays; update it again")

        with atomic_folder(path.absolute(), unchanged) as fresh:
            for name in self.bundle.files:
                shutil.copyfile(self.bundle.path / name, fresh / name)
            changed: dict[str, Any] = {files.MAP: known, files.COARSE: self.coarse}
            for name, part in changed.items():
                if part is not None:
                    part.save(fresh / name, about["precision"])
            if built is not None:
                layer = built.layer
                if self.coarse is not None:
                    means = CoarseLayer.of_labels(self.coarse, layer.labels, layer.names).representatives
                    layer = replace(layer, representatives=means)
                layer.save(fresh / files.LAYER)
            for name in {files.ERRORS, files.REFINEMENT} & set(self.bundle.files):
                replace(self.bundle.load(name), map_digest=known.placed().digest).save(fresh / name)
            if self.thumbnails is not None:
                write_thumbnails(fresh / files.THUMBNAILS, self.thumbnails)
            about["sha256"] = {name: file_hash(fresh / name) for name in self.bundle.files}
            write_json(fresh / files.DESCRIPTION, about)
            if len(Localizer(fresh).map) != len(known):
                raise SiamlocError(f"the updated bundle of {path} cannot be read back: the old one stays")


def _uncounted(drive: FrameTable, counted: list[str]) -> FrameTable:
    """Return the pictures of a drive that a map did not count yet, as a drive named after the newest of them.

    A robot that drives on between two updates adds to the folder of its drive.
    """
    name = str(drive.sequence[0])
    parts = (one.rpartition("/")[2].rpartition(SINCE) for one in counted)  # of any building
    drive = drive.take(drive.time > max((float(newest) for one, _, newest in parts if one == name), default=-np.inf))
    return drive.with_columns(sequence=[f"{name}{SINCE}{drive.time.max(initial=0):.6f}"] * len(drive))


def _read(drive: FrameTable, size: tuple[int, int]) -> tuple[FrameTable, NDArray[np.uint8]]:
    """Return the readable pictures of a drive that show anything, and their panoramas (n, 3, H, W), uint8, RGB."""
    rows, found, faults = list[int](), [np.empty((0, *size, 3), np.uint8)], list[str]()
    for row, path in enumerate(drive.path.tolist()):
        try:
            picture = read_image(path)
        except UnreadableImageError as error:
            faults.append(f"{path}: {error}")
            continue
        if picture.shape[:2] != size:
            raise DataError(
                f"{path} is {picture.shape[0]} x {picture.shape[1]} px, and the bundle's panoramas {size[0]} x "
                f"{size[1]}: another bundle collected it"
            )
        if shows_nothing(picture.transpose(2, 0, 1)[None])[0]:
            faults.append(f"{path}: it shows nothing")
            continue
        rows.append(row)
        found.append(picture[None, ..., ::-1])
    if faults:
        logger.warning("%d of %d pictures cannot be used, the first: %s; left out", len(faults), len(drive), faults[0])
    return drive.take(np.array(rows, dtype=np.int64)), np.concatenate(found).transpose(0, 3, 1, 2)


def _placed_in(known: VisualMap, drive: VisualMap, radius: float) -> VisualMap:
    """Return a described drive with frames as those of a map, with paths from the folder of all drives on.

    They have the buildings in which they were taken (see `buildings_of`), rooms of the nearest map frames there, and
    headings if the map has any.
    """
    drive = replace(drive, frames=drive.frames.with_columns(building=buildings_of(known, drive, radius)))
    paths = ["/".join(Path(path).parts[-2:]) for path in drive.frames.path.tolist()]
    room = known.frames.room[nearest(known.frames, drive.frames)]
    theta = drive.frames.theta if known.orientation is not None else np.full(len(drive), np.nan)
    return replace(drive, frames=drive.frames.with_columns(path=paths, room=room, theta=theta, unit=known.unit))
