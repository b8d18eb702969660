"""`Range`: what a parameter is drawn from; `spread` turns uniform numbers into values of several ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from numbers import Real
from typing import Any

import torch
from torch import Tensor

from augment.errors import AugmentError

_FARTHEST = 1e7  # larger than any column, row or angle that makes sense


@dataclass(frozen=True)
class Range:
    """The range of values from which a parameter is drawn uniformly.

    Attributes:
        low: smallest value.
        high: largest value.
        minimum: smallest `low` that is allowed.
        maximum: largest `high` that is allowed.
        neutral: the value at which the effect does nothing, for the parameters that set its strength.
        log: whether values are drawn uniformly in the logarithm.
        whole: whether values are drawn from the whole numbers low ... high.
    """

    low: float
    high: float
    minimum: float = -math.inf
    maximum: float = math.inf
    neutral: float | None = None
    log: bool = False
    whole: bool = False

    def narrowed(self, value: Any, what: str) -> Range:
        """Return this range with another low and high, from one number or a pair (low, high).

        Args:
            value: a number, or a pair (low, high).
            what: name of the parameter in the error.

        Raises:
            AugmentError: neither a number nor a pair, out of order, or beyond minimum and maximum.
        """
        pair = value if isinstance(value, Sequence) and not isinstance(value, str) else (value, value)
        fits = len(pair) == 2 and all(
            isinstance(end, Real) and not isinstance(end, bool) and math.isfinite(end) for end in pair
        )
        if not fits or (self.whole and any(end % 1 for end in pair)):
            kind = "whole number" if self.whole else "number"
            raise AugmentError(f"{what} must be a {kind} or a pair of them (low, high), got {value!r}")
        if not self.minimum <= pair[0] <= pair[1] <= self.maximum:
            raise AugmentError(f"{what} must lie in [{self.minimum:g}, {self.maximum:g}], lower first, got {value!r}")
        return replace(self, low=float(pair[0]), high=float(pair[1]))

    @property
    def ends(self) -> tuple[float, float]:
        """The smallest and the largest value that `Effect.apply` accepts."""
        return max(self.minimum, -_FARTHEST), min(self.maximum, _FARTHEST)

    def at(self, strength: float) -> float:
        """Return the value for a strength in [-1, 1]: 0 is neutral, 1 the far end, -1 the end on the other side."""
        if self.neutral is None:
            middle = math.sqrt(self.low * self.high) if self.log else (self.low + self.high) / 2
            return math.floor(middle) if self.whole else middle
        end = self.high if self.neutral <= self.low or (strength >= 0 and self.high > self.neutral) else self.low
        if self.log:
            return self.neutral * (end / self.neutral) ** abs(strength)
        value = self.neutral + abs(strength) * (end - self.neutral)
        return math.floor(value + 0.5) if self.whole else value


def spread(uniform: Tensor, ranges: Mapping[str, Range]) -> dict[str, Tensor]:
    """Turn uniform numbers in [0, 1) into values drawn from ranges.

    Args:
        uniform: (B, number of ranges), float32.
        ranges: ranges by the name of the parameter.

    Returns:
        Values by name (B,): float32, or int64 for ranges of whole numbers.
    """
    low, step, log, whole, has_log = _tables(tuple(ranges.values()))
    values = low + uniform * step
    if has_log:
        values = torch.where(log, values.exp(), values)
    # float32 may round low + u * step up to the excluded end, one above the largest whole number
    counts = torch.minimum(values.floor(), low + step - 1).long().unbind(1)
    columns = values.unbind(1)
    return {name: counts[i] if whole[i] else columns[i] for i, name in enumerate(ranges)}


@lru_cache(maxsize=256)
def _tables(ranges: tuple[Range, ...]) -> tuple[Tensor, Tensor, Tensor, tuple[bool, ...], bool]:
    low = torch.tensor([math.log(r.low) if r.log else float(r.low) for r in ranges], dtype=torch.float32)
    high = torch.tensor([math.log(r.high) if r.log else float(r.high) + r.whole for r in ranges], dtype=torch.float32)
    log = torch.tensor([r.log for r in ranges])
    return low, high - low, log, tuple(r.whole for r in ranges), bool(log.any())
