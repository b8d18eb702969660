"""Compare descriptors that a map holds without what computed them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from analytic import Description, Descriptor
from siamloc.errors import ConfigError


class Vectors(Descriptor):
    """Compare vectors that were computed elsewhere, by a distance between them.

    Args:
        identity: the identity of the map; without a name, the vectors are called "vectors".
        distance: a name in `analytic.DISTANCES`.

    Example:
        >>> import numpy as np
        >>> two = Description(np.array([[0.0, 0.0], [3.0, 4.0]]))
        >>> Vectors({"name": "mine"}, "euclidean").pairwise(two, two)[0]
        array([0., 5.])
    """

    name: ClassVar[str] = "vectors"

    def __init__(self, identity: Mapping[str, Any], distance: str) -> None:
        self._identity = {"name": self.name, **{key: value for key, value in identity.items() if key != "images"}}
        self.name, self.default_distance = self._identity["name"], distance  # type: ignore[misc]

    @property
    def identity(self) -> dict[str, Any]:
        """The identity of what computed the vectors."""
        return self._identity

    def describe(self, batch: ArrayLike) -> Description:
        """Always raise an error: only what computed the vectors describes images.

        Raises:
            ConfigError: always.
        """
        raise ConfigError(f"{self.name} cannot describe images here: give the descriptor with known.with_descriptor")
