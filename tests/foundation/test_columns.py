from __future__ import annotations

from dataclasses import MISSING, dataclass, fields

import numpy as np
import pytest

from analytic import Alignment, AnalyticError, Description, Match
from foundation.columns import Rows
from foundation.errors import DataError
from siamloc.data.frames import FrameTable
from siamloc.data.pairs import Pairs
from siamloc.evaluation.disturbed_tables import Answer
from siamloc.evaluation.session import Found
from siamloc.maps import NodeRanking, Retrieval, VisualMap

FRAMES = FrameTable(path=["0.png", "1.png", "2.png"])


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


@pytest.mark.parametrize(
    "table",
    [
        Inner(np.arange(3.0)),
        Description(np.eye(3), np.ones((3, 2, 2))),
        FRAMES,
        VisualMap(np.eye(3), FRAMES),
        Pairs(*np.zeros((4, 3))),
    ],
    ids=lambda one: type(one).__name__,
)
def test_every_table_takes_a_single_row_and_a_slice_and_refuses_rows_that_it_lacks(table):
    for rows, count in ((1, 1), (-1, 1), (slice(0, 2), 2), ([True, False, True], 2)):
        some = table.take(rows)
        assert (type(some), len(some)) == (type(table), count)
    for wrong in ([3], [-4], [True, False], [0.0], "1", [[0]], [[1], [1, 2]]):
        with pytest.raises(
            (DataError, AnalyticError), match=r"of 3 rows, some are taken by their numbers from 0, a mask"
        ):
            table.take(wrong)


@pytest.mark.parametrize("kind", [Description, Alignment, Match, Retrieval, NodeRanking, Pairs, Found, Answer])
def test_results_that_hold_arrays_can_be_looked_for_in_a_list(kind):
    one, other = (kind(*[np.zeros((2, 2))] * sum(field.default is MISSING for field in fields(kind))) for _ in "ab")
    assert [other, one].index(one) == 1
