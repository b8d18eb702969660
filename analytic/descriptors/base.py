"""The interface that analytic and learned descriptors share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.descriptors import circular
from analytic.distances import between_units, unit_vectors
from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError


@dataclass(frozen=True)
class Description:
    """What a descriptor says of a batch of images.

    Attributes:
        position: (B, D) float32, unchanged when the robot turns on the spot (as far as the descriptor can).
        orientation: (B, K, F) what moves along its second axis when the robot turns, K steps being a full turn;
            None for a descriptor that has no such part.
        identity: of the descriptor that made it; None if unknown.
    """

    position: NDArray[Any]
    orientation: NDArray[Any] | None = None
    identity: dict[str, Any] | None = None

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: Any) -> Description:
        """Return the rows of an index array, a mask or a slice."""
        orientation = None if self.orientation is None else self.orientation[rows]
        return Description(self.position[rows], orientation, self.identity)

    @staticmethod
    def concatenate(parts: Sequence[Description]) -> Description:
        """Return the rows of several descriptions of one descriptor, in order.

        Raises:
            AnalyticError: no parts, or parts of different descriptors.
        """
        if not parts:
            raise AnalyticError("there is no description to put together")
        for part in parts:
            check_alike(parts[0], part)
        return Description(*joined([(part.position, part.orientation) for part in parts]), parts[0].identity)

    def units(self, centred: bool) -> NDArray[np.float64]:
        """Return the position parts as unit vectors, centred or not, kept so that a map is normalized once."""
        kept, name = vars(self), f"units, centred {centred}"
        if name not in kept:
            kept[name] = unit_vectors(self.position, centred)
        return kept[name]

    @cached_property
    def squares(self) -> NDArray[np.float64]:
        """Squared lengths of the orientation parts (B,)."""
        if self.orientation is None:
            raise AnalyticError("this description has no orientation part")
        flat = self.orientation.reshape(len(self), prod(self.orientation.shape[1:]))
        return np.einsum("bf,bf->b", flat, flat, dtype=np.float64)

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        """Fourier transform of the orientation part, kept so that a map is transformed once for all queries."""
        if self.orientation is None:
            raise AnalyticError("this description has no orientation part")
        return circular.spectrum(self.orientation)


@dataclass(frozen=True)
class Alignment:
    """How queries stand to references.

    Attributes:
        heading: (n, m) how far the robot of the query has turned left since the reference, rad in (-pi, pi].
        distance: (n, m) between the orientation parts after turning them alike.
    """

    heading: NDArray[np.float64]
    distance: NDArray[np.float64]


@dataclass(frozen=True)
class Match:
    """The nearest frame of a map for each query.

    Attributes:
        index: (n,) row of the map.
        distance: (n,) to it.
        heading: (n,) how far the robot has turned left since that frame, rad in (-pi, pi].
    """

    index: NDArray[np.int64]
    distance: NDArray[np.float64]
    heading: NDArray[np.float64]


class Descriptor(ABC):
    """A map from panoramas to vectors.

    Attributes:
        name: what configurations and files call it.
        default_distance: the distance between position descriptors that it is meant for.
        aligned: whether position parts are compared only after turning them alike, so that only `pairwise` can.
    """

    name: ClassVar[str]
    default_distance: ClassVar[str] = "euclidean"
    aligned: ClassVar[bool] = False

    @property
    def tells_heading(self) -> bool:
        """Whether `relative_heading` works on descriptions that have an orientation part."""
        return True

    @property
    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """Name and parameters as plain values: two descriptions may be compared if these agree."""

    @abstractmethod
    def describe(self, batch: ArrayLike) -> Description:
        """Describe a batch (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1]."""

    def pairwise(
        self, queries: Description, references: Description, distance: str | None = None
    ) -> NDArray[np.float64]:
        """Return the distances (n, m) between position descriptors, by the default distance or a named one."""
        self.check(queries, references)
        name = distance or self.default_distance
        measure = distance_named(name)
        if name not in ("cosine", "correlation"):
            return measure(queries.position, references.position)
        centred = name == "correlation"
        return between_units(queries.units(centred), references.units(centred))

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading and the aligned distance of every query to every reference (n, m).

        The turn is the one with the largest circular correlation of the orientation parts, which is the one of the
        smallest Euclidean distance between them, since turning leaves their lengths.

        Raises:
            AnalyticError: descriptions that cannot be compared, or that have no orientation part.
        """
        self.check(queries, references)
        steps = self._steps(queries, references)
        best = np.zeros((len(queries), len(references)), dtype=np.int64)
        peak = np.zeros(best.shape)
        for part in circular.blocks(*best.shape, steps):
            found = circular.correlate(queries.spectrum[:, part[0]], references.spectrum[:, part[1]], steps)
            best[part] = found.argmax(axis=2)
            peak[part] = np.take_along_axis(found, best[part][..., None], axis=2)[..., 0]
        squared = queries.squares[:, None] + references.squares[None, :] - 2 * peak
        return Alignment(circular.heading(best, steps), np.sqrt(np.maximum(squared, 0)))

    def relative_heading(self, query: Description, reference: Description) -> NDArray[np.float64]:
        """Return how far the robot of each query has turned left since its reference (B,), rad in (-pi, pi].

        Args:
            query: B descriptions.
            reference: as many, compared row by row; or a single one, compared with all.

        Raises:
            AnalyticError: as `align`, or different numbers of descriptions.
        """
        if len(reference) not in (1, len(query)):
            raise AnalyticError(
                f"headings are compared row by row: {len(query)} queries need as many references or one, "
                f"got {len(reference)}"
            )
        if len(reference) == 1:
            return self.align(query, reference).heading[:, 0]
        rows = [self.align(query.take([i]), reference.take([i])).heading[0, 0] for i in range(len(query))]
        return np.array(rows, dtype=np.float64)

    def localize(self, queries: Description, references: Description, distance: str | None = None) -> Match:
        """Return the nearest reference by the position descriptor, and the heading relative to it ([T] 3.3).

        Raises:
            AnalyticError: no references, or descriptions that cannot be compared.
        """
        if not len(references):
            raise AnalyticError("there is no reference to localize in: describe at least one map frame")
        apart = self.pairwise(queries, references, distance)
        index = apart.argmin(axis=1)
        heading = self.relative_heading(queries, references.take(index))
        return Match(index, apart[np.arange(len(queries)), index], heading)

    def check(self, queries: Description, references: Description) -> None:
        """Raise AnalyticError unless both can have been made by this descriptor, with these parameters."""
        for description in (queries, references):
            if description.identity is not None and description.identity != self.identity:
                raise AnalyticError(_other_parameters(self.identity, description.identity))
        check_alike(queries, references)

    def _steps(self, queries: Description, references: Description) -> int:
        for description in (queries, references):
            if description.orientation is None:
                raise AnalyticError(
                    f"a description for {self.name!r} has no orientation part, so that no turn can be found: describe "
                    "the images with a descriptor that has one, such as 'hog', and keep it"
                )
        assert queries.orientation is not None
        return int(queries.orientation.shape[1])


