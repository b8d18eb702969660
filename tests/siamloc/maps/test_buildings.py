"""In which building of a map a drive was taken."""

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.maps import VisualMap
from siamloc.maps.buildings import buildings_of, nearest
from tests.siamloc.maps.conftest import placed

LOOK = {"ground": 0.0, "top": 1.0}


def drive(building: str, noise: float = 0.0, shift: float = 0.0, stated: str | None = None, frames: int = 40, seed=0):
    """A drive along a line on a floor; a floor looks different everywhere, but its frames change with the light."""
    at = np.arange(frames) + shift
    look = np.column_stack([at, np.full(frames, LOOK[building])])
    look[:, 1] += np.random.default_rng(seed).normal(0, noise, frames) if noise else 0
    xy = np.column_stack([at, 0 * at])
    name = building if stated is None else stated
    return VisualMap(look, placed(xy, building=[name] * frames, sequence=[building] * frames))


def named(name, known):
    frames = known.frames.with_columns(path=[f"{name}{path}" for path in known.frames.path])
    return replace(known, frames=frames)


@pytest.fixture
def known():
    return drive("ground").merge(named("t", drive("top", shift=0.3)))


def test_the_nearest_frame_is_one_of_the_own_building_where_the_map_has_it():
    known = FrameTable(path=["a", "b", "c"], x=[0, 1, np.nan], y=[0, 0, np.nan], building=["up", "down", "up"])
    drive = FrameTable(path=["1", "2", "3", "4"], x=[0.9, 0.1, 0.9, 0.1], y=[0] * 4, building=["up", "down", "", "x"])
    assert nearest(known, drive).tolist() == [0, 1, 1, 0]


@pytest.mark.parametrize("building", ["ground", "top"])
@pytest.mark.parametrize("frames", [1, 2, 40])
def test_floors_that_lie_over_each_other_are_told_by_what_they_look_like(known, building, frames):
    for shift in (0.0, 0.3):
        seen = drive(building, shift=shift, stated="", frames=frames)
        assert buildings_of(known, seen).tolist() == [building] * frames


def test_frames_in_a_row_decide_together(known):
    seen = drive("top", noise=0.6, shift=0.15, stated="")
    alone = [buildings_of(known, seen.take([row]))[0] for row in range(len(seen))]
    assert 2 < alone.count("ground") < 20
    assert set(buildings_of(known, seen)) == {"top"}


@pytest.mark.parametrize(("first", "frames"), [(0, 6), (17, 8), (34, 6)])
def test_a_short_stay_on_another_floor_is_told_to_the_frame(known, first, frames):
    true = np.full(40, "ground", dtype=object)
    true[first : first + frames] = "top"
    look = np.column_stack([np.arange(40) + 0.1, [LOOK[one] for one in true]])
    seen = replace(drive("ground", stated=""), descriptors=look)
    assert buildings_of(known, seen).tolist() == true.tolist()


def test_a_floor_that_is_mostly_alone_is_as_steady():
    known = drive("ground", frames=200).merge(named("t", drive("top", frames=20, shift=0.3)))
    for seed in range(3):
        seen = drive("ground", noise=0.45, stated="", frames=200, shift=0.1, seed=seed)
        assert (buildings_of(known, seen) == "ground").all()


def test_each_drive_is_on_a_floor_of_its_own(known):
    seen = drive("top", stated="", frames=20).merge(named("g", drive("ground", stated="", frames=20)))
    assert buildings_of(known, seen).tolist() == ["top"] * 20 + ["ground"] * 20


def test_a_drive_that_states_one_building_of_the_map_is_in_it(known):
    seen = drive("top", stated="")
    some = np.where(np.arange(40) % 2, "ground", "")
    assert set(buildings_of(known, replace(seen, frames=seen.frames.with_columns(building=some)))) == {"ground"}


def test_frames_without_a_building_are_a_building_of_a_map_but_nobody_states_it(known):
    bare = replace(
        known, frames=known.frames.with_columns(building=np.where(known.frames.building == "top", "top", ""))
    )
    for building in ("top", "ground"):
        found = buildings_of(bare, drive(building, stated=""))
        assert set(found) == {"top" if building == "top" else ""}


def test_a_floor_with_fewer_frames_is_told_as_well():
    def bend(at, building):
        look = np.column_stack([0.02 * at, np.full(len(at), LOOK[building])])
        frames = placed(np.column_stack([at, 0 * at]), building=[building] * len(at), sequence=[building] * len(at))
        return VisualMap(look, frames)

    known = bend(np.arange(0.0, 40, 6), "ground").merge(named("t", bend(np.arange(0.0, 40, 1), "top")))
    seen = bend(np.arange(0.0, 40, 0.5), "ground")
    assert set(buildings_of(known, replace(seen, frames=seen.frames.with_columns(building=[""] * 80)))) == {"ground"}


def test_nothing_is_compared_where_each_frame_states_its_building_or_only_one_is_near(known, monkeypatch):
    monkeypatch.delattr("siamloc.maps.buildings.learned_distances")
    away = replace(known, frames=known.frames.with_columns(y=np.where(known.frames.building == "top", 9.0, 0.0)))
    assert set(buildings_of(known, drive("top"))) == {"top"}
    assert set(buildings_of(away, drive("top", stated=""))) == {"ground"}


def test_a_building_elsewhere_is_not_asked_and_a_stated_one_is_believed(known):
    away = replace(known, frames=known.frames.with_columns(y=np.where(known.frames.building == "top", 9.0, 0.0)))
    seen = drive("top", stated="")
    assert set(buildings_of(away, seen)) == {"ground"}
    assert set(buildings_of(known, drive("top", stated="ground"))) == {"ground"}
    assert set(buildings_of(known, drive("top", stated="annex"))) == {"top"}
    assert set(buildings_of(drive("ground"), drive("top", stated="annex"))) == {"ground"}
