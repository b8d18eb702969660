"""`thin`: keep a map within a budget, by forgetting one of two frames nearby that look alike, again and again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.calls import OF_FIELDS, takes
from foundation.settings import Count, Positive, Settings
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.maps.checked_arrays import check_placed
from siamloc.maps.history import Reason
from siamloc.maps.matching import learned_distances
from siamloc.maps.search import slices
from siamloc.maps.visual_map import VisualMap

_REACH = 1.5  # units: frames of one square metre are at most this far apart
_PAIRS_AT_ONCE = 1 << 20
_AT_ONCE = 64  # frames whose descriptors are compared with all others


@dataclass(frozen=True)
class Budget(Settings):
    """How large a map may be; without limits if all are None.

    Attributes:
        frames: number of frames.
        per_square_metre: number of frames in any square of a grid, one unit of the positions wide.
        megabytes: size of descriptors and orientation parts in float32, as in memory; a saved map may be smaller.
    """

    frames: Count | None = None
    per_square_metre: Count | None = None
    megabytes: Positive | None = None

    def most(self, known: VisualMap) -> int | None:
        """Return how many frames of a map `frames` and `megabytes` allow; None if any number.

        Raises:
            ConfigError: not even one.
        """
        if self.megabytes is None:
            return self.frames
        each = known.bytes / len(known)
        if (most := int(self.megabytes * 1e6 / each)) < 1:
            raise ConfigError(f"megabytes={self.megabytes:g} holds no frame of {each / 1e6:.3g} MB: give more")
        return most if self.frames is None else min(most, self.frames)


@dataclass(frozen=True, eq=False, repr=False)
class Thinned:
    """A map within its budget.

    Attributes:
        known: the map with the frames that are left.
        reason: (n,) of `Reason`: why each of the n frames of the map before was kept or forgotten.
    """

    known: VisualMap
    reason: NDArray[np.object_]

    def __repr__(self) -> str:
        return f"Thinned({self.summary()})"

    def summary(self) -> str:
        """Return one line about how many frames are left, and why the others were forgotten."""
        gone = Counter(reason.name.lower() for reason in self.reason.tolist() if reason != Reason.KEPT)
        forgotten = ", ".join(f"{count} {name}" for name, count in sorted(gone.items()))
        left = f"{len(self.known)} of {len(self.reason)} frames are left"
        return f"{left}; forgotten: {forgotten}" if gone else left


@takes(Budget)
def thin(known: VisualMap, *, settings: Budget = OF_FIELDS, **fields: Any) -> Thinned:
    """Forget frames of a map until it is within a budget; one frame of each building stays in any case.

    Of the two frames nearby whose descriptors are the most alike, the one that the last drives did not recognize is
    forgotten (the one contradicted more often), or else the one that the last drive found more changed, or confirmed
    less often, or the later one, and so on. Frames of one place under different lights, or before and after a change,
    are less alike than consecutive frames, and so stay longer. Frames of squares that hold too many
    are forgotten first.

    Args:
        known: the map.
        settings: all limits in one object, instead of one keyword each.

    Raises:
        ConfigError: a limit that is not positive, or too small for one frame.
        DataError: a frame without a position.

    Example:
        >>> frames = FrameTable(path=["a.png", "b.png", "c.png"], x=[0.1, 0.2, 0.3], y=[0, 0, 0])
        >>> found = thin(VisualMap([[0.0], [0.1], [5.0]], frames), per_square_metre=2)
        >>> [reason.name for reason in found.reason]
        ['KEPT', 'REDUNDANT', 'KEPT']
        >>> found
        Thinned(2 of 3 frames are left; forgotten: 1 redundant)
    """
    check_placed(known.frames, "thinning")
    reason = np.full(len(known), Reason.KEPT, dtype=object)
    most, per_cell = settings.most(known) or len(known), settings.per_square_metre or len(known)
    _, building = np.unique(known.frames.building, return_inverse=True)
    squares = np.column_stack([building, np.floor(known.frames.xy)])
    _, cell, in_cell = np.unique(squares, axis=0, return_inverse=True, return_counts=True)
    cell, left = cell.reshape(-1), len(known)

    confirmed, contradicted = known.history.confirmed, known.history.contradicted
    change = np.nan_to_num(known.history.change)  # frames that no drive has passed show the place as it is

    reach, widest = _REACH, float(np.ptp(known.frames.xy, axis=0).sum()) + _REACH
    while (crowded := (in_cell > per_cell).any()) or left > most:
        kept = np.flatnonzero(reason == Reason.KEPT)
        for pair in kept[_alike(known.take(kept), min(reach, widest))].tolist():
            if (reason[pair] == Reason.KEPT).all():
                row = max(pair, key=lambda row: (contradicted[row], change[row], -confirmed[row], row))
                if in_cell[cell[row]] > per_cell if crowded else left > most:
                    reason[row], left = Reason.UNRECOGNIZED if contradicted[row] else Reason.REDUNDANT, left - 1
                    in_cell[cell[row]] -= 1
        if reach > widest:
            break  # one frame in each building
        reach *= 1 if crowded else 2
    kept = reason == Reason.KEPT
    return Thinned(known if kept.all() else known.take(kept), reason)


def _alike(known: VisualMap, reach: float) -> NDArray[np.int64]:
    """Return the pairs of map frames (p, 2) at most `reach` apart, those with the most similar descriptors first."""
    pairs, apart = list[NDArray[np.int64]](), list[NDArray[np.float64]]()
    for rows, others, unlike in compared_nearby(known, reach, np.less):
        apart.append(unlike)
        pairs.append(np.column_stack([rows, others]))
    if not pairs:
        return np.empty((0, 2), dtype=np.int64)
    return np.concatenate(pairs)[np.argsort(np.concatenate(apart), kind="stable")]


def nearest(known: FrameTable, drive: FrameTable) -> NDArray[np.int64]:
    """Return the row of the nearest map frame that has a position, for each frame of a drive (n,)."""
    found = [int(np.nanargmin(np.square(known.xy - here).sum(axis=1))) for here in drive.xy]
    return np.array(found, dtype=np.int64)


def compared_nearby(
    known: VisualMap, reach: float, wanted: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
    """Yield pairs of map frames of one building at most `reach` apart, and how far apart their descriptors are.

    Args:
        known: a map whose frames have positions.
        reach: distance in the unit of the positions.
        wanted: returns which pairs to compare (q,), by the rows of both frames (q,).

    Yields:
        Rows of the first frames (p,), increasing, rows of the second ones (p,), and distances of descriptors (p,).
    """
    for rows, others, _ in near(known.frames, known.frames, reach, _AT_ONCE):
        some = wanted(rows, others)
        rows, others = rows[some], others[some]
        if len(rows):
            which, row = np.unique(rows, return_inverse=True)
            yield rows, others, learned_distances(known, known.turning(which))[row, others]


def near(
    first: FrameTable, second: FrameTable, reach: float, at_once: int | None = None
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
    """Yield the pairs of frames of one building at most `reach` apart, for blocks of frames of the first table.

    Args:
        first: n frames with positions.
        second: m frames with positions.
        reach: distance in the unit of the positions.
        at_once: frames of the first table; as many as memory allows if None.

    Yields:
        Rows of the first table (p,), increasing, rows of the second table (p,), and their distances (p,).
    """
    for part in slices(len(first), at_once or _PAIRS_AT_ONCE // max(len(second), 1)):
        apart = np.hypot(first.x[part, None] - second.x, first.y[part, None] - second.y)
        rows, others = np.nonzero((apart <= reach) & (first.building[part, None] == second.building))
        yield rows + part.start, others, apart[rows, others]
