"""Size, speed and accuracy of a bundle in each precision.

"float16" stores the map in half precision; the network stays float32. "int8" stores the map in one byte per number, and
the network computes convolutions and fully connected layers with 8-bit integers (static, per channel, ranges from
panoramas of the map): a quarter of the size, and faster if the processor supports such multiplications. Weights are
limited to 7 bits, so that the sums do not overflow on any processor and all processors give the same answers. On the
robot, maps are float32 in memory.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from foundation.calls import typed
from foundation.columns import spread_rows
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps.packing import Precision
from siamloc.runtime.bundle import Bundle
from siamloc.runtime.localizer import Localizer
from siamloc.tables import Column, Table

if TYPE_CHECKING:
    from siamloc.data.frames import FrameTable
    from siamloc.data.library import PanoramaLibrary

CALIBRATION = 32
"""Number of panoramas from which the ranges of the integers are taken."""
LOSS = 0.02
"""Relative increase of the localization error that precision="auto" accepts."""

_ASKED = 200  # number of images that a bundle is measured with


@dataclass(frozen=True)
class Measured:
    """Size, speed and accuracy of a bundle in one precision.

    Attributes:
        precision: "float32", "float16" or "int8", the precision of network and map.
        bytes: size of the whole bundle.
        ms: median time per image, from the panorama on.
        change: median distance between its descriptors and the original's, relative to their norm.
        error: mean localization error, in units of x and y; an image without a position counts with the map's size.
        images: number of images measured.
        located: number of images that got a position.
    """

    precision: Precision
    bytes: int
    ms: float
    change: float
    error: float
    images: int
    located: int = 0


def smallest(rows: Sequence[Measured]) -> Measured:
    """Return the smallest bundle whose error exceeds that of the float32 bundle by at most `LOSS`."""
    full = next(row for row in rows if row.precision == "float32")
    if not full.located:
        raise ConfigError(
            f"precision=auto compares localization errors, and none of the {full.images} validation images finds a map "
            "frame with a position: use other frames, or name a precision"
        )
    good = [row for row in rows if row.error <= (1 + LOSS) * full.error]
    return min(good, key=lambda row: row.bytes)


@typed
def precision_table(bundle: Bundle) -> str:
    """Return a text table of the bundle's size, speed and accuracy in each precision; a star marks the chosen one.

    Args:
        bundle: written with precision="auto"; for others there is nothing to compare, and the text is empty.

    Raises:
        FormatError: the bundle was altered.
    """
    about = bundle.about
    try:
        rows = [Measured(**row) for row in about.get("precisions") or []]
        columns = [Column("precision"), Column("size", "MB", 2), Column("time", "ms", 2)]
        columns += [Column("change of descriptor", form="percent"), Column("error", about["unit"], 3)]
        chosen = about["precision"]
        cells = [
            (row.precision + " *" * (row.precision == chosen), row.bytes / 1e6, row.ms, row.change, row.error)
            for row in rows
        ]
        return Table("precisions", tuple(columns), tuple(cells)).text() if rows else ""
    except (TypeError, ValueError) as error:
        raise FormatError(f"{bundle.path} is altered in its precisions: export again") from error


def measured(bundle: Path, original: Descriptor, panoramas: NDArray[np.uint8], xy: NDArray[np.float64]) -> Measured:
    """Measure the size, speed and accuracy of a bundle.

    Args:
        bundle: folder of the bundle.
        original: the descriptor that was exported.
        panoramas: (n, 3, H, W) of the images to locate.
        xy: (n, 2) positions where they were taken.
    """
    localizer = Localizer(bundle)
    localizer.locate_panorama(panoramas[0])  # the first is slower
    found = [localizer.locate_panorama(panorama) for panorama in panoramas]
    expected = original.describe(localizer.map.mounting.straight(panoramas)).position
    apart = localizer.describe(panoramas).position - expected
    errors = np.hypot(*(np.array([[one.x, one.y] for one in found]) - xy).T)
    known = localizer.map.frames.xy
    farthest = float(np.hypot(*(np.nanmax(known, axis=0) - np.nanmin(known, axis=0))))
    return Measured(
        localizer.bundle.about["precision"],
        localizer.bundle.bytes,
        statistics.median(one.ms for one in found),
        float(np.median(np.linalg.norm(apart, axis=1) / np.linalg.norm(expected, axis=1))),
        float(np.where(np.isfinite(errors), errors, farthest).mean()),
        len(found),
        int(np.isfinite(errors).sum()),
    )


def spread(images: PanoramaLibrary, frames: FrameTable, count: int = _ASKED) -> tuple[NDArray[np.uint8], FrameTable]:
    """Return the panoramas of at most `count` evenly spread frames, and these frames.

    Raises:
        DataError: none of their images can be read.
    """
    readable = images.readable(frames)
    if not len(readable):
        raise DataError(f"none of the images of {len(frames)} frames could be read")
    chosen = readable.take(spread_rows(len(readable), count))
    return np.concatenate(list(images.batches(chosen))), chosen
