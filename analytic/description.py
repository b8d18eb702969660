"""Descriptions of images, and the results of comparing two of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from analytic.distances import unit_vectors
from analytic.errors import AnalyticError
from foundation.columns import chosen_rows
from foundation.files import plain

T = TypeVar("T")

_VALUES = 1 << 20  # transformed at a time: 4 MiB


@dataclass(frozen=True, eq=False)
class Description:
    """A batch of images as a descriptor sees them: position parts, orientation parts, and the descriptor's identity.

    Values that are needed for every comparison, such as the spectrum, are computed once and cached, since a map is
    compared with many queries.

    Attributes:
        position: (B, D) float32, unchanged when the robot turns on the spot (as far as the descriptor can).
        orientation: (B, K, F) values that move along the second axis when the robot turns, K steps being a full turn;
            None for a descriptor that has no such part.
        identity: identity of the descriptor that made the description; None if unknown.

    Example:
        >>> import analytic
        >>> hog = analytic.descriptor("hog", rows=4, bins=8, step=4)
        >>> found = hog.describe(np.zeros((5, 128, 512), dtype=np.uint8))
        >>> len(found), found.position.shape, found.orientation.shape
        (5, (5, 32), (5, 128, 16))
        >>> len(found.take([0, 3]))
        2
    """

    position: NDArray[Any]
    orientation: NDArray[Any] | None = None
    identity: dict[str, Any] | None = None

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: Any) -> Description:
        """Return the description of some images, given by their numbers, a mask (B,) or a slice.

        Raises:
            AnalyticError: images that it does not hold.
        """
        rows = chosen_rows(rows, len(self), AnalyticError)
        orientation = None if self.orientation is None else self.orientation[rows]
        return Description(self.position[rows], orientation, self.identity)

    @staticmethod
    def concatenate(parts: Sequence[Description]) -> Description:
        """Concatenate several descriptions made by the same descriptor, in order.

        Raises:
            AnalyticError: no parts, or parts of different descriptors.
        """
        if not parts:
            raise AnalyticError("there is no description to concatenate")
        for part in parts:
            check_alike(parts[0], part)
        return Description(*joined([(part.position, part.orientation) for part in parts]), parts[0].identity)

    def kept(self, name: str, compute: Callable[[Description], T]) -> T:
        """Return `compute(self)`, computed at the first call with that name and cached."""
        values: dict[str, Any] = vars(self)
        if name not in values:
            values[name] = compute(self)
        return values[name]

    def units(self, centred: bool) -> NDArray[np.float64]:
        """Return the position parts as unit vectors, after subtracting their means if `centred`."""
        return self.kept(f"units, centred {centred}", lambda made: unit_vectors(made.position, centred))

    @property
    def turnable(self) -> NDArray[Any]:
        """The orientation part.

        Raises:
            AnalyticError: there is none.
        """
        if self.orientation is None:
            raise AnalyticError("the description has no orientation part: use a descriptor that has one, such as hog")
        return self.orientation

    @cached_property
    def squares(self) -> NDArray[np.float64]:
        """Squared lengths of the orientation parts (B,)."""
        flat = self.turnable.reshape(len(self), prod(self.turnable.shape[1:]))
        return np.einsum("bf,bf->b", flat, flat, dtype=np.float64)

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        """Fourier transform of the orientation parts along the turn (K // 2 + 1, B, F)."""
        return spectrum(self.turnable)


@dataclass(frozen=True, eq=False)
class Alignment:
    """The relative heading of n queries to m references, and their distances after alignment.

    Attributes:
        heading: (n, m) how far the robot of the query has turned left since the reference, rad in (-pi, pi].
        distance: (n, m) distance between the orientation parts after aligning them.

    Example:
        >>> import analytic
        >>> hog = analytic.descriptor("hog")
        >>> seen = hog.describe(np.random.default_rng(0).random((2, 128, 512)))
        >>> found = hog.align(seen, seen)
        >>> found.heading.shape, np.diag(found.distance)
        ((2, 2), array([0., 0.]))
    """

    heading: NDArray[np.float64]
    distance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Match:
    """The nearest frame of a map for each query.

    Attributes:
        index: (n,) row of the map.
        distance: (n,) distance to that frame.
        heading: (n,) how far the robot has turned left since that frame, rad in (-pi, pi].

    Example:
        >>> import analytic
        >>> hog = analytic.descriptor("hog")
        >>> known = hog.describe(np.random.default_rng(0).random((4, 128, 512)))
        >>> hog.localize(known.take([2]), known).index
        array([2])
    """

    index: NDArray[np.int64]
    distance: NDArray[np.float64]
    heading: NDArray[np.float64]


def spectrum(columns: NDArray[Any]) -> NDArray[np.complex64]:
    """Return the Fourier transform (K // 2 + 1, B, F) of real values (B, K, F) along the turn, frequency first.

    Each row has its own transform, so a few are transformed at a time: a large map needs memory for the result only.
    """
    rows, steps, features = columns.shape
    made = np.empty((steps // 2 + 1, rows, features), dtype=np.complex64)
    few, rfft = max(1, _VALUES // max(steps * features, 1)), fft().rfft
    for start in range(0, rows, few):
        part = np.asarray(columns[start : start + few], dtype=np.float32)
        made[:, start : start + few] = rfft(part, axis=1).transpose(1, 0, 2)
    return made


def fft() -> ModuleType:
    """Return the FFT module of scipy, or that of numpy where scipy is not installed, as on a robot."""
    try:
        from scipy import fft as found
    except ImportError:
        from numpy import fft as found
    return found


def joined(parts: Sequence[tuple[NDArray[Any], NDArray[Any] | None]]) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Join the position parts and the orientation parts of several descriptions.

    If the position part is a flat view of the orientation part, it stays one, so the values are in memory only once.

    Raises:
        AnalyticError: only some of the descriptions have an orientation part.
    """
    if len(parts) == 1:
        return parts[0]
    positions, orientations = zip(*parts, strict=True)
    lacking = sum(orientation is None for orientation in orientations)
    if lacking == len(parts):
        return np.concatenate(positions), None
    if lacking:
        raise AnalyticError(
            f"{lacking} of {len(parts)} descriptions have no orientation part: give one for every image, or for none"
        )
    orientation = np.concatenate(orientations)
    if all(map(np.shares_memory, positions, orientations)):
        return orientation.reshape(len(orientation), -1), orientation
    return np.concatenate(positions), orientation


def check_alike(first: Description, second: Description) -> None:
    """Raise AnalyticError unless two descriptions have the same identity and size.

    Equal parameters on images of different sizes give orientation parts that cannot be compared.
    """
    one, other = first.identity, second.identity
    if one is not None and other is not None and plain(one) != plain(other):
        raise AnalyticError(other_parameters(one, other))
    sizes = [_sizes(description) for description in (first, second)]
    if sizes[0] != sizes[1]:
        raise AnalyticError(
            f"descriptions have different sizes ({sizes[0]}, {sizes[1]}): describe images of one size with the same "
            "descriptor"
        )


def other_parameters(expected: dict[str, Any], found: dict[str, Any]) -> str:
    """Return the error message for descriptions made by two different descriptors."""
    expected, found = plain(expected), plain(found)
    keys = [key for key in {**expected, **found} if expected.get(key) != found.get(key)]
    if "name" in keys:
        keys = ["name"]  # the parameters of different descriptors are unrelated
    said = ", ".join(f"{key}={found.get(key)} instead of {expected.get(key)}" for key in keys)
    return f"the descriptions were made with other parameters ({said}): describe all images with the same descriptor"


def _sizes(made: Description) -> str:
    position = " x ".join(map(str, made.position.shape[1:]))
    if made.orientation is None:
        return f"position {position} and no orientation part"
    return f"position {position} and orientation {' x '.join(map(str, made.orientation.shape[1:]))}"