def joined(parts: Sequence[tuple[NDArray[Any], NDArray[Any] | None]]) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return position and orientation parts of all rows.

    Where the position part is the orientation part in one line, it stays so: they are kept in memory once.
    """
    if len(parts) == 1:
        return parts[0]
    orientations = [orientation for _, orientation in parts if orientation is not None]
    if not orientations:
        return np.concatenate([position for position, _ in parts]), None
    orientation = np.concatenate(orientations)
    if all(both is not None and np.shares_memory(position, both) for position, both in parts):
        return orientation.reshape(len(orientation), -1), orientation
    return np.concatenate([position for position, _ in parts]), orientation


def check_alike(first: Description, second: Description) -> None:
    """Raise AnalyticError unless two descriptions have one identity and one size.

    Equal parameters on images of different sizes give orientation parts that cannot be compared.
    """
    if first.identity is not None and second.identity is not None and first.identity != second.identity:
        raise AnalyticError(_other_parameters(first.identity, second.identity))
    shapes = [
        (d.position.shape[1:], None if d.orientation is None else d.orientation.shape[1:]) for d in (first, second)
    ]
    if shapes[0] != shapes[1]:
        raise AnalyticError(
            f"descriptions of different sizes cannot be compared: {_sizes(shapes[0])} against {_sizes(shapes[1])}; "
            "describe images of one size with one descriptor"
        )


def _sizes(shape: tuple[tuple[int, ...], tuple[int, ...] | None]) -> str:
    orientation = "no orientation part" if shape[1] is None else "orientation " + " x ".join(map(str, shape[1]))
    return f"position {' x '.join(map(str, shape[0]))} and {orientation}"


def _other_parameters(expected: dict[str, Any], found: dict[str, Any]) -> str:
    keys = [key for key in {**expected, **found} if expected.get(key) != found.get(key)]
    if "name" in keys:
        keys = ["name"]  # the parameters of two descriptors have nothing to do with each other
    said = ", ".join(f"{key}={found.get(key)} instead of {expected.get(key)}" for key in keys)
    return f"the descriptions were made with other parameters ({said}): describe all images with one descriptor"


def as_batch(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as float32 in [0, 1] of shape (B, C, H, W), C being 1 or 3.

    Three planes (3, H, W) are one colour image, not three grey ones.

    Raises:
        AnalyticError: another shape, another number of channels, or values that are not finite.
    """
    array = with_channels(images)
    if array.dtype == np.uint8:
        return array.astype(np.float32) / np.float32(255)
    if not np.isfinite(array).all():
        raise AnalyticError("an image holds values that are not finite: clean it before describing it")
    return array.astype(np.float32, copy=False)


def with_channels(images: ArrayLike) -> NDArray[Any]:
    """Return images as they are, with shape (B, C, H, W). Errors as `as_batch`, but values are not looked at."""
    try:
        array = np.asarray(images)
    except ValueError as error:
        raise AnalyticError("the images of a batch must have one size: resize them first") from error
    array = shaped(array)
    if array.dtype != np.uint8 and array.dtype.kind != "f":
        raise AnalyticError(f"images must be uint8 or floating point in [0, 1], got {array.dtype}")
    return array


def shaped(array: Any) -> Any:
    """Return an array or tensor with shape (B, C, H, W), C being 1 or 3.

    Raises:
        AnalyticError: another shape.
    """
    shape = tuple(array.shape)
    if array.ndim == 2:
        array = array[None, None]
    elif array.ndim == 3:
        if shape[2] == 3 and shape[0] != 3:
            raise AnalyticError(f"a colour image must have its channels first, (3, H, W), got {shape}: transpose it")
        array = array[None] if shape[0] == 3 else array[:, None]
    if array.ndim != 4 or array.shape[1] not in (1, 3) or 0 in shape:
        raise AnalyticError(f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), got {shape}")
    return array


def as_grey(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as float32 luma (ITU-R BT.601) in [0, 1] of shape (B, H, W). Errors as `as_batch`."""
    batch = as_batch(images)
    if batch.shape[1] == 1:
        return batch[:, 0]
    return np.einsum("bchw,c->bhw", batch, np.array([0.299, 0.587, 0.114], dtype=np.float32))
