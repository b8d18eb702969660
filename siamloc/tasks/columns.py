"""Columns of equal length: the form in which tasks hand over what became of each query."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import DataError

Columns = dict[str, NDArray[Any]]
UNLABELLED = "(unlabelled)"


def rows_by_label(labels: NDArray) -> dict[str, NDArray[np.int64]]:
    """Return the row numbers of each label, labels in alphabetic order.

    Rows without a label come under "(unlabelled)"; where no row carries one there are no groups at all.
    """
    names, inverse = np.unique(labels, return_inverse=True)
    if names.tolist() == [""]:
        return {}
    return {str(name) or UNLABELLED: np.flatnonzero(inverse == i) for i, name in enumerate(names)}


def room_names(*tables: FrameTable) -> list[NDArray[np.str_]]:
    """Return each table's rooms by names that tell them apart: with their building only where there are several."""
    buildings = {building for table in tables for building in np.unique(table.building).tolist()}
    return [table.room if len(buildings) <= 1 else table.place for table in tables]


def one_descriptor_per_query(descriptors: ArrayLike, frames: FrameTable) -> NDArray:
    """Return the descriptors as an array.

    Raises:
        DataError: no queries, or not one descriptor for each.
    """
    values = np.asarray(descriptors)
    if not len(frames):
        raise DataError("there are no queries to evaluate")
    if values.ndim != 2 or len(values) != len(frames):
        raise DataError(f"{len(frames)} queries need descriptors of shape ({len(frames)}, D), got {values.shape}")
    return values
