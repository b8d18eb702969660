"""Headings from orientation parts with few columns, such as a network's: the turn may lie between two columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.alignment import best_turns, euclidean, heading
from analytic.description import Alignment, Description
from analytic.descriptors.base import Descriptor
from analytic.errors import AnalyticError

_TURNS = 1024  # at least this many are compared


class BetweenColumns(Descriptor):
    """Base of descriptors whose orientation part (B, K, F) changes smoothly from column to column.

    The circular correlation of two orientation parts is known between the columns as well: the inverse transform of
    its K // 2 + 1 frequencies, padded with zeros, gives it at 1024 turns or slightly more, which include whole columns.
    The relative heading is the turn with the largest correlation, the aligned distance the Euclidean one at that turn.

    Example:
        >>> class Columns(BetweenColumns):
        ...     name = "columns"
        ...     @property
        ...     def identity(self):
        ...         return {"name": self.name}
        ...     def describe(self, batch):
        ...         return Description(np.asarray(batch).mean(axis=1), np.asarray(batch), self.identity)
        >>> azimuth = np.arange(16) * (2 * np.pi / 16)
        >>> known, turned = (Columns().describe(np.cos(azimuth - turn)[None, :, None]) for turn in (0, 0.5))
        >>> Columns().relative_heading(turned, known).round(2)
        array([0.5])
    """

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading in rad and the aligned distance (n, m) of each query to each reference."""
        self.check(queries, references)
        columns = self._steps(queries)
        turns = _turns(columns)
        found = best_turns(_filled_up(queries.spectrum, columns, turns), references.spectrum, turns)
        product = found.peak * (turns / columns)  # the inverse transform divides by the number of turns
        distance, _ = euclidean(product, queries.squares[:, None] + references.squares)
        return Alignment(heading(found.step, turns), distance)


def _filled_up(spectrum: NDArray[Any], columns: int, turns: int) -> NDArray[Any]:
    """Prepare frequencies (K // 2 + 1, ...) of real signals for padding with zeros.

    The highest frequency of an even number of columns stands for itself and its negative. When higher ones follow, the
    negative gets its own place, and each of the two gets half.
    """
    if columns % 2 or turns == columns:
        return spectrum
    return np.concatenate([spectrum[:-1], spectrum[-1:] / 2])


def _turns(columns: int) -> int:
    """Return how many turns are compared: equally many for each column, at least 1024 in total."""
    if columns < 3:
        raise AnalyticError(f"a turn is visible only in three columns or more, got {columns}: use wider panoramas")
    return columns * -(-_TURNS // columns)
