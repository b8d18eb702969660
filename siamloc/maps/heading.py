"""Headings in a network's map, from the orientation parts of the network or of an additional analytic descriptor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import DESCRIPTORS, Description, Descriptor, ImageDescriptor, descriptor
from analytic.descriptors.between_columns import BetweenColumns
from foundation.files import plain
from siamloc.errors import ConfigError, DataError
from siamloc.maps.packing import all_finite, packed

HEADINGS: dict[str, dict[str, Any]] = {
    "hog": {"rows": 1},
    "fs": {"rows": 1},
    "gist": {"blocks": 1, "orientations": 16},
    "radon_fourier": {},
}
"""Descriptors that estimate headings in place of a network's, and their parameters: the position part is not used, so
that one band, which divides every height, is enough for it."""


@dataclass(frozen=True, eq=False)
class HeadingPart:
    """Orientation parts of a map's frames, from a network or an additional analytic descriptor, that give headings.

    Values are in half precision, those of each frame scaled by a power of two that brings the largest one to
    2^13 ... 2^14: a heading is the turn with the largest correlation, and no scale changes that.

    Attributes:
        identity: name and parameters of the analytic descriptor, as plain values; {"name": "network"} if the parts
            come from the network that describes the map.
        values: (n, K, F) float16, or (n, K, F, 2) for complex ones; read-only.

    Raises:
        DataError: another shape or type, or values that are not finite.
    """

    identity: dict[str, Any]
    values: NDArray[np.float16]

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        values = values.copy() if values.flags.writeable else values
        if values.dtype != np.float16 or 0 in values.shape or not (values.ndim == 3 or values.shape[3:] == (2,)):
            raise DataError(
                f"a map's heading part must be float16 of shape (n, K, F) or (n, K, F, 2), got {values.dtype} "
                f"{values.shape}"
            )
        if not all_finite(values):
            raise DataError("a map's heading part holds values that are not finite: look at the images")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "identity", plain(dict(self.identity)))

    @classmethod
    def of(cls, descriptor: Descriptor, orientation: NDArray[Any]) -> HeadingPart:
        """Create the heading part from the orientation parts (n, K, F) of a descriptor.

        Raises:
            DataError: values that are not finite.
        """
        if not all_finite(orientation):
            raise DataError(f"the orientation parts of {descriptor.name} hold values that are not finite")
        return cls(descriptor.identity, packed("values", orientation, "float16")["values"])

    def __len__(self) -> int:
        return len(self.values)

    @property
    def own(self) -> bool:
        """Whether the orientation parts come from the map's own descriptor, in one pass with the position parts."""
        return self.identity.get("name") == NetworkHeading.name

    @property
    def orientation(self) -> NDArray[Any]:
        """The orientation parts (n, K, F) up to their scale, float32 or complex64."""
        full = self.values.astype(np.float32)
        return full if full.ndim == 3 else full.view(np.complex64)[..., 0]

    def take(self, rows: Any) -> HeadingPart:
        """Return some rows, given by index or by a mask."""
        return HeadingPart(self.identity, self.values[rows])

    @cached_property
    def descriptor(self) -> Descriptor:
        """The descriptor that compares the parts; an analytic one runs without torch.

        Raises:
            AnalyticError: a descriptor or a parameter that this version does not know.
        """
        return NetworkHeading() if self.own else descriptor_of(self.identity)


def is_analytic(identity: Mapping[str, Any]) -> bool:
    """Whether an identity is that of an analytic descriptor, which can be created from it."""
    return identity.get("name") in list(DESCRIPTORS)  # a name from a file may be anything, also a list


def without_images(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the identity of the descriptor alone, without the entry on how images became panoramas."""
    return {key: value for key, value in identity.items() if key != "images"}


def descriptor_of(identity: Mapping[str, Any]) -> ImageDescriptor:
    """Return the analytic descriptor that an identity, its name and parameters, stands for.

    Raises:
        AnalyticError: a descriptor or a parameter that this version does not know.
    """
    return descriptor(**{"name": "", **without_images(identity)})


class NetworkHeading(BetweenColumns):
    """Compare orientation parts that a network computed, without the network and without torch.

    Example:
        >>> seen = np.random.default_rng(0).random((1, 16, 8))
        >>> known, turned = (Description(np.zeros((1, 1)), np.roll(seen, columns, axis=1)) for columns in (0, 4))
        >>> np.degrees(NetworkHeading().relative_heading(turned, known))
        array([90.])
    """

    name: ClassVar[str] = "network"

    @property
    def identity(self) -> dict[str, Any]:
        """Name and version of the parts' format; the network itself is named in the identity of the map."""
        return {"name": self.name, "version": 1}

    def describe(self, batch: ArrayLike) -> Description:
        """Always raise an error: only the network describes images.

        Raises:
            ConfigError: always.
        """
        raise ConfigError("orientation parts by a network come from the network: describe images with known.describe")


def described(by: Descriptor, heading: Descriptor | None, batch: ArrayLike) -> Description:
    """Describe images with one descriptor, and with the orientation parts of a second one if there is one."""
    found = by.describe(batch)
    return found if heading is None else Description(found.position, heading.describe(batch).orientation)
