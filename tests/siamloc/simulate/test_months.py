"""Months: what changes, what stays, and the free way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.simulate import Run, load_building
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import Array, Building, Item
from siamloc.simulate.mesh import MeshBuilder, QuadMesh
from siamloc.simulate.months import aged
from siamloc.simulate.overlap import changed_share
from siamloc.simulate.plan import blocked_points, clearance, inside_item, obstacles
from siamloc.simulate.run import draw_run
from siamloc.simulate.scene import built


def test_a_month_is_the_one_before_with_further_changes(mini: Building) -> None:
    assert aged(mini, 0) == (mini, ())
    (before, earlier), (after, changes) = aged(mini, 2), aged(mini, 3)
    assert aged(mini, 3) == (after, changes)
    assert changes[: len(earlier)] == earlier
    assert {change.month for change in changes[len(earlier) :]} == {3}
    stayed = [item for item in after.items if item in before.items]
    assert 0.5 * len(before.items) < len(stayed) < len(before.items)
    assert aged(load_building("mini", 1), 3)[1] != changes, "another seed, other changes"


def test_everything_that_may_change_does(mini: Building) -> None:
    _, changes = aged(mini, 6)
    hung = [change for change in changes if change.kind in KINDS and not KINDS[change.kind].blocks]
    standing = [change for change in changes if change.kind in KINDS and KINDS[change.kind].blocks]
    assert {change.what for change in standing} == {"moved", "exchanged", "added", "taken"}
    assert {"moved", "exchanged"} <= {change.what for change in hung}
    assert any(change.kind == "lamps" for change in changes)
    months = [draw_run(mini, Run("cloudy", 1, "path1", month=month)) for month in range(3)]
    assert [state.fixtures.door_angles[2] < 1 for state in months].count(True) in (1, 2), "of a room off the route"
    people = [[item for item in state.items if item.kind == "person"] for state in months]
    assert people[0] != people[1] != people[2]
    assert draw_run(mini, Run("cloudy", 1)).building == mini


@pytest.mark.parametrize(("name", "seed"), [("mini", 0), ("annex", 0), ("random", 7)])
def test_furniture_has_space_and_the_way_stays_free(name: str, seed: int) -> None:
    building = load_building(name, seed)
    state = draw_run(building, Run("cloudy", 1, month=6))
    later, points = state.building, state.track.poses[:, :2]
    assert not blocked_points(later, points, state.items).any()
    assert clearance(points, obstacles(later, state.items)[0]).min() > 0.25
    new = [item for item in later.items if not _among(item, building.items)]
    assert len(new) > 5
    for item in new:
        inner = later.rooms[item.room].inner()
        x, y = _inside(item).T
        assert (min(x) > inner.x[0], max(x) < inner.x[1], min(y) > inner.y[0], max(y) < inner.y[1]) == (True,) * 4
        for other in later.items:
            if other is not item and other.room == item.room and not (_among(item, [other]) or _flat(item, other)):
                level = item.z < other.z + other.size[2] and other.z < item.z + item.size[2]
                assert not (level and inside_item(other, _inside(item)).any()), f"{item} reaches into {other}"


def test_a_building_without_paths_changes_as_well(mini: Building) -> None:
    pathless = replace(mini, paths={})
    later, changes = aged(pathless, 2)
    blocking = [change for change in changes if change.kind in KINDS and KINDS[change.kind].blocks]
    assert {"moved", "added"} <= {change.what for change in blocking}
    track = draw_run(pathless, Run("cloudy", 1, "grid", 0.8, month=2)).track
    assert not blocked_points(later, track.poses[:, :2]).any()


def _among(item: Item, items: object) -> bool:
    """Return whether an item of the same size is in the same place."""
    return any((item.x, item.y, item.size) == (other.x, other.y, other.size) for other in items)


def _flat(item: Item, other: Item) -> bool:
    return min(item.size[2], other.size[2]) < 0.03


def _inside(item: Item) -> Array:
    """Return points (225, 2) that fill an item's rectangle, but for its rim."""
    across, along = np.meshgrid(*(np.linspace(-0.49, 0.49, 15) * size for size in item.size[:2]))
    ahead = np.array([np.cos(np.radians(item.facing)), np.sin(np.radians(item.facing))])
    right = np.array([ahead[1], -ahead[0]])
    return across.reshape(-1, 1) * right + along.reshape(-1, 1) * ahead + (item.x, item.y)


def test_the_changed_share_is_measured_and_grows(mini: Building) -> None:
    run = Run("cloudy", 1)
    first = draw_run(mini, run)
    eyes = np.column_stack([first.track.poses[::8, :2], np.full(len(first.track.poses[::8]), 0.9)])
    months = [aged(mini, month)[0] for month in (0, 1, 3, 6)]
    meshes = [built(replace(first, building=month, items=month.items))[0] for month in months]
    shares = [float(changed_share(meshes[0], mesh, eyes).mean()) for mesh in meshes]
    assert shares[0] == 0
    assert 0.02 < shares[1] < shares[2] < shares[3] < 0.5, shares


def test_the_changed_share_is_one_of_solid_angles() -> None:
    def shaft(colour: float = 1.0, ledge: float | None = None) -> QuadMesh:
        builder = MeshBuilder({"paint": (0, None)})
        for degrees in (0, 90, 180, 270):
            with builder.at(0, 0, 0, degrees):
                tint = (colour if degrees == 0 else 1.0,) * 3
                builder.quad((1, -1, -3), (1, 1, -3), (1, 1, 3), (1, -1, 3), "paint", tint)
        if ledge is not None:
            builder.box((0.5, -0.2, ledge), (0.9, 0.2, ledge + 0.2), "paint")
        return builder.build()

    eye = np.zeros((1, 3))
    assert changed_share(shaft(), shaft(), eye) == 0
    assert changed_share(shaft(), shaft(colour=0.2), eye, 4000) == pytest.approx(0.25, abs=0.005)
    whole, near, far = (
        changed_share(one, shaft(ledge=0.1), eye, 4000)[0] for one in (shaft(), shaft(ledge=0.07), shaft(ledge=0.0))
    )
    assert near < 0.5 * whole < whole < far, "a surface within 5 cm is the same, only its rim has moved"
    assert changed_share(shaft(), shaft(ledge=0.0), eye, 4000) == changed_share(shaft(ledge=0.0), shaft(), eye, 4000)
