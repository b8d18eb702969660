"""A map within a budget: the frames go that the others replace best."""

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps import History, VisualMap, thin
from siamloc.maps.thinning import near
from tests.siamloc.maps.conftest import placed, plain_map

DAY, NIGHT = 0.0, 500.0


def lit(frames: int = 10) -> VisualMap:
    """A drive of 0.1 m steps by day, then one through the same places by night, twice as fast."""
    x = np.concatenate([0.1 * np.arange(frames), 0.2 * np.arange(frames // 2)])
    look = np.where(np.arange(len(x)) < frames, DAY, NIGHT) + np.rint(10 * x)
    drive = np.where(np.arange(len(x)) < frames, "day", "night")
    return VisualMap(look[:, None], placed(np.column_stack([x, 0 * x]), sequence=drive))


def names(found):
    return [reason.name for reason in found.reason]


def test_a_map_within_its_budget_stays_as_it_is_and_is_not_compared(monkeypatch):
    monkeypatch.delattr("siamloc.maps.thinning.learned_distances")
    known = lit()
    assert thin(known).known is known
    assert thin(known, per_square_metre=15, megabytes=1).known is known


def test_the_light_with_few_frames_outlives_the_frames_that_crowd():
    found = thin(lit(), per_square_metre=10)
    assert names(found)[:10].count("REDUNDANT") == 5
    assert names(found)[10:] == ["KEPT"] * 5


@pytest.mark.parametrize(
    ("limits", "forgotten"),
    [
        ({"per_square_metre": 1}, [0, 2]),
        ({"frames": 3}, [0, 2]),
        ({"frames": 3, "per_square_metre": 1}, [0, 2]),
        ({"frames": 2, "per_square_metre": 1}, [0, 2, 4]),
        ({"frames": 3, "per_square_metre": 3}, [0, 2]),
    ],
)
def test_limits_together_forget_no_more_than_they_ask_for(limits, forgotten):
    crowded_and_alike = placed([(0.1, 0.5), (0.2, 0.5), (0.3, 0.5), (1.2, 0.5), (2.2, 0.5)])
    found = thin(VisualMap([[0.0], [90.0], [170.0], [300.0], [301.0]], crowded_and_alike), **limits)
    assert [row for row, name in enumerate(names(found)) if name == "REDUNDANT"] == forgotten


def moved_by_loss(known: VisualMap, stays: list[int], row: int) -> float:
    """How far all pictures move that are located among the frames that stay, if one of these goes: by plain loops."""

    unlike = np.linalg.norm(known.learned[:, None] - known.learned, axis=2) - np.eye(len(known))

    def located(picture: int, among: list[int]) -> float:
        best = min(among, key=lambda frame: unlike[picture, frame])
        return float(np.linalg.norm(known.frames.xy[best] - known.frames.xy[picture]))

    rest = [other for other in stays if other != row]
    return sum(located(picture, rest) - located(picture, stays) for picture in range(len(known)))


def test_the_frame_goes_whose_loss_moves_pictures_least():
    rng = np.random.default_rng(0)
    known = VisualMap(rng.uniform(0, 1, (40, 3)), placed(rng.uniform(0, 4, (40, 2))))
    stays = list(range(40))
    while len(stays) > 25:
        stays.remove(min(stays, key=lambda row: (round(moved_by_loss(known, stays, row), 6), -row)))
        assert [row for row, name in enumerate(names(thin(known, frames=len(stays)))) if name == "KEPT"] == stays


def test_pictures_whose_most_similar_frames_are_all_forgotten_are_compared_with_those_left(monkeypatch):
    monkeypatch.setattr("siamloc.maps.thinning._MOST_ALIKE", 3)
    rng = np.random.default_rng(1)
    known = VisualMap(rng.uniform(0, 1, (30, 3)), placed(rng.uniform(0, 4, (30, 2)), building=["a", "b"] * 15))
    found = thin(known, frames=4)
    assert names(found).count("KEPT") == 4
    assert set(found.known.frames.building) == {"a", "b"}
    assert names(thin(known, frames=1)).count("KEPT") == 2, "one in each building"


def test_of_frames_equally_well_replaced_the_one_contradicted_more_often_goes():
    history = History([0, 9, 0], [0, 2, 0], [np.nan] * 3)
    known = replace(plain_map(np.array([[0.0], [1.0], [2.0]])), history=history)
    frame = known.bytes / len(known) / 1e6
    assert names(thin(known, megabytes=2 * frame)) == ["KEPT", "UNRECOGNIZED", "KEPT"]
    np.testing.assert_array_equal(thin(known, megabytes=frame).known.history.contradicted, [0])


def test_a_frame_without_which_its_place_is_taken_for_another_stays():
    known = VisualMap([[0.0], [5.0], [5.1], [1.0]], placed([(0, 0), (0, 0), (9, 0), (0.5, 0)]))
    assert names(thin(known, frames=3)) == ["KEPT", "KEPT", "KEPT", "REDUNDANT"]


def test_of_two_alike_frames_the_one_confirmed_more_often_stays():
    known = VisualMap([[0.0], [0.1]], placed([(0, 0), (0.1, 0)]), history=History([1, 2], [0, 0], [np.nan] * 2))
    assert names(thin(known, per_square_metre=1)) == ["REDUNDANT", "KEPT"]


def test_the_frame_that_shows_a_place_as_it_is_stays():
    old_and_new = History([5, 0], [0, 0], [1.5, np.nan])  # the new one joined on the last drive
    known = VisualMap([[0.0], [0.1]], placed([(0, 0), (0.1, 0)]), history=old_and_new)
    assert names(thin(known, per_square_metre=1)) == ["REDUNDANT", "KEPT"]


def test_each_building_and_each_square_has_its_own_budget():
    frames = placed([(0.1, 0.1), (0.2, 0.1), (0.1, 0.1), (1.1, 0.1)], building=["a", "a", "b", "a"])
    found = thin(VisualMap(np.zeros((4, 1)), frames), per_square_metre=1)
    assert names(found) == ["KEPT", "REDUNDANT", "KEPT", "KEPT"]


def test_pairs_nearby_are_those_of_a_loop_over_all(monkeypatch):
    monkeypatch.setattr("siamloc.maps.thinning._PAIRS_AT_ONCE", 50)
    rng = np.random.default_rng(0)
    first, second = (placed(rng.uniform(0, 5, (n, 2)), building=rng.choice(["a", "b"], n)) for n in (30, 20))
    found = [(i, j, d) for part in near(first, second, 1.0) for i, j, d in zip(*part, strict=True)]
    apart = np.linalg.norm(first.xy[:, None] - second.xy, axis=2)
    expected = (apart <= 1) & (first.building[:, None] == second.building)
    assert [(i, j) for i, j, _ in found] == list(zip(*np.nonzero(expected), strict=True))
    np.testing.assert_allclose([d for *_, d in found], apart[expected])


def test_budgets_that_make_no_sense_are_refused():
    known = plain_map(np.zeros((2, 4)))
    with pytest.raises(ConfigError, match=r"megabytes=1e-06 holds no frame of 1.6e-05 MB: give more"):
        thin(known, megabytes=1e-6)
    with pytest.raises(ConfigError, match=r"^per_square_metre must be a whole number from 1"):
        thin(known, per_square_metre=0)
    with pytest.raises(
        DataError, match=r"of the .* map frames have no position, which thinning needs: .*`VisualMap.placed"
    ):
        thin(VisualMap([[1.0]], FrameTable(path=["a.png"])), per_square_metre=1)
