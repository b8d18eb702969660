"""`Rows`: the base of results that hold one row of several arrays for each query or frame, and how to select some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from foundation.errors import DataError
from foundation.settings import shortened

Own = TypeVar("Own", bound="Rows")


@dataclass(frozen=True, eq=False)
class Rows:
    """Base of a frozen dataclass whose fields have n rows: arrays, results with `take` and `concatenate`, or None.

    Example:
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True)
        ... class Sighting(Rows):
        ...     frame: np.ndarray
        ...     heading: np.ndarray | None = None
        >>> both = Sighting.concatenate([Sighting(np.array([3, 1])), Sighting(np.array([4]))])
        >>> len(both), both.take([0, 2])
        (3, Sighting(frame=array([3, 4]), heading=None))
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def take(self: Own, rows: Any) -> Own:
        """Return some of the rows; see `chosen_rows`."""
        rows = chosen_rows(rows, len(self))

        def taken(value: Any) -> Any:
            return value[rows] if isinstance(value, np.ndarray) else None if value is None else value.take(rows)

        return replace(self, **{one.name: taken(getattr(self, one.name)) for one in fields(self)})

    @classmethod
    def concatenate(cls: type[Own], parts: Sequence[Own]) -> Own:
        """Join the results of consecutive batches; a field that is None in the first part is None in the result."""

        def joined(values: list[Any]) -> Any:
            first = values[0]
            if first is None:
                return None
            return np.concatenate(values) if isinstance(first, np.ndarray) else type(first).concatenate(values)

        return cls(**{one.name: joined([getattr(part, one.name) for part in parts]) for one in fields(cls)})


def chosen_rows(rows: Any, count: int, error: type[Exception] = DataError) -> slice | NDArray[Any]:
    """Return what selects rows of an array (count, ...), after checking it.

    Args:
        rows: row numbers, of which negative ones count from the end, a single number, a mask (count,) or a slice.
        count: number of rows.
        error: the exception to raise.

    Raises:
        DataError: anything else, or rows that do not exist; or another `error`.

    Example:
        >>> np.arange(0, 50, 10)[chosen_rows(-1, 5)]
        array([40])
    """
    if isinstance(rows, slice):
        return rows
    try:
        key = np.atleast_1d(rows)
    except ValueError:  # lists of different lengths
        key = np.array(None)
    key = key if key.size else key.astype(np.int64)
    if key.dtype == bool:
        fits = key.shape == (count,)
    else:
        fits = key.ndim == 1 and key.dtype.kind in "iu" and bool(((-count <= key) & (key < count)).all())
    if not fits:
        raise error(
            f"of {count} rows, some are taken by their numbers from 0, a mask ({count},) or a slice, got "
            f"{shortened(repr(rows))}"
        )
    return key


def spread_rows(count: int, most: int) -> NDArray[np.int64]:
    """Return up to `most` of `count` rows, evenly spread from the first to the last.

    Example:
        >>> spread_rows(9, 3).tolist(), spread_rows(2, 3).tolist()
        ([0, 4, 8], [0, 1])
    """
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
