"""Ranges that parameters are drawn from."""

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


@dataclass(frozen=True)
class Range:
    """What a parameter is drawn from, uniformly.

    Attributes:
        low: smallest value.
        high: largest value.
        minimum: no range may begin below.
        maximum: no range may end above.
        neutral: the value at which the effect does nothing, for the parameters that set its strength.
        log: drawn uniformly in the logarithm.
        whole: drawn from the whole numbers low ... high.
    """

    low: float
    high: float
    minimum: float = -math.inf
    maximum: float = math.inf
    neutral: float | None = None
    log: bool = False
    whole: bool = False

    def narrowed(self, value: Any, what: str) -> Range:
        """Return this range with another low and high: a number, or a pair (low, high).

        Args:
            value: what the user gave.
            what: name of the parameter in words, for the error.

        Raises:
            AugmentError: no number or pair, out of order, or beyond minimum and maximum.
        """
        pair = value if isinstance(value, Sequence) and not isinstance(value, str) else (value, value)
        if len(pair) != 2 or not all(isinstance(end, Real) and not isinstance(end, bool) for end in pair):
            raise AugmentError(f"{what} must be a number or a pair (low, high), got {value!r}")
        low, high = float(pair[0]), float(pair[1])
        if not (math.isfinite(low) and math.isfinite(high)):
            raise AugmentError(f"{what} must be finite, got {value!r}")
        if low > high:
            raise AugmentError(f"{what} is out of order: {low:g} must not exceed {high:g}")
        if low < self.minimum or high > self.maximum:
            raise AugmentError(f"{what} must lie in [{self.minimum:g}, {self.maximum:g}], got {value!r}")
        if self.whole and (low != int(low) or high != int(high)):
            raise AugmentError(f"{what} must be made of whole numbers, got {value!r}")
        return replace(self, low=low, high=high)

    def at(self, strength: float) -> float:
        """Return the value for a strength in [-1, 1]: 0 neutral, 1 the far end, -1 the end on the other side."""
        if self.neutral is None:
            middle = math.sqrt(self.low * self.high) if self.log else (self.low + self.high) / 2
            return math.floor(middle) if self.whole else middle
        end = self.high if self.neutral <= self.low or (strength >= 0 and self.high > self.neutral) else self.low
        if self.log:
            return self.neutral * (end / self.neutral) ** abs(strength)
        value = self.neutral + abs(strength) * (end - self.neutral)
        return math.floor(value + 0.5) if self.whole else value


def spread(uniform: Tensor, ranges: Mapping[str, Range]) -> dict[str, Tensor]:
    """Turn uniform numbers in [0, 1) into values of ranges.

    Args:
        uniform: (B, number of ranges), float32.
        ranges: by name.

    Returns:
        By name (B,): float32, or int64 for ranges of whole numbers.
    """
    if not ranges:
        return {}
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
    low = torch.tensor([math.log(r.low) if r.log else float(r.low) for r in ranges])
    high = torch.tensor([math.log(r.high) if r.log else float(r.high) + r.whole for r in ranges])
    log = torch.tensor([r.log for r in ranges])
    return low, high - low, log, tuple(r.whole for r in ranges), bool(log.any())
