"""Which evaluations may be compared: by their protocols, their queries and the frames of their maps."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.comparable import doubts
from siamloc.data.frames import FrameTable
from tests.siamloc.evaluation import scenes

QUERIES, KNOWN = scenes.frames(2, 30), scenes.frames(1, 20)
MOVED = KNOWN.with_columns(x=KNOWN.x + np.where(np.arange(20) < 5, 0.5, 0))


def localized(queries: FrameTable, known: FrameTable, root: str = "") -> tuple[dict, dict]:
    """Return what is compared of an evaluation whose files lie in the folder `root`."""
    queries_, known_ = (
        {"path": np.array([f"{root}{path}" for path in table.path]), "x": table.x, "y": table.y}
        for table in (queries, known)
    )
    return {}, {"queries": queries_, "map": known_, "rooms": {"path": queries_["path"]}}


def rooms_alone(queries: FrameTable, map_every: int | None = None) -> tuple[dict, dict]:
    return {"config": {"protocol": {"map": {"every": map_every}}}}, {"rooms": {"path": queries.path}}


@pytest.mark.parametrize(
    ("one", "other", "says"),
    [
        (localized(QUERIES, KNOWN, "data/"), localized(QUERIES.take(np.arange(30)[::-1]), KNOWN, "/mnt/data/"), None),
        (localized(QUERIES, KNOWN), localized(QUERIES, MOVED), "map frames (20 and 20, 15 of them in common)"),
        (rooms_alone(QUERIES), rooms_alone(QUERIES), None),
        (rooms_alone(QUERIES), localized(QUERIES, KNOWN), None),
        (rooms_alone(QUERIES), rooms_alone(QUERIES, map_every=2), "map frames (protocol.map)"),
        (rooms_alone(QUERIES), rooms_alone(KNOWN), "queries (20 and 30, 0 of them in common)"),
    ],
    ids=["another folder and order", "moved", "same rooms", "with and without a map", "another map", "other queries"],
)
def test_evaluations_differ_in_their_frames_not_in_where_these_lie(one, other, says) -> None:
    expected = [f"Take care when comparing b with a: they differ in their {says}."] if says else []
    assert doubts({"a": one, "b": other}) == expected


def test_evaluations_that_differ_alike_share_a_warning() -> None:
    every = {"a": localized(QUERIES, KNOWN), **dict.fromkeys("bc", localized(QUERIES, MOVED))}
    (warning,) = doubts(every)
    assert warning.startswith("Take care when comparing b, c with a: ")
    (warning,) = doubts({**every, **dict.fromkeys("defgh", localized(QUERIES, MOVED))})
    assert warning.startswith("Take care when comparing b, c, d and 4 more with a: ")
