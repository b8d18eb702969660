"""`Columns`: base of results that hold one row for each query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

Kind = TypeVar("Kind", bound="Columns")


class Columns:
    """Base of frozen dataclasses whose fields have n rows each: arrays, other `Columns`, or None.

    Example:
        >>> from siamloc.maps import Retrieval
        >>> found = Retrieval(np.array([[3], [1]]), np.array([[0.5], [0.2]]))
        >>> len(found), found.take([1]).indices, Retrieval.concatenate([found, found]).indices[:, 0]
        (2, array([[1]]), array([3, 1, 3, 1]))
    """

    def __len__(self) -> int:
        return len(self._columns()[0])

    def take(self: Kind, rows: Any) -> Kind:
        """Return some rows, given by index or by a mask."""
        return type(self)(*(_rows(column, rows) for column in self._columns()))

    @classmethod
    def concatenate(cls: type[Kind], parts: Sequence[Kind]) -> Kind:
        """Join the rows of several results, such as those of consecutive batches of queries."""
        return cls(*(_joined(columns) for columns in zip(*(part._columns() for part in parts), strict=True)))

    def _columns(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]


def _rows(column: Any, rows: Any) -> Any:
    if column is None:
        return None
    return column.take(rows) if isinstance(column, Columns) else column[rows]


def _joined(columns: Sequence[Any]) -> Any:
    first = columns[0]
    if first is None:
        return None
    return type(first).concatenate(columns) if isinstance(first, Columns) else np.concatenate(columns)
