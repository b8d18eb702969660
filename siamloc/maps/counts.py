"""`Counts`: how often the drives that updated a map recognized its frames."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from foundation.columns import Rows


@dataclass(frozen=True, eq=False)
class Counts(Rows):
    """Numbers of drives for each of the n frames of a map, as `siamloc.maps.update` counts them; read-only.

    Attributes:
        confirmed: (n,) drives that recognized the frame.
        contradicted: (n,) drives that passed the frame and did not recognize it, since the last that did.

    Raises:
        ValueError: not two rows of as many whole numbers, 0 or more.
    """

    confirmed: NDArray[np.int64]
    contradicted: NDArray[np.int64]

    def __post_init__(self) -> None:
        for one in fields(self):
            counts = np.array(getattr(self, one.name))
            if counts.dtype.kind not in "iu" or counts.shape != (len(self),) or (counts < 0).any():
                raise ValueError(f"{one.name} must be {len(self)} whole numbers, 0 or more")
            counts = counts.astype(np.int64)
            counts.flags.writeable = False
            object.__setattr__(self, one.name, counts)

    @classmethod
    def none(cls, n: int) -> Counts:
        """Return the counts of n frames that no drive has passed."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
