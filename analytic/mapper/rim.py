"""The frames of a node that may be the furthest from its centre, so that not all are looked at for each image.

Once all distances to the centre have been taken, the furthest frames form the rim, and the rest lie within a radius of
that centre. When the centre has moved by s since, none of the rest is further from it than the radius plus s. As long
as a frame of the rim is, the furthest of the rim is the furthest of all; otherwise a new rim is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

_KEPT = 32  # frames of a new rim
_MOST = 128  # after which a rim, which every new frame joins, is taken anew
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Rim:
    """Frames that may be the furthest.

    Attributes:
        anchor: (D,) the centre when the rim was taken.
        members: (k,) rows of these frames.
        radius: about the anchor, within which all other frames lie.
    """

    anchor: NDArray[np.float64]
    members: NDArray[np.int64]
    radius: float

    @staticmethod
    def of(rows: NDArray[np.float64], squares: NDArray[np.float64], centre: NDArray[np.float64]) -> Rim:
        """Return the rim of frames (n, D) whose squared lengths (n,) are known."""
        if len(rows) <= _KEPT:
            return Rim(centre, np.arange(len(rows)), -np.inf)
        apart = squares - 2 * (rows @ centre) + centre @ centre
        order = np.argpartition(apart, -_KEPT)
        return Rim(centre, np.sort(order[-_KEPT:]), float(np.sqrt(max(apart[order[:-_KEPT]].max(), 0.0))))

    def add(self, row: int) -> Rim:
        """Return the rim with another frame."""
        return replace(self, members=np.append(self.members, row))

    def furthest(self, rows: NDArray[np.float64], centre: NDArray[np.float64]) -> float:
        """Return the largest distance of its frames, of (n, D), to a centre (D,)."""
        # Row by row, so that the value does not depend on which others are in the rim.
        return float(np.sqrt(np.square(rows[self.members] - centre).sum(axis=1).max()))

    def holds(self, furthest: float, centre: NDArray[np.float64]) -> bool:
        """Return whether no frame outside the rim can be further from a centre (D,) than its furthest."""
        reach = (self.radius + float(np.linalg.norm(centre - self.anchor))) * (1 + _ROUNDING)
        return furthest >= reach and len(self.members) <= _MOST
