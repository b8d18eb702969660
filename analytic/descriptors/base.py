"""The interface shared by analytic and learned descriptors, and the base classes of all image descriptors."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.alignment import Turns, aligned_distances, best_turns, heading
from analytic.arrays import Floats
from analytic.description import Alignment, Description, Match, check_alike, joined, other_parameters
from analytic.distances import between_units
from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError
from analytic.filters import homomorphic
from analytic.images import luma, unit, with_channels
from foundation.files import plain
from foundation.settings import Rule, Settings
from foundation.threads import each

Cells = Annotated[int, Rule("a whole number from 1 to 16,384", lambda value: 1 <= value <= 16_384)]
"""A number of rows, columns, bins ...: at most as many as an image has pixels along a side."""
Several = Annotated[int, Rule("a whole number from 2 to 16,384", lambda value: 2 <= value <= 16_384)]
"""`Cells` of which at least two are needed."""
_NUMBERS = 1 << 24  # limit for the description of one image
_ROUNDING = 0.05  # share of its length by which a descriptor may differ from batch to batch, if a network computes it


class Descriptor(ABC):
    """A way of turning panoramas into vectors; subclass it to use your own in maps, tasks and the mapper.

    A subclass sets `name` and defines `identity` and `describe`, which describes each image of a batch by itself; maps
    check this for a few images. Descriptions with an orientation part then also give headings.

    Attributes:
        name: the name used in configurations and files.
        default_distance: the distance that position descriptors are meant to be compared with.
        aligned: whether position parts can be compared only after aligning them, that is, only with `pairwise`.

    Example:
        >>> class Columns(Descriptor):
        ...     name = "columns"
        ...     @property
        ...     def identity(self):
        ...         return {"name": self.name}
        ...     def describe(self, batch):
        ...         columns = np.asarray(batch).mean(axis=1)
        ...         return Description(np.sort(columns, axis=1), columns[..., None], self.identity)
        >>> panoramas = np.random.default_rng(0).random((3, 8, 36))
        >>> columns = Columns()
        >>> known, turned = columns.describe(panoramas), columns.describe(np.roll(panoramas, 9, axis=2))
        >>> found = columns.localize(turned, known)
        >>> found.index, np.degrees(found.heading)
        (array([0, 1, 2]), array([90., 90., 90.]))
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
        """Name and parameters as plain values; two descriptions can be compared if their identities are equal."""

    @abstractmethod
    def describe(self, batch: ArrayLike) -> Description:
        """Describe a batch (B, H, W), (B, 3, H, W) or one image; uint8, or floating point in [0, 1].

        The shape (3, H, W) is one colour image; three grey ones are (3, 1, H, W).
        """

    def pairwise(self, queries: Description, references: Description, distance: str | None = None) -> Floats:
        """Return the distances (n, m) between position descriptors, with the default distance or a named one."""
        if (queries.orientation is None) != (references.orientation is None):  # which does not matter here
            queries, references = (Description(one.position, None, one.identity) for one in (queries, references))
        self.check(queries, references)
        name = distance or self.default_distance
        measure = distance_named(name)
        if name not in ("cosine", "correlation"):
            return measure(queries.position, references.position)
        centred = name == "correlation"
        return between_units(queries.units(centred), references.units(centred))

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading in rad and the aligned distance (n, m) of each query to each reference.

        The turn is the one with the largest circular correlation of the orientation parts, which is also the one
        with the smallest Euclidean distance between them, since turning does not change their lengths.

        Raises:
            AnalyticError: descriptions that cannot be compared, or that have no orientation part.
        """
        self.check(queries, references)
        steps = self._steps(queries)
        turns = self._best_turns(queries, references, steps)
        return Alignment(heading(turns.step, steps), aligned_distances("euclidean", queries, references, turns))

    def relative_heading(self, query: Description, reference: Description) -> Floats:
        """Return how far the robot of each query has turned left since its reference (B,), rad in (-pi, pi].

        Args:
            query: B descriptions.
            reference: B descriptions, compared row by row, or a single one, compared with all.

        Raises:
            AnalyticError: as `align`, or different numbers of descriptions.
        """
        if len(reference) not in (1, len(query)):
            raise AnalyticError(f"{len(query)} queries need as many references, or one, got {len(reference)}")
        if len(reference) == 1:
            return self.align(query, reference).heading[:, 0]
        rows = [self.align(query.take([i]), reference.take([i])).heading[0, 0] for i in range(len(query))]
        return np.array(rows, dtype=np.float64)

    def localize(self, queries: Description, references: Description, distance: str | None = None) -> Match:
        """Return the nearest reference by the position descriptor, and the heading relative to it ([T] 3.3).

        Headings are in rad, counter-clockwise, in (-pi, pi]; they are NaN if the descriptor tells none, or
        the descriptions have no orientation part.

        Raises:
            AnalyticError: no references, or descriptions that cannot be compared.
        """
        if not len(references):
            raise AnalyticError("there is no reference to localize in: describe at least one map frame")
        apart = self.pairwise(queries, references, distance)
        index = apart.argmin(axis=1)
        turned = np.full(len(queries), np.nan)
        if self.tells_heading and queries.orientation is not None:
            turned = self.relative_heading(queries, references.take(index))
        return Match(index, apart[np.arange(len(queries)), index], turned)

    def check(self, queries: Description, references: Description) -> None:
        """Raise AnalyticError unless both descriptions can come from this descriptor with these parameters."""
        for description in (queries, references):
            if description.identity is not None and plain(description.identity) != plain(self.identity):
                raise AnalyticError(other_parameters(self.identity, description.identity))
        check_alike(queries, references)

    def _best_turns(self, queries: Description, references: Description, steps: int) -> Turns:
        """Return the best turn of each pair; a subclass that searches differently overrides this."""
        return best_turns(queries.spectrum, references.spectrum, steps)

    def _steps(self, queries: Description) -> int:
        """Return the number of steps of a full turn in the orientation part."""
        return int(queries.turnable.shape[1])


def description_of(by: Descriptor, batch: ArrayLike) -> Description:
    """Describe images with a descriptor, which may be the user's own, and check what it returns.

    Raises:
        AnalyticError: anything but a description of the images by this descriptor.
    """
    made = by.describe(batch)
    if not isinstance(made, Description):
        raise AnalyticError(f"`describe` of {by.name} must return an analytic.Description, got {type(made).__name__}")
    size = np.shape(batch)
    count = 1 if len(size) < 3 or (len(size) == 3 and size[0] == 3) else size[0]
    for what, part, shape in (("position", made.position, "(B, D)"), ("orientation", made.orientation, "(B, K, F)")):
        wrong = not isinstance(part, np.ndarray) or part.ndim != shape.count(",") + 1 or len(part) != count
        if wrong and not (part is None and what == "orientation"):
            raise AnalyticError(
                f"`describe` of {by.name} must return an array {shape} as {what}, one row for each of {count} images, "
                f"got {part.shape if isinstance(part, np.ndarray) else type(part).__name__}"
            )
    if made.identity is not None and plain(made.identity) != plain(by.identity):
        raise AnalyticError(f"`describe` of {by.name} returns the identity {made.identity} instead of {by.identity}")
    return made


def check_own(by: Descriptor, images: NDArray[np.uint8]) -> None:
    """Check that a descriptor of the user's own gives an image the same position part again, and among other images.

    Args:
        by: the descriptor.
        images: (B, 3, H, W); the first is described alone.

    Raises:
        AnalyticError: an identity that is no dictionary, or position parts that differ by more than rounding.
    """
    if not isinstance(by.identity, Mapping):
        raise AnalyticError(
            f"`identity` of {by.name} must be a dictionary, such as {{'name': {by.name!r}}}, got {by.identity!r}"
        )
    among, alone, again = (description_of(by, batch).position[0] for batch in (images, images[:1], images[:1]))
    if alone.dtype.kind not in "buifc":
        return  # a map refuses it
    among, alone, again = (part.astype(np.complex128) for part in (among, alone, again))
    for other, when in ((again, "it is described again"), (among, "other images are in its batch")):
        if alone.shape != other.shape or np.linalg.norm(alone - other) > _ROUNDING * np.linalg.norm(alone) + 1e-6:
            raise AnalyticError(
                f"`describe` of {by.name} gives an image another descriptor when {when}: compute each row from its "
                "image alone, without chance and without statistics along axis 0, the images of the batch"
            )


@dataclass(frozen=True, kw_only=True)
class ImageDescriptor(Descriptor, Settings):
    """A descriptor computed from pixels. Subclasses are frozen dataclasses whose fields are the parameters.

    Args:
        circular: whether columns are azimuth and wrap around; those of an ordinary camera do not, and give no heading.
        homomorphic: whether images go through `analytic.filters.homomorphic` first ([C] 2.4).

    Example:
        >>> import analytic
        >>> hog = analytic.descriptor("hog", rows=16, bins=16)
        >>> isinstance(hog, ImageDescriptor), hog.sizes(128, 512), round(360 * hog.resolution(512) / (2 * np.pi), 2)
        (True, ((256,), (256, 16)), 1.41)
    """

    ERROR = AnalyticError
    colour: ClassVar[bool] = False  # whether the descriptor uses colours, not only luma
    oriented: ClassVar[bool] = True  # whether descriptions have an orientation part
    divides: ClassVar[tuple[tuple[str, str], ...]] = ()  # parameters that divide the "height" or "width" of an image

    circular: bool = True
    homomorphic: bool = False

    @property
    def identity(self) -> dict[str, Any]:
        """Name and parameters."""
        return {"name": self.name, **self.plain()}

    @property
    def tells_heading(self) -> bool:
        """Whether there is an orientation part and columns wrap around; otherwise there is no heading."""
        return self.oriented and self.circular

    def resolution(self, width: int) -> float:
        """Return the smallest turn visible in the orientation part of images with that many columns, rad.

        It is the angle of one step of the orientation part; infinite for a descriptor that is not `oriented`.
        """
        return 2 * math.pi / self.sizes(1, width)[1][0] if self.oriented else math.inf

    @abstractmethod
    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the shapes of the position and orientation parts of one image, written as in [T] table 3.2.

        The orientation part of a descriptor that is not `oriented` has shape (0,).
        """

    def describe(self, batch: ArrayLike) -> Description:
        """Describe grey or colour images; colours are converted to BT.601 luma unless the descriptor uses them.

        Args:
            batch: (B, H, W), (B, 3, H, W) or one image (H, W), (3, H, W); uint8, or floating point in [0, 1]. Three
                grey images are (3, 1, H, W).

        Raises:
            AnalyticError: a wrong shape or type, images of different sizes, values that are not finite or out of
                range, or a size that the parameters do not fit.
        """
        images = with_channels(batch)
        height, width = images.shape[2:]
        if width < 2:
            raise AnalyticError(f"a panorama needs at least 2 columns, got {height} x {width} pixels")
        self._check_size(height, width)
        numbers = sum(math.prod(shape) for shape in self.sizes(height, width))
        if numbers > _NUMBERS:
            raise AnalyticError(f"{self.name} would give {numbers:,} numbers, more than {_NUMBERS:,}: ask for fewer")
        parts = each(self._parts, np.split(images, len(images)), cv2.getNumThreads())
        return Description(*joined(parts), self.identity)

    def _parts(self, image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """Return the position part (1, D) and the orientation part (1, K, F) of one image (1, C, H, W)."""
        seen = unit(image)
        seen = seen if self.colour else luma(seen)
        seen = homomorphic(seen, circular=self.circular) if self.homomorphic else seen
        position, orientation = self._describe(seen[0] if self.colour else seen[0, 0])
        return position[None], None if orientation is None else np.ascontiguousarray(orientation)[None]

    def _steps(self, queries: Description) -> int:
        if not self.circular:
            raise AnalyticError(f"{self.name} with circular=False has no relative heading: columns are no full turn")
        return super()._steps(queries)

    @classmethod
    def _key(cls, name: str) -> str:
        return f"{cls.name}.{name}"

    def _check_size(self, height: int, width: int) -> None:
        """Raise AnalyticError, suggesting sizes that would fit, for images that the parameters do not fit."""
        for key, side in self.divides:
            pixels, value = height if side == "height" else width, getattr(self, key)
            if pixels % value:
                raise AnalyticError(
                    f"{self.name}'s {key}={value} does not divide the {side} of {pixels} pixels: use "
                    f"{key}={divisors_near(pixels, value)}, or resize the image"
                )
        if (window := getattr(self, "window", 0)) > width:
            raise AnalyticError(f"{self.name}'s window={window} is wider than {width} columns: use at most {width}")

    @abstractmethod
    def _describe(self, image: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """Return the position part (D,) and the orientation part (K, F), or None, of one image, float32 in [0, 1].

        The image is luma (H, W), or (C, H, W) with one or three channels for a descriptor that uses colours.
        """


@dataclass(frozen=True, kw_only=True)
class AlignedDescriptor(ImageDescriptor):
    """A descriptor that compares orientation parts (B, K, F) at their best turn ([T] 3.3.4-3.3.5).

    The position part of a description holds the values of the orientation part in a different order; every distance
    of `analytic.DISTANCES` compares whole vectors, so the order does not matter.
    """

    aligned: ClassVar[bool] = True

    def pairwise(self, queries: Description, references: Description, distance: str | None = None) -> Floats:
        """Return the distances (n, m) at the best turn of each pair; with `circular=False`, without any turn.

        Args:
            queries: n descriptions.
            references: m descriptions; their spectrum is computed once and cached.
            distance: a name in `analytic.DISTANCES`; the default distance if None. With any distance, the turn is
                the one with the largest correlation.

        Raises:
            AnalyticError: descriptions that cannot be compared, an unknown distance.
        """
        if not self.circular:
            return super().pairwise(queries, references, distance)
        self.check(queries, references)
        turns = self._best_turns(queries, references, self._steps(queries))
        return self._compared(queries, references, turns, distance or self.default_distance)

    def _compared(self, queries: Description, references: Description, turns: Turns, name: str) -> Floats:
        """Return the named distance (n, m) of each pair at its turn; override it to compare differently."""
        return aligned_distances(name, queries, references, turns)


def divisors_near(number: int, wanted: int) -> str:
    """Return the divisors of a number nearest to a wanted number, as text for an error message.

    Example:
        >>> divisors_near(128, 12)
        '8 or 16'
    """
    every = [d for d in range(1, number + 1) if number % d == 0]
    below = [d for d in every if d <= wanted][-1:]
    above = [d for d in every if d > wanted][:1]
    return " or ".join(map(str, below + above))
