"""`Rows`: the base of results that hold one row of several arrays for each query or frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

Own = TypeVar("Own", bound="Rows")


@dataclass(frozen=True)
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
        """Return some of the rows, selected by index, mask or slice."""

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
