from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foundation.columns import Rows


@dataclass(frozen=True)
class Inner(Rows):
    distance: np.ndarray


@dataclass(frozen=True)
class Outer(Rows):
    inner: Inner
    frame: np.ndarray
    heading: np.ndarray | None = None


def test_rows_are_taken_and_joined_in_every_field():
    parts = [Outer(Inner(np.arange(3.0) + 10 * i), np.arange(6).reshape(3, 2) + 10 * i) for i in (0, 1)]
    both = Outer.concatenate(parts)
    assert len(both) == 6
    assert both.heading is None
    for rows in ([5, 0], np.arange(6) % 5 == 0, slice(0, 6, 5)):
        some = both.take(rows)
        assert sorted(some.inner.distance.tolist()) == [0, 12]
        assert sorted(some.frame.tolist()) == [[0, 1], [14, 15]]
        assert some.heading is None
