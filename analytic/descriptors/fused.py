"""Late fusion: several descriptors as one, whose squared distances are a weighted sum of those of its parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.description import Alignment, Description
from analytic.descriptors.base import Descriptor, description_of
from analytic.distances import unit_vectors
from analytic.errors import AnalyticError

SIGN = "+"
"""Between the names of parts in one name, such as "pretrained+hsv+hog"."""
NUMBERS = {"weights": 0, "typical": 1e-30, "widths": 1}
"""The fields of `Fused` that hold a number for each part, and the smallest number that each allows."""


@dataclass(frozen=True, eq=False)
class Fused(Descriptor):
    """Several descriptors as one: their position parts one after the other, so that squared distances add.

    With the distance d_i of two images by part i, its typical distance t_i and its weight w_i, the squared Euclidean
    distance of the two images is t_1^2 times the sum of w_i (d_i / t_i)^2: as large as a distance by the first part.
    For this, position parts that are meant to be compared by correlation or by cosine are scaled to unit length first
    (d_i^2 is then twice the correlation or cosine distance); all others, also those meant for the Manhattan distance,
    are compared by the Euclidean one.

    The orientation part, and with it headings and the comparison of images, is that of the first part that compares
    images, or else of the first that finds headings. A part that compares images is put first.

    Args:
        parts: two descriptors or more, by name.
        weights: a weight for each part, not negative; they are divided by their sum. None if unknown.
        typical: a typical distance for each part, above 0. None if unknown.
        widths: the length of each part's position part, D_i. None if unknown.

    Attributes:
        complete: whether all these numbers are known. As long as they are not, `describe` leaves the parts as they are;
            `siamloc.maps.build` learns them.

    Raises:
        AnalyticError: fewer than two parts, a part that is no descriptor, is fused itself or is compared only after
            turning, or numbers that do not fit.

    Example:
        >>> import analytic
        >>> parts = {name: analytic.descriptor(name) for name in ("hog", "hsv")}
        >>> both = Fused(parts, weights={"hog": 1, "hsv": 3}, typical={"hog": 0.5, "hsv": 2})
        >>> both.describe(np.zeros((5, 3, 128, 512))).position.shape, both.weights
        ((5, 1856), {'hog': 0.25, 'hsv': 0.75})
    """

    name: ClassVar[str] = "fused"

    parts: Mapping[str, Descriptor]
    weights: Mapping[str, float] | None = None
    typical: Mapping[str, float] | None = None
    widths: Mapping[str, int] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.parts, Mapping) or not all(isinstance(one, Descriptor) for one in self.parts.values()):
            raise AnalyticError(f"the parts of a fused descriptor are descriptors by name, got {self.parts}")
        distinct(list(self.parts))
        for name, part in self.parts.items():
            if isinstance(part, Fused):
                raise AnalyticError(f"{name} is fused itself: name its parts, {', '.join(part.parts)}, instead of it")
            if part.aligned:
                raise AnalyticError(
                    f"{name} is compared after turning, so it cannot be part of a fused descriptor: leave it out"
                )
        if self.compares:
            first = sorted(self.parts.items(), key=lambda one: one[1] is not self.oriented_by)
            object.__setattr__(self, "parts", dict(first))
        for key, least in NUMBERS.items():
            if (given := getattr(self, key)) is not None:
                object.__setattr__(self, key, self._numbers(given, key, least))
        if self.weights is not None:
            total = sum(self.weights.values())
            object.__setattr__(self, "weights", {name: value / total for name, value in self.weights.items()})

    @property
    def complete(self) -> bool:
        """Whether all numbers are known."""
        return all(getattr(self, key) is not None for key in NUMBERS)

    @property
    def tells_heading(self) -> bool:
        """Whether a part finds headings."""
        return self.oriented_by is not None and self.oriented_by.tells_heading

    @property
    def identity(self) -> dict[str, Any]:
        """The identities of the parts by name, and the numbers that are known."""
        known = {key: dict(value) for key in NUMBERS if (value := getattr(self, key)) is not None}
        return {"name": self.name, "parts": {name: part.identity for name, part in self.parts.items()}, **known}

    @cached_property
    def oriented_by(self) -> Descriptor | None:
        """The part that gives the orientation part: the first that compares images, or that finds headings."""
        for what in ("compares", "tells_heading"):
            for part in self.parts.values():
                if getattr(part, what, False):
                    return part
        return None

    @property
    def compares(self) -> bool:
        """Whether a part estimates where one image was taken relative to another, as some networks do."""
        return getattr(self.oriented_by, "compares", False)

    @property
    def compare(self) -> Any:
        """The function of that part which compares images."""
        return self.oriented_by.compare  # type: ignore[union-attr]

    @property
    def elevations(self) -> tuple[float, float] | None:
        """Elevations in degrees of the edges of the panoramas that a part was trained on; None if unknown."""
        return next((found for one in self.parts.values() if (found := getattr(one, "elevations", None))), None)

    def describe(self, batch: ArrayLike) -> Description:
        """Describe a batch by each part."""
        found = {name: description_of(part, batch) for name, part in self.parts.items()}
        turning = next((found[name].orientation for name, one in self.parts.items() if one is self.oriented_by), None)
        blocks = {name: _comparable(self.parts[name], one.position) for name, one in found.items()}
        return Description(self.joined(blocks), turning)

    def joined(self, blocks: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Join the position parts (B, D_i) of all parts into one (B, D), weighted if the descriptor is complete."""
        if self.weights is None or self.typical is None:
            return np.concatenate(list(blocks.values()), axis=1)
        first = next(iter(self.typical.values()))
        scales = {name: np.float32(np.sqrt(self.weights[name]) * first / self.typical[name]) for name in blocks}
        return np.concatenate([block * scales[name] for name, block in blocks.items()], axis=1)

    def measured(self, batch: ArrayLike) -> Fused:
        """Return this descriptor with the lengths of its parts' position parts, measured on images."""
        widths = {name: description_of(one, batch).position.shape[1] for name, one in self.parts.items()}
        return replace(self, widths=widths)

    def split(self, position: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        """Split position parts (B, D) into those of each part (B, D_i), the reverse of `joined`."""
        widths = list((self.widths or {}).values())
        return dict(zip(self.parts, np.split(position, np.cumsum(widths)[:-1], axis=1), strict=True))

    def align(self, queries: Description, references: Description) -> Alignment:
        """Align by the part that finds headings.

        Raises:
            AnalyticError: no part does.
        """
        part = self.oriented_by
        return super().align(queries, references) if part is None else part.align(queries, references)

    def _numbers(self, given: Any, what: str, least: float) -> dict[str, Any]:
        """Return a number for each part, in their order, after checking them."""
        numbers = {name: given.get(name) for name in self.parts} if isinstance(given, Mapping) else {}
        fits = all(isinstance(one, Real) and least <= float(one) < np.inf for one in numbers.values())
        if not fits or not any(numbers.values()) or set(given) != set(numbers):
            raise AnalyticError(
                f"{what} of a fused descriptor are a number for each of {', '.join(self.parts)}, not negative and not "
                f"all 0, got {given}"
            )
        return {name: np.asarray(one).item() for name, one in numbers.items()}


def distinct(names: Sequence[Any]) -> list[str]:
    """Return the names of the parts of a fused descriptor, after checking them.

    Raises:
        AnalyticError: fewer than two names, the same name twice, or no names at all.

    Example:
        >>> distinct(["hog", "hsv"])
        ['hog', 'hsv']
    """
    several = isinstance(names, list | tuple) and all(isinstance(name, str) and name for name in names)
    if not several or len(names) < 2:
        raise AnalyticError(f"a fused descriptor is a list of two descriptors or more, such as [hog,hsv], got {names}")
    for name in names:
        if names.count(name) > 1:
            raise AnalyticError(f"{name} is twice among the parts {list(names)}: name it once, and give it more weight")
    return list(names)


def _comparable(part: Descriptor, position: NDArray[Any]) -> NDArray[np.float32]:
    """Scale position parts so that their Euclidean distances rank images as the part's default distance does."""
    if part.default_distance in ("cosine", "correlation"):
        position = unit_vectors(position, centred=part.default_distance == "correlation")
    return position.astype(np.float32, copy=False)
