import copy
import pickle
from itertools import combinations

import numpy as np
import pytest

from analytic.mapper import state
from analytic.mapper.state import Spacing, mean_distance


def plain(places):
    """The mean over all pairs of places, each by the nearest pair of representatives."""
    apart = [min(np.linalg.norm(a - b) for a in first for b in second) for first, second in combinations(places, 2)]
    return float(np.mean(apart)) if apart else 0.0


def test_a_place_is_as_far_as_the_nearest_of_its_modes():
    place, other = [np.zeros(2), np.array([10.0, 0])], [np.array([4.0, 0])]
    assert mean_distance(np.array([9.0, 0]), [place, other]) == 3
    assert Spacing().among([place, other]) == 4
    assert Spacing().among([place]) == 0
    assert Spacing().among([]) == 0


@pytest.mark.parametrize("most_modes", [1, 3])
def test_the_table_answers_as_all_pairs_do_while_places_come_move_and_go(most_modes):
    generator = np.random.default_rng(most_modes)
    table, places = Spacing(), []
    for _ in range(120):
        kind = generator.integers(5)
        if kind < 2 or len(places) < 3:
            modes = generator.integers(1, most_modes + 1)
            places.append([generator.normal(size=7) for _ in range(modes)])
        elif kind == 2:
            places.pop(generator.integers(len(places)))
        elif kind == 3:  # a representative moves: another array takes its place
            place = places[generator.integers(len(places))]
            place[generator.integers(len(place))] = generator.normal(size=7)
        draft = [*places[: len(places) // 2], [generator.normal(size=7)]]
        assert table.among(draft) == plain(draft)
        assert table.among(places) == plain(places)
    assert table.among(places[::-1]) == pytest.approx(plain(places), rel=1e-12)
    assert Spacing().among(places) == table.among(places)
    assert len(places) > state._ROOM // 2


def test_only_what_has_moved_is_computed(monkeypatch):
    generator = np.random.default_rng(0)
    places = [[generator.normal(size=4)] for _ in range(70)]
    table = Spacing()
    table.among(places)
    rows = []
    monkeypatch.setattr(state, "distances", lambda *args, whole=state.distances: rows.append(1) or whole(*args))
    table.among(places)
    assert not rows
    places[3] = [generator.normal(size=4)]
    del places[50]
    assert table.among(places) == plain(places)
    assert len(rows) == 1


def test_a_row_that_was_not_finished_is_computed_again(monkeypatch):
    generator = np.random.default_rng(1)
    places = [[generator.normal(size=4)] for _ in range(6)]
    table = Spacing()
    table.among(places[:5])
    before = [*places]
    places[2] = [generator.normal(size=4)]

    def broken(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(state, "distances", broken)
        for asked in (places, places[:5]):
            with pytest.raises(MemoryError):
                table.among(asked)
    assert table.among(places) == plain(places)
    assert table.among(before) == plain(before)


def test_two_places_with_the_same_representative():
    centre, other = np.zeros(3), np.ones(3)
    assert Spacing().among([[centre], [centre], [other]]) == plain([[centre], [centre], [other]])


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda table: pickle.loads(pickle.dumps(table))])
def test_a_copy_does_not_take_other_arrays_for_those_of_the_table(copied):
    generator = np.random.default_rng(2)
    places = [[generator.normal(size=64)] for _ in range(20)]
    table = Spacing()
    table.among(places)
    other = copied(table)
    moved = [[row.copy() for row in place] for place in places]
    del table, places
    for _ in range(100):
        moved[generator.integers(20)] = [generator.normal(size=64)]
        assert other.among(moved) == plain(moved)
