"""The floor plan against slow, obvious geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.simulate.layout import Building, Item
from siamloc.simulate.plan import blocked_points, clearance, crossings, inside_item, obstacles, room_codes

numbers = st.floats(-3, 3, allow_nan=False).map(lambda value: round(value, 2))
points = st.tuples(numbers, numbers)


@settings(deadline=None, max_examples=60)
@given(a=points, b=points, p=points)
def test_clearance_is_the_smallest_distance_along_the_segment(a, b, p) -> None:
    along = np.linspace(np.array(a), np.array(b), 4001)
    slow = np.linalg.norm(along - p, axis=1).min()
    assert clearance(np.array([p]), np.array([[a, b]]))[0] == pytest.approx(slow, abs=2e-3)


@settings(deadline=None, max_examples=100)
@given(a=points, b=points, c=points, d=points)
def test_crossings_agree_with_solving_for_the_intersection(a, b, c, d) -> None:
    a, b, c, d = (np.array(v) for v in (a, b, c, d))
    matrix = np.column_stack([b - a, c - d])
    if abs(np.linalg.det(matrix)) < 1e-3:
        return
    s, t = np.linalg.solve(matrix, c - a)
    if min(abs(s), abs(s - 1), abs(t), abs(t - 1)) < 1e-6:
        return
    expected = 0 < s < 1 and 0 < t < 1
    assert bool(crossings(np.array([[a, b]]), np.array([[c, d]]))[0, 0]) == expected


@settings(deadline=None, max_examples=60)
@given(p=points, facing=st.floats(0, 360), width=st.floats(0.2, 2), depth=st.floats(0.2, 2))
def test_inside_item_agrees_with_its_corners(p, facing, width, depth) -> None:
    item = Item("desk", 0.3, -0.2, facing, (width, depth, 1.0), 0.0, "room")
    corners = item.footprint()
    following = np.roll(corners, -1, axis=0)
    turns = [np.cross([*(b - a), 0], [*(np.array(p) - a), 0])[2] for a, b in zip(corners, following, strict=True)]
    if min(abs(turn) for turn in turns) < 1e-6:
        return
    assert bool(inside_item(item, np.array([p]))[0]) == all(turn > 0 for turn in turns)


def test_free_space_of_the_small_building(mini: Building) -> None:
    places = np.array([[1.0, 1.1], [2.4, 2.2], [1.0, 2.2], [5.6, 0.0], [0.4, 5.4], [20.0, 0.0], [2.4, 4.0]])
    assert blocked_points(mini, places).tolist() == [False, False, True, False, True, True, False]
    codes = room_codes(mini, places)
    assert [*codes[:3], *codes[5:]] == ["CR-A", "CR-A", "CR-A", "", "1PO-A"]


def test_walls_stop_and_doors_do_not(mini: Building) -> None:
    segments, names = obstacles(mini)
    through_door = np.array([[[2.4, 1.2], [2.4, 3.4]]])
    through_wall = np.array([[[1.4, 1.2], [1.4, 3.4]]])
    assert not crossings(through_door, segments).any()
    hit = crossings(through_wall, segments)[0]
    assert {names[i] for i in np.flatnonzero(hit)} == {"a wall of room 'corridor'", "a wall of room 'office_west'"}
