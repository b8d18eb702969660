"""An array that grows by rows, as a value: a longer one shares the room of the shorter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_GROWTH = 1.25  # of the room; memory counts more than the copies


@dataclass(frozen=True)
class Rows:
    """The first `count` rows of a buffer (capacity, D)."""

    buffer: NDArray[np.float64]
    count: int

    @staticmethod
    def of(array: NDArray[np.float64]) -> Rows:
        """Return the rows of an array (n, D)."""
        return Rows(np.ascontiguousarray(array, dtype=np.float64), len(array))

    @property
    def array(self) -> NDArray[np.float64]:
        """Return them as an array (n, D)."""
        return self.buffer[: self.count]

    def add(self, row: NDArray[np.float64]) -> Rows:
        """Return them with one more (D,); of two made from these rows, only the later may be used."""
        buffer = self.buffer
        if self.count == len(buffer):
            buffer = np.empty((max(16, int(self.count * _GROWTH)), buffer.shape[1]))
            buffer[: self.count] = self.array
        buffer[self.count] = row
        return Rows(buffer, self.count + 1)
