"""What a bundle costs and gives in each precision.

"float16" keeps weights in half precision and computes as before: file and memory have half the length, the descriptor
changes by about a thousandth, and an image takes up to 1.7 times as long. "int8" computes convolutions and fully
connected layers with whole numbers of 8 bits (static, per channel, ranges from panoramas of the map): a quarter of the
length, and faster where the processor multiplies such numbers. Weights keep to 7 bits, so that no processor's sums
overflow and all give the same answers.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from siamloc.calls import typed
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps.packing import Precision
from siamloc.runtime.bundle import Bundle
from siamloc.runtime.localizer import Localizer

if TYPE_CHECKING:
    from siamloc.data.frames import FrameTable
    from siamloc.data.library import PanoramaLibrary

CALIBRATION = 32
"""Panoramas from which the ranges of whole numbers are taken."""
LOSS = 0.02
"""What share of the localization error precision="auto" may lose."""

_ASKED = 200  # images that a bundle is measured with
_COLUMNS = ("precision", "MB", "ms", "change of descriptor", "error")


@dataclass(frozen=True)
class Measured:
    """What a bundle costs and gives in one precision.

    Attributes:
        precision: of network and map.
        bytes: of the whole bundle.
        ms: median time of an image, from the panorama on.
        change: median distance between its descriptors and the original's, of their length.
        error: mean localization error, in units of x and y; an image without a position counts with the map's size.
        images: that it was measured with.
        located: those of them that got a position.
    """

    precision: Precision
    bytes: int
    ms: float
    change: float
    error: float
    images: int
    located: int = 0

    def plain(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)


def smallest(rows: Sequence[Measured]) -> Measured:
    """Return the smallest bundle that loses at most `LOSS` of the error of the one in float32."""
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
    """Return what each precision costs and gives, as lines to read, the chosen one with a star.

    Args:
        bundle: written with precision="auto"; for others there is nothing to compare, and the text is empty.

    Raises:
        FormatError: it was altered.
    """
    try:
        rows = [Measured(**row) for row in bundle.about.get("precisions") or []]
        cells = [
            (
                f"{row.precision}{' *' if row.precision == bundle.about['precision'] else ''}",
                f"{row.bytes / 1e6:.2f}",
                f"{row.ms:.2f}",
                f"{row.change:.2%}",
                f"{row.error:.3f} {bundle.about['unit']}",
            )
            for row in rows
        ]
    except (TypeError, ValueError) as error:
        raise FormatError(f"{bundle.path} is altered in its precisions: export again") from error
    if not rows:
        return ""
    widths = [max(map(len, column)) for column in zip(_COLUMNS, *cells, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in [_COLUMNS, *cells]
    )


def measured(bundle: Path, original: Descriptor, panoramas: NDArray[np.uint8], xy: NDArray[np.float64]) -> Measured:
    """Measure a bundle.

    Args:
        bundle: its folder.
        original: what described its map.
        panoramas: (n, 3, H, W), of images to be located.
        xy: (n, 2) where they were taken.
    """
    localizer = Localizer(bundle)
    localizer.locate_panorama(panoramas[0])  # the first is slower
    found = [localizer.locate_panorama(panorama) for panorama in panoramas]
    expected = original.describe(panoramas).position
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
    """Return panoramas of at most so many frames, evenly spread, and the frames.

    Raises:
        DataError: none of their images can be read.
    """
    readable = images.readable(frames)
    if not len(readable):
        raise DataError(f"none of the images of {len(frames)} frames could be read")
    chosen = readable.take(np.unique(np.linspace(0, len(readable) - 1, min(count, len(readable))).round().astype(int)))
    return np.concatenate(list(images.batches(chosen))), chosen
