"""`thin`: keep a map within a budget, by forgetting the frames that the others replace best."""

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

# Frames among which the picture of a forgotten frame is located; once all are gone, those that stay are compared again.
_MOST_ALIKE = 64
_DIGITS = 6  # of how far pictures move, in the unit of the positions: sums of equal distances are equal
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

    A picture like that of a forgotten frame is then located at the most similar frame that stays. The frame whose
    loss moves such pictures the least goes first: one of two frames that stand close together and look alike, while
    frames without which a place would be taken for another stay, such as those of one place under different lights,
    or before and after a change. Of frames whose loss is equal, as of pictures taken in one place, the one contradicted
    more often goes, or else the one that the last drive found more changed, or confirmed less often, or the later one.
    Frames of squares that hold too many are forgotten first. Where the budget is a small part of the map, the pictures
    of frames forgotten early stop to count.

    Args:
        known: the map.
        settings: all limits in one object, instead of one keyword each.

    Raises:
        ConfigError: a limit that is not positive, or too small for one frame.
        DataError: a frame without a position.

    Example:
        >>> frames = FrameTable(path=["a.png", "b.png", "c.png"], x=[0.1, 0.2, 0.9], y=[0, 0, 0])
        >>> found = thin(VisualMap([[0.0], [0.1], [5.0]], frames), per_square_metre=2)
        >>> [reason.name for reason in found.reason]
        ['KEPT', 'REDUNDANT', 'KEPT']
        >>> found
        Thinned(2 of 3 frames are left; forgotten: 1 redundant)
    """
    check_placed(known.frames, "thinning")
    most, per_square = settings.most(known) or len(known), settings.per_square_metre or len(known)
    squares = np.column_stack([_numbered(known.frames.building), np.floor(known.frames.xy)])
    _, square, in_square = np.unique(squares, axis=0, return_inverse=True, return_counts=True)
    square, history = square.reshape(-1), known.history
    stays = np.ones(len(known), dtype=bool)
    # The order in which frames go whose loss is equal; frames that no drive has passed show the place as it is.
    change = np.nan_to_num(history.change)
    going = np.lexsort([-np.arange(len(known)), history.confirmed, -change, -history.contradicted])
    while (in_square > per_square).any() or stays.sum() > most:
        rows = going[stays[going]]
        witnesses = _Witnesses(known.take(rows))
        while (crowded := (in_square > per_square)[square[rows]] & stays[rows]).any() or stays.sum() > most:
            if (row := witnesses.cheapest(crowded if crowded.any() else stays[rows])) is None:
                break
            witnesses.forget(row)
            stays[rows[row]] = False
            in_square[square[rows[row]]] -= 1
        if stays.sum() == len(rows):
            break  # one frame in each building
    reason = np.full(len(known), Reason.KEPT, dtype=object)
    reason[~stays] = Reason.REDUNDANT
    reason[~stays & (history.contradicted > 0)] = Reason.UNRECOGNIZED
    return Thinned(known if stays.all() else known.take(stays), reason)


class _Witnesses:
    """Pictures like the frames of a map, and where they are located as frames of it are forgotten.

    Attributes:
        alike: (n, k + 2) the frames that look most like each picture, its own frame first; n where there are no more.
        off: (n, k + 2) how far these frames are from the picture's own; infinite where there are no more.
    """

    def __init__(self, known: VisualMap) -> None:
        n, building = len(known), _numbered(known.frames.building)
        k = min(n, _MOST_ALIKE)
        self.alike, self.off = np.full((n, k + 2), n), np.full((n, k + 2), np.inf)
        self._stays = np.ones(n + 1, dtype=bool)
        self._pictures, self._first = np.arange(n), np.zeros(n, dtype=np.int64)
        self._second = self._first + 1
        for part in slices(n, _AT_ONCE):
            own = np.arange(n)[part]
            unlike = np.where(building[own, None] == building, learned_distances(known, known.turning(own)), np.inf)
            unlike[np.arange(len(own)), own] = -np.inf
            order = np.sort(np.argpartition(unlike, k - 1, axis=1)[:, :k], axis=1)
            nearest_first = np.argsort(np.take_along_axis(unlike, order, axis=1), axis=1, kind="stable")
            order = np.take_along_axis(order, nearest_first, axis=1)
            same = building[order] == building[own, None]
            self.alike[part, :k] = np.where(same, order, n)
            apart = np.linalg.norm(known.frames.xy[order] - known.frames.xy[own, None], axis=2)
            self.off[part, :k] = np.where(same, apart, np.inf)

    def cheapest(self, some: NDArray[np.bool_]) -> int | None:
        """Return the first of some frames (n,) whose loss moves the pictures least; None if some would be nowhere."""
        at, after = self.off[self._pictures, self._first], self.off[self._pictures, self._second]
        located = self.alike[self._pictures, self._first]
        moved = np.bincount(located, after - at, len(located)).round(_DIGITS)
        moved[~some] = np.inf
        row = int(moved.argmin())
        return row if np.isfinite(moved[row]) else None

    def forget(self, row: int) -> None:
        """Forget a frame."""
        self._stays[row] = False
        self._first = self._next(self._first)
        self._second = self._next(np.maximum(self._second, self._first + 1))

    def _next(self, column: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the first columns from some on (n,) of frames that stay."""
        while (gone := ~self._stays[self.alike[self._pictures, column]]).any():
            column = column + gone
        return column


def _numbered(building: NDArray[np.str_]) -> NDArray[np.int64]:
    """Return the number of the building of each frame (n,)."""
    return np.unique(building, return_inverse=True)[1]


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
