"""Check the arrays that a map is made of, and keep others from writing to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.distances import DISTANCES
from foundation.errors import known
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps.packing import all_finite
from siamloc.maps.search import array_of


def checked_descriptors(given: Any, frames: FrameTable) -> NDArray[np.float32]:
    """Return the descriptors (n, D) of n frames, read-only.

    Raises:
        DataError: another shape or type, or values that are not finite.
    """
    values = array_of(given)
    if values.dtype.kind not in "buif" or values.ndim != 2 or 0 in values.shape:
        raise DataError(
            "a map needs descriptors that are real numbers, of shape (n, D), n and D at least 1, got "
            f"{values.dtype} {values.shape}"
        )
    descriptors = _own(values.astype(np.float32, copy=False), values)
    descriptors.flags.writeable = False
    if len(descriptors) != len(frames):
        raise DataError(f"a map needs one descriptor per frame, got {len(descriptors)} for {len(frames)} frames")
    if not all_finite(descriptors):
        bad = np.flatnonzero(~np.isfinite(descriptors).all(axis=1))
        raise DataError(
            f"{len(bad)} of {len(descriptors)} map descriptors hold values that are not finite, the first that of "
            f"{frames.path[bad[0]]}: look at the model and at this image"
        )
    return descriptors


def checked_orientation(orientation: Any, descriptors: NDArray, *, halved: bool) -> NDArray:
    """Return valid orientation parts, as the descriptors in another shape if both are the same values."""
    values = array_of(orientation)
    array = _own(values, values)
    frames = len(descriptors)
    if halved:
        fits = array.dtype == np.float16 and (array.ndim == 3 or array.shape[3:] == (2,))
    else:
        fits = array.dtype.kind in "fcu" and array.ndim == 3
    if not fits or len(array) != frames or 0 in array.shape:
        kind = "float16" if halved else "numbers"
        raise DataError(
            f"a map's orientation parts must be {kind} of shape ({frames}, K, F), got {array.dtype} {array.shape}"
        )
    same = array.dtype == descriptors.dtype and array.size == descriptors.size
    if same and np.array_equal(array.reshape(descriptors.shape), descriptors):
        return descriptors.reshape(array.shape)
    if not all_finite(array):
        raise DataError("a map's orientation parts hold values that are not finite: look at the images")
    array.flags.writeable = False
    return array


def check_placed(frames: FrameTable, what: str) -> None:
    """Refuse map frames without a position, and a map without frames, where something needs positions.

    Raises:
        DataError: a frame without a position, or no frames.
    """
    lacking = int((~frames.has_position).sum())
    if lacking or not len(frames):
        raise DataError(
            f"{lacking} of the {len(frames)} map frames have no position, which {what} needs: leave them out with "
            "`VisualMap.placed()`"
        )


def check_means(known: Any, remedy: str) -> None:
    """Refuse a map whose descriptors are turned before they are compared, where something needs their means.

    Raises:
        ConfigError: descriptors that are turned first; the message ends with the remedy.
    """
    if known.aligned:
        name = known.descriptor.name
        raise ConfigError(f"descriptors of {name} are compared after turning, so their means are meaningless: {remedy}")


def check_distance(name: str, width: int) -> None:
    """Refuse an unknown distance, or a distance by which all descriptors of this width are alike."""
    least = {"cosine": 2, "correlation": 3}.get(known(name, DISTANCES, "distance"), 1)
    if width < least:
        raise ConfigError(
            f"distance={name} needs descriptors of {least} numbers or more, and these have {width}: use euclidean or "
            "manhattan"
        )


def _own(array: NDArray, given: Any) -> NDArray:
    """Return an array that nothing else can write to: the array itself if read-only or freshly made, else a copy."""
    shared = isinstance(given, np.ndarray) and np.may_share_memory(array, given)
    return array.copy() if shared and array.flags.writeable else array
