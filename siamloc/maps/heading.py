"""Headings in a network's map, from the orientation parts of the network or of an additional analytic descriptor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import DESCRIPTORS, Description, Descriptor, Fused, descriptor
from analytic.descriptors.base import description_of
from analytic.descriptors.between_columns import BetweenColumns
from analytic.descriptors.fused import NUMBERS
from siamloc.data.mounting import Mounting
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


def halved(by: Descriptor, orientation: NDArray[Any]) -> NDArray[np.float16]:
    """Return the orientation parts (n, K, F) of a descriptor in half precision, complex ones as (n, K, F, 2).

    Each frame's parts are scaled by a power of two that brings the largest value to 2^13 ... 2^14: a heading is the
    turn with the largest correlation, and no scale changes that.

    Raises:
        DataError: values that are not finite.
    """
    if not all_finite(orientation):
        raise DataError(f"the orientation parts of {by.name} hold values that are not finite")
    return packed("values", orientation, "float16")["values"]


def is_analytic(identity: Mapping[str, Any]) -> bool:
    """Whether an identity belongs to an analytic descriptor, or several fused, which can be made from it alone."""
    if identity.get("name") == Fused.name:
        return all(map(is_analytic, parts_of(identity).values()))
    return identity.get("name") in list(DESCRIPTORS)  # a name from a file may be anything, also a list


def parts_of(identity: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the identities of the parts of a fused descriptor by name; none if they are not whole."""
    parts = identity.get("parts")
    whole = isinstance(parts, Mapping) and all(isinstance(one, Mapping) for one in parts.values())
    return dict(parts) if whole else {}  # type: ignore[arg-type]


def descriptor_of(identity: Mapping[str, Any], network: Descriptor | None = None) -> Descriptor:
    """Return the descriptor with this identity, that is, with these name and parameters; none of them needs torch.

    Args:
        identity: the identity of an analytic descriptor, of a fused one, or of what compares a network's headings.
        network: the network among the parts of a fused descriptor; None if there is none.

    Raises:
        AnalyticError: a descriptor or a parameter that this version does not know.
    """
    alone = {key: value for key, value in identity.items() if key != "images"}  # how images became panoramas
    if alone.get("name") == NetworkHeading.name:
        return NetworkHeading(bool(alone.get("circular", True))) if network is None else network
    if alone.get("name") != Fused.name:
        return descriptor(**{"name": "", **alone})
    parts = {name: descriptor_of(one, network) for name, one in parts_of(alone).items()}
    return Fused(parts, *(alone.get(key) for key in NUMBERS))


class NetworkHeading(BetweenColumns):
    """Compare orientation parts that a network computed, without the network and without torch.

    Args:
        circular: whether the columns are a full turn. If not, the parts give no headings, and only the network's
            comparing part can use them.

    Example:
        >>> seen = np.random.default_rng(0).random((1, 16, 8))
        >>> known, turned = (Description(np.zeros((1, 1)), np.roll(seen, columns, axis=1)) for columns in (0, 4))
        >>> np.degrees(NetworkHeading().relative_heading(turned, known))
        array([90.])
    """

    name: ClassVar[str] = "network"

    def __init__(self, circular: bool = True) -> None:
        self.circular = circular

    @property
    def tells_heading(self) -> bool:
        """Whether the columns are a full turn."""
        return self.circular

    @property
    def identity(self) -> dict[str, Any]:
        """Name and version of the parts' format; the network itself is named in the identity of the map."""
        return {"name": self.name, "version": 1, **({} if self.circular else {"circular": False})}

    def describe(self, batch: ArrayLike) -> Description:
        """Always raise an error: only the network describes images.

        Raises:
            ConfigError: always.
        """
        raise ConfigError("orientation parts by a network come from the network: describe images with known.describe")


def described(
    by: Descriptor, heading: Descriptor | None, batch: ArrayLike, mounting: Mounting | None = None
) -> Description:
    """Describe images with one descriptor, with the orientation parts of a second descriptor if one is given.

    Args:
        by: gives the position parts, and the orientation parts without a second descriptor.
        heading: the second descriptor, None if there is none.
        batch: images (B, 3, H, W) as both descriptors take them.
        mounting: how the camera that took them is mounted, which is taken out first; straight if None.
    """
    if mounting is not None and mounting != Mounting():
        batch = mounting.straight(np.asarray(batch))
    found = description_of(by, batch)
    return found if heading is None else Description(found.position, heading.describe(batch).orientation)
