"""The interface that analytic and learned descriptors share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.distances import distance
from analytic.errors import AnalyticError


@dataclass(frozen=True)
class Description:
    """What a descriptor says of a batch of images.

    Attributes:
        position: (B, D) float32, unchanged when the robot turns on the spot (as far as the descriptor can).
        orientation: (B, ...) what shifts when the robot turns; None for a descriptor that has no such part.
    """

    position: NDArray[np.float32]
    orientation: NDArray[Any] | None = None

    def __len__(self) -> int:
        return len(self.position)


class Descriptor(ABC):
    """A map from panoramas to vectors.

    Attributes:
        name: what configurations and files call it.
        default_distance: the distance between position descriptors that it is meant for.
    """

    name: str
    default_distance: str = "euclidean"

    @property
    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """Name and parameters as plain values: two descriptions may be compared if these agree."""

    @abstractmethod
    def describe(self, batch: ArrayLike) -> Description:
        """Describe a batch (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1]."""

    def pairwise(self, queries: Description, references: Description, distance_name: str | None = None) -> NDArray:
        """Return the distances (n, m) between position descriptors."""
        return distance(distance_name or self.default_distance)(queries.position, references.position)


def as_batch(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as float32 in [0, 1] of shape (B, C, H, W), C being 1 or 3.

    Three planes (3, H, W) are one colour image, not three grey ones.

    Raises:
        AnalyticError: another shape, another number of channels, or values that are not finite.
    """
    array = np.asarray(images)
    if array.ndim == 2:
        array = array[None, None]
    elif array.ndim == 3:
        array = array[None] if array.shape[0] == 3 else array[:, None]
    if array.ndim != 4 or array.shape[1] not in (1, 3) or 0 in array.shape:
        raise AnalyticError(
            f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), got {np.shape(images)}"
        )
    if array.dtype == np.uint8:
        return array.astype(np.float32) / np.float32(255)
    if array.dtype.kind != "f":
        raise AnalyticError(f"images must be uint8 or floating point in [0, 1], got {array.dtype}")
    if not np.isfinite(array).all():
        raise AnalyticError("an image holds values that are not finite: clean it before describing it")
    return array.astype(np.float32, copy=False)


def as_grey(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as float32 luma (ITU-R BT.601) in [0, 1] of shape (B, H, W). Errors as `as_batch`."""
    batch = as_batch(images)
    if batch.shape[1] == 1:
        return batch[:, 0]
    return np.einsum("bchw,c->bhw", batch, np.array([0.299, 0.587, 0.114], dtype=np.float32))
