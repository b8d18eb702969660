"""Drawn buildings: any seed gives one that a robot can drive through, and two seeds give two architects' work."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import combinations
from typing import get_args

import numpy as np
import pytest

from siamloc.errors import DataError
from siamloc.simulate import Run, load_building
from siamloc.simulate.buildings import draw_building, random_building
from siamloc.simulate.floor_plans import PLANS, Cell, Kind, Plan, draw_plan, dwelling, great_hall, workshop
from siamloc.simulate.furnishing import USES, Room, Use, furnish
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import SIDES, Building
from siamloc.simulate.parse import parse_building
from siamloc.simulate.plan import clearance, crossings, obstacles, room_at
from siamloc.simulate.route import FreeSpace
from siamloc.simulate.run import draw_run
from siamloc.simulate.shell import leaf_segment

SEEDS = {"office": [0, 1, 2, 3, 11, 94, 137, 12345], "home": [0, 5], "workshop": [0, 5], "hall": [0, 5]}


@lru_cache
def made(kind: Kind, seed: int) -> Building:
    return parse_building(draw_building(seed, kind), seed, kind)


@pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in get_args(Kind) for seed in SEEDS[kind]])
def test_the_robot_visits_every_room_and_touches_nothing(kind: Kind, seed: int) -> None:
    building = made(kind, seed)
    for path, share in (("path1", 0.3), ("path2", 1.0)):
        state = draw_run(building, Run("cloudy", 1, path))
        poses = state.track.poses
        visited = set(room_at(building, poses[:, :2]).tolist())
        assert -1 not in visited
        assert len(visited) >= share * len(building.rooms)
    segments, _ = obstacles(building)
    doors = state.fixtures.door_angles.items()
    leaves = [leaf_segment(building, building.openings[number], angle) for number, angle in doors]
    assert clearance(poses[:, :2], segments).min() > 0.2, "a robot is half a metre wide"
    assert clearance(poses[:, :2], np.stack(leaves)).min() > 0.15, "its camera does not look into the wood of a door"
    inside = [[hinge + 0.05 * (tip - hinge), tip] for hinge, tip in leaves]  # without its end at the wall
    through = crossings(np.array(inside), obstacles(building, [])[0]).any(axis=1)
    assert through.sum() <= 2, "a door goes through a wall only where every other angle is in the way of the camera"


def test_a_seed_is_a_building_and_another_seed_another_one() -> None:
    drawn = [made("office", seed) for seed in range(10)]
    assert len({building.bounds for building in drawn}) == 10
    assert len({str(building.paths["path2"]) for building in drawn}) == 10
    again = load_building("random", 3)
    assert (again.rooms, again.items) == (drawn[3].rooms, drawn[3].items)


@pytest.mark.parametrize(
    "draw", [*(plan for plan, _ in PLANS), dwelling, workshop, great_hall], ids=lambda plan: plan.__name__
)
def test_every_kind_of_plan_is_connected_and_nothing_overlaps(draw) -> None:
    for seed in range(25):
        plan = draw(np.random.default_rng(seed))
        reached, waiting = set(), [plan.cells[0].name]
        while waiting:
            here = waiting.pop()
            if here not in reached:
                reached.add(here)
                waiting += [b if a == here else a for a, b, _ in plan.doors if here in (a, b)]
        assert reached == {cell.name for cell in plan.cells}
        for a, b in combinations(plan.cells, 2):
            across, along = (min(s[1], t[1]) - max(s[0], t[0]) for s, t in ((a.x, b.x), (a.y, b.y)))
            assert min(across, along) < 1e-9, (a, b)
        assert all(door["width"] > 0.9 for door in plan.place_doors(np.random.default_rng(seed)))


def test_all_kinds_of_plans_are_drawn_and_what_their_rooms_may_hold_exists() -> None:
    uses = {cell.use for seed in range(40) for cell in draw_plan(np.random.default_rng(seed)).cells}
    assert {"corridor", "office", "bedroom", "living"} <= uses <= set(USES)
    assert {"foyer", "workshop", "canteen", "open_office"} & uses
    groups = {"desk_pair", "dining", "conference", "seating", "benches", "stacks", "plant_island"}
    groups |= {"television_set", "television_wall"}
    for use in USES.values():
        assert set(f"{use.walls} {use.middle} {use.hung}".split()) - groups <= set(KINDS)


def test_kinds_differ_as_their_names_say() -> None:
    drawn = {kind: [made(kind, seed) for seed in range(6)] for kind in ("home", "workshop", "hall")}
    areas = {
        kind: [[np.prod(np.diff(room.inner())) for room in one.rooms.values()] for one in buildings]
        for kind, buildings in drawn.items()
    }
    crowd = {
        kind: sum(len(one.items) for one in buildings) / sum(np.prod(np.diff(one.bounds)) for one in buildings)
        for kind, buildings in drawn.items()
    }
    assert np.median(np.concatenate(areas["home"])) < 16
    assert min(max(rooms) for rooms in areas["workshop"] + areas["hall"]) > 50
    assert crowd["home"] > 2 * crowd["hall"]
    assert sum(any(item.kind in ("bed", "bunk_bed", "cot") for item in one.items) for one in drawn["home"]) >= 5
    halls = [list(one.rooms.values()) for kind in ("workshop", "hall") for one in drawn[kind]]
    assert all(rooms[0].height > 3.1 for rooms in halls)
    beside = [room.height for rooms in halls for room in rooms[1:]]
    assert len(beside) > 5
    assert 2.6 < min(beside) <= max(beside) <= 3.2, "a toilet is not as high as the hall"


@pytest.mark.parametrize("free", [True, False])
def test_no_sideboard_waits_for_a_television_that_has_no_place(monkeypatch, free: bool) -> None:
    monkeypatch.setitem(USES, "home_living", Use("LR", "parquet", "sofa", needs="television_wall television_wall"))
    plan = Plan(2.6, [Cell("living", "home_living", (0.0, 6.0), (0.0, 5.0))])
    windows = [] if free else [{"wall": side, "at": 2.5, "width": 6.0, "sill": 1.0, "head": 2.3} for side in SIDES]
    room = Room(plan.cells[0], plan, [], windows)
    kinds = [entry["kind"] for entry in furnish(room, np.random.default_rng(0), np.random.default_rng(1), 1.0)]
    assert (kinds.count("sideboard"), kinds.count("television")) == ((2, 2) if free else (0, 0))


def test_two_people_stand_apart_in_natural_buildings(mini: Building) -> None:
    pairs = 0
    for number in range(1, 11):
        state = draw_run(replace(mini, materials="natural"), Run("cloudy", number, spacing=1.0))
        people = [item for item in state.items if item.kind == "person"]
        for one, other in combinations(people, 2):
            pairs += 1
            assert np.hypot(one.x - other.x, one.y - other.y) > 0.6
    assert pairs > 8


def test_worlds_of_any_kind_are_drawn_only_if_asked_for() -> None:
    assert random_building(3).items == load_building("random", 3).items
    worlds = [random_building(seed, "any") for seed in range(5, 15)]
    assert {building.materials for building in worlds} == {"drawn", "natural"}
    first = {next(iter(building.rooms)).rpartition("_")[0] for building in worlds}
    assert {"home_entrance", "machine_hall", "corridor"} < first
    assert {"great_hall", "sports_hall"} & first
    assert random_building(7, "any").items == worlds[2].items


def ends(space: FreeSpace, *points: tuple[float, float]) -> list[int]:
    return [int(np.argmin(np.linalg.norm(space.points - point, axis=1))) for point in points]


def test_a_way_keeps_off_what_stands_there_and_leads_through_no_wall() -> None:
    column = {"kind": "column", "at": [3, 2], "size": [0.5, 0.5, 2.0]}
    rooms = {"one": {"x": [0, 6], "y": [0, 4], "items": [column]}, "two": {"x": [6, 10], "y": [0, 3]}}
    building = parse_building({"rooms": rooms}, 0, "test")
    space = FreeSpace(building)
    here, there, beyond = ends(space, (0.6, 2.0), (5.4, 2.0), (8.0, 1.5))
    way = space.way([here, there])
    segments, _ = obstacles(building)
    assert clearance(way, segments).min() > 0.25
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() < 6.5, "around the column, and no farther"
    assert not space.reachable(here)[beyond]
    with pytest.raises(DataError, match="cannot reach"):
        space.way([here, beyond])
