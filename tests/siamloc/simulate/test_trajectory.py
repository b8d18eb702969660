"""Drives: spacing, headings, differences between runs, and lists of poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from siamloc.data.names import parse_name
from siamloc.errors import ConfigError, DataError
from siamloc.simulate import Run
from siamloc.simulate.layout import Building
from siamloc.simulate.plan import blocked_points, clearance, crossings, obstacles
from siamloc.simulate.run import DAY, draw_run
from siamloc.simulate.shell import leaf_segment
from siamloc.simulate.sky import make_sky, sun_direction
from siamloc.simulate.trajectory import drive, listed


def test_frames_are_spaced_and_named_and_look_ahead(mini: Building) -> None:
    track = drive(mini, "path2", 0.15, np.random.default_rng(0), 1000.0)
    steps = np.linalg.norm(np.diff(track.poses[:, :2], axis=0), axis=1)
    turns = np.abs((np.diff(track.poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    assert steps.max() < 0.15 + 0.03
    assert ((steps > 0.13) | (turns > np.radians(18)))[:-1].all()
    assert (np.diff(track.time) > 0).all()
    assert track.time[0] == 1000.0
    for name, pose, time in zip(track.names, track.poses, track.time, strict=True):
        read = parse_name(name)
        assert read is not None
        np.testing.assert_allclose([read.x, read.y, read.theta, read.time], [*pose, time], atol=1e-6)
    ahead = np.gradient(track.poses[:, :2], axis=0)
    difference = np.arctan2(ahead[:, 1], ahead[:, 0]) - track.poses[:, 2]
    assert np.median(np.abs((difference + np.pi) % (2 * np.pi) - np.pi)) < np.radians(10)


def test_runs_take_different_lines_within_a_third_of_a_metre(mini: Building) -> None:
    lines = [drive(mini, "path2", 0.1, np.random.default_rng(seed), 0.0).poses[:, :2] for seed in range(4)]
    for a in lines[1:]:
        gap = np.linalg.norm(a[:, None] - lines[0][None], axis=2).min(axis=1)
        assert 0.05 < gap.max() < 0.75


@pytest.mark.parametrize("lighting", ["cloudy", "sunny"])
def test_a_run_leaves_its_own_way_free(mini: Building, lighting: str) -> None:
    for number in (1, 2, 3):
        state = draw_run(mini, Run(lighting, number))
        points = state.track.poses[:, :2]
        segments, _ = obstacles(mini, state.items)
        assert not blocked_points(mini, points, state.items).any()
        assert clearance(points, segments).min() > 0.15
        leaves = [leaf_segment(mini, mini.openings[i], a) for i, a in state.fixtures.door_angles.items()]
        moves = np.stack([points[:-1], points[1:]], axis=1)
        assert not crossings(moves, np.stack(leaves)).any()


def test_runs_differ_in_doors_hours_chairs_and_people(mini: Building) -> None:
    a, b = draw_run(mini, Run("sunny", 1)), draw_run(mini, Run("sunny", 2))
    assert a.fixtures.door_angles != b.fixtures.door_angles
    assert abs(a.light.hour - b.light.hour) > 1
    for kind in ("chair", "person"):
        first, second = ([(i.x, i.y, i.facing) for i in state.items if i.kind == kind] for state in (a, b))
        assert first != second
    assert draw_run(mini, Run("sunny", 1)).items == a.items
    assert Run("cloudy", 2).name == "seq2_cloudy2"
    assert Run.parse("night1", path="path1").name == "seq1_night1"


def test_a_grid_covers_the_free_floor_and_queries_stand_halfway(mini: Building) -> None:
    state = draw_run(mini, Run("cloudy", 1, "grid", 0.4))
    points, segments = state.track.poses[:, :2], obstacles(mini, state.items)[0]
    assert set(state.track.codes) == {room.code for room in mini.rooms.values()}
    assert not blocked_points(mini, points, state.items).any()
    leaves = [leaf_segment(mini, mini.openings[i], a) for i, a in state.fixtures.door_angles.items()]
    assert clearance(points, np.concatenate([segments, leaves])).min() > 0.25
    gap = np.linalg.norm(points[:, None] - points, axis=2) + 9 * np.eye(len(points))
    np.testing.assert_allclose(gap.min(axis=1), 0.4, atol=1e-6)
    assert not state.track.poses[:, 2].any()
    between = [draw_run(mini, Run("cloudy", n, "halfway", 0.4, headings=16, positions=9)).track for n in (2, 3)]
    every = draw_run(mini, Run("cloudy", 2, "halfway", 0.4)).track.poses[:, None, :2]
    np.testing.assert_allclose(np.linalg.norm(every - points, axis=2).min(axis=1), 0.2 * np.sqrt(2), atol=1e-6)
    for track in between:
        turns = np.diff(np.sort(track.poses[:, 2].reshape(9, 16), axis=1), axis=1)
        np.testing.assert_allclose(turns, np.pi / 8, atol=1e-5)
        assert len(np.unique(track.poses[:, :2], axis=0)) == 9
        assert len(set(track.codes)) == 4, "every room has its share of the positions"
    assert between[0].names[0] != between[1].names[0]


def test_hours_dim_a_cloudy_sky_and_leave_the_rest(mini: Building) -> None:
    noon, late, drawn = (draw_run(mini, Run("cloudy", 1, hour=hour)) for hour in (12, 17, None))
    assert noon.items == late.items == drawn.items
    assert (noon.light.hour, noon.light.overcast, drawn.light.overcast) == (12, 1.0, 1.0)
    assert 0.1 < late.light.overcast < 0.4
    assert min(sun_direction(hour, 0, day)[2] for hour in DAY for day in (-10, 0)) > 0.02, "the sun is up by day"
    rngs, sun = (0, 1), sun_direction(12, 0, 0)
    outside = [make_sky("cloudy", *map(np.random.default_rng, rngs), sun, 16, level) for level in (1.0, 0.5)]
    np.testing.assert_allclose(outside[1].image, 0.5 * outside[0].image, rtol=1e-5)


def test_lists_are_rendered_under_their_own_names(mini: Building, tmp_path: FilePath) -> None:
    names = ["t5.000000_x1.000000_y1.100000_a-0.000000.jpeg", "t5.300000_x1.200000_y1.100000_a0.000000.jpeg"]
    file = tmp_path / "own.places.lst"
    file.write_text("".join(f"{name} XX\n" for name in names))
    track = listed(mini, file)
    assert track.names == tuple(names)
    assert track.codes == ("CR-A", "CR-A")
    np.testing.assert_allclose(track.poses[1], [1.2, 1.1, 0.0])
    assert track.speed[0] == pytest.approx(0.2 / 0.3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("t1_x0.4_y5.4_a0.png", "images are written as JPEG, but the list names t1_x0"),
        ("t1_x0.4_y5.4_a0.jpeg", r"1 of 1 poses lie in a wall or on .* the first: t1_x0\.4_y5\.4_a0\.jpeg"),
    ],
)
def test_bad_lists(mini: Building, tmp_path: FilePath, name: str, message: str) -> None:
    file = tmp_path / "bad.lst"
    file.write_text(f"{name} 1PO-A\n")
    with pytest.raises(DataError, match=message):
        listed(mini, file)


def test_bad_paths(mini: Building) -> None:
    with pytest.raises(ConfigError, match="has no path 'path3'; did you mean 'path"):
        drive(mini, "path3", 0.15, np.random.default_rng(0), 0.0)
    with pytest.raises(ConfigError, match="spacing must be a number above 0, got 0"):
        Run("cloudy", 1, "path1", 0.0)
    with pytest.raises(ConfigError, match="headings and positions go with path=grid or path=halfway, got path=path2"):
        Run("cloudy", headings=16)
    with pytest.raises(DataError, match=r"has \d+ free positions on a grid of 0.4 m: ask for 1 to \d+, got 999"):
        draw_run(mini, Run("cloudy", 1, "grid", 0.4, positions=999))
    with pytest.raises(DataError, match="has no free position on a grid of 99 m: use a smaller spacing"):
        draw_run(mini, Run("cloudy", 1, "halfway", 99))
    for wrong in ("cloudy", "rainy1", "cloudy0"):
        with pytest.raises(ConfigError, match=r"got '(cloudy'; did you mean 'cloudy1'|rainy1')|number must be"):
            Run.parse(wrong)


def test_corners_that_cannot_be_rounded(mini: Building) -> None:
    corner = np.array([[0.3, 3.6], [0.3, 6.4], [2.6, 6.4]])
    desk = replace(mini.items[0], kind="desk", x=0.55, y=6.15, facing=0.0, size=(0.3, 0.3, 0.7), room="office_west")
    tight = replace(mini, paths={"path1": corner}, items=(desk,))
    with pytest.raises(
        DataError, match=r": rounding the corners of path 'path1' leads into .* of room '1PO-A' at \(0\.\d+, 6"
    ):
        drive(tight, "path1", 0.15, np.random.default_rng(0), 0.0)
